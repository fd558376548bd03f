"""Seeded noise as pure functions of position, without tables or tiling, identical on every machine."""

from __future__ import annotations

import math
from enum import IntEnum

import numpy as np

from sfr_loc_map.jit import jit, jit_inline

# Multipliers of the hash lowbias32 (Wellons 2018).
_M1 = np.uint32(0x7FEB352D)
_M2 = np.uint32(0x846CA68B)
# Primes of xxHash32 (Collet), which decorrelate the coordinates.
_X = np.uint32(0x9E3779B1)
_Y = np.uint32(0x85EBCA77)
_Z = np.uint32(0xC2B2AE3D)
_S15 = np.uint32(15)
_S16 = np.uint32(16)
_TOP_BIT = np.uint32(0x80000000)
_TO_UNIT = 1.0 / 2.0**32
DIRECTIONS = 1024  #: Number of the gradient directions of `gradient2`, which suffices to hide the grid.
_DIRECTION_SHIFT = np.uint32(22)  #: Number of bits by which a hash is shifted for one of `DIRECTIONS` numbers.
_DIRECTION_STEP_RAD = 2.0 * math.pi / DIRECTIONS
GRADIENT_RANGE = 1.4  #: Factor that scales the range of noise with unit gradients, +-0.71, to +-1.


class Stream(IntEnum):
    """Keys of the random values for each purpose; changing a key changes the images.

    Keys of the first group are combined with the seed of the data set. Keys of the second group select the noise at a
    position and are combined with the number of the octave by XOR. Octaves of two purposes can therefore have the same
    values, but on grids with different cell sizes.
    """

    TERRAIN = 1
    ROCK_PLACES = 2
    ROCK_POSES = 3
    ROCK_SHAPES = 4
    DRIVE = 5
    RIGHT_EXPOSURE = 6
    EXPOSURE = 8
    SENSOR_NOISE = 9
    SUN_SAMPLES = 20

    HILLS = 11
    RELIEF = 22
    RIPPLES = 33
    CRATERS = 44
    SAND = 55
    BEDROCK = 66
    PEBBLES = 101
    FINE_TEXTURE = 102
    ROCK_SURFACE = 103
    PLATES = 104


@jit_inline
def mix(value: np.uint32) -> np.uint32:
    """Return a well mixed 32-bit number (xor-shift-multiply finaliser, constants of lowbias32 by C. Wellons)."""
    value ^= value >> _S16
    value = np.uint32(value * _M1)
    value ^= value >> _S15
    value = np.uint32(value * _M2)
    value ^= value >> _S16
    return value


@jit_inline
def hash2(i: int | np.int32, j: int | np.int32, seed: np.uint32) -> np.uint32:
    """Return the hash of a cell of a plane grid."""
    return mix(np.uint32(np.uint32(i) * _X) ^ np.uint32(np.uint32(j) * _Y) ^ seed)


@jit
def hash3(i: int, j: int, k: int, seed: np.uint32) -> np.uint32:
    """Return the hash of a cell of a spatial grid."""
    return mix(np.uint32(np.uint32(i) * _X) ^ np.uint32(np.uint32(j) * _Y) ^ np.uint32(np.uint32(k) * _Z) ^ seed)


@jit_inline
def unit(value: np.uint32) -> float:
    """Return a hash as a number in [0, 1)."""
    return value * _TO_UNIT


@jit_inline
def _quintic(t: float) -> float:
    """Return the polynomial whose first two derivatives are zero at 0 and 1 (Perlin 2002)."""
    return t * t * t * (t * (t * 6.0 - 15.0) + 10.0)


@jit_inline
def _quintic_slope(t: float) -> float:
    """Return the derivative of `_quintic`."""
    return 30.0 * t * t * (t - 1.0) * (t - 1.0)


@jit_inline
def value2(x: float, y: float, seed: np.uint32) -> tuple[float, float, float]:
    """Return smooth noise in [-1, 1] at a position in cells, and the derivatives by x and y.

    This is value noise: a quintic blends the corner values of a cell, so that the gradient is also smooth.
    """
    xf = np.floor(x)
    yf = np.floor(y)
    i = np.int32(xf)  # 32 bits and no branch, so that loops are vectorised
    j = np.int32(yf)
    a = x - xf
    b = y - yf
    h00 = _signed(hash2(i, j, seed))
    h10 = _signed(hash2(i + 1, j, seed))
    h01 = _signed(hash2(i, j + 1, seed))
    h11 = _signed(hash2(i + 1, j + 1, seed))
    u = _quintic(a)
    v = _quintic(b)
    du = _quintic_slope(a)
    dv = _quintic_slope(b)
    k1 = h10 - h00
    k2 = h01 - h00
    k3 = h00 - h10 - h01 + h11
    return h00 + k1 * u + k2 * v + k3 * u * v, du * (k1 + k3 * v), dv * (k2 + k3 * u)


@jit
def gradient2(x: float, y: float, seed: np.uint32) -> tuple[float, float, float]:
    """Return gradient noise (Perlin 2002) at a position in cells, and the derivatives by x and y.

    The values are about -1 to 1, with a standard deviation of about 0.3.
    """
    xf = math.floor(x)
    yf = math.floor(y)
    i = int(xf)
    j = int(yf)
    a = x - xf
    b = y - yf
    ax, ay = _direction(hash2(i, j, seed))
    bx, by = _direction(hash2(i + 1, j, seed))
    cx, cy = _direction(hash2(i, j + 1, seed))
    dx, dy = _direction(hash2(i + 1, j + 1, seed))
    na = ax * a + ay * b
    nb = bx * (a - 1.0) + by * b
    nc = cx * a + cy * (b - 1.0)
    nd = dx * (a - 1.0) + dy * (b - 1.0)
    u = _quintic(a)
    v = _quintic(b)
    du = _quintic_slope(a)
    dv = _quintic_slope(b)
    k1 = nb - na
    k2 = nc - na
    k3 = na - nb - nc + nd
    gx = ax + u * (bx - ax) + v * (cx - ax) + u * v * (ax - bx - cx + dx) + du * (k1 + k3 * v)
    gy = ay + u * (by - ay) + v * (cy - ay) + u * v * (ay - by - cy + dy) + dv * (k2 + k3 * u)
    value = na + k1 * u + k2 * v + k3 * u * v
    return GRADIENT_RANGE * value, GRADIENT_RANGE * gx, GRADIENT_RANGE * gy


@jit
def value3(x: float, y: float, z: float, seed: np.uint32) -> tuple[float, float, float, float]:
    """Return three-dimensional value noise in [-1, 1] and its gradient; see `value2`."""
    xf = math.floor(x)
    yf = math.floor(y)
    zf = math.floor(z)
    i = int(xf)
    j = int(yf)
    k = int(zf)
    a = x - xf
    b = y - yf
    c = z - zf
    u = _quintic(a)
    v = _quintic(b)
    w = _quintic(c)
    du = _quintic_slope(a)
    dv = _quintic_slope(b)
    dw = _quintic_slope(c)
    h000 = _signed(hash3(i, j, k, seed))
    h100 = _signed(hash3(i + 1, j, k, seed))
    h010 = _signed(hash3(i, j + 1, k, seed))
    h110 = _signed(hash3(i + 1, j + 1, k, seed))
    h001 = _signed(hash3(i, j, k + 1, seed))
    h101 = _signed(hash3(i + 1, j, k + 1, seed))
    h011 = _signed(hash3(i, j + 1, k + 1, seed))
    h111 = _signed(hash3(i + 1, j + 1, k + 1, seed))
    k1 = h100 - h000
    k2 = h010 - h000
    k3 = h001 - h000
    k4 = h000 - h100 - h010 + h110
    k5 = h000 - h010 - h001 + h011
    k6 = h000 - h100 - h001 + h101
    k7 = -h000 + h100 + h010 - h110 + h001 - h101 - h011 + h111
    value = h000 + k1 * u + k2 * v + k3 * w + k4 * u * v + k5 * v * w + k6 * u * w + k7 * u * v * w
    gx = du * (k1 + k4 * v + k6 * w + k7 * v * w)
    gy = dv * (k2 + k4 * u + k5 * w + k7 * u * w)
    gz = dw * (k3 + k5 * v + k6 * u + k7 * u * v)
    return value, gx, gy, gz


@jit_inline
def _signed(value: np.uint32) -> float:
    """Return a hash as a number in [-1, 1)."""
    return np.int32(value ^ _TOP_BIT) * (2.0 * _TO_UNIT)


@jit
def _direction(value: np.uint32) -> tuple[float, float]:
    """Return a unit vector in one of `DIRECTIONS` directions."""
    angle = (value >> _DIRECTION_SHIFT) * _DIRECTION_STEP_RAD
    return math.cos(angle), math.sin(angle)


def sub_seed(seed: int, *words: int) -> np.uint32:
    """Return a 32-bit seed for one purpose, derived from the seed of the data set."""
    return np.uint32(np.random.SeedSequence([seed, *words]).generate_state(1)[0])
