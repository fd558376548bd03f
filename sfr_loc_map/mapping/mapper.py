"""The mapper: one call per stereo pair, one to fuse up to three of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.arrays import FloatImage
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.checks import check_images, check_matches, matched_share
from sfr_loc_map.mapping.config import MAX_PAIRS, MappingConfig
from sfr_loc_map.mapping.disparity.semi_global_matching import search_range, semi_global_matching
from sfr_loc_map.mapping.disparity.uncertainty import disparity_sigma
from sfr_loc_map.mapping.disparity.validity import valid_mask
from sfr_loc_map.mapping.disparity.variational_refinement import RefinedDisparity, refine
from sfr_loc_map.mapping.multiview.fusion import fuse_views
from sfr_loc_map.mapping.multiview.registration import Registration, register_views
from sfr_loc_map.mapping.multiview.view import View
from sfr_loc_map.mapping.reprojection import cloud_from_disparity

F = np.float32


@dataclass(frozen=True, slots=True, eq=False)
class PairMap:
    """The map of one stereo pair.

    Attributes:
        stamp_ns: The pair's stamp.
        view: Its points in LM, with `pair` as given to `process`, its disparities and pose.
        statistics: Figures of this call by name.
        warnings: What is suspicious, one line each.
    """

    stamp_ns: int
    view: View
    statistics: Mapping[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    @property
    def cloud(self) -> PointCloud:
        """Its points in LM."""
        return self.view.cloud

    @property
    def disparity_px(self) -> FloatImage:
        """Disparities of the left image `(H, W)` float32, pixels; NaN where none."""
        return self.view.disparity_px


@dataclass(frozen=True, slots=True, eq=False)
class FusedMap:
    """The map of up to three pairs.

    Attributes:
        cloud: Points in LM, each on the ray of its pair and pixel.
        T_lm_left: Poses of the pairs' left cameras that it was made with: those given, or as registered.
        statistics: Figures of the fusion by name (overlap and disagreement per pair, ...).
        warnings: What is suspicious, one line each.
    """

    cloud: PointCloud
    T_lm_left: tuple[Transform, ...] = ()
    statistics: Mapping[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


class Mapper:
    """Turns stereo pairs into point clouds in LM."""

    def __init__(self, rig: StereoRig, config: MappingConfig) -> None:
        """Prepare for a rig.

        Raises:
            ConfigError: If the parameters do not fit together or the rig.
        """
        self._rig = rig
        self._refine_poses = config.refine_poses
        self._search = search_range(rig, config)

    def warm_up(self) -> None:
        """Load or compile all kernels, so that no call pays for it."""
        side = 64
        noise = np.random.default_rng(0).integers(0, 256, (side, side + 8), dtype=np.uint8)
        left, right = noise[:, :side].copy(), noise[:, 8:].copy()
        initial = np.full(left.shape, 8.0, F)
        initial[:, side // 2 :] = 4.0
        refined = refine(left.astype(F), right.astype(F), initial)
        sigma = disparity_sigma(refined)
        valid_mask(left.astype(F), refined, initial, sigma)
        cloud = cloud_from_disparity(initial, sigma, left, self._rig, self._rig.T_sb_left, 0)
        view = View(cloud, initial, self._rig.T_sb_left, refined.noise)
        fuse_views([view, view], self._rig)

    def process(self, pair: StereoPair, T_lm_navsb: Transform, index: int) -> PairMap:
        """Return the points that one pair sees.

        Args:
            pair: Rectified images of the rig's size.
            T_lm_navsb: Takes points in NAVSB to LM.
            index: Number of the pair within its set: 0, 1 or 2.

        Raises:
            MappingError: If the size is not the rig's, the index is not 0 to 2, an image is textureless, or the two do
                not match (swapped, not rectified, not of the same moment).
        """
        if not 0 <= index < MAX_PAIRS:
            raise MappingError(f"pair index is {index}: a map has up to {MAX_PAIRS} pairs, 0 to {MAX_PAIRS - 1}")
        check_images(pair, self._rig)
        left, right = pair.left.astype(F), pair.right.astype(F)
        initial = semi_global_matching(pair.left, pair.right, self._search.count)
        refined = refine(left, right, initial)
        sigma = disparity_sigma(refined)
        valid = valid_mask(left, refined, initial, sigma) & (refined.disparity_px >= self._search.min_disparity_px)
        share = matched_share(left, valid)
        warnings = check_matches(pair, share, refined.correction, self._search.count)
        disparity = np.where(valid, refined.disparity_px, F(np.nan))
        T_lm_left = T_lm_navsb @ self._rig.T_sb_left
        cloud = cloud_from_disparity(disparity, sigma, pair.left, self._rig, T_lm_left, index)
        view = View(cloud, disparity, T_lm_left, refined.noise)
        return PairMap(pair.stamp_ns, view, _statistics(view, refined, share), warnings)

    def fuse(self, maps: Sequence[PairMap]) -> FusedMap:
        """Return one cloud of up to three pairs.

        Raises:
            MappingError: For no pair, or more than three.
        """
        if not 1 <= len(maps) <= MAX_PAIRS:
            raise MappingError(f"a map is fused from 1 to {MAX_PAIRS} pairs: got {len(maps)}")
        views = [item.view for item in maps]
        registered = register_views(views, self._rig) if self._refine_poses else Registration(views)
        fused = fuse_views(registered.views, self._rig)
        return FusedMap(
            fused.cloud,
            tuple(view.T_lm_left for view in registered.views),
            {**fused.statistics, **registered.statistics},
            (*fused.warnings, *registered.warnings),
        )


def _statistics(view: View, refined: RefinedDisparity, share: float) -> dict[str, float]:
    """Return the figures of a pair by name; `share` is that of the textured pixels that are matched."""
    return {
        "points": float(len(view.cloud)),
        "density": len(view.cloud) / view.disparity_px.size,
        "noise_grey": refined.noise,
        "gain": refined.correction.gain,
        "offset_grey": refined.correction.offset,
        "vertical_offset_px": refined.correction.vertical_px[0],
        "vertical_offset_largest_px": refined.correction.max_vertical_px,
        "matched_share": share,
    }
