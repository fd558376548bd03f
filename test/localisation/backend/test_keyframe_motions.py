"""Motions against a host by the poses: the relative pose of two keyframes, moved by finite differences."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from sfr_loc_map.geometry.camera import Poses
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.localisation.backend.keyframe_motions import motions_by_poses, system_of_poses

KEYFRAMES = 4
UNKNOWNS = 6 * KEYFRAMES + 1


def keyframes(random: np.random.Generator) -> Poses:
    rotations = np.stack([matrix_from_rotvec(random.normal(0, 0.3, 3)) for _ in range(KEYFRAMES)])
    return Poses(rotations, random.normal(0, 1.0, (KEYFRAMES, 3)))


def seen(poses: Poses, host: int, point: np.ndarray) -> np.ndarray:
    """Return a point fixed to the host in all keyframes, `(K, 3)`."""
    world = poses.rotations[host] @ point + poses.positions[host]
    return np.einsum("kji,kj->ki", poses.rotations, world - poses.positions)


def moved(poses: Poses, change: np.ndarray) -> Poses:
    step = change[:-1].reshape(-1, 6)
    rotations = np.stack([matrix_from_rotvec(w) @ r for w, r in zip(step[:, 3:], poses.rotations, strict=True)])
    return Poses(rotations, poses.positions + step[:, :3])


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.integers(0, KEYFRAMES - 1))
def test_motions_of_the_keyframes_alone_show_what_a_change_of_all_poses_shows(seed: int, host: int) -> None:
    random = np.random.default_rng(seed)
    poses, point, step = keyframes(random), random.normal(0, 3.0, 3), 1e-6 * random.normal(size=UNKNOWNS)
    motions = motions_by_poses(poses)[host] @ step
    np.testing.assert_array_equal(motions[6 * host : 6 * host + 6], 0.0)
    assert motions[-1] == step[-1]
    change = seen(moved(poses, step), host, point) - seen(poses, host, point)
    by_motions = seen(moved(poses, motions), host, point) - seen(poses, host, point)
    np.testing.assert_allclose(by_motions, change, atol=1e-10)


def test_normal_equations_of_poses_are_those_of_the_stacked_jacobians() -> None:
    random = np.random.default_rng(0)
    poses, jacobians = keyframes(random), random.normal(size=(KEYFRAMES, 50, UNKNOWNS))
    residuals = random.normal(size=(KEYFRAMES, 50))
    by_poses = np.concatenate(list(jacobians @ motions_by_poses(poses)))
    normal, rhs = jacobians.swapaxes(1, 2) @ jacobians, np.einsum("kna,kn->ka", jacobians, residuals)
    garbage = np.tril(np.full((UNKNOWNS, UNKNOWNS), 7.0), -1)
    found, found_rhs = system_of_poses(np.triu(normal) + garbage, rhs, poses)
    np.testing.assert_allclose(found, by_poses.T @ by_poses, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found_rhs, by_poses.T @ residuals.ravel(), rtol=1e-9, atol=1e-9)
