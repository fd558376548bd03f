"""Common parts of the nodes that process the pairs of one stereo rig."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import TypeVar

from std_msgs.msg import String

from sfr_loc_map.calls.call_message import encode_call
from sfr_loc_map.calls.call_record import CallRecord
from sfr_loc_map.configuration.parameters import param
from sfr_loc_map.errors import ConfigError, InputError
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.message_types import Level
from sfr_loc_map.metrics.calls.call_meter import CallMeter
from sfr_loc_map.nodes.lifecycle.managed_node import ManagedNode
from sfr_loc_map.nodes.lifecycle.parameters import NodeConfig
from sfr_loc_map.nodes.stereo.missing_input import Input, missing_input
from sfr_loc_map.nodes.stereo.stereo_input import ReceivedPair, StereoInput, StereoInputConfig
from sfr_loc_map.ros.transport import latencies
from sfr_loc_map.run_order import AGREEING
from sfr_loc_map.suite_names import Task
from sfr_loc_map.topics import call_topic
from sfr_loc_map.worker import Overload

CALL_DEPTH = 1000  #: Number of calls kept for a slow subscriber.


@dataclass(frozen=True, slots=True)
class PairNodeConfig(NodeConfig):
    """Parameters common to the nodes that process stereo pairs."""

    overload: str = param(
        Overload.ALL.value,
        doc="Policy under overload. every_pair: all pairs are processed in order, up to queue_size waiting pairs. "
        "newest_first: a new pair replaces all waiting pairs.",
        choices=tuple(mode.value for mode in Overload),
    )
    queue_size: int = param(
        30, doc="Maximum number of waiting pairs (every_pair); the oldest pairs are dropped.", low=1, high=1000
    )
    frame_prefix: str = param(
        "", doc="Prefix of each frame name, such as rover1/, so that several rovers can share one tf tree."
    )
    input: StereoInputConfig = field(default_factory=StereoInputConfig)

    def frame(self, name: str) -> str:
        """Return a frame name with the prefix, as used in messages."""
        return self.frame_prefix + name

    def check_message_frame(self, what: str, found: str, parameter: str) -> None:
        """Raise an InputError if the frame of a message is not empty and differs from the frame in a parameter."""
        wanted = self.frame(getattr(self, parameter))
        if found not in ("", wanted):
            raise InputError(f"{what} is in frame '{found}': frame '{wanted}' (parameter {parameter}) is required")

    def check_frame_names(self, *names: str) -> None:
        """Raise a ConfigError if frame names violate the rules of tf2 or are equal."""
        for name in names:
            full = self.frame(name)
            if not name or full.startswith("/") or full.split() != [full]:
                raise ConfigError(f"'{full}' is not a frame name: give a name without spaces and without a leading /")
        if len(set(names)) < len(names):
            raise ConfigError(f"the frames are {', '.join(names)}: different names are required")

    def queue(self) -> tuple[Overload, int]:
        """Return the overload policy and the queue size of the parameters."""
        return Overload(self.overload), self.queue_size


P = TypeVar("P", bound=PairNodeConfig)


def decoded(received: ReceivedPair) -> tuple[StereoPair, float]:
    """Return the decoded pair, and the time of decoding and rectification, s."""
    begin_s = time.perf_counter()
    pair = received.decode()
    return pair, time.perf_counter() - begin_s


class PairNode(ManagedNode[P], ABC):
    """A managed node whose worker processes the pairs of one rig; its input is handled in the executor's thread.

    The table shows what happens to the state of both nodes at an activation, at `~/reset`, and at a new run, which
    begins when the stamps jump or the clock is set back. A configuration and a clean-up create all state again
    (`reset_state`).

    | state | activation | `~/reset` | new run |
    |---|---|---|---|
    | pairs that wait for the worker | cleared | cleared | processed first |
    | waiting images, last stamp | cleared | cleared | stamps: kept; clock: cleared |
    | sequence number of the last image (`TransportGaps`) | cleared | kept | kept |
    | numbers of dropped messages | kept | kept | kept |
    | calibration, bit depth | cleared | kept | kept |
    | extrinsics from /tf_static, `motion_prior` | kept | kept | kept |
    | localiser | kept | starts at the identity | starts at its first pose |
    | published path | kept | cleared | cleared by the first older stamp |
    | pairs that wait for a pose | cleared | cleared | cleared |
    | poses of `nav/pose` | cleared | cleared | kept, because they may belong to the new run |
    | map in progress | kept | cleared | cleared |

    `motion_prior` has runs of its own (`OdometryBuffer`). Each pair contains its rig. If the cameras of a pair differ
    from those of the previous pair, the localiser restarts at its last pose, and the map in progress is cleared. After
    an internal fault (`restart_after_fault`), the localiser restarts at its last pose, and the map in progress is
    cleared.
    """

    task: Task

    @abstractmethod
    def on_pair(self, pair: ReceivedPair) -> None:
        """Enqueue a pair for the worker, immediately or when the other input of the pair is received."""

    @abstractmethod
    def on_new_run(self, reason: str) -> None:
        """Start a new run once the pairs received earlier are processed."""

    @property
    def rig(self) -> StereoRig | None:
        """The rig of the next pairs; None until camera_info of both cameras is received."""
        return self._stereo.rig

    def agreeing_stamps(self) -> int:
        """Return how many consecutive pairs after a jump of the stamps start a new run."""
        return AGREEING

    def setup(self) -> None:
        """Create the meter and the publisher of calls.

        Calls are latched, so that the doctor can detect whether the node has processed input.
        """
        self.meter = CallMeter()
        self._call_publisher = self.endpoints.add_publisher(String, call_topic(self.task), CALL_DEPTH, latched=True)

    def reset_state(self) -> None:
        """Create the state of the node, without input and results."""
        self._failed = 0  # pairs that could not be processed
        self._silent_periods = 0  # consecutive calls of `report_periodically` without input
        self._stereo = StereoInput(
            self.task.rig,
            self.config.input,
            self.status,
            self.endpoints,
            on_pair=self.on_pair,
            on_new_run=self.on_new_run,
            agreeing=self.agreeing_stamps(),
        )

    def subscribe(self) -> None:
        """Subscribe to the images and the camera_info, which defines the rig."""
        self.forget_waiting()
        self._call_count_before = 0  # number of calls at the last `report_periodically`
        self._stereo.subscribe()

    @contextmanager
    def ignoring_broken(self) -> Iterator[None]:
        """Ignore a message, with a warning, if the `with` block raises an InputError."""
        try:
            yield
        except InputError as error:
            self.status.warn(f"{error}; ignored")

    def report_periodically(self) -> None:
        """Log how many messages were dropped.

        If no pair was processed since the last call, also report what the node waits for. The log has this report after
        each period with input, and after the 1st, 2nd, 4th, 8th, ... of consecutive periods without input.
        """
        super().report_periodically()
        self._stereo.losses.update_publishers()
        has_worked = self.status.call_count > self._call_count_before or not self.worker.is_idle
        self._call_count_before = self.status.call_count
        is_silent = not any(item.received for item in self.inputs() if item.is_stream)
        self._silent_periods = self._silent_periods + 1 if is_silent else 0
        is_log_due = self._silent_periods.bit_count() <= 1  # with input, or 1, 2, 4, 8, ... silent periods
        missing = self.waits_for()
        self.reset_received()
        if has_worked or not missing or (is_silent and not self.expects_input()):
            return
        if is_silent and self.status.call_count:
            missing = f"The source has ended or is silent. {missing}"
        self.status.note_problem(Level.WARN, missing)
        if is_log_due:
            self.get_logger().warning(missing)

    def inputs(self) -> list[Input]:
        """Return the inputs of the pairs, each with its number of messages since `reset_received`."""
        return self._stereo.inputs()

    def reset_received(self) -> None:
        """Reset the counts of received messages."""
        self._stereo.reset_received()

    def waits_for(self) -> str:
        """Return in one line what the node waits for; empty if nothing is missing."""
        has_received = self.status.call_count > 0
        return missing_input(self, self.inputs(), has_received=has_received) or self._stereo.apart_text()

    def clock_jumped_back(self) -> None:
        """Start a new run, unless pairs with stamps of the set-back clock were received already."""
        self._stereo.clock_jumped_back(self.get_clock().now().nanoseconds)

    def counts(self) -> dict[str, int]:
        """Return the numbers of messages dropped since the configuration, by cause."""
        counts = self._stereo.counts() | super().counts()
        counts["dropped_rejected"] += self._failed
        return counts

    def count_failed(self) -> None:
        """Count a pair that could not be processed."""
        self._failed += 1

    def forget_waiting(self) -> None:
        """Forget the messages and pairs that wait, and the last stamp; the next pair begins a run."""
        self.worker.clear()
        self._stereo.forget_waiting()

    def publish_call(self, call: CallRecord, level: Level) -> None:
        """Publish the record of a call with the numbers of dropped messages.

        Programs read this report on `call_topic`, and people read it on /diagnostics.
        """
        call = replace(call, counts=self.counts())
        self._call_publisher.publish(String(data=encode_call(call)))
        self.status.report_call(call, level, self.meter.method)

    def times(self, received: ReceivedPair, conversion_s: float) -> dict[str, float]:
        """Return the latencies of a result and its decoding time, s; called when the result has just been published."""
        now_ns = self.get_clock().now().nanoseconds
        found = latencies([info for _, info in received.images], received.stamp_ns, time.time_ns(), now_ns)
        return found | {"conversion_s": conversion_s}
