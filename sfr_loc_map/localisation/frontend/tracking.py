"""Landmarks of the window looked for in a new pair, and the pose that follows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.localisation.backend.online_calibration import RightOffset
from sfr_loc_map.localisation.backend.sliding_window import Landmarks
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.frontend.image_pyramid import LEVELS, Pyramid
from sfr_loc_map.localisation.frontend.patch_tracking import plane_homographies, track_patches
from sfr_loc_map.localisation.frontend.photometric_alignment import align_pose
from sfr_loc_map.localisation.frontend.pose_solver import solve_pose
from sfr_loc_map.localisation.parallel import both

Pose = tuple[FloatArray, FloatArray]
"""Rotation `(3, 3)` left camera to world, and position `(3,)`, metres."""
LEAST_CORRELATION = 0.6
"""Of a patch with the picture where it is found."""


@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """A pair tracked against the window.

    Attributes:
        rotation: `(3, 3)` left camera to world.
        position: `(3,)` metres.
        information: `(6, 6)` of the pose given the window.
        landmarks: The M landmarks looked for.
        observed: `(M, 4)` u, v left, u, v right; NaN where not seen.
        variance: `(M, 2, 3)` uu, uv, vv, px^2.
        chi: `(M,)` squared Mahalanobis residual a degree of freedom; NaN where not seen.
    """

    rotation: FloatArray
    position: FloatArray
    information: FloatArray
    landmarks: Landmarks
    observed: FloatArray
    variance: FloatArray
    chi: FloatArray

    @property
    def residual_px(self) -> float:
        """Typical residual of the agreeing landmarks, pixels: root of the median of chi times the variance."""
        seen = np.isfinite(self.observed[:, ::2])
        variance = np.where(seen, self.variance[:, :, (0, 2)].mean(axis=2), 0.0).sum(axis=1) / np.maximum(
            seen.sum(axis=1), 1
        )
        typical = np.sqrt(self.chi * variance)[self.inliers]
        return float(np.median(typical)) if len(typical) else float("nan")

    @property
    def left_count(self) -> int:
        """Number of agreeing landmarks that were found in the left picture."""
        return int(np.count_nonzero(self.inliers & np.isfinite(self.observed[:, 0])))

    @property
    def right_share(self) -> float:
        """Share of the landmarks found in the left picture that were found in the right one."""
        left = np.isfinite(self.observed[:, 0])
        return float(np.isfinite(self.observed[left, 2]).mean()) if left.any() else 0.0

    @property
    def inliers(self) -> NDArray[np.bool_]:
        """Landmarks `(M,)` that agree with the pose."""
        return np.nan_to_num(self.chi, nan=1e9) < 9.0


class Tracker:
    """Finds landmarks in pairs: first all together on small copies of the left picture, then each in both pictures."""

    def __init__(self, rig: StereoRig, config: LocalisationConfig, camera: FloatArray) -> None:
        """Track for a rig whose `(4,)` camera is fx, fy, cx, cy."""
        self._baseline, self._config, self._camera = rig.baseline_m, config, camera

    def align(self, left: Pyramid, marks: Landmarks, starts: list[Pose]) -> Pose:
        """Return the pose to some tenths of a pixel, from the best of some starts."""
        top = LEVELS - 1
        results = [self._align_level(left, top, marks, start, 6) for start in starts]
        rotation, position, _, _ = max(results, key=lambda result: result[2])
        # the finest level adds nothing: `refine` starts from some tenths of a pixel
        for level in range(top - 1, 0, -1):
            rotation, position, _, _ = self._align_level(left, level, marks, (rotation, position), 4)
        return rotation, position

    def refine(self, left: Pyramid, right: Pyramid, marks: Landmarks, start: Pose, offset: RightOffset) -> Tracked:
        """Return what is found of the landmarks near where a pose puts them, and the pose that follows."""
        places = (*start, marks.host_rotations, marks.host_positions, marks.uv, marks.rho, marks.slopes)
        found = both(
            track_patches,
            *(
                (image.levels[0], marks.patches[0], marks.uv, plane_homographies(*places, self._camera, shift), 2.5, 6)
                for image, shift in ((left, 0.0), (right, self._baseline))
            ),
        )
        for side in found:
            side[side[:, 6] < LEAST_CORRELATION] = np.nan
        observed = np.column_stack((found[0][:, :2], found[1][:, :2] - offset.at(found[1][:, :2])))
        variance = np.stack((self.variance(found[0][:, 2:]), self.variance(found[1][:, 2:])), axis=1)
        known = (marks.host_rotations, marks.host_positions, marks.rays, marks.rho, marks.covariance)
        pose = solve_pose(*start, *known, observed, variance, self._camera, self._baseline, 10)
        rotation, position, information, chi = pose
        return Tracked(rotation, position, information, marks, observed, variance, chi)

    def refine_from_afar(
        self, left: Pyramid, right: Pyramid, marks: Landmarks, start: Pose, offset: RightOffset
    ) -> Tracked:
        """Return the same from a start that is right to some pixels."""
        rotation, position, _, _ = self._align_level(left, 0, marks, start, 6)
        return self.refine(left, right, marks, (rotation, position), offset)

    def trusted(self, tracked: Tracked) -> bool:
        """Tell whether enough landmarks agree on the pose, of all and of those that were found."""
        agree, found = int(tracked.inliers.sum()), int(np.isfinite(tracked.chi).sum())
        return agree >= self._config.min_tracked and agree > 0.5 * found and found > 0.2 * len(tracked.landmarks)

    def variance(self, found: FloatArray) -> FloatArray:
        """Return the variances `(N, 3)` uu, uv, vv of tracked positions, px^2: half the patch's, half the picture's.

        Args:
            found: `(N, 4)` or more columns: covariance for a noise of one grey level (uu, uv, vv, px^2), residual.
        """
        residual = found[:, 3:4]
        typical = np.nanmedian(residual) if np.isfinite(residual).any() else 1.0
        variance = found[:, :3] * (1.2 * np.maximum(residual, typical) ** 2)
        variance[:, 0] += self._config.pixel_floor**2
        variance[:, 2] += self._config.pixel_floor**2
        return np.asarray(variance)

    def _align_level(
        self, left: Pyramid, level: int, marks: Landmarks, start: Pose, rounds: int
    ) -> tuple[FloatArray, FloatArray, float, float]:
        places = (*start, marks.host_rotations, marks.host_positions, marks.uv, marks.rho)
        homographies = plane_homographies(*places, marks.slopes, self._camera, 0.0)
        return align_pose(left.levels[level], level, marks.patches[level], homographies, *places, self._camera, rounds)
