import weakref

import numpy as np

from sfr_loc_map.geometry.camera import Poses
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.localisation.frontend.image_pyramid import LEVELS, build_pyramid
from sfr_loc_map.localisation.frontend.landmarks import (
    COARSE_HALF,
    ENOUGH_TO_ALIGN,
    ENOUGH_TO_FOLLOW,
    HostPatches,
    Landmarks,
    Patches,
)
from sfr_loc_map.localisation.frontend.patch import cut_patches, templates_of

BLACK = build_pyramid(np.zeros((128, 128), np.uint8))


def hosted(grey: np.ndarray) -> HostPatches:
    """Patches of grey levels `(n, S * S)`, without texture at the smaller levels."""
    patches = np.zeros((len(grey), 3, grey.shape[1]), np.float32)
    patches[:, 0] = grey
    return HostPatches(np.full((len(grey), 2), 64.0), templates_of(patches), BLACK.levels[1:])


def landmarks(inverse_depth: np.ndarray) -> Landmarks:
    count = len(inverse_depth)
    rotation, position = matrix_from_rotvec([0.1, 0.2, 0.3]), np.array([1.0, 2.0, 3.0])
    rays = np.column_stack((np.linspace(-0.5, 0.5, count), np.full(count, 0.1), np.ones(count)))
    return Landmarks(
        index=np.arange(count),
        hosts=Poses(np.tile(rotation, (count, 1, 1)), np.tile(position, (count, 1))),
        uv=np.zeros((count, 2)),
        rays=rays,
        inverse_depth=inverse_depth,
        slopes=np.zeros((count, 2)),
        covariance=np.zeros((count, 3, 3)),
        patches=Patches((hosted(np.zeros((count, 9))),), np.arange(count)),
        last_seen=np.zeros((count, 4)),
    )


def test_points_lie_on_their_rays_at_their_depth() -> None:
    marks = landmarks(np.array([0.5, 0.1, 2.0]))
    in_camera = (marks.points - marks.hosts.positions[0]) @ marks.hosts.rotations[0]
    np.testing.assert_allclose(in_camera[:, 2], [2.0, 10.0, 0.5])
    np.testing.assert_allclose(in_camera / in_camera[:, 2:], marks.rays, atol=1e-12)


def test_a_landmark_at_infinity_is_no_point() -> None:
    points = landmarks(np.array([0.5, 0.0, -0.1])).points
    assert np.isfinite(points[0]).all()
    assert np.isnan(points[1:]).all()


def test_median_depth_has_a_limit() -> None:
    assert landmarks(np.array([0.5, 0.2, 0.1])).median_depth == 5.0
    assert landmarks(np.zeros(3)).median_depth == 1000.0
    assert Landmarks.none().median_depth == 0.0
    assert len(Landmarks.none()) == 0
    assert Landmarks.none().points.shape == (0, 3)


def test_a_subset_is_a_mask_on_each_array() -> None:
    marks = landmarks(np.array([0.5, 0.2, 0.1]))
    part = marks.subset(np.array([True, False, True]))
    np.testing.assert_array_equal(part.index, [0, 2])
    np.testing.assert_array_equal(part.inverse_depth, [0.5, 0.1])
    assert [len(part.patches.level(number)) for number in range(LEVELS)] == [2] * LEVELS


def test_patches_are_those_of_the_hosts() -> None:
    ramp = np.array([-1.0, 0.0, 1.0] * 3, np.float32)
    hosts = [
        hosted(np.multiply.outer(10 * number + np.arange(count), ramp)) for number, count in enumerate((3, 0, 2, 4))
    ]
    patches = Patches(tuple(hosts), np.array([0, 2, 4, 5, 8]))
    np.testing.assert_array_equal(patches.level(0).values[:, 0, 2], [0, 2, 21, 30, 33])
    part = patches.subset(np.array([False, True, False, True, True]))
    np.testing.assert_array_equal(part.level(0).values[:, 0, 2], [2, 30, 33])
    assert part.subset(np.zeros(3, np.bool_)).level(0).values.shape == (0, 3, 9)


def test_coarse_patches_are_cut_where_they_are_used_and_have_no_texture_beyond_the_edge() -> None:
    image = np.random.default_rng(0).integers(0, 255, (128, 128), np.uint8)
    pyramid = build_pyramid(image)
    uv = np.array([[64.0, 60.0], [10.0, 64.0], [70.0, 66.0]])
    host = HostPatches(uv, hosted(np.zeros((3, 9))).fine, pyramid.levels[1:])
    found = Patches((HostPatches.none(), host), np.array([0, 1, 2])).level(1)
    inside = cut_patches(pyramid.levels[1], (uv[[0, 2]] + 0.5) / 2.0 - 0.5, COARSE_HALF)
    np.testing.assert_array_equal(found.values[[0, 2]], templates_of(inside).values)
    assert not found.values[1].any()  # at level 1 its patch would begin 1 pixel from the edge
    assert not found.moments[1].any()


def test_few_are_enough_to_align_from_all_of_them() -> None:
    marks = landmarks(np.ones(3 * ENOUGH_TO_ALIGN))
    np.testing.assert_array_equal(marks.few.index, np.arange(0, len(marks), 3))
    assert len(landmarks(np.ones(ENOUGH_TO_ALIGN + 1)).few) == ENOUGH_TO_ALIGN
    assert len(landmarks(np.ones(ENOUGH_TO_FOLLOW)).followed) == ENOUGH_TO_FOLLOW


def test_landmarks_that_are_no_longer_used_are_freed_at_once() -> None:
    marks = landmarks(np.ones(ENOUGH_TO_ALIGN))
    assert marks.few is marks.followed is marks
    alive = weakref.ref(marks)
    del marks
    assert alive() is None  # not by a cycle: their patches are megabytes
