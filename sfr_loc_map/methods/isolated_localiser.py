"""A localiser under test in a process of its own: whatever it does, each pair has an estimate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import isfinite, isnan
from operator import sub
from typing import Any

import numpy as np

from sfr_loc_map.errors import GeometryError, MethodError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState, lost_covariance
from sfr_loc_map.methods.isolated_method import IsolatedMethod, check_stamp, finding_kind, leak_finding
from sfr_loc_map.methods.method import Method, MethodLimits
from sfr_loc_map.methods.method_process import Answer, MethodFailureError, MethodProcess, no_usage
from sfr_loc_map.metrics.calls import CallUsage
from sfr_loc_map.metrics.score import FindingKind

SYMMETRY = 1e-6
"""Largest asymmetry of a covariance, over its largest element."""


@dataclass(frozen=True, slots=True, eq=False)
class LocaliserCall:
    """One call of a localiser under test.

    Attributes:
        estimate: Its estimate; lost where it gave none that is valid.
        usage: Time and memory of the call; the time is NaN where it did not return.
        reason: Why it is degraded or lost.
        finding: What it did wrong, `KIND: text`; empty for nothing.
        statistics: Figures that it states.
        covariance: Covariance that it states, None for none.
        step: `(27,)` uncertainty of the step that it states, None for none.
    """

    estimate: PoseEstimate
    usage: CallUsage = field(default_factory=no_usage)
    reason: str = ""
    finding: str = ""
    statistics: Mapping[str, float] = field(default_factory=dict)
    covariance: FloatArray | None = None
    step: FloatArray | None = None


class IsolatedLocaliser(IsolatedMethod):
    """A localiser under test.

    A process that was lost is started again at the next pair, at the last known pose.
    """

    def __init__(
        self,
        method: Method,
        rig: StereoRig,
        T_ds_rb: Transform,
        limits: MethodLimits | None = None,
        setup: Mapping[str, object] | None = None,
    ) -> None:
        """Start it.

        Args:
            method: The method.
            rig: Rig with its extrinsics.
            T_ds_rb: Pose of RB in DS at the first pair.
            limits: What it may take.
            setup: Sent to its adapter besides that.

        Raises:
            MethodError: If it does not start.
            GeometryError: If the extrinsics of the rig are not known.
        """
        self._T_left_rb = rig.T_rb_left.inverse()
        self._last = T_ds_rb
        super().__init__(method, rig, limits, setup, T_ds_rb)

    def _start(self, T_ds_rb: Transform) -> MethodProcess:
        self._T_ds_first_left = T_ds_rb @ self._rig.T_rb_left
        return super()._start(T_ds_rb)

    def process(self, pair: StereoPair, order: Mapping[str, object] | None = None) -> LocaliserCall:
        """Return the estimate at one pair.

        Args:
            pair: Images of the rig's size.
            order: Sent to its adapter with the pair.
        """
        if self._is_given_up:
            return self._lost(pair, "not started again")
        try:
            self._process = self._process or self._start(self._last)
            answer = self._process.show_and_call(pair, order or {})
        except (MethodFailureError, MethodError) as error:
            return self._failed(pair, error)
        return self._checked(pair, answer)

    def _checked(self, pair: StereoPair, answer: Answer) -> LocaliserCall:
        """Return the estimate of an answer, lost where that is not valid."""
        try:
            check_stamp(pair, answer)
            T_ds_rb = self._pose(answer.result)
            covariance = _covariance(answer.result.get("covariance"))
        except MethodFailureError as failure:
            return self._lost(pair, failure.kind.value, f"{failure.kind}: {failure}", answer.usage)
        finding = leak_finding(answer)
        statistics = answer.result.get("statistics") or {}
        state = TrackingState(answer.result.get("state", TrackingState.TRACKING))
        if T_ds_rb is None or state is TrackingState.LOST:
            lost = self._lost(pair, str(answer.result.get("reason", "")), finding, answer.usage)
            return replace(lost, statistics=statistics)
        self._last = T_ds_rb
        known = np.full((6, 6), np.nan) if covariance is None else covariance
        estimate = PoseEstimate(pair.stamp_ns, T_ds_rb, known, state)
        step = answer.result.get("step")
        known_step = None if step is None else np.asarray(step, np.float64)
        reason = str(answer.result.get("reason", ""))
        return LocaliserCall(estimate, answer.usage, reason, finding, statistics, covariance, known_step)

    def _pose(self, result: Mapping[str, Any]) -> Transform | None:
        """Return the pose of RB in DS; None where the method does not know it.

        Raises:
            MethodFailureError: If it is no pose.
        """
        by_left = "T_first_left" in result
        numbers = result["T_first_left" if by_left else "T_ds_rb"]
        if numbers is None:
            return None
        matrix = np.reshape(np.asarray(numbers, np.float64), (4, 4))
        if not all(map(isfinite, matrix.ravel().tolist())):
            raise MethodFailureError(FindingKind.NOT_FINITE, "the pose has a number that is not finite", ended=False)
        try:
            pose = Transform.from_matrix(matrix)
        except GeometryError as error:
            raise MethodFailureError(FindingKind.INVALID_RESULT, str(error), ended=False) from error
        return self._T_ds_first_left @ pose @ self._T_left_rb if by_left else pose

    def _failed(self, pair: StereoPair, error: MethodFailureError | MethodError) -> LocaliserCall:
        finding = self._finding(error)
        if self._is_given_up:
            finding += f"; not started again after {self._starts} starts"
        return self._lost(pair, finding_kind(error).value, finding)

    def _lost(self, pair: StereoPair, reason: str, finding: str = "", usage: CallUsage | None = None) -> LocaliserCall:
        estimate = PoseEstimate(pair.stamp_ns, self._last, lost_covariance(), TrackingState.LOST)
        return LocaliserCall(estimate, usage or no_usage(), reason, finding, covariance=lost_covariance())


def _covariance(numbers: Any) -> FloatArray | None:  # noqa: ANN401 - 36 numbers or None
    """Return a covariance `(6, 6)`, None where none is stated.

    Raises:
        MethodFailureError: If it is none.
    """
    if numbers is None:
        return None
    covariance = np.reshape(np.asarray(numbers, np.float64), (6, 6))
    values: list[float] = covariance.ravel().tolist()  # loops over a few numbers are faster than arrays of them
    if not all(map(isfinite, values)):
        if all(map(isnan, values)):
            return None
        raise MethodFailureError(FindingKind.NOT_FINITE, "the covariance has a number that is not finite", ended=False)
    transposed: list[float] = covariance.T.ravel().tolist()
    asymmetry = max(map(abs, map(sub, values, transposed)))
    if min(values[::7]) < 0.0 or asymmetry > SYMMETRY * max(map(abs, values)):
        raise MethodFailureError(
            FindingKind.INVALID_RESULT, "the covariance is not symmetric, or a variance is negative", ended=False
        )
    return covariance
