"""Coverage of tolerance bounds, one line per case: `python -m campaigns tolerance-coverage [CAMPAIGNS]`.

Each campaign draws independent errors, or overlapping windows of steps, from a distribution with a known quantile. A
campaign without a bound counts as covered. The coverage must be at least the stated confidence.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.metrics.statistics.tolerance import BoundMethod, Sample, tolerance_bound

OVERLAP = 5  #: Number of steps of a window of the normal errors; neighbouring windows share all steps but one.
REFERENCE = 2_000_000  #: Number of errors for the numerical quantile.
LEVELS = ((0.95, 0.95), (0.9973, 0.9))


def normal(rng: np.random.Generator, count: int, sigmas: FloatArray, mean: float = 0.0) -> FloatArray:
    """Return normal errors with the given sigmas, and with a mean along the first axis."""
    errors = rng.standard_normal((count, len(sigmas))) * sigmas
    errors[:, 0] += mean
    return errors


def heavy(rng: np.random.Generator, count: int, sigmas: FloatArray) -> FloatArray:
    """Return errors of Student's t with three degrees of freedom along each axis."""
    return rng.standard_t(3, (count, len(sigmas))) * sigmas


def windows(steps: FloatArray, length: int, spacing: int = 1) -> FloatArray:
    """Return the errors of windows of `length` steps, which begin `spacing` steps apart."""
    sums = np.concatenate((np.zeros((1, steps.shape[1])), np.cumsum(steps, axis=0)))
    return (sums[length:] - sums[:-length])[::spacing] / np.sqrt(length)


def normal_windows(rng: np.random.Generator, count: int, sigmas: FloatArray) -> FloatArray:
    """Return the errors of windows of OVERLAP steps for `count` independent errors."""
    return windows(normal(rng, count * OVERLAP + OVERLAP - 1, sigmas), OVERLAP)


def heavy_windows(rng: np.random.Generator, count: int, length: int, spacing: int) -> FloatArray:
    """Return the errors of windows of heavy-tailed steps, whose overlap `length / spacing` need not be an integer."""
    return windows(heavy(rng, count * length, np.ones(1)), length, spacing)


ISOTROPIC, ONE_AXIS, OBLONG = np.ones(3), np.array([1.0, 0.0, 0.0]), np.array([1.0, 0.3, 0.3])
CASES: dict[str, tuple[Callable[[np.random.Generator, int], FloatArray], float]] = {
    "isotropic": (lambda rng, count: normal(rng, count, ISOTROPIC), 1.0),
    "1 : 0.3 : 0.3": (lambda rng, count: normal(rng, count, OBLONG), 1.0),
    "one axis": (lambda rng, count: normal(rng, count, ONE_AXIS), 1.0),
    "one axis, mean 1 sigma": (lambda rng, count: normal(rng, count, ONE_AXIS, 1.0), 1.0),
    "isotropic, mean 2 sigma": (lambda rng, count: normal(rng, count, ISOTROPIC, 2.0), 1.0),
    "heavy tails, isotropic": (lambda rng, count: heavy(rng, count, ISOTROPIC), 1.0),
    "heavy tails, one axis": (lambda rng, count: heavy(rng, count, ONE_AXIS), 1.0),
    "correlated windows": (lambda rng, count: normal_windows(rng, count, ISOTROPIC), OVERLAP),
    "correlated windows, one axis": (lambda rng, count: normal_windows(rng, count, ONE_AXIS), OVERLAP),
    "heavy tails, overlap 1.1": (lambda rng, count: heavy_windows(rng, count, 11, 10), 1.1),
    "heavy tails, overlap 1.5": (lambda rng, count: heavy_windows(rng, count, 3, 2), 1.5),
    "heavy tails, overlap 2.2": (lambda rng, count: heavy_windows(rng, count, 11, 5), 2.2),
}
"""Functions that draw the errors of a campaign with a number of independent errors, and the overlap."""


class Coverage(NamedTuple):
    """Results of the campaigns of one case."""

    held: float  #: Fraction of campaigns whose bound is not too small, including campaigns without a bound.
    stated: float  #: Fraction of campaigns with a bound.
    normal: float  #: Fraction of campaigns whose bound assumes a normal distribution.
    held_of_stated: float  #: Fraction of the stated bounds that are not too small.
    accused: float  #: Fraction of campaigns whose lower bound wrongly exceeds the true quantile.


def coverage(
    case: str, count: int, prob: float, confidence: float, campaigns: int, *, is_normal: bool = False
) -> Coverage:
    """Return the coverage of the bounds of a case; `is_normal` declares that the errors are normal."""
    draw, overlap = CASES[case]
    rng = np.random.default_rng(count)
    reference = np.linalg.norm(draw(rng, REFERENCE // int(overlap)), axis=1)
    true = float(np.quantile(reference, prob))
    held = stated = by_normal = accused = 0
    for _ in range(campaigns):
        errors = draw(rng, count)
        bound = tolerance_bound(Sample(errors, len(errors) / overlap), prob, confidence, is_normal=is_normal)
        stated += bound.upper is not None
        by_normal += bound.method is not BoundMethod.ORDER
        held += bound.upper is None or bound.upper >= true
        accused += bound.lower is not None and bound.lower > true
    missed = campaigns - held
    of_stated = 1.0 - missed / stated if stated else 1.0
    return Coverage(held / campaigns, stated / campaigns, by_normal / campaigns, of_stated, accused / campaigns)


def lines(campaigns: int) -> Iterator[str]:
    """Yield a line for each case."""
    for prob, confidence in LEVELS:
        for case in CASES:
            for count in (5, 20, 60, 200):
                declared = count < 60 and "heavy" not in case
                found = coverage(case, count, prob, confidence, campaigns, is_normal=declared)
                named = " ".join(f"{name} {value:.4f}" for name, value in found._asdict().items())
                drawn = f"{case}, {count} independent" + ", declared normal" * declared
                yield f"{100 * prob:g} % with {100 * confidence:g} %: {drawn}: {named}"


def main(arguments: list[str]) -> int:
    """Print the coverage of the bounds of each case, with CAMPAIGNS campaigns each (10,000)."""
    for line in lines(int(arguments[0]) if arguments else 10_000):
        print(line, flush=True)
    return 0
