"""A rover that drives back and forth in front of a textured wall: images of any size with exact poses, endlessly."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import GreyImage
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform

WALL_M = 3.0
"""Distance of the wall x = WALL_M from DS and LM."""
HALF_WALL_M = 2.6
TURN = 40
"""Pairs after which the rover turns back."""
LOCSB_EXTRINSICS = Transform.from_quat([0.3, 0.01, 0.2], [0.01, -0.02, 0.03, 0.9993])
"""Extrinsics `T_rb_locsb` of the localisation rig."""


class Scene:
    """The images of both stereo rigs.

    Attributes:
        loc: Rig of the localisation cameras.
        nav: Rig of the navigation cameras.
    """

    def __init__(self, width: int = 160, height: int = 120) -> None:
        """Make the wall for images of this size."""
        focal = 0.94 * width
        camera = (width, height, focal, focal, 0.5 * (width - 1), 0.5 * (height - 1), 0.12)
        self.loc, self.nav = StereoRig(*camera, LOCSB_EXTRINSICS), StereoRig(*camera)
        self._texels_per_m = focal
        self._wall = _texture(round(2 * HALF_WALL_M * self._texels_per_m))
        self._loc_images = cache(self._make_loc)
        self._nav_images = cache(self._make_nav)

    def loc_pair(self, index: int, stamp_ns: int) -> StereoPair:
        """Return a pair of the drive."""
        return StereoPair(stamp_ns, *self._loc_images(_there_and_back(index)))

    def true_pose(self, index: int) -> Transform:
        """Return `T_ds_rb` of a pair of the drive."""
        step = _there_and_back(index)
        rotation = matrix_from_rotvec([0.0, 0.0, 0.05 + 0.002 * step])
        return Transform(rotation, np.array([0.01 * step, -0.3 + 0.012 * step, 0.05]))

    def nav_pair(self, index: int, stamp_ns: int) -> StereoPair:
        """Return one of the three pairs of a map."""
        return StereoPair(stamp_ns, *self._nav_images(index % 3))

    def nav_pose(self, index: int) -> Transform:
        """Return `T_lm_navsb` of one of the three pairs of a map."""
        rotation = matrix_from_rotvec([0.0, 0.02, 0.05 * (index % 3 - 1)])
        return Transform(rotation, np.array([0.2, 0.1 * (index % 3), 0.1]))

    def _make_loc(self, step: int) -> tuple[GreyImage, GreyImage]:
        return self._images(self.true_pose(step) @ LOCSB_EXTRINSICS, self.loc)

    def _make_nav(self, index: int) -> tuple[GreyImage, GreyImage]:
        return self._images(self.nav_pose(index), self.nav)

    def _images(self, T_world_sb: Transform, rig: StereoRig) -> tuple[GreyImage, GreyImage]:
        left = T_world_sb @ rig.T_sb_left
        right = left @ Transform(np.eye(3), np.array([rig.baseline_m, 0.0, 0.0]))
        return self._image(left, rig), self._image(right, rig)

    def _image(self, T_world_camera: Transform, rig: StereoRig) -> GreyImage:
        """Render an image: the ray of each pixel meets the wall, whose grey value is interpolated there."""
        u, v = np.meshgrid(np.arange(rig.width), np.arange(rig.height))
        rays = np.stack(((u - rig.cx) / rig.fx, (v - rig.cy) / rig.fy, np.ones(u.shape)), axis=-1)
        rays = rays @ T_world_camera.rotation.T
        origin = T_world_camera.translation
        met = origin + rays * ((WALL_M - origin[0]) / rays[..., 0])[..., None]
        at = ((met[..., 1:] + HALF_WALL_M) * self._texels_per_m).astype(np.float32)
        grey = cv2.remap(self._wall, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        return np.asarray(grey, np.uint8)


def _there_and_back(index: int) -> int:
    phase = index % (2 * TURN)
    return phase if phase <= TURN else 2 * TURN - phase


def _texture(size: int) -> GreyImage:
    noise = np.random.default_rng(5).standard_normal((size, size), np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.6) * 1.6 + cv2.GaussianBlur(noise, (0, 0), 5.0) * 5.0
    return np.clip(128 + 45 * smooth / smooth.std(), 0, 255).astype(np.uint8)
