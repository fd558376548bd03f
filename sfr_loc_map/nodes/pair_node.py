"""What the nodes that process stereo pairs have in common."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar, TypeVar

from sfr_loc_map.config import param
from sfr_loc_map.errors import ConfigError, SfrError
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.nodes.lifecycle.managed_node import ManagedNode
from sfr_loc_map.nodes.lifecycle.parameters import NodeConfig
from sfr_loc_map.nodes.lifecycle.worker import Overload
from sfr_loc_map.nodes.stereo_input import ReceivedPair, StereoInput, StereoInputConfig
from sfr_loc_map.pipeline.reception import latencies


@dataclass(frozen=True, slots=True)
class PairNodeConfig(NodeConfig):
    """Parameters that each node has that processes stereo pairs."""

    overload: str = param(
        Overload.EVERY_PAIR.value,
        doc="What is processed under overload: every_pair in order, as far as queue_size allows, or newest_first, "
        "which drops all waiting pairs when a newer one comes.",
        choices=tuple(mode.value for mode in Overload),
    )
    queue_size: int = param(
        30, doc="Most pairs that wait to be processed (every_pair); the oldest are dropped.", low=1, high=1000
    )
    frame_prefix: str = param(
        "", doc="Put before the name of each frame, as rover1/: several rovers then share one tree of frames."
    )
    input: StereoInputConfig = field(default_factory=StereoInputConfig)

    def frame(self, name: str) -> str:
        """Return the name that a frame has in messages."""
        return self.frame_prefix + name

    def check_frames(self, *names: str) -> None:
        """Check names of frames that must differ, by the rules of tf2."""
        for name in names:
            full = self.frame(name)
            if not name or full.startswith("/") or full.split() != [full]:
                raise ConfigError(f"'{full}' is no name of a frame: give one without blanks and without / before it")
        if len(set(names)) < len(names):
            raise ConfigError(f"the frames {', '.join(names)} must have different names")

    def queue(self) -> tuple[Overload, int]:
        """Return the limits that the parameters set."""
        return Overload(self.overload), self.queue_size


P = TypeVar("P", bound=PairNodeConfig)


class PairNode(ManagedNode[P]):
    """A managed node whose worker processes the pairs of one rig."""

    rig_name: ClassVar[str]
    _stereo: StereoInput | None = None

    def restart(self, reason: str) -> None:
        """Start a new run after the pairs that came before; called in the executor's thread."""
        raise NotImplementedError

    def subscribe_images(self, on_pair: Callable[[ReceivedPair], None], on_rig: Callable[[StereoRig], None]) -> None:
        """Subscribe to the images of the rig."""
        self._stereo = StereoInput(
            self.rig_name,
            self.config.input,
            on_pair,
            on_rig,
            lambda: self.restart("stamps have gone back"),
            self.status.error,
        )
        self._stereo.subscribe(self.endpoints, self.status)

    def clock_jumped_back(self) -> None:
        """Start a new run, unless its pairs have come already."""
        if self._stereo is not None and self._stereo.is_ahead_of(self.get_clock().now().nanoseconds):
            self.restart("the clock has gone back")

    def counts(self) -> dict[str, int]:
        """Return what was dropped since the start, by name."""
        return (self._stereo.counts() if self._stereo is not None else {}) | super().counts()

    def count_unprocessed(self, error: SfrError | None = None) -> None:
        """Count a pair that could not be processed, and report why."""
        if self._stereo is not None:
            self._stereo.unprocessed += 1
        if error is not None:
            self.status.error(str(error))

    def forget_waiting(self) -> None:
        """Drop the pairs that wait."""
        self.worker.clear()
        if self._stereo is not None:
            self._stereo.restart()

    def times(self, received: ReceivedPair, conversion_s: float) -> dict[str, float]:
        """Return the latencies of a result that was just published, and what decoding took, seconds."""
        now_ns = self.get_clock().now().nanoseconds
        found = latencies(received.times, received.stamp_ns, time.time_ns(), now_ns)
        return found | {"conversion_s": conversion_s}
