"""Schur elimination against dense normal equations, marginalisation against the joint solution."""

import numpy as np
import pytest

from sfr_loc_map.geometry.camera import Poses, StereoCamera
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.localisation.backend.bundle_adjustment import ADJUSTMENT_SCALE, BundleProblem, linearise

CAMERA = StereoCamera(400.0, 410.0, 256.0, 240.0, 0.2)
KEYFRAMES, LANDMARKS = 3, 40
UNKNOWNS = 6 * KEYFRAMES + 1


def project(keyframes: Poses, host: np.ndarray, landmarks: np.ndarray) -> np.ndarray:
    """Return u, v left, u, v right `(N, K, 4)` by the pinhole model; infinite depth is allowed."""
    rays = np.column_stack((CAMERA.normalised(landmarks[:, :2]), np.ones(len(landmarks))))
    rho = landmarks[:, 2:]
    scaled = np.einsum("nij,nj->ni", keyframes.rotations[host], rays) + rho * keyframes.positions[host]
    seen = np.einsum("kji,nkj->nki", keyframes.rotations, scaled[:, None] - rho[:, None] * keyframes.positions)
    u = CAMERA.fx * seen[..., 0] / seen[..., 2] + CAMERA.cx
    v = CAMERA.fy * seen[..., 1] / seen[..., 2] + CAMERA.cy
    return np.stack((u, v, u - CAMERA.fx * CAMERA.baseline_m * rho / seen[..., 2], v), axis=2)


def problem(seed: int = 0, noise_px: float = 0.2) -> BundleProblem:
    random = np.random.default_rng(seed)
    rotations = np.stack([matrix_from_rotvec(random.normal(0, 0.03, 3)) for _ in range(KEYFRAMES)])
    keyframes = Poses(rotations, 0.3 * np.arange(KEYFRAMES)[:, None] * [0.5, 0.1, 1.0])
    host = random.integers(0, KEYFRAMES - 1, LANDMARKS)
    landmarks = np.column_stack((random.uniform(80, 420, (LANDMARKS, 2)), random.uniform(0.05, 0.4, LANDMARKS)))
    observations = project(keyframes, host, landmarks) + random.normal(0, noise_px, (LANDMARKS, KEYFRAMES, 4))
    observations[np.arange(KEYFRAMES) < host[:, None]] = np.nan
    observations[::7, -1, 2:] = np.nan
    root = random.normal(0, 0.1, (LANDMARKS, KEYFRAMES, 2, 2, 2))
    full = root @ root.swapaxes(-1, -2) + noise_px**2 * np.eye(2)
    variance = np.stack((full[..., 0, 0], full[..., 0, 1], full[..., 1, 1]), axis=-1)
    return BundleProblem(keyframes, host, landmarks, observations, variance, CAMERA)


def moved(base: BundleProblem, step: np.ndarray) -> tuple[Poses, np.ndarray, float]:
    """Apply a step of poses, right-image offset and landmarks."""
    poses = step[: UNKNOWNS - 1].reshape(-1, 6)
    rotations = np.stack(
        [matrix_from_rotvec(w) @ r for w, r in zip(poses[:, 3:], base.keyframes.rotations, strict=True)]
    )
    keyframes = Poses(rotations, base.keyframes.positions + poses[:, :3])
    return keyframes, base.uv_inverse_depth + step[UNKNOWNS:].reshape(-1, 3), step[UNKNOWNS - 1]


def residuals(base: BundleProblem, step: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return residuals `(N, K, 2, 2)` of the landmarks `rows`, 0 where not observed, after a step."""
    keyframes, landmarks, offset = moved(base, step)
    predicted = project(keyframes, base.host, landmarks) + offset * np.array([0.0, 0.0, 1.0, 0.0])
    difference = np.where(rows[:, None, None], base.observations - predicted, np.nan)
    return np.nan_to_num(difference).reshape(LANDMARKS, KEYFRAMES, 2, 2)


def dense(base: BundleProblem, rows: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return the normal equations of all unknowns by central differences."""
    rows = np.ones(LANDMARKS, np.bool_) if rows is None else rows
    uu, uv, vv = np.moveaxis(base.variance, -1, 0)
    information = np.linalg.inv(np.stack((np.stack((uu, uv), -1), np.stack((uv, vv), -1)), -2))
    size, step = UNKNOWNS + 3 * LANDMARKS, 1e-6
    now = residuals(base, np.zeros(size), rows)
    chi2 = np.einsum("nksi,nksij,nksj->nks", now, information, now)
    weighted = information / ((1.0 + chi2 / ADJUSTMENT_SCALE) ** 2)[..., None, None]
    columns = [(residuals(base, -e, rows) - residuals(base, e, rows)) / (2 * step) for e in step * np.eye(size)]
    jacobian = np.stack(columns, axis=-1)
    h = np.einsum("nksia,nksij,nksjb->ab", jacobian, weighted, jacobian, optimize=True)
    h[np.arange(UNKNOWNS + 2, size, 3), np.arange(UNKNOWNS + 2, size, 3)] += 1e-6
    return h, np.einsum("nksia,nksij,nksj->a", jacobian, weighted, now, optimize=True)


def eliminate(h: np.ndarray, g: np.ndarray, kept: slice, gone: slice) -> tuple[np.ndarray, np.ndarray]:
    gain = np.linalg.solve(h[gone, gone], h[gone, kept]).T
    return h[kept, kept] - gain @ h[gone, kept], g[kept] - gain @ g[gone]


@pytest.mark.parametrize("seed", [0, 1])
def test_elimination_of_the_landmarks_is_the_schur_complement_of_the_dense_system(seed: int) -> None:
    base = problem(seed)
    h, g = dense(base)
    wanted_h, wanted_g = eliminate(h, g, slice(UNKNOWNS), slice(UNKNOWNS, None))
    found_h, found_g, *_ = linearise(base)
    scale = np.sqrt(np.diag(wanted_h))
    np.testing.assert_allclose(found_h / np.outer(scale, scale), wanted_h / np.outer(scale, scale), atol=1e-6)
    np.testing.assert_allclose(found_g / scale, wanted_g / scale, atol=1e-4)
