"""Find the worst case within ranges: choose points, reduce the worst case to the required changes, compute slices.

The search is deterministic: the same file, seed and results give the same points. An interrupted search can be
continued, because points with results are not run again.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from typing import Protocol

import numpy as np
from scipy.stats import spearmanr

from sfr_loc_map.errors import MissingExtraError
from sfr_loc_map.suite.search.record import LOST_RATIO, CoverageRecord, SliceRecord
from sfr_loc_map.suite.search.specification import Parameter, Point

WITHOUT_FIGURE = math.inf
"""Ratio of a drive that lacks the figure, for example a lost drive: worse than any drive that has the figure."""
BISECTIONS = 4  #: Number of bisections between the usual value and the found value.
CELLS = 3  #: Number of cells per range in the coverage.
MAX_SLICED = 3  #: Maximum number of parameters that are combined into slices.
Evaluate = Callable[[Sequence[Point]], Sequence[float | None]]
"""Runs points and returns the ratio of each: the figure of the worst seed divided by the limit; `WITHOUT_FIGURE` if a
drive lacks the figure; None if the scenario cannot be run."""


class Chooser(Protocol):
    """Chooses points, informed by the ratios of earlier points."""

    def ask(self, count: int) -> list[Point]:
        """Return the next points."""

    def tell(self, points: Sequence[Point], ratios: Sequence[float | None]) -> None:
        """Add the ratios of the last points, in their order; None for a point without a result."""


class RandomChooser:
    """Chooses uniform points, as a baseline for searches."""

    def __init__(self, parameters: Sequence[Parameter], seed: int) -> None:
        self._parameters = parameters
        self._rng = np.random.default_rng(seed)

    def ask(self, count: int) -> list[Point]:
        """Return uniform points."""
        drawn = self._rng.random((count, len(self._parameters)))
        return [
            tuple(
                parameter.drawn(parameter.low + share * (parameter.high - parameter.low))
                for parameter, share in zip(self._parameters, row, strict=True)
            )
            for row in drawn
        ]

    def tell(self, points: Sequence[Point], ratios: Sequence[float | None]) -> None:
        """Ignore the ratios."""


class TreeChooser:
    """The multivariate tree-structured Parzen estimator of optuna (Bergstra et al. 2011).

    The first point of each batch is uniform, so that the search does not stay at a local maximum.
    """

    def __init__(self, parameters: Sequence[Parameter], seed: int) -> None:
        try:
            import optuna
        except ImportError as error:
            raise MissingExtraError(
                f"the search requires optuna ({error}): pip install 'sfr_loc_map[search]'"
            ) from error
        optuna.logging.set_verbosity(optuna.logging.ERROR)
        self._uniform = RandomChooser(parameters, seed)
        self._parameters = parameters
        self._ranges: dict[str, optuna.distributions.BaseDistribution] = {
            parameter.name: optuna.distributions.FloatDistribution(parameter.low, parameter.high)
            for parameter in parameters
        }
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            sampler = optuna.samplers.TPESampler(seed=seed, multivariate=True, constant_liar=True)
        self._study = optuna.create_study(sampler=sampler, direction="maximize")
        self._asked: list[optuna.trial.Trial] = []
        self._lost_ratio = LOST_RATIO
        self._failed = optuna.trial.TrialState.FAIL

    def ask(self, count: int) -> list[Point]:
        """Return the next points."""
        self._study.enqueue_trial(self._named(self._uniform.ask(1)[0]))
        trials = [self._study.ask(self._ranges) for _ in range(count)]
        self._asked = trials
        return [
            tuple(parameter.drawn(trial.params[parameter.name]) for parameter in self._parameters) for trial in trials
        ]

    def tell(self, points: Sequence[Point], ratios: Sequence[float | None]) -> None:
        """Add the ratios of the last points; the sampler ignores points without a result.

        The sampler requires finite ratios. A point with the ratio `WITHOUT_FIGURE` is assigned the largest finite ratio
        so far, which is at least `LOST_RATIO`.
        """
        known = [ratio for ratio in ratios if ratio is not None and ratio != WITHOUT_FIGURE]
        self._lost_ratio = max([self._lost_ratio, *known])
        for trial, ratio in zip(self._asked, ratios, strict=True):
            finite = None if ratio is None else min(ratio, self._lost_ratio)
            self._study.tell(trial, finite, state=self._failed if ratio is None else None)

    def _named(self, point: Point) -> dict[str, float]:
        return {parameter.name: value for parameter, value in zip(self._parameters, point, strict=True)}


@dataclass(frozen=True, slots=True)
class TriedPoint:
    """A point and its ratio."""

    point: Point
    ratio: float  #: `WITHOUT_FIGURE` if a drive lacks the figure.

    @property
    def is_lost(self) -> bool:
        """Whether a drive lacks the figure."""
        return self.ratio == WITHOUT_FIGURE

    @property
    def fails(self) -> bool:
        """Whether the limit is missed."""
        return self.ratio > 1.0


def search_worst(chooser: Chooser, evaluate: Evaluate, count: int, batch: int) -> Iterator[TriedPoint]:
    """Yield those of `count` points that have a result, in the order of the search."""
    for begin in range(0, count, batch):
        points = chooser.ask(min(batch, count - begin))
        ratios = evaluate(points)
        chooser.tell(points, ratios)
        for point, ratio in zip(points, ratios, strict=True):
            if ratio is not None:
                yield TriedPoint(point, ratio)


def reduced(found: TriedPoint, parameters: Sequence[Parameter], evaluate: Evaluate) -> TriedPoint:
    """Return a point with fewer and smaller changes of the scenario than `found` that still misses the limit.

    First, each parameter in turn is reset to its usual value if the case still fails with that value. Then each
    remaining parameter is moved towards its usual value by bisection, in `BISECTIONS` steps. Because the parameters are
    reduced one after the other, another order may give a smaller change. If `found` meets the limit, it is returned.
    """
    if not found.fails:
        return found
    case = found
    for index, parameter in enumerate(parameters):
        if case.point[index] != parameter.usual:
            case = _failing(_with(case.point, index, parameter.usual), evaluate) or case
    for index, parameter in enumerate(parameters):
        holds, fails = parameter.usual, case.point[index]
        for _ in range(BISECTIONS):
            between = parameter.rounded(0.5 * (holds + fails))
            if between in (holds, fails):
                break
            tried = _failing(_with(case.point, index, between), evaluate)
            if tried is None:
                holds = between
            else:
                case, fails = tried, between
    return case


def _failing(point: Point, evaluate: Evaluate) -> TriedPoint | None:
    """Return a point with its ratio if the point misses the limit; None if it meets the limit or has no result."""
    (ratio,) = evaluate([point])
    if ratio is None:
        return None
    tried = TriedPoint(point, ratio)
    return tried if tried.fails else None


def _with(point: Point, index: int, value: float) -> Point:
    return (*point[:index], value, *point[index + 1 :])


def slices_of(
    parameters: Sequence[Parameter], case: TriedPoint, tried: Sequence[TriedPoint], count: int, evaluate: Evaluate
) -> list[SliceRecord]:
    """Return slices through a case for each pair of the most important parameters."""
    slices = []
    for first, second in combinations(most_important(parameters, case, tried), 2):
        x, y = (_grid(parameters[index], count) for index in (first, second))
        points = [_with(_with(case.point, first, at_x), second, at_y) for at_y, at_x in product(y, x)]
        ratios = evaluate(points)
        rows = [list(ratios[begin : begin + len(x)]) for begin in range(0, len(ratios), len(x))]
        slices.append(SliceRecord(first, second, list(x), list(y), rows))
    return slices


def _grid(parameter: Parameter, count: int) -> tuple[float, ...]:
    values = (parameter.drawn(value) for value in np.linspace(parameter.low, parameter.high, count))
    return tuple(dict.fromkeys(values))


def most_important(parameters: Sequence[Parameter], case: TriedPoint, tried: Sequence[TriedPoint]) -> list[int]:
    """Return at most three parameters: first those that the case changes, then those most correlated with the ratio."""
    usual = [parameter.usual for parameter in parameters]
    correlations = rank_correlations(tried, len(parameters))
    order = sorted(
        range(len(parameters)), key=lambda index: (case.point[index] == usual[index], -abs(correlations[index]))
    )
    return sorted(order[:MAX_SLICED])


def rank_correlations(tried: Sequence[TriedPoint], count: int) -> list[float]:
    """Return Spearman's rank correlation of each parameter with the ratio; 0 if undefined."""
    ratios = [item.ratio for item in tried]
    found = []
    for index in range(count):
        values = [item.point[index] for item in tried]
        is_defined = len(set(values)) > 1 and len(set(ratios)) > 1
        found.append(float(spearmanr(values, ratios).statistic) if is_defined else 0.0)
    return found


def coverage_of(parameters: Sequence[Parameter], points: Sequence[Point]) -> list[CoverageRecord]:
    """Return the coverage of each combination of parameters, one from each of the first three groups."""
    groups: dict[str, list[int]] = {}
    for index, parameter in enumerate(parameters):
        groups.setdefault(parameter.group, []).append(index)
    chosen = list(groups.values())[:3]
    return [_combination([parameters[index] for index in indices], indices, points) for indices in product(*chosen)]


def _combination(parameters: Sequence[Parameter], indices: Sequence[int], points: Sequence[Point]) -> CoverageRecord:
    edges = [np.linspace(parameter.low, parameter.high, CELLS + 1) for parameter in parameters]
    tested = {
        tuple(
            int(np.clip(np.searchsorted(edge, point[index], side="right") - 1, 0, CELLS - 1))
            for edge, index in zip(edges, indices, strict=True)
        )
        for point in points
    }
    cells = list(product(range(CELLS), repeat=len(indices)))
    missing = [
        [(float(edge[part]), float(edge[part + 1])) for edge, part in zip(edges, cell, strict=True)]
        for cell in cells
        if cell not in tested
    ]
    return CoverageRecord([parameter.name for parameter in parameters], len(cells), missing)
