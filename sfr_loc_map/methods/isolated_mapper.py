"""A mapper under test in a process of its own: whatever it does, each pair has a map, an empty one at worst."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import GeometryError, MethodError
from sfr_loc_map.geometry.arrays import FloatImage
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.disparity.uncertainty import Saturation
from sfr_loc_map.mapping.mapper import FusedMap, PairMap
from sfr_loc_map.mapping.multiview.pair_view import PairView
from sfr_loc_map.mapping.reprojection import CalibrationSigma, cloud_from_disparity
from sfr_loc_map.methods.isolated_method import IsolatedMethod, check_stamp, leak_finding
from sfr_loc_map.methods.method import Method, MethodLimits
from sfr_loc_map.methods.method_process import Answer, MethodFailureError, no_usage
from sfr_loc_map.metrics.calls import CallUsage
from sfr_loc_map.metrics.score import FindingKind

F = np.float32
DISPARITY_SIGMA_PX = F(0.5)
"""Standard deviation that is assumed of a disparity of a matcher, which states none."""
NO_CALIBRATION = CalibrationSigma(0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class MapperCall:
    """What one call of a mapper under test took and did wrong.

    Attributes:
        usage: Time and memory of the call; the time is NaN where it did not return.
        finding: What it did wrong, `KIND: text`; empty for nothing.
    """

    usage: CallUsage = field(default_factory=no_usage)
    finding: str = ""


class IsolatedMapper(IsolatedMethod):
    """A mapper under test; a process that was lost is started again at the next pair."""

    def __init__(
        self,
        method: Method,
        rig: StereoRig,
        limits: MethodLimits | None = None,
        setup: Mapping[str, object] | None = None,
    ) -> None:
        """Start it.

        Args:
            method: The method.
            rig: The rig.
            limits: What it may take.
            setup: Sent to its adapter besides that.

        Raises:
            MethodError: If it does not start.
        """
        super().__init__(method, rig, limits, setup, Transform.identity())
        self._complete = True

    def disparity(self, pair: StereoPair) -> tuple[FloatImage, CallUsage, str]:
        """Return the disparities of a pair `(H, W)`, NaN where none, for a comparison of matchers; costs; finding."""
        try:
            answer = self._ask(pair, Transform.identity(), 0, {"disparity_only": True})
            found = self._disparity(pair)
            if found is None:
                found = _disparity_of(self._cloud(0), self._rig, self._rig.T_sb_left)
        except (MethodFailureError, MethodError) as error:
            return np.full(pair.left.shape, np.nan, F), no_usage(), self._finding(error)
        call = _costs(answer)
        return found, call.usage, call.finding

    def process(self, pair: StereoPair, T_lm_navsb: Transform, index: int) -> tuple[PairMap, MapperCall]:
        """Return the points that one pair sees, none where the method gave no valid ones."""
        T_lm_left = T_lm_navsb @ self._rig.T_sb_left
        nothing = np.full((self._rig.height, self._rig.width), np.nan, F)
        try:
            answer = self._ask(pair, T_lm_navsb, index, {})
            disparity = self._disparity(pair)
            if Path(self._file("cloud")).exists():
                cloud = self._cloud(index)
            elif disparity is not None:
                disparity = np.where(disparity > 0.0, disparity, F(np.nan))
                sigma = np.full_like(disparity, DISPARITY_SIGMA_PX)
                cloud = cloud_from_disparity(disparity, sigma, pair.left, self._rig, T_lm_left, index)
        except (MethodFailureError, MethodError) as error:
            empty = PointCloud.empty(fused=False)
            self._complete = False
            return self._map(pair, empty, nothing, T_lm_left, {}), MapperCall(finding=self._finding(error))
        shown = nothing if disparity is None else disparity
        return self._map(pair, cloud, shown, T_lm_left, answer.result), _costs(answer)

    def fuse(self, maps: Sequence[PairMap], last: StereoPair) -> tuple[FusedMap, MapperCall | None]:
        """Return one cloud of the pairs' maps: the method's, or their points side by side where it does not fuse.

        Args:
            maps: What `process` returned.
            last: A pair; it is shown, and not used.

        Returns:
            The map, and what the call did; None where there was none.
        """
        T_lm_left = tuple(item.view.T_lm_left for item in maps)
        call: MapperCall | None = None
        cloud: PointCloud | None = None
        statistics: Mapping[str, float] = {}
        if self._process is not None and self._process.fuses and self._complete:
            try:
                answer = self._process.show_and_call(last, {"fuse": True})
                cloud, call = replace(self._cloud(None), fused=True), _costs(answer)
                statistics = answer.result.get("statistics") or {}
            except (MethodFailureError, MethodError) as error:
                call = MapperCall(finding=self._finding(error))
        if cloud is None:
            cloud = PointCloud.concatenate([item.cloud for item in maps])
        cloud = replace(cloud, pair_stamps_ns=tuple(item.stamp_ns for item in maps))
        return FusedMap(cloud, cloud.sigma, T_lm_left, statistics), call

    def _ask(self, pair: StereoPair, T_lm_navsb: Transform, index: int, more: Mapping[str, object]) -> Answer:
        if self._is_given_up:
            raise MethodError("not started again")
        self._process = self._process or self._start(Transform.identity())
        for what in ("cloud", "disparity"):
            Path(self._file(what)).unlink(missing_ok=True)
        order = {"T_lm_navsb": T_lm_navsb.matrix.ravel().tolist(), "index": index, **more}
        answer = self._process.show_and_call(pair, order)
        check_stamp(pair, answer)
        return answer

    def _file(self, what: str) -> str:
        assert self._process is not None
        return f"{self._process.output}.{what}.npy"

    def _disparity(self, pair: StereoPair) -> FloatImage | None:
        """Return the disparities of the last answer, None where it has none."""
        path = Path(self._file("disparity"))
        if not path.exists():
            return None
        found: FloatImage = np.load(path)
        if found.shape != pair.left.shape:
            text = f"the disparity image is {found.shape}, the left image {pair.left.shape}"
            raise MethodFailureError(FindingKind.INVALID_RESULT, text, ended=False)
        if np.isinf(found).any():
            raise MethodFailureError(FindingKind.NOT_FINITE, "a disparity is infinite", ended=False)
        return found

    def _cloud(self, index: int | None) -> PointCloud:
        """Return the points of the last answer, of the pair that was asked for (None: of all)."""
        try:
            cloud = PointCloud.from_structured(np.load(self._file("cloud")), fused=False)
        except (OSError, ValueError, GeometryError) as error:
            raise MethodFailureError(FindingKind.INVALID_RESULT, f"no cloud: {error}", ended=False) from error
        if not (np.isfinite(cloud.xyz).all() and np.isfinite(cloud.sigma).all()):
            raise MethodFailureError(FindingKind.NOT_FINITE, "a point or its sigma is not finite", ended=False)
        if len(cloud) and not (cloud.u.max() < self._rig.width and cloud.v.max() < self._rig.height):
            raise MethodFailureError(FindingKind.INVALID_RESULT, "a point names a pixel outside the image", ended=False)
        return cloud if index is None else replace(cloud, pair=np.full(len(cloud), index, np.uint8))

    @staticmethod
    def _map(
        pair: StereoPair, cloud: PointCloud, disparity: FloatImage, T_lm_left: Transform, result: Mapping[str, Any]
    ) -> PairMap:
        shape = disparity.shape
        plain = Saturation(np.zeros(shape, np.bool_), np.zeros(shape, np.uint8), 0.0)
        view, figures = PairView(cloud, disparity, T_lm_left, 0.0), result.get("statistics") or {}
        warnings = tuple(result.get("warnings") or ())
        return PairMap(pair.stamp_ns, cloud, cloud.sigma, view, plain, NO_CALIBRATION, figures, warnings)


def _costs(answer: Answer) -> MapperCall:
    return MapperCall(answer.usage, leak_finding(answer))


def _disparity_of(cloud: PointCloud, rig: StereoRig, T_lm_left: Transform) -> FloatImage:
    """Return the disparities `(H, W)` that points have at their pixels."""
    depth = (cloud.xyz.astype(np.float64) - T_lm_left.translation) @ T_lm_left.rotation[:, 2]
    disparity: NDArray[np.float32] = np.full((rig.height, rig.width), np.nan, F)
    seen = depth > 0.0
    disparity[cloud.v[seen], cloud.u[seen]] = (rig.fx * rig.baseline_m / depth[seen]).astype(F)
    return disparity
