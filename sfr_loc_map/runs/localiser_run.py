"""A localiser over a complete drive, without ROS; the node makes the same calls of `process`.

    run_localiser ─► localiser_steps ─► localise, localise_with

`localise` calls our localiser in this process, and `localise_with` a method under test in its own process.
`localiser_steps` yields the estimates of a drive one by one, and `run_localiser` returns the complete drive.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sfr_loc_map.calls.call_record import CallRecord, call_of_estimate
from sfr_loc_map.calls.run_identity import hash_of_pair
from sfr_loc_map.configuration.parameters import changed
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.host_clock import checked_clock
from sfr_loc_map.io.sequence import LocSequence
from sfr_loc_map.kernels import load_kernels
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import PoseEstimate, StartPose
from sfr_loc_map.localisation.localiser import Localiser
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.methods.config_truth import check_configuration
from sfr_loc_map.methods.isolated_localiser import IsolatedLocaliser
from sfr_loc_map.methods.registry import record_of_ours
from sfr_loc_map.metrics.calls.call_meter import CallMeter
from sfr_loc_map.metrics.figures.records import MethodRecord
from sfr_loc_map.runs.track_video import FrameObserver
from sfr_loc_map.runs.under_test import Progress, UnderTest
from sfr_loc_map.signals import stopping
from sfr_loc_map.suite_names import Task

DEFAULT_STEP_S = 0.1  #: Time between pairs, s, that a method receives if the stamps of a drive do not define it.


class Step(NamedTuple):
    """The result of a call of a localiser."""

    estimate: PoseEstimate
    record: CallRecord  #: State and cost.
    method: MethodRecord  #: Method that made the call.


@dataclass(frozen=True, slots=True)
class DriveRun:
    """The steps of a drive, at least one."""

    steps: Sequence[Step]

    @property
    def trajectory(self) -> Trajectory:
        """The estimated trajectory."""
        return trajectory_of(step.estimate for step in self.steps)

    @property
    def records(self) -> list[CallRecord]:
        """State and cost of each call."""
        return [step.record for step in self.steps]

    @property
    def method(self) -> MethodRecord:
        """The method that made the estimates, from the last step, because the version may be reported late."""
        return self.steps[-1].method


def run_localiser(
    sequence: LocSequence,
    localiser: LocalisationConfig | UnderTest,
    start: StartPose,
    watch: FrameObserver | None = None,
    progress: Progress = lambda done: None,
    *,
    keeps_finished: bool = False,
) -> DriveRun:
    """Localise the pairs of a drive by our localiser or by a method under test; see `localiser_steps`.

    `progress` is called with the number of localised pairs. With `keeps_finished`, an interruption after the first pair
    ends the drive, and the run has the localised pairs. Otherwise the interruption is raised.
    """
    steps: list[Step] = []
    try:
        for step in localiser_steps(sequence, localiser, start, watch):
            steps.append(step)
            progress(len(steps))
    except KeyboardInterrupt:
        if not (keeps_finished and steps):
            raise
    return DriveRun(steps)


def localiser_steps(
    sequence: LocSequence,
    localiser: LocalisationConfig | UnderTest,
    start: StartPose,
    watch: FrameObserver | None = None,
) -> Iterator[Step]:
    """Yield the step of each pair of a drive by our localiser or by a method under test.

    `watch` is called after each pair of our localiser. Raises InputError if the drive has no pair.
    """
    if not len(sequence):
        raise InputError("the drive has no complete pair of images: at least one is required; sfr info SRC shows why")
    with checked_clock():
        if isinstance(localiser, UnderTest):
            yield from localise_with(localiser, sequence, start.T_ds_rb)
            return
        ours = record_of_ours(Task.LOCALISATION, changed(localiser))
        for estimate, record in localise(sequence, localiser, start, watch):
            yield Step(estimate, record, ours)


def localise(
    sequence: LocSequence, config: LocalisationConfig, start: StartPose, watch: FrameObserver | None = None
) -> Iterator[tuple[PoseEstimate, CallRecord]]:
    """Yield the estimate and the cost of each pair of a drive by our localiser; `watch` is called after each pair.

    A signal during a call raises a KeyboardInterrupt after the estimate of this call is yielded.
    """
    load_kernels("localisation")
    meter = CallMeter()  # first, so that the memory of the localiser itself counts
    localiser = Localiser(sequence.rig, config, start)
    for pair in sequence.pairs():
        with stopping() as stopped, meter.measure() as call:  # an exception in a kernel would end the process
            estimate = localiser.process(pair)
        if watch is not None:
            watch(pair, estimate)
        record = call_of_estimate(estimate, call, images_sha256=hash_of_pair(pair))
        yield replace(estimate, tracks=None), record
        if stopped():
            raise KeyboardInterrupt


def localise_with(under_test: UnderTest, sequence: LocSequence, T_ds_rb: Transform) -> Iterator[Step]:
    """Yield the step of each pair of a drive by a method under test, which starts at the pose `T_ds_rb`."""
    check_configuration(under_test.method.config, sequence.ground_truth)
    step_s = _frame_step_s(sequence.stamps_ns)
    setup = (sequence.rig, T_ds_rb, under_test.limits)
    with IsolatedLocaliser(under_test.method, *setup, rate_hz=1.0 / step_s, hidden=under_test.hidden) as localiser:
        for pair in sequence.pairs():
            estimate, call = localiser.localise(pair)
            record = replace(
                call_of_estimate(estimate, call.usage, images_sha256=hash_of_pair(pair)),
                statistics=call.statistics,
                covariance=call.covariance,
                reason=call.reason,
                step=call.step,
                finding=call.finding,
            )
            yield Step(estimate, record, localiser.record)


def _frame_step_s(stamps_ns: Sequence[int]) -> float:
    """Return the median time between pairs, s, so that a missing pair does not change the rate."""
    steps_ns = np.diff(np.asarray(stamps_ns, np.int64))
    steps_ns = steps_ns[steps_ns > 0]
    return float(np.median(steps_ns)) / NS_PER_S if len(steps_ns) else DEFAULT_STEP_S


def trajectory_of(estimates: Iterable[PoseEstimate]) -> Trajectory:
    """Return the trajectory of estimates."""
    return Trajectory.from_poses((estimate.stamp_ns, estimate.T_ds_rb) for estimate in estimates)
