"""Landmarks that a pose does not explain, against their projections."""

from dataclasses import replace

import numpy as np

from sfr_loc_map.geometry.camera import Pose, Poses, StereoCamera
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.localisation.frontend.image_pyramid import Pyramid
from sfr_loc_map.localisation.frontend.landmarks import BORDER, HostPatches, Landmarks, Patches
from sfr_loc_map.localisation.frontend.motion_segmentation import MIN_MOTION_PX, project, unexplained_by
from sfr_loc_map.localisation.frontend.patch import SIDE, templates_of
from sfr_loc_map.localisation.frontend.tracking import StereoFrame, TrackingResult

CAMERA = StereoCamera(200.0, 210.0, 80.0, 60.0, 0.1)
SHAPE = (120, 160)


def test_what_is_in_view_and_what_moved_follows_from_the_projections() -> None:
    random = np.random.default_rng(0)
    count = 400
    uv = np.rint(random.uniform((0, 0), SHAPE[::-1], (count, 2)))
    rotations = np.array([matrix_from_rotvec(0.1 * random.normal(size=3)) for _ in range(count)])
    fine = templates_of(random.normal(size=(count, 3, SIDE * SIDE)).astype(np.float32))
    landmarks = replace(
        Landmarks.none(),
        index=np.arange(count),
        hosts=Poses(rotations, 0.1 * random.normal(size=(count, 3))),
        uv=uv,
        rays=np.column_stack((CAMERA.normalised(uv), np.ones(count))),
        inverse_depth=random.uniform(-0.2, 1.0, count),
        patches=Patches((HostPatches(uv, fine, ()),), np.arange(count)),
    )
    pose = Pose(matrix_from_rotvec([0.0, 0.05, 0.02]), np.array([0.1, 0.0, 1.5]))
    image = random.uniform(0, 255, SHAPE).astype(np.float32)
    pyramid = Pyramid((image,))
    frame = StereoFrame(0, image.astype(np.uint8), pyramid, pyramid)
    result = TrackingResult(
        pose, np.eye(6), landmarks, np.zeros((count, 4)), np.ones((count, 2, 3)), np.full(count, 1e3)
    )

    seen = project(pose, landmarks, CAMERA)
    inside = np.all((seen > BORDER) & (seen < [SHAPE[1] - 1 - BORDER, SHAPE[0] - 1 - BORDER]), axis=1)
    moved = ~(np.abs(seen - uv).max(axis=1) < MIN_MOTION_PX)
    assert np.isnan(seen[:, 0]).any()
    assert 0 < inside.sum() < count
    found = unexplained_by(result, frame, CAMERA)
    np.testing.assert_array_equal(found.in_view, inside)
    np.testing.assert_allclose(found.uv, seen, atol=1e-9)
    np.testing.assert_array_equal(found.rows, inside)
    assert not found.fixed.any()

    # what the image shows where it was cut is fixed, if the pose moves it
    left, top = SIDE // 2, SIDE // 2
    inner = np.flatnonzero(np.all((uv >= left + 4) & (uv < np.array(SHAPE[::-1]) - left - 4), axis=1))
    for n in inner:
        column, row = uv[n].astype(int)
        cut = image[row - top : row + top + 1, column - left : column + left + 1]
        landmarks.patches.level(0).values[n, 0] = cut.reshape(-1)
    fixed = unexplained_by(result, frame, CAMERA).fixed
    np.testing.assert_array_equal(np.flatnonzero(fixed), inner[moved[inner]])
