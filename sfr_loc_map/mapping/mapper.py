"""The mapper: one call per stereo pair, one to fuse up to three of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.checks import check_images, check_matches, matched_share
from sfr_loc_map.mapping.config import MAX_PAIRS, MappingConfig
from sfr_loc_map.mapping.fusion import View, fused
from sfr_loc_map.mapping.registration import Fit, fitted
from sfr_loc_map.mapping.reprojection import cloud_from_disparity
from sfr_loc_map.mapping.semi_global_matching import match, search_range
from sfr_loc_map.mapping.uncertainty import sigma_of, trusted
from sfr_loc_map.mapping.variational_refinement import refine


@dataclass(frozen=True, slots=True, eq=False)
class PairMap:
    """What one stereo pair says of the terrain.

    Attributes:
        stamp_ns: The pair's stamp.
        T_lm_navsb: The pose it was made with.
        disparity_px: `(H, W)` float32, pixels, of the left picture; NaN where none.
        cloud: Its points in LM, with `pair` as given to `process`.
        statistics: Figures of this call by name.
        warnings: What is suspicious, one line each.
    """

    stamp_ns: int
    T_lm_navsb: Transform
    disparity_px: NDArray[np.float32]
    cloud: PointCloud
    statistics: Mapping[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class FusedMap:
    """The map of up to three pairs.

    Attributes:
        cloud: Points in LM; each names the pair and pixel that weigh most in it.
        T_lm_navsb: Poses of the pairs that it was made with: those given, or as refined.
        statistics: Figures of the fusion by name (overlap and disagreement per pair, ...).
        warnings: What is suspicious, one line each.
    """

    cloud: PointCloud
    T_lm_navsb: tuple[Transform, ...] = ()
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
        """Load or compile all machine code, so that no call pays for it."""
        side = 64
        noise = np.random.default_rng(0).integers(0, 256, (side, side + 8), dtype=np.uint8)
        left, right = noise[:, :side].copy(), noise[:, 8:].copy()
        initial = np.full(left.shape, 8.0, np.float32)
        initial[:, side // 2 :] = 4.0
        refined = refine(left.astype(np.float32), right.astype(np.float32), initial)
        sigma = sigma_of(refined)
        trusted(left.astype(np.float32), refined, initial, sigma)
        cloud = cloud_from_disparity(initial, sigma, left, self._rig, Transform.identity(), 0)
        view = View(cloud, initial, self._rig.T_sb_left, refined.noise)
        fused([view, view], self._rig)

    def process(self, pair: StereoPair, T_lm_navsb: Transform, index: int) -> PairMap:
        """Return the points that one pair sees.

        Args:
            pair: Rectified pictures of the rig's size.
            T_lm_navsb: Takes points in NAVSB to LM.
            index: Number of the pair within its set: 0, 1 or 2.

        Raises:
            MappingError: If the size is not the rig's, the index is not 0 to 2, a picture is empty, or the two do not
                match (swapped, not rectified, not of the same moment).
        """
        if pair.left.shape != (self._rig.height, self._rig.width):
            raise MappingError(
                f"pictures of stamp {pair.stamp_ns} are {pair.left.shape[1]} x {pair.left.shape[0]}: the rig has "
                f"{self._rig.width} x {self._rig.height}; give the rig of these pictures"
            )
        if not 0 <= index < MAX_PAIRS:
            raise MappingError(f"pair index is {index}: a map has up to {MAX_PAIRS} pairs, 0 to {MAX_PAIRS - 1}")
        check_images(pair)
        left, right = pair.left.astype(np.float32), pair.right.astype(np.float32)
        initial = match(pair.left, pair.right, self._search.count)
        refined = refine(left, right, initial)
        sigma = sigma_of(refined)
        usable = trusted(left, refined, initial, sigma) & (refined.disparity_px >= self._search.farthest)
        share = matched_share(left, usable)
        warnings = check_matches(pair, share, refined.alignment, self._search.count)
        disparity = np.where(usable, refined.disparity_px, np.float32(np.nan))
        cloud = cloud_from_disparity(disparity, sigma, pair.left, self._rig, T_lm_navsb, index)
        statistics = {
            "points": float(len(cloud)),
            "density": len(cloud) / disparity.size,
            "noise_grey": refined.noise,
            "gain": refined.alignment.gain,
            "offset_grey": refined.alignment.offset,
            "vertical_offset_px": refined.alignment.rows_px[0],
            "vertical_offset_largest_px": refined.alignment.largest_rows_px,
            "matched_share": share,
        }
        return PairMap(pair.stamp_ns, T_lm_navsb, disparity, cloud, statistics, warnings)

    def fuse(self, maps: Sequence[PairMap]) -> FusedMap:
        """Return one cloud of up to three pairs.

        Raises:
            MappingError: For no pair, or more than three.
        """
        if not 1 <= len(maps) <= MAX_PAIRS:
            raise MappingError(f"a map is fused from 1 to {MAX_PAIRS} pairs: got {len(maps)}")
        views = [
            View(item.cloud, item.disparity_px, item.T_lm_navsb @ self._rig.T_sb_left, item.statistics["noise_grey"])
            for item in maps
        ]
        fit = fitted(views, self._rig) if self._refine_poses else Fit(views)
        result = fused(fit.views, self._rig)
        poses = tuple(view.T_lm_left @ self._rig.T_sb_left.inverse() for view in fit.views)
        return FusedMap(result.cloud, poses, {**result.statistics, **fit.statistics}, (*result.warnings, *fit.warnings))
