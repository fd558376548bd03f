"""Images of a known disparity field with a band-limited texture, and a block in front of a background."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.stereo import StereoPair, StereoRig

Field = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]


@dataclass(frozen=True)
class World:
    """Images of a known disparity field."""

    rig: StereoRig
    pair: StereoPair
    disparity: NDArray[np.float64]


def texture(u: NDArray[np.float64], v: NDArray[np.float64], seed: int) -> NDArray[np.float64]:
    """Return grey levels of waves in all directions, 4 to 40 pixels long, about 25 levels of spread."""
    rng = np.random.default_rng(seed)
    total = np.zeros(np.broadcast_shapes(u.shape, v.shape))
    for _ in range(60):
        turn = 2.0 * np.pi * rng.uniform()
        frequency = 2.0 * np.pi / np.exp(rng.uniform(np.log(4.0), np.log(40.0)))
        total += np.sin(frequency * (np.cos(turn) * u + np.sin(turn) * v) + 2.0 * np.pi * rng.uniform())
    return 128.0 + 25.0 * total / np.sqrt(30.0)


@cache
def make_world(
    field: Field,
    *,
    width: int = 320,
    height: int = 256,
    noise: float = 1.0,
    seed: int = 0,
    noise_seed: int = 1,
    rows: float = 0.0,
    gain: float = 1.0,
    offset: float = 0.0,
) -> World:
    """Render both images once; the content of the right image is `rows` lower and `gain` times brighter plus `offset`.

    All tests share the arrays, so a test must not change them. They are not read-only, because numba would compile
    its kernels again for read-only arrays.
    """
    rng = np.random.default_rng([seed, noise_seed])
    v, u = np.mgrid[:height, :width].astype(np.float64)
    left = texture(u, v, seed)
    row = v - rows
    source = u + field(u, row)
    for _ in range(60):  # u - d(u) = u_right, by fixed point: |dd/du| < 1
        source = u + field(source, row)
    right = gain * texture(source, row, seed) + offset
    grey = [np.clip(np.rint(i + rng.normal(0.0, noise, i.shape)), 0, 255).astype(np.uint8) for i in (left, right)]
    rig = StereoRig(width, height, 250.0, 250.0, (width - 1) / 2, (height - 1) / 2, 0.2)
    u_left, v_left = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    return World(rig, StereoPair(0, *grey), field(u_left, v_left))


def slope(u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Ground that nears downwards and to the right."""
    return 9.0 + 0.02 * u + 0.06 * v


def hills(u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    """The slope with hills of some tens of pixels."""
    return slope(u, v) + 0.6 * np.sin(u / 14.0 + v / 23.0) + 0.4 * np.sin(u / 31.0 - v / 12.0)


def two_planes(
    shape: tuple[int, int], block: tuple[slice, slice], near: int, far: int, noise: float
) -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.float32]]:
    """Return left and right random dots and the disparity of a block before a background."""
    rng = np.random.default_rng(0)
    rows, columns = block
    background = rng.uniform(20.0, 235.0, (shape[0], shape[1] + far))
    left, right = background[:, : shape[1]].copy(), background[:, far:].copy()
    left[block] = dots = rng.uniform(20.0, 235.0, left[block].shape)
    right[rows, columns.start - near : columns.stop - near] = dots
    disparity = np.full(shape, far, np.float32)
    disparity[block] = near
    noisy = [np.rint(image + rng.normal(0.0, noise, shape)).astype(np.uint8) for image in (left, right)]
    return noisy[0], noisy[1], disparity
