"""The frame and the unit of points without pixels, judged by their distances to the nearest true points.

The distance to the nearest true point is small also for wrong points, because the ground is everywhere. A cloud in
another unit or with other axes is therefore not obvious from its figures. Units and axes that bring the points much
nearer to the truth are reported.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import permutations, product

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray

SAMPLE = 500  #: Number of points that are compared in each frame and unit.
FEWEST = 50  #: Smallest number of points whose frame is judged.
NEARER = 3.0
"""Smallest factor by which another frame or unit must reduce the median distance. Chosen by hand: errors of a map of
less than its roughness do not become smaller in other axes."""
FAR_EXTENTS = 0.1
"""Smallest median distance that cannot be an error of a map, and smallest extent of a cloud in another unit, as
fractions of the extent of the truth. Without the second limit, points far away would be near if they were divided."""
UNITS = {"millimetres": 0.001, "centimetres": 0.01, "feet": 0.3048}  #: Units, m.


def frame_problem(xyz: FloatArray, true_points: FloatArray, nearest: Callable[[FloatArray], FloatArray]) -> str:
    """Return why points `(N, 3)` are probably not in LM or not in metres; empty if nothing indicates this.

    `nearest` returns the distances of points to the nearest of the true points `(M, 3)`.
    """
    if len(xyz) < FEWEST or not len(true_points):
        return ""
    sample = xyz[:: max(len(xyz) // SAMPLE, 1)]
    as_given_m = float(np.median(nearest(sample)))
    extent_m = _extent(true_points)
    others = [(as_given_m, "")]
    others += [
        (float(np.median(nearest(points))), text)
        for text, points in _others(sample)
        if _extent(points) > FAR_EXTENTS * extent_m
    ]
    other_m, condition = min(others)
    if NEARER * other_m < as_given_m and other_m < FAR_EXTENTS * extent_m:
        return (
            f"the points of the cloud are typically {as_given_m:.3g} m from the nearest true point, but "
            f"{other_m:.3g} m if {condition}: convert the cloud to metres in frame LM"
        )
    if as_given_m > FAR_EXTENTS * extent_m:
        return (
            f"the points of the cloud are typically {as_given_m:.3g} m from the nearest true point, and the truth "
            f"extends over about {extent_m:.3g} m: the cloud is in another frame or unit, or shifted; metres in frame "
            "LM are required"
        )
    return ""


def _extent(points: FloatArray) -> float:
    """Return the median distance of points `(N, 3)` from their middle, because single true points are far away."""
    return float(np.median(np.linalg.norm(points - np.median(points, axis=0), axis=1)))


def _others(points: FloatArray) -> Iterator[tuple[str, FloatArray]]:
    """Yield the points in other units and in all other axes, each with its description."""
    for unit, metres in UNITS.items():
        yield f"its unit is {unit}", metres * points
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        names = ", ".join(f"{'-' if sign < 0.0 else ''}{'xyz'[axis]}" for axis, sign in zip(order, signs, strict=True))
        if names != "x, y, z":
            yield f"x, y, z of LM are its {names}", points[:, order] * signs
