"""A method under test in a process of its own: whatever it does, each pair has an estimate or a map, lost or empty."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sfr_loc_map.errors import GeometryError
from sfr_loc_map.geometry.arrays import FloatArray, FloatImage
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import Task
from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState, lost_covariance
from sfr_loc_map.mapping.config import MAX_PAIRS
from sfr_loc_map.mapping.mapper import FusedMap, PairMap
from sfr_loc_map.mapping.reprojection import cloud_from_disparity
from sfr_loc_map.methods.method_process import MethodCall, MethodFailureError, MethodProcess
from sfr_loc_map.methods.registry import Method, MethodLimits
from sfr_loc_map.metrics.score import FindingKind, MethodRecord

F = np.float32
SYMMETRY = 1e-6  #: Largest asymmetry of a covariance, over its largest element.
DISPARITY_SIGMA_PX = F(0.5)  #: Standard deviation that is assumed of a disparity of a matcher, which states none.


class IsolatedMethod(AbstractContextManager["IsolatedMethod"]):
    """A method under test; a process that was lost is started again at the next pair, at the last known pose."""

    def __init__(
        self,
        method: Method,
        rig: StereoRig,
        T_ds_rb: Transform | None = None,
        limits: MethodLimits | None = None,
        setup: Mapping[str, object] | None = None,
        hidden: Sequence[Path] = (),
    ) -> None:
        """Start it at a pose; `setup` is sent to its adapter besides rig and pose; it cannot read what is hidden."""
        self._method, self._rig, self._setup, self._hidden = method, rig, dict(setup or {}), hidden
        self._limits, self._starts = limits or MethodLimits(), 0
        self._T_rb_left = rig.T_rb_left if method.task is Task.LOCALISATION else Transform.identity()
        self._last, self._complete = T_ds_rb or Transform.identity(), True
        self._process: MethodProcess | None = None
        process = self._started()
        self.record: MethodRecord = method.record(process.version, process.isolation)
        self.idle_bytes: int | None = process.idle_bytes  # resident after warm-up, None where that is not known
        self.maps_sets: bool = process.maps_sets  # in one call, which then is the only one of a mapper

    @property
    def alive(self) -> bool:
        """Whether its process is there."""
        return self._process is not None

    def close(self) -> None:
        """End its process."""
        if self._process is not None:
            self._process.close()

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def _is_given_up(self) -> bool:
        return self._process is None and self._starts > self._limits.restarts

    def _started(self) -> MethodProcess:
        if self._process is None:
            self._starts += 1
            self._T_ds_first_left = self._last @ self._T_rb_left
            given = (self._limits, self._last, self._setup, self._hidden)
            self._process = MethodProcess(self._method, self._rig, *given)
        return self._process

    def _failed(self, error: MethodFailureError) -> MethodCall:
        """Return what it did wrong, and forget a process that has ended."""
        if error.ended:
            self._process = None
        again = f"; not started again after {self._starts} starts" if error.ended and self._is_given_up else ""
        return MethodCall(finding=f"{error.kind}: {error}{again}", reason=error.kind.value)

    # ---- localisers

    def localise(self, pair: StereoPair, order: Mapping[str, object] | None = None) -> tuple[PoseEstimate, MethodCall]:
        """Return the estimate at one pair, lost where the method gave none that is valid, and what the call did."""
        if self._is_given_up:
            return self._lost(pair, MethodCall(reason="not started again"))
        call = MethodCall()
        try:
            call, result = self._started().call([pair], order or {})
            _check_stamp(pair, result)
            T_ds_rb = self._pose(result)
            covariance = _covariance(result.get("covariance"))
        except MethodFailureError as error:
            return self._lost(pair, replace(self._failed(error), usage=call.usage))
        call = replace(call, reason=str(result.get("reason", "")))
        state = TrackingState(result.get("state", TrackingState.TRACKING))
        if T_ds_rb is None or state is TrackingState.LOST:
            return self._lost(pair, call)
        self._last = T_ds_rb
        stated = np.full((6, 6), np.nan) if covariance is None else covariance
        step = None if result.get("step") is None else np.asarray(result["step"], np.float64)
        call = replace(call, covariance=covariance, step=step)
        return PoseEstimate(pair.stamp_ns, T_ds_rb, stated, state), call

    def _pose(self, result: Mapping[str, Any]) -> Transform | None:
        """Return the pose of RB in DS, None where the method does not know it."""
        by_left = "T_first_left" in result
        numbers = result["T_first_left" if by_left else "T_ds_rb"]
        if numbers is None:
            return None
        matrix = np.reshape(np.asarray(numbers, np.float64), (4, 4))
        if not np.isfinite(matrix).all():
            raise MethodFailureError(FindingKind.NOT_FINITE, "the pose has a number that is not finite")
        try:
            pose = Transform.from_matrix(matrix)
        except GeometryError as error:
            raise MethodFailureError(FindingKind.INVALID_RESULT, str(error)) from error
        return self._T_ds_first_left @ pose @ self._T_rb_left.inverse() if by_left else pose

    def _lost(self, pair: StereoPair, call: MethodCall) -> tuple[PoseEstimate, MethodCall]:
        estimate = PoseEstimate(pair.stamp_ns, self._last, lost_covariance(), TrackingState.LOST)
        return estimate, replace(call, covariance=lost_covariance())

    # ---- mappers

    def map_set(self, pairs: Sequence[PosedStereoPair]) -> tuple[list[PairMap], FusedMap, MethodCall]:
        """Return what one call makes of one to three pairs: each pair's part of the cloud, the cloud, what it did."""
        cloud, call, warnings = PointCloud.empty(), MethodCall(), ()
        stamps_ns = tuple(item.pair.stamp_ns for item in pairs)
        T_lm_left = tuple(item.T_lm_navsb @ self._rig.T_sb_left for item in pairs)
        orders = [_posed(item.pair.stamp_ns, item.T_lm_navsb, number) for number, item in enumerate(pairs)]
        try:
            call, result = self._called([item.pair for item in pairs], {"set": orders})
            cloud = replace(self._cloud(len(pairs)), fused=bool(result["fused"]))
            warnings = tuple(result.get("warnings") or ())
        except MethodFailureError as error:
            call = self._failed(error)
        cloud = replace(cloud, pair_stamps_ns=stamps_ns)
        parts = [cloud.select(cloud.pair == number) for number in range(len(pairs))]
        maps = [self._pair_map(*about) for about in zip(stamps_ns, parts, T_lm_left, strict=True)]
        return maps, FusedMap(cloud, cloud.sigma, T_lm_left, call.statistics, warnings), call

    def map_pair(self, pair: StereoPair, T_lm_navsb: Transform, index: int) -> tuple[PairMap, MethodCall]:
        """Return the points that one pair sees, none where the method gave no valid ones, and what the call did."""
        T_lm_left = T_lm_navsb @ self._rig.T_sb_left
        disparity, cloud, warnings = None, PointCloud.empty(fused=False), ()
        order = {"set": [_posed(pair.stamp_ns, T_lm_navsb, 0)]} if self.maps_sets else {}
        try:
            call, result = self._called([pair], order or _posed(pair.stamp_ns, T_lm_navsb, index))
            disparity = self._disparity(pair)
            if self._file("cloud").exists():
                found = self._cloud(MAX_PAIRS)
                cloud = replace(found, pair=np.full(len(found), index, np.uint8))
            elif disparity is not None:
                disparity = np.where(disparity > 0.0, disparity, F(np.nan))
                sigma = np.full_like(disparity, DISPARITY_SIGMA_PX)
                cloud = cloud_from_disparity(disparity, sigma, pair.left, self._rig, T_lm_left, index)
            warnings = tuple(result.get("warnings") or ())
        except MethodFailureError as error:
            call, self._complete = self._failed(error), False
        return self._pair_map(pair.stamp_ns, cloud, T_lm_left, disparity, call.statistics, warnings), call

    def _pair_map(
        self,
        stamp_ns: int,
        cloud: PointCloud,
        T_lm_left: Transform,
        disparity: FloatImage | None = None,
        figures: Mapping[str, float] = {},
        warnings: tuple[str, ...] = (),
    ) -> PairMap:
        shown = np.full((self._rig.height, self._rig.width), np.nan, F) if disparity is None else disparity
        return PairMap(
            stamp_ns, cloud, cloud.sigma, T_lm_left, shown, fusion_input=None, statistics=figures, warnings=warnings
        )

    def fuse(self, maps: Sequence[PairMap], last: StereoPair) -> tuple[FusedMap, MethodCall | None]:
        """Return one cloud of the pairs' maps, and what the call did; points stand side by side if it cannot fuse."""
        call: MethodCall | None = None
        cloud = PointCloud.concatenate([item.cloud for item in maps])
        if self._process is not None and self._process.fuses and self._complete:
            try:
                made, _ = self._process.call([last], {"fuse": True})
                cloud, call = replace(self._cloud(len(maps)), fused=True), made
            except MethodFailureError as error:
                call = self._failed(error)
        cloud = replace(cloud, pair_stamps_ns=tuple(item.stamp_ns for item in maps))
        T_lm_left = tuple(item.T_lm_left for item in maps)
        return FusedMap(cloud, cloud.sigma, T_lm_left, {} if call is None else call.statistics), call

    def _called(self, pairs: Sequence[StereoPair], order: Mapping[str, object]) -> tuple[MethodCall, Mapping[str, Any]]:
        """Return what a call of a mapper took and reports; the arrays of the one before are gone."""
        if self._is_given_up:
            raise MethodFailureError(FindingKind.CRASHED, "not started again")
        process = self._started()
        for what in ("cloud", "disparity"):
            self._file(what).unlink(missing_ok=True)
        call, result = process.call(pairs, order)
        _check_stamp(pairs[-1], result)
        return call, result

    def _file(self, what: str) -> Path:
        assert self._process is not None
        return Path(f"{self._process.output}.{what}.npy")

    def _disparity(self, pair: StereoPair) -> FloatImage | None:
        path = self._file("disparity")
        if not path.exists():
            return None
        found: FloatImage = np.load(path)
        if found.shape != pair.left.shape:
            text = f"the disparity image is {found.shape}, the left image {pair.left.shape}"
            raise MethodFailureError(FindingKind.INVALID_RESULT, text)
        if np.isinf(found).any():
            raise MethodFailureError(FindingKind.NOT_FINITE, "a disparity is infinite")
        return found

    def _cloud(self, pairs: int) -> PointCloud:
        """Return the points of the last answer, which are of so many pairs."""
        try:
            cloud = PointCloud.from_structured(np.load(self._file("cloud")), fused=False)
        except (OSError, ValueError, GeometryError) as error:
            raise MethodFailureError(FindingKind.INVALID_RESULT, f"no cloud: {error}") from error
        if not (np.isfinite(cloud.xyz).all() and np.isfinite(cloud.sigma).all()):
            raise MethodFailureError(FindingKind.NOT_FINITE, "a point or its sigma is not finite")
        if len(cloud) and not (cloud.u.max() < self._rig.width and cloud.v.max() < self._rig.height):
            raise MethodFailureError(FindingKind.INVALID_RESULT, "a point names a pixel outside the image")
        if len(cloud) and not cloud.pair.max() < pairs:
            text = f"a point names pair {cloud.pair.max()}: there are {pairs}, counted from 0"
            raise MethodFailureError(FindingKind.INVALID_RESULT, text)
        return cloud


def _posed(stamp_ns: int, T_lm_navsb: Transform, index: int) -> dict[str, object]:
    return {"stamp_ns": stamp_ns, "T_lm_navsb": T_lm_navsb.matrix.ravel().tolist(), "index": index}


def _check_stamp(pair: StereoPair, result: Mapping[str, Any]) -> None:
    """Refuse the answer to another pair; one without a stamp is to this."""
    stamp_ns = result.get("stamp_ns", pair.stamp_ns)
    if stamp_ns != pair.stamp_ns:
        text = f"answered for stamp {stamp_ns}, asked for {pair.stamp_ns}"
        raise MethodFailureError(FindingKind.WRONG_STAMP, text)


def _covariance(numbers: Any) -> FloatArray | None:  # noqa: ANN401 - 36 numbers or None
    covariance = np.reshape(np.asarray([np.nan] * 36 if numbers is None else numbers, np.float64), (6, 6))
    if np.isnan(covariance).all():
        return None
    if not np.isfinite(covariance).all():
        raise MethodFailureError(FindingKind.NOT_FINITE, "the covariance has a number that is not finite")
    asymmetry = np.abs(covariance - covariance.T).max()
    if covariance.diagonal().min() < 0.0 or asymmetry > SYMMETRY * np.abs(covariance).max():
        text = "the covariance is not symmetric, or a variance is negative"
        raise MethodFailureError(FindingKind.INVALID_RESULT, text)
    return covariance
