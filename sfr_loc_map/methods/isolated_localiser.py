"""A localiser under test in its own process. Each pair has an estimate, whose state is `lost` after a failure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sfr_loc_map.errors import GeometryError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState, lost_covariance
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.methods.child.loop import Answer, Pose
from sfr_loc_map.methods.isolated_method import IsolatedMethod
from sfr_loc_map.methods.method_call import MethodCall, MethodFailureError, Request, RequestedPair
from sfr_loc_map.methods.method_process import ProcessSettings
from sfr_loc_map.methods.registry import Method, MethodLimits
from sfr_loc_map.metrics.figures.records import FindingKind
from sfr_loc_map.metrics.frames.covariance import UPPER, check_variances, step_variances, symmetric

COVARIANCE_TOLERANCE = 1e-6
"""Largest asymmetry and largest negative eigenvalue of a covariance whose positions and rotations are scaled so that
their largest variances are 1, because m^2 and rad^2 cannot be compared."""
STEP_NUMBERS = 48
"""Number of values in the uncertainty of a step (`StepEstimate.uncertainty`): covariance (21), systematic vector (6)
and noise (21)."""


@dataclass(frozen=True, slots=True, eq=False)
class _Result:
    """Checked answer of a localiser."""

    T_ds_rb: Transform | None  #: Pose of RB in DS; None if lost.
    covariance: FloatArray | None  #: `(6, 6)`; None if the method does not state it.
    step: FloatArray | None  #: `(48,)` uncertainty of the step; None if the method does not state it.
    state: TrackingState
    reason: str


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
        rate_scale: float = 1.0,
        keeps_rate: bool = False,
        hidden: Sequence[Path],
    ) -> None:
        """Start the localiser at a pose. Its process cannot read the paths `hidden`.

        The pairs arrive at `rate_hz`, which is `rate_scale` times the rate of their stamps; `keeps_rate` states that
        they are not sent earlier. A rate of 0 is unknown.
        """
        settings = ProcessSettings(
            method=method,
            rig=rig,
            limits=limits or MethodLimits(),
            rate_hz=rate_hz,
            keeps_rate=keeps_rate,
            hidden=hidden,
        )
        super().__init__(settings, T_ds_rb)
        self._last_pose = T_ds_rb
        self._rate_scale = rate_scale
        self._first_ns: int | None = None  # stamp of the first pair

    def localise(self, pair: StereoPair) -> tuple[PoseEstimate, MethodCall]:
        """Localise one pair. Return the estimate and the record of the call.

        If the result is invalid, the state of the estimate is lost.
        """
        self._first_ns = pair.stamp_ns if self._first_ns is None else self._first_ns
        since_start_s = (pair.stamp_ns - self._first_ns) / NS_PER_S / self._rate_scale
        request = Request(kind="pair", pairs=[RequestedPair(pair)], since_start_s=since_start_s)
        call, result = self.call(request, _read, self._last_pose)
        if result is None:
            return self._lost(pair, call)
        call = replace(call, reason=result.reason)
        if result.T_ds_rb is None or result.state is TrackingState.LOST:
            return self._lost(pair, call)
        self._last_pose = result.T_ds_rb
        stated = np.full((6, 6), np.nan) if result.covariance is None else result.covariance
        estimate = PoseEstimate(pair.stamp_ns, result.T_ds_rb, stated, result.state)
        return estimate, replace(call, covariance=result.covariance, step=result.step)

    def _lost(self, pair: StereoPair, call: MethodCall) -> tuple[PoseEstimate, MethodCall]:
        estimate = PoseEstimate(pair.stamp_ns, self._last_pose, lost_covariance(), TrackingState.LOST)
        return estimate, replace(call, covariance=lost_covariance())


def _read(answer: Answer, _: Mapping[str, bytes]) -> _Result:
    """Return the checked answer; MethodFailureError if it is invalid."""
    return _Result(
        T_ds_rb=_pose(answer.get("T_ds_rb")),
        covariance=_covariance(answer.get("covariance")),
        step=_step(answer.get("step")),
        state=_state(answer.get("state", TrackingState.TRACKING.value)),
        reason=answer.get("reason", ""),
    )


def _pose(numbers: Pose | None) -> Transform | None:
    """Return the pose of RB in DS; None if the method returned no pose."""
    if numbers is None:
        return None
    matrix = _finite(_array(numbers, (4, 4), "pose"), "pose")
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
    _finite(covariance, "covariance")
    largest = np.abs(np.diag(covariance)).reshape(2, 3).max(axis=1)
    scales = np.repeat(np.sqrt(np.where(largest > 0.0, largest, 1.0)), 3)
    scaled = covariance / scales / scales[:, None]
    is_symmetric = np.abs(scaled - scaled.T).max() <= COVARIANCE_TOLERANCE
    if not is_symmetric or np.linalg.eigvalsh(scaled).min() < -COVARIANCE_TOLERANCE:
        text = "the covariance is not symmetric and positive semi-definite"
        raise MethodFailureError(FindingKind.INVALID_RESULT, text)
    covariance = symmetric(covariance[UPPER])
    np.fill_diagonal(covariance, np.maximum(np.diag(covariance), 0.0))  # variances that are negative by rounding
    return covariance


def _step(numbers: list[float] | None) -> FloatArray | None:
    if numbers is None:
        return None
    step = _array(numbers, (STEP_NUMBERS,), "uncertainty of the step")
    if np.isnan(step).all():
        return None
    _finite(step, "uncertainty of the step")
    try:
        check_variances("step", step_variances(step))
    except ValueError as error:
        raise MethodFailureError(FindingKind.INVALID_RESULT, str(error)) from error
    return step


def _state(text: str) -> TrackingState:
    try:
        return TrackingState(text)
    except ValueError as error:
        raise MethodFailureError(FindingKind.INVALID_RESULT, str(error)) from error


def _finite(array: FloatArray, what: str) -> FloatArray:
    if not np.isfinite(array).all():
        raise MethodFailureError(FindingKind.NOT_FINITE, f"the {what} contains a non-finite number")
    return array


def _array(numbers: list[float], shape: tuple[int, ...], what: str) -> FloatArray:
    array = np.asarray(numbers, np.float64)
    if array.size != np.prod(shape):
        text = f"the {what} has {array.size} numbers: {np.prod(shape)} are required"
        raise MethodFailureError(FindingKind.INVALID_RESULT, text)
    return array.reshape(shape)
