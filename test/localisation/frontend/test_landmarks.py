import weakref

import numpy as np

from sfr_loc_map.geometry.camera import Poses
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.localisation.frontend.landmarks import (
    COARSE_HALF,
    ENOUGH_TO_ALIGN,
    ENOUGH_TO_FOLLOW,
    NO_PATCHES,
    HostPatches,
    Landmarks,
    Patches,
)
from sfr_loc_map.localisation.frontend.patch import LocalPlanes, build_pyramid, cut_patches, templates_of
from sfr_loc_map.localisation.frontend.pose_solver import LandmarkEstimates

BLACK = build_pyramid(np.zeros((128, 128), np.uint8))


def hosted(grey: np.ndarray) -> HostPatches:
    """Patches of grey levels `(n, S * S)`, without texture at the smaller levels."""
    patches = np.zeros((len(grey), 3, grey.shape[1]), np.float32)
    patches[:, 0] = grey
    return HostPatches(np.full((len(grey), 2), 64.0), templates_of(patches), BLACK[1:])


def landmarks(inverse_depth: np.ndarray) -> Landmarks:
    count, rotation = len(inverse_depth), matrix_from_rotvec([0.1, 0.2, 0.3])
    hosts = Poses(np.tile(rotation, (count, 1, 1)), np.tile([1.0, 2.0, 3.0], (count, 1)))
    rays = np.column_stack((np.linspace(-0.5, 0.5, count), np.full(count, 0.1), np.ones(count)))
    return Landmarks(
        np.arange(count),
        LocalPlanes(hosts, np.zeros((count, 2)), inverse_depth, np.zeros((count, 2))),
        LandmarkEstimates(hosts, rays, inverse_depth, np.zeros((count, 3, 3))),
        Patches((hosted(np.zeros((count, 9))),), np.arange(count)),
        np.zeros((count, 4)),
    )


def test_patches_are_those_of_the_hosts() -> None:
    ramp = np.array([-1.0, 0.0, 1.0] * 3, np.float32)
    greys = [np.multiply.outer(10 * number + np.arange(count), ramp) for number, count in enumerate((3, 0, 2, 4))]
    patches = Patches(tuple(map(hosted, greys)), np.array([0, 2, 4, 5, 8]))
    np.testing.assert_array_equal(patches[0].values[:, 0, 2], [0, 2, 21, 30, 33])
    assert Patches(patches.hosted, patches.rows[:0])[0].values.shape == (0, 3, 9)


def test_coarse_patches_are_cut_where_they_are_used_and_have_no_texture_beyond_the_edge() -> None:
    pyramid = build_pyramid(np.random.default_rng(0).integers(0, 255, (128, 128), np.uint8))
    uv = np.array([[64.0, 60.0], [10.0, 64.0], [70.0, 66.0]])
    host = HostPatches(uv, hosted(np.zeros((3, 9))).fine, pyramid[1:])
    found = Patches((NO_PATCHES, host), np.array([0, 1, 2]))[1]
    inside = cut_patches(pyramid[1].image, (uv[[0, 2]] + 0.5) / 2.0 - 0.5, COARSE_HALF)
    np.testing.assert_array_equal(found.values[[0, 2]], templates_of(inside).values)
    assert not found.values[1].any()  # at level 1 its patch would begin 1 pixel from the edge


def test_few_are_enough_to_align_from_all_of_them_and_what_is_unused_is_freed_at_once() -> None:
    marks = landmarks(np.ones(3 * ENOUGH_TO_ALIGN))
    np.testing.assert_array_equal(marks.few.index, np.arange(0, 3 * ENOUGH_TO_ALIGN, 3))
    small = landmarks(np.ones(ENOUGH_TO_ALIGN))
    assert small.few.patches is small.followed.patches is small.patches
    assert len(landmarks(np.ones(ENOUGH_TO_FOLLOW + 1)).followed.index) == ENOUGH_TO_FOLLOW
    alive = weakref.ref(small)
    del small
    assert alive() is None  # not by a cycle: their patches are megabytes
