"""The mapper: one call per stereo pair, and one call that fuses up to three of them.

LM is the local map, the frame of the points. NAVSB is the frame of the stereo rig for mapping, which the rig calls SB:
`T_lm_navsb` is the pose of a pair, and `T_sb_left` is that of its left camera in NAVSB. Disparities are those of the
left image, in pixels. Lengths are in metres.

The stages of `Mapper.process`, with their modules and results:

1. `check_images` (`checks`): images that are textureless, identical or of another size are refused.
2. `estimate_disparity` (`disparity/estimation`) -> `DisparityMap`: disparity, sigma and status of each pixel of the
   left image, and the fraction of the textured pixels that are measured.
3. `check_matches` (`checks`): a pair is refused if too few of its textured pixels are measured.
4. `measure_right_rotation` (`disparity/right_camera`) -> `CameraRotation`: yaw, pitch and roll of the right camera
   relative to its calibration, from the vertical disparity at measured pixels. Filled pixels are no measurements.
5. `fill_holes` (`disparity/hole_filling`) -> `DisparityMap`: invalid pixels take the surface beside them where the
   images agree.
6. `without_roll` (`disparity/right_camera`) -> `DisparityMap`: the effect of a roll is removed from the disparities.
7. `within_range` (`reprojection`) -> `DisparityMap`: pixels beyond the largest range become invalid.
8. `view_of_pair` (`reprojection`) -> `PairView`: the valid disparities become points in LM.
9. `calibration_sigma` (`calibration_sigma`) -> `CalibrationSigma`: the uncertainty of the calibration given the
   rotation of the right camera.
10. `sigma_of_view` (`point_sigma`) -> `PointSigma`: sigma of the points, increased by saturation (the random part) and
    by the uncertainty of the calibration (the total).
11. `findings_of_pair` (`pair_findings`) -> `Findings`: statistics and warnings.

The stages of `Mapper.fuse`:

1. `without_fixed_content` (`multiview/fixed_content`) -> views and `Findings`: content that is fixed to the image is
   removed.
2. `register_views` (`multiview/registration`), on request -> views and `Findings`: later pairs are moved to fit those
   before.
3. `fuse_views` (`multiview/fusion`, `multiview/projection`) -> `FusedViews`: points on which pairs agree move along
   their rays to the mean by inverse variance. Of points that sample the same spot one is kept. A point is dropped if a
   pair of larger weight sees through it, that is, observes a farther surface at its pixel.
4. `point_sigma` (`point_sigma`) -> `PointSigma`: sigma of the fused points, as above.

No stage changes its arguments, and the mapper has no state but its rig, its parameters and the search range of
disparities that follows from both. Compiled kernels and the network that judges pixels beside jumps of disparity are
loaded once for a process. During small solves numba's number of threads is 1 (`conjugate_gradients`). Elevation and
hazard grids are made of a cloud by `terrain`, not by the mapper.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sfr_loc_map import __version__
from sfr_loc_map.config import checked
from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.calibration_sigma import calibration_sigma, largest_of
from sfr_loc_map.mapping.checks import check_images, check_index, check_matches, check_pair_count
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.disparity.estimation import estimate_disparity
from sfr_loc_map.mapping.disparity.hole_filling import fill_holes
from sfr_loc_map.mapping.disparity.right_camera import measure_right_rotation, without_roll
from sfr_loc_map.mapping.maps import FusedMap, FusionInput, MappedPair, PairMap
from sfr_loc_map.mapping.multiview.fixed_content import without_fixed_content
from sfr_loc_map.mapping.multiview.fusion import fuse_views
from sfr_loc_map.mapping.multiview.registration import register_views
from sfr_loc_map.mapping.pair_findings import findings_of_pair
from sfr_loc_map.mapping.pair_view import read_only
from sfr_loc_map.mapping.point_sigma import point_sigma, sigma_of_view
from sfr_loc_map.mapping.reprojection import view_of_pair, within_range
from sfr_loc_map.mapping.search_range import SearchRange, search_range


class Mapper:
    """Turns stereo pairs into point clouds in LM."""

    version = __version__

    def __init__(self, rig: StereoRig, config: MappingConfig = MappingConfig()) -> None:  # noqa: B008 - frozen
        """Prepare for a rig; raises ConfigError if the parameters do not fit together or the rig."""
        self._rig = rig
        self._config = checked(config)
        self._search = search_range(rig, self._config)

    @property
    def search(self) -> SearchRange:
        """The disparities that are searched."""
        return self._search

    @staticmethod
    def warm_up() -> None:
        """Load or compile all kernels, so that no later call takes the time."""
        rig = StereoRig(width=160, height=120, fx=150.0, fy=150.0, cx=79.5, cy=59.5, baseline_m=0.1)
        scene = np.random.default_rng(0).integers(0, 256, (rig.height + 1, rig.width + 8), dtype=np.uint8)
        left = scene[1:, : rig.width].copy()
        right = scene[:-1, 8:].copy()  # a pixel lower: the rows of the right image are shifted
        right[40:60, 40:80] = 255  # saturated, and a hole to fill
        mapper = Mapper(rig)
        pair_map = mapper.process(StereoPair(0, left, right), Transform.identity())
        mapper.fuse([pair_map, pair_map])

    def map(self, pairs: Sequence[PosedStereoPair]) -> FusedMap:
        """Return one cloud of one to three pairs: the mapping call of the specification [1.3].

        Raises MappingError as `process` and `fuse` do, which are its stages.
        """
        check_pair_count(len(pairs))
        return self.fuse([self.process(item.pair, item.T_lm_navsb, index) for index, item in enumerate(pairs)])

    def process(self, pair: StereoPair, T_lm_navsb: Transform, index: int = 0) -> MappedPair:
        """Return the map of a pair, whose points have an index of 0 to 2 as their `pair`.

        The index distinguishes the points of several maps that are not fused. `fuse` numbers the pairs anew.

        Raises MappingError for another index, for images of another size than the rig's, for a textureless image, for
        identical images, and for images that do not match (`check_matches`).
        """
        check_index(index)
        check_images(pair, self._rig)
        estimated = estimate_disparity(pair, self._search.count)
        check_matches(pair, estimated, self._search.count)
        rotation = measure_right_rotation(estimated, self._rig)
        filled = fill_holes(estimated)
        unrolled = without_roll(filled, rotation, self._rig)
        in_range = within_range(unrolled, self._search.min_disparity_px)
        view = view_of_pair(in_range, self._rig, T_lm_navsb @ self._rig.T_sb_left)
        calibration_of_pair = calibration_sigma(rotation, self._rig, self._config.calibration)
        saturation = in_range.saturation
        sigma = sigma_of_view(view, saturation, calibration_of_pair, self._rig)
        findings = findings_of_pair(in_range, rotation, self._rig, self._config.calibration)
        pair_in_set = np.full(view.points.size, index, np.uint8)
        cloud = view.points.to_cloud(sigma.total, pair_in_set, fused=False)
        random_sigma = read_only(sigma.random)
        disparity_px = read_only(view.images.disparity)
        return MappedPair(
            stamp_ns=pair.stamp_ns,
            cloud=cloud,
            random_sigma=random_sigma,
            T_lm_left=view.T_lm_left,
            disparity_px=disparity_px,
            pixel_status=read_only(in_range.status),
            fusion_input=FusionInput(
                rig=self._rig,
                view=view,
                saturation=saturation,
                calibration=calibration_of_pair,
                original_values=(cloud, random_sigma, view.T_lm_left, disparity_px),
            ),
            statistics=findings.statistics,
            warnings=findings.warnings,
        )

    def fuse(self, maps: Sequence[PairMap]) -> FusedMap:
        """Return one cloud of up to three pairs; the `pair` of its points is the position of their map in the order.

        Inputs, views, poses and saturations are in the order of the maps.

        Raises MappingError for no map or more than three, for a map that `process` did not make or whose points,
        sigmas, pose or disparities were replaced since, and for maps of other cameras than those of the mapper.
        """
        check_pair_count(len(maps))
        inputs = [_fusion_input(item, self._rig) for item in maps]
        cleaned = without_fixed_content([item.view for item in inputs], self._rig)
        views = cleaned.views
        findings = cleaned.findings
        if self._config.refine_poses:
            registered = register_views(views, self._rig)
            views = registered.views
            findings += registered.findings
        fused = fuse_views(views, self._rig)
        poses_lm_left = tuple(view.T_lm_left for view in views)
        saturations = [item.saturation for item in inputs]
        largest_calibration = largest_of(item.calibration for item in inputs)
        sigma = point_sigma(
            fused.points,
            fused.pair,
            poses_lm_left=poses_lm_left,
            saturations=saturations,
            calibration=largest_calibration,
            rig=self._rig,
        )
        cloud = fused.points.to_cloud(sigma.total, fused.pair, fused=len(maps) > 1)
        findings += fused.findings
        return FusedMap(
            cloud=replace(cloud, pair_stamps_ns=tuple(item.stamp_ns for item in maps)),
            random_sigma=read_only(sigma.random),
            T_lm_left=poses_lm_left,
            statistics=findings.statistics,
            warnings=findings.warnings,
        )


def _fusion_input(pair_map: PairMap, rig: StereoRig) -> FusionInput:
    """Return the input that `Mapper.process` stored in a map.

    Raises MappingError for a map of another method or of other cameras, and for a map whose values were replaced. Their
    arrays are read-only, so that they are not changed in place.
    """
    if not isinstance(pair_map, MappedPair):
        raise MappingError(f"the map of stamp {pair_map.stamp_ns} was not made by `Mapper.process`: fuse maps of it")
    found = pair_map.fusion_input
    if not found.rig.same_cameras(rig):
        raise MappingError(
            f"the map of stamp {pair_map.stamp_ns} was made with other cameras than those of this mapper: fuse maps of "
            "one rig"
        )
    values = (pair_map.cloud, pair_map.random_sigma, pair_map.T_lm_left, pair_map.disparity_px)
    if any(value is not original for value, original in zip(values, found.original_values, strict=True)):
        raise MappingError(
            f"the map of stamp {pair_map.stamp_ns} has another cloud, sigma, pose or disparity than `Mapper.process` "
            "gave it: fuse maps as they were made, and select or move points afterwards"
        )
    return found
