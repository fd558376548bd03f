"""A small drive that calls each kernel of the localiser, so that no later call compiles or loads a kernel."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.frontend.landmarks import Landmarks
from sfr_loc_map.localisation.frontend.patch import SIDE
from sfr_loc_map.localisation.frontend.patch_slopes import refine_slopes
from sfr_loc_map.localisation.frontend.plane_warp import plane_homographies
from sfr_loc_map.localisation.ground.double_exposure import MIXTURE_LEVEL, mixture_of
from sfr_loc_map.localisation.ground.rigid_motion import image_motion

RIG: Final = StereoRig(
    width=320, height=240, fx=300.0, fy=300.0, cx=160.0, cy=120.0, baseline_m=0.1, T_rb_sb=Transform.identity()
)
CONFIG: Final = LocalisationConfig(window_keyframes=2, max_features=100, min_tracked=8)
SHIFTS_PX: Final = (0, 4, 30, 60, 90, 150)
"""Left edges of the images in the texture, px. Chosen so that tracking, keyframes, marginalisation and relocalisation
occur. `test_warm_up_leaves_nothing_to_compile` checks that no kernel is left to compile."""
DISPARITY_PX: Final = 10  #: Disparity of all pixels.


def small_drive() -> Iterator[StereoPair]:
    """Yield pairs of a random texture, then a black pair."""
    texture = np.random.default_rng(0).integers(0, 255, (RIG.height, RIG.width + 200), np.uint8)
    for stamp_ns, shift in enumerate(SHIFTS_PX):
        left = texture[:, shift : shift + RIG.width]
        right = texture[:, shift + DISPARITY_PX : shift + DISPARITY_PX + RIG.width]
        yield StereoPair(stamp_ns, np.ascontiguousarray(left), np.ascontiguousarray(right))
    black = np.zeros((RIG.height, RIG.width), np.uint8)
    yield StereoPair(len(SHIFTS_PX), black, black.copy())


def call_kernels_of_two_motions(landmarks: Landmarks) -> None:
    """Compare two motions and two exposures of some landmarks, which a drive with one motion does not require."""
    pose = Pose.of(Transform.identity())
    camera = RIG.camera
    image = np.zeros((RIG.height >> MIXTURE_LEVEL, RIG.width >> MIXTURE_LEVEL), np.float32)
    image_motion(pose, pose, landmarks.estimates, camera)
    homographies = plane_homographies(pose, landmarks.planes, camera, 0.0)
    mixture_of(image, landmarks, homographies, homographies)


def call_kernels_of_large_images() -> None:
    """Refine the slopes of one patch, which the small drive does not do."""
    image = np.zeros((SIDE, SIDE), np.float32)
    at = np.zeros((1, 2))
    refine_slopes(image, np.zeros((1, 3, SIDE * SIDE), np.float32), at, at)
