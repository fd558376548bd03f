"""A localiser under test in its own process. Each pair has an estimate; if the localiser fails, its state is lost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from sfr_loc_map.errors import GeometryError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState, lost_covariance
from sfr_loc_map.methods.child.loop import OrderedPair, Pose
from sfr_loc_map.methods.isolated_method import IsolatedMethod, check_stamp
from sfr_loc_map.methods.method_call import MethodCall, MethodFailureError
from sfr_loc_map.methods.registry import Method, MethodLimits
from sfr_loc_map.metrics.records import FindingKind

COVARIANCE_TOLERANCE = 1e-6
"""Largest asymmetry and largest negative eigenvalue of a covariance, relative to its largest element."""
STEP_NUMBERS = 48
"""Number of values in the uncertainty of a step (`StepEstimate.uncertainty`): covariance (21), systematic vector (6)
and noise (21)."""


class IsolatedLocaliser(IsolatedMethod):
    """A localiser; after a restart the localiser continues at the last known pose."""

    def __init__(
        self,
        method: Method,
        rig: StereoRig,
        T_ds_rb: Transform,
        limits: MethodLimits | None = None,
        *,
        rate_hz: float = 0.0,
        keeps_rate: bool = False,
        hidden: Sequence[Path],
    ) -> None:
        """Start the localiser, which cannot read `hidden`, at a pose.

        The pairs were recorded at `rate_hz`. `keeps_rate` states that they also arrive at this rate.
        """
        super().__init__(method, rig, limits, T_ds_rb=T_ds_rb, rate_hz=rate_hz, keeps_rate=keeps_rate, hidden=hidden)

    def localise(self, pair: StereoPair, since_start_s: float = 0.0) -> tuple[PoseEstimate, MethodCall]:
        """Localise one pair. Return the estimate and the record of the call.

        If the result is invalid, the state of the estimate is lost.
        """
        call = MethodCall()
        about = OrderedPair(stamp_ns=pair.stamp_ns, index=0, T_lm_navsb=None)
        try:
            call, answer, _ = self._running_process().call("pair", [pair], [about], since_start_s)
            check_stamp(pair, answer)
            T_ds_rb = _pose(answer.get("T_ds_rb"))
            covariance = _covariance(answer.get("covariance"))
            step = _step(answer.get("step"))
            state = _state(answer.get("state", TrackingState.TRACKING.value))
        except MethodFailureError as error:
            return self._lost(pair, replace(self._failed(error), usage=call.usage))
        call = replace(call, reason=answer.get("reason", ""))
        if T_ds_rb is None or state is TrackingState.LOST:
            return self._lost(pair, call)
        self._last_pose = T_ds_rb
        stated = np.full((6, 6), np.nan) if covariance is None else covariance
        return PoseEstimate(pair.stamp_ns, T_ds_rb, stated, state), replace(call, covariance=covariance, step=step)

    def _lost(self, pair: StereoPair, call: MethodCall) -> tuple[PoseEstimate, MethodCall]:
        estimate = PoseEstimate(pair.stamp_ns, self._last_pose, lost_covariance(), TrackingState.LOST)
        return estimate, replace(call, covariance=lost_covariance())


def _pose(numbers: Pose | None) -> Transform | None:
    """Return the pose of RB in DS; None if the method returned no pose."""
    if numbers is None:
        return None
    matrix = _array(numbers, (4, 4), "pose")
    if not np.isfinite(matrix).all():
        raise MethodFailureError(FindingKind.NOT_FINITE, "the pose contains a non-finite number")
    try:
        return Transform.from_matrix(matrix)
    except GeometryError as error:
        raise MethodFailureError(FindingKind.INVALID_RESULT, str(error)) from error


def _covariance(numbers: list[float] | None) -> FloatArray | None:
    if numbers is None:
        return None
    covariance = _array(numbers, (6, 6), "covariance")
    if np.isnan(covariance).all():
        return None
    if not np.isfinite(covariance).all():
        raise MethodFailureError(FindingKind.NOT_FINITE, "the covariance contains a non-finite number")
    tolerance = COVARIANCE_TOLERANCE * np.abs(covariance).max()
    is_symmetric = np.abs(covariance - covariance.T).max() <= tolerance
    if not is_symmetric or np.linalg.eigvalsh(covariance).min() < -tolerance:
        text = "the covariance is not symmetric and positive semi-definite"
        raise MethodFailureError(FindingKind.INVALID_RESULT, text)
    return covariance


def _step(numbers: list[float] | None) -> FloatArray | None:
    return None if numbers is None else _array(numbers, (STEP_NUMBERS,), "uncertainty of the step")


def _state(text: str) -> TrackingState:
    try:
        return TrackingState(text)
    except ValueError as error:
        raise MethodFailureError(FindingKind.INVALID_RESULT, str(error)) from error


def _array(numbers: list[float], shape: tuple[int, ...], what: str) -> FloatArray:
    array = np.asarray(numbers, np.float64)
    if array.size != np.prod(shape):
        text = f"the {what} has {array.size} numbers: {np.prod(shape)} are required"
        raise MethodFailureError(FindingKind.INVALID_RESULT, text)
    return array.reshape(shape)
