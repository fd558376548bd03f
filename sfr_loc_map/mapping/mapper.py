"""The mapper: one call per stereo pair, and one call that fuses up to three of them.

LM is the local map, the frame of the points. NAVSB is the frame of the stereo rig for mapping, which `StereoRig` names
SB. Disparities refer to the left image and are in pixels. Lengths are in metres.

A pair is a stereo pair. The pair index of a point (`PointCloud.pair`) is the index of its pair in the set of pairs. A
view (`PairView`) contains the data of one pair that the fusion uses.

The stages of `Mapper.process`, with their modules and results:

1. `check_pose`, `check_images` (`checks`): a pose is refused if its rotation is invalid, or if it is far from the
   origin of LM. Images are refused if they are textureless, identical, or not of the rig's size.
2. `estimate_disparity` (`disparity/estimation`) -> `DisparityMap`: disparity, sigma and status of each pixel of the
   left image, and the rotation of the right camera relative to its calibration. A pair is refused if its images do not
   match.
3. `reproject` (`pair_view`) -> `PairView`: the valid disparities are reprojected to points in LM.
4. `sigma_of_calibration` (`calibration_sigma`) -> `CalibrationSigma`: the uncertainty of the calibration given the
   measured rotation of the right camera.
5. `sigma_of_points` (`point_sigma`) -> `PointSigma`: sigma of the points. Saturation increases the random part, and the
   total also includes the uncertainty of the calibration.
6. `findings_of_pair` (`pair_findings`) -> `Findings`: statistics and warnings.

The stages of `Mapper.fuse`:

1. `without_fixed_content` (`multiview/fixed_content`) -> views and `Findings`: content that is fixed to the image is
   removed.
2. `register_views` (`multiview/registration`), on request -> views and `Findings`: later pairs are moved to agree with
   the earlier pairs.
3. `fuse_views` (`multiview/fusion`, `multiview/projection`, `multiview/pose_agreement`) -> points of each view and
   `Findings`: points on which pairs agree move along their rays to the inverse-variance weighted mean. Of several
   compared points at the same position in an image, one is kept. A point is dropped if a pair with a larger weight
   observes a surface behind the point. The same observations show whether the poses agree.
4. `sigma_of_points` (`point_sigma`) -> `PointSigma`: sigma of the fused points of each view, as for one pair.

To add

- a validity test of the pixels of one pair: the docstring of `disparity/validity/pixel_status` lists the steps.
- a test of the final disparities of one pair, measured or filled: add a value to `PixelStatus`, and call `with_reason`
  at the end of `estimate_disparity`, as for BEYOND_RANGE. The fraction of measured pixels does not change, because it
  is computed before holes are filled.
- a contribution to sigma: the docstring of `point_sigma` lists the steps.
- a test of points across pairs: add a flag to `Comparison` (`multiview/fusion`) that drops points, or a stage of
  `Mapper.fuse` that takes and returns views, like `without_fixed_content`.
- a statistic or a warning: `pair_findings` for one pair, or the findings of a stage of `multiview`.

Each stage takes results of earlier stages, and no stage changes its arguments. The only state of the mapper is its rig,
its parameters and the disparity search range that follows from both. Compiled kernels, and the network that classifies
pixels beside disparity jumps, are loaded once per process. Elevation and hazard grids are computed from a cloud by
`terrain`, not by the mapper.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sfr_loc_map import __version__
from sfr_loc_map.configuration.parameters import checked
from sfr_loc_map.geometry.arrays import read_only
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair, StereoRig, check_rig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.calibration_sigma import largest_of, sigma_of_calibration
from sfr_loc_map.mapping.checks import (
    check_images,
    check_index,
    check_items,
    check_maps,
    check_pair,
    check_pair_count,
    check_pose,
)
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.disparity.estimation import estimate_disparity
from sfr_loc_map.mapping.disparity.semi_global_matching import SearchRange, search_range_of
from sfr_loc_map.mapping.maps import FusedMap, MappedPair, warnings_of_pairs
from sfr_loc_map.mapping.multiview.fixed_content import without_fixed_content
from sfr_loc_map.mapping.multiview.fusion import fuse_views
from sfr_loc_map.mapping.multiview.registration import register_views
from sfr_loc_map.mapping.pair_findings import findings_of_pair
from sfr_loc_map.mapping.pair_view import ViewPoints, reproject
from sfr_loc_map.mapping.point_sigma import PointSigma, sigma_of_points


class Mapper:
    """Turns stereo pairs into point clouds in LM."""

    version = __version__

    def __init__(self, rig: StereoRig, config: MappingConfig = MappingConfig()) -> None:  # noqa: B008 - frozen
        """Prepare for a rig.

        Raises GeometryError if the rig has a wrong type or too small images. Raises ConfigError if the parameters are
        inconsistent or do not suit the rig.
        """
        check_rig(rig)
        self._rig = rig
        self._config = checked(config)
        self._search = search_range_of(rig, self._config)

    @property
    def search(self) -> SearchRange:
        """The range of the disparity search."""
        return self._search

    @staticmethod
    def warm_up() -> None:
        """Load or compile all kernels, so that the first call is not slower than later calls."""
        rig = StereoRig(width=160, height=120, fx=150.0, fy=150.0, cx=79.5, cy=59.5, baseline_m=0.1)
        scene = np.random.default_rng(0).integers(0, 256, (rig.height + 1, rig.width + 8), dtype=np.uint8)
        left = scene[1:, : rig.width].copy()
        right = scene[:-1, 8:].copy()  # vertical disparity of one pixel
        right[40:60, 40:80] = 255  # a saturated region, and a hole to fill
        mapper = Mapper(rig)
        pair_map = mapper.process(StereoPair(0, left, right), Transform.identity())
        mapper.fuse([pair_map, pair_map])

    def map(self, pairs: Sequence[PosedStereoPair]) -> FusedMap:
        """Return one cloud from one to three pairs: the mapping call of clause 1.3 of the specification.

        The result contains the warnings of the pairs and of the fusion, but only the statistics of the fusion. Call
        `process` and `fuse` to obtain the statistics of the pairs, too.

        Raises MappingError under the same conditions as `process` and `fuse`.
        """
        check_items(pairs, PosedStereoPair, "PosedStereoPair")
        check_pair_count(len(pairs))
        maps = [self.process(posed.pair, posed.T_lm_navsb) for posed in pairs]
        fused = self.fuse(maps)
        return replace(fused, warnings=warnings_of_pairs([item.warnings for item in maps]) + fused.warnings)

    def process(self, pair: StereoPair, T_lm_navsb: Transform, index: int = 0) -> MappedPair:
        """Return the map of a pair; `index`, 0 to 2, becomes the pair index of the points.

        The index only distinguishes the points of several maps that are used without a fusion. `fuse` ignores the
        index and assigns new indices.

        Raises MappingError if an argument has another type, the index is out of range, the rotation of the pose is
        invalid, the pose is farther than `checks.MAX_LM_M` from the origin of LM, the images do not have the rig's
        size, an image is textureless, both images are identical, or they do not match (`check_matches`).
        """
        check_index(index)
        check_pair(pair)
        check_pose(pair.stamp_ns, T_lm_navsb)
        check_images(pair, self._rig)
        prior = self._config.calibration
        T_lm_left = T_lm_navsb @ self._rig.T_sb_left
        disparity = estimate_disparity(pair, self._rig, self._search)
        view = reproject(disparity, self._rig, T_lm_left)
        calibration = sigma_of_calibration(disparity.rotation, self._rig, prior)
        sigma = sigma_of_points(view.points, view, calibration, self._rig)
        findings = findings_of_pair(disparity, self._rig, prior, self._search)
        return MappedPair(
            stamp_ns=pair.stamp_ns,
            cloud=view.points.to_cloud(sigma.total, np.full(view.points.size, index, np.uint8), fused=False),
            random_sigma=sigma.random,
            T_lm_left=view.T_lm_left,
            disparity_px=read_only(disparity.px),
            statistics=findings.statistics,
            warnings=findings.warnings,
            pixel_status=read_only(disparity.status),
            rig=self._rig,
            view=view,
            calibration=calibration,
        )

    def fuse(self, maps: Sequence[MappedPair]) -> FusedMap:
        """Return one cloud from up to three pairs; the pair index of a point is the index of its map in `maps`.

        The poses of the result are in the order of the maps.

        Raises MappingError if the argument is not a sequence of maps that `process` returned, for zero or more than
        three maps, and for a map of other cameras.
        """
        check_maps(maps, self._rig)
        views, findings = without_fixed_content([item.view for item in maps], self._rig)
        if self._config.refine_poses:
            views, of_registration = register_views(views, self._rig)
            findings += of_registration
        parts, of_fusion = fuse_views(views, self._rig)
        findings += of_fusion
        calibration = largest_of(item.calibration for item in maps)
        sizes = [part.size for part in parts]
        points = ViewPoints.concatenated(parts)
        del parts  # copied: their memory serves the standard deviations
        of_views = zip(points.split(sizes), views, strict=True)
        sigma = PointSigma.concatenated(
            [sigma_of_points(part, view, calibration, self._rig) for part, view in of_views]
        )
        pair_index = np.repeat(np.arange(len(views), dtype=np.uint8), sizes)
        stamps_ns = tuple(item.stamp_ns for item in maps)
        is_fused = len(maps) > 1
        return FusedMap(
            cloud=points.to_cloud(sigma.total, pair_index, fused=is_fused, pair_stamps_ns=stamps_ns),
            random_sigma=sigma.random,
            poses_lm_left=tuple(view.T_lm_left for view in views),
            statistics=findings.statistics,
            warnings=findings.warnings,
        )
