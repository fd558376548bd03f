"""The mapper: one call per stereo pair, one to fuse up to three of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map import __version__
from sfr_loc_map.config import checked
from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.arrays import FloatImage
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.checks import check_images, check_matches, matched_share
from sfr_loc_map.mapping.config import MAX_PAIRS, MappingConfig
from sfr_loc_map.mapping.disparity.filters import local_variance
from sfr_loc_map.mapping.disparity.hole_filling import FILLED_SIGMA_PX, fill_holes
from sfr_loc_map.mapping.disparity.photometric_residual import shift_rows
from sfr_loc_map.mapping.disparity.right_camera import camera_rotation, without_roll
from sfr_loc_map.mapping.disparity.semi_global_matching import search_range, semi_global_matching
from sfr_loc_map.mapping.disparity.uncertainty import Saturation, disparity_sigma, saturation
from sfr_loc_map.mapping.disparity.validity import valid_mask
from sfr_loc_map.mapping.disparity.variational_refinement import refine
from sfr_loc_map.mapping.multiview.fixed_content import without_fixed_content
from sfr_loc_map.mapping.multiview.fusion import fuse_views
from sfr_loc_map.mapping.multiview.pair_view import PairView
from sfr_loc_map.mapping.multiview.registration import register_views
from sfr_loc_map.mapping.reprojection import CalibrationSigma, check_calibration, cloud_from_disparity, total_sigma

F = np.float32


@dataclass(frozen=True, slots=True, eq=False)
class PairMap:
    """The map of one stereo pair."""

    stamp_ns: int  #: The pair's stamp.
    cloud: PointCloud  #: Its points in LM, with `pair` as given to `process`. Sigma has the part of the calibration.
    #: `(N,)`, metres, the part of sigma that differs from point to point: noise and smoothing.
    random_sigma: NDArray[np.float32]
    view: PairView  #: Points with the sigma by which pairs are fused; disparities and pose.
    saturation: Saturation  #: Saturated pixels, which widen the stated sigma.
    calibration: CalibrationSigma  #: Standard deviations of the calibration, widened by what the pair shows.
    statistics: Mapping[str, float] = field(default_factory=dict)  #: Figures of this call by name.
    warnings: tuple[str, ...] = ()  #: What is suspicious, one line each.

    @property
    def disparity_px(self) -> FloatImage:
        """Disparities of the left image `(H, W)` float32, pixels; NaN where none."""
        return self.view.disparity_px


@dataclass(frozen=True, slots=True, eq=False)
class FusedMap:
    """The map of up to three pairs."""

    cloud: PointCloud  #: Points in LM, each on the ray of its pair and pixel. Sigma has the part of the calibration.
    #: `(N,)`, metres, the part of sigma that differs from point to point: noise and smoothing.
    random_sigma: NDArray[np.float32]
    #: Poses of the pairs' left cameras that it was made with: those given, or as registered.
    T_lm_left: tuple[Transform, ...] = ()
    #: Figures of the fusion by name (overlap and disagreement per pair, ...).
    statistics: Mapping[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()  #: What is suspicious, one line each.


class Mapper:
    """Turns stereo pairs into point clouds in LM; `statistics` are figures of the last call by name."""

    version = __version__

    def __init__(self, rig: StereoRig, config: MappingConfig = MappingConfig()) -> None:  # noqa: B008 - frozen
        """Prepare for a rig; raises ConfigError if the parameters do not fit together or the rig."""
        config = checked(config)
        self._rig = rig
        self._refine_poses = config.refine_poses
        self._calibration = config.calibration
        self._search = search_range(rig, config)
        self.statistics: Mapping[str, float] = {}

    def warm_up(self) -> None:
        """Load or compile all kernels, so that no call pays for it."""
        rig = StereoRig(160, 120, 150.0, 150.0, 79.5, 59.5, 0.1)
        scene = np.random.default_rng(0).integers(0, 256, (rig.height, rig.width + 8), dtype=np.uint8)
        left, right = scene[:, : rig.width].copy(), scene[:, 8:].copy()
        right[40:60, 40:80] = 255  # saturated, and a hole to fill
        small = Mapper(rig)
        done = small.process(StereoPair(0, left, right), Transform.identity(), 0)
        small.fuse([done, done])
        shift_rows(left.astype(F), np.zeros(left.shape, F))  # only where rows have to be corrected

    def map(self, pairs: Sequence[PosedStereoPair]) -> FusedMap:
        """Return one cloud of one to three pairs: the mapping call of the specification [1.3].

        MappingError as of `process` and `fuse`, which are its stages.
        """
        return self.fuse([self.process(item.pair, item.T_lm_navsb, index) for index, item in enumerate(pairs)])

    def process(self, pair: StereoPair, T_lm_navsb: Transform, index: int) -> PairMap:
        """Return the points of a pair, 0 to 2 of its set; MappingError if it is not the rig's or does not match."""
        if not 0 <= index < MAX_PAIRS:
            raise MappingError(f"pair index is {index}: a map has up to {MAX_PAIRS} pairs, 0 to {MAX_PAIRS - 1}")
        check_images(pair, self._rig)
        left, right = pair.left.astype(F), pair.right.astype(F)
        initial = semi_global_matching(pair.left, pair.right, self._search.count)
        refined = refine(left, right, initial)
        sigma = disparity_sigma(refined)
        clipped = saturation(pair.left, pair.right, refined.disparity_px)
        contrast = local_variance(left)
        valid = valid_mask(left, refined, initial, sigma, contrast) & ~clipped.flat
        rotation = camera_rotation(
            left, refined.right, refined.disparity_px, valid, refined.correction.vertical_px, self._rig
        )
        share = matched_share(left, contrast, valid)
        found, filled = fill_holes(
            left, refined.right, refined.disparity_px, valid, initial, refined.noise, ~clipped.flat
        )
        sigma[filled] = np.maximum(sigma[filled], FILLED_SIGMA_PX)
        found = without_roll(found, rotation, self._rig)
        valid |= filled
        valid &= found >= self._search.min_disparity_px
        warnings = check_matches(
            pair, share, refined.correction, clipped.share, self._search.count, self._calibration.distortion_px
        )
        disparity = np.where(valid, found, F(np.nan))
        T_lm_left = T_lm_navsb @ self._rig.T_sb_left
        cloud = cloud_from_disparity(disparity, sigma, pair.left, self._rig, T_lm_left, index)
        view = PairView(cloud, disparity, T_lm_left, refined.noise)
        calibration, doubts = check_calibration(self._calibration, rotation, self._rig)
        random_sigma = cloud.sigma.copy()
        clipped.widen(random_sigma, cloud, index)
        stated = self._stated(replace(cloud, sigma=random_sigma), [T_lm_left] * (index + 1), calibration)
        yaw_known = math.isfinite(rotation.yaw_sigma_rad)
        self.statistics = {
            "points": float(len(cloud)),
            "density": len(cloud) / disparity.size,
            "noise_grey": refined.noise,
            "gain": refined.correction.gain,
            "offset_grey": refined.correction.offset,
            "vertical_offset_px": refined.correction.vertical_px[0],
            "vertical_offset_largest_px": refined.correction.max_vertical_px,
            "matched_share": share,
            "right_yaw_deg": math.degrees(rotation.yaw_rad) if yaw_known else math.nan,
            "right_yaw_sigma_deg": math.degrees(rotation.yaw_sigma_rad) if yaw_known else math.nan,
            "right_roll_deg": math.degrees(rotation.roll_rad),
            "saturated_share": clipped.share,
        }
        warnings += doubts
        return PairMap(pair.stamp_ns, stated, random_sigma, view, clipped, calibration, self.statistics, warnings)

    def fuse(self, maps: Sequence[PairMap]) -> FusedMap:
        """Return one cloud of up to three pairs; its points' `pair` is the place of their map in the order given."""
        if not 1 <= len(maps) <= MAX_PAIRS:
            raise MappingError(f"a map is fused from 1 to {MAX_PAIRS} pairs: got {len(maps)}")
        views: Sequence[PairView] = [item.view.numbered(number) for number, item in enumerate(maps)]
        views, fixed, fixed_warnings = without_fixed_content(views, self._rig)
        moved: dict[str, float] = {}
        pose_warnings: tuple[str, ...] = ()
        if self._refine_poses:
            views, moved, pose_warnings = register_views(views, self._rig)
        cloud, agreement, fusion_warnings = fuse_views(views, self._rig)
        T_lm_left = tuple(view.T_lm_left for view in views)
        random_sigma = cloud.sigma.copy()
        for number, item in enumerate(maps):
            item.saturation.widen(random_sigma, cloud, number)
        # Pairs of one rig share its calibration: the largest sigma of each part holds for all.
        calibration = CalibrationSigma(*(max(values) for values in zip(*(m.calibration for m in maps), strict=True)))
        cloud = replace(cloud, sigma=random_sigma, pair_stamps_ns=tuple(item.stamp_ns for item in maps))
        self.statistics = {**agreement, **fixed, **moved}
        return FusedMap(
            self._stated(cloud, T_lm_left, calibration),
            random_sigma,
            T_lm_left,
            self.statistics,
            (*fixed_warnings, *fusion_warnings, *pose_warnings),
        )

    def _stated(self, cloud: PointCloud, T_lm_left: Sequence[Transform], calibration: CalibrationSigma) -> PointCloud:
        """Return a cloud with the sigma that is published: its own, with the calibration's part."""
        return replace(cloud, sigma=total_sigma(cloud, T_lm_left, self._rig, calibration))
