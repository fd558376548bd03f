"""Find the worst case within ranges: choose points, reduce the worst case to the required changes, compute slices.

The search is deterministic: the same file, seed and results give the same points. An interrupted search can be
continued, because points with results are not run again.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from typing import Protocol

import numpy as np

from sfr_loc_map.errors import MissingExtraError
from sfr_loc_map.suite.search.record import LOST_RATIO, CoverageRecord, Parameter, SliceRecord, badness_of
from sfr_loc_map.suite.search.specification import Point

BISECTIONS = 4  #: Number of bisections between the usual value and the found value.
CELLS = 3  #: Number of cells per range in the coverage.
MAX_SLICED = 3  #: Maximum number of parameters that are combined into slices.


@dataclass(frozen=True, slots=True)
class TriedPoint:
    """A point with its result."""

    point: Point
    #: Figure of the worst seed divided by the limit; None if a drive lacks the figure, or if there is a refusal.
    ratio: float | None = None
    refusal: str = ""  #: Why the scenario cannot be run; empty if it was run.

    @property
    def badness(self) -> float:
        """The value by which points are compared. A point that cannot be run is better than any other."""
        return -np.inf if self.refusal else badness_of(self.ratio)

    @property
    def fails(self) -> bool:
        """Whether the limit is missed."""
        return self.badness > 1.0


Evaluate = Callable[[Sequence[Point]], Sequence[TriedPoint]]
"""Runs points, and returns them with their results in the same order."""


class Chooser(Protocol):
    """Chooses points, informed by the results of earlier points."""

    def run_batch(self, count: int, evaluate: Evaluate) -> Sequence[TriedPoint]:
        """Choose a number of points, run them, and return their results."""


class RandomChooser:
    """Chooses uniform points, as a baseline for searches."""

    def __init__(self, parameters: Sequence[Parameter], seed: int) -> None:
        self._parameters = parameters
        self._rng = np.random.default_rng(seed)

    def points(self, count: int) -> list[Point]:
        """Return uniform points."""
        drawn = self._rng.random((count, len(self._parameters)))
        return [
            tuple(
                parameter.drawn(parameter.low + share * (parameter.high - parameter.low))
                for parameter, share in zip(self._parameters, row, strict=True)
            )
            for row in drawn
        ]

    def run_batch(self, count: int, evaluate: Evaluate) -> Sequence[TriedPoint]:
        """Run uniform points, and return their results."""
        return evaluate(self.points(count))


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
        self._tried: list[TriedPoint] = []
        self._failed = optuna.trial.TrialState.FAIL

    def run_batch(self, count: int, evaluate: Evaluate) -> Sequence[TriedPoint]:
        """Choose points, run them, report them to the sampler, and return their results.

        The sampler requires finite ratios. A drive without the figure has the ratio of `lost_ratio_of`. The sampler
        ignores points that cannot be run.
        """
        uniform = zip(self._parameters, self._uniform.points(1)[0], strict=True)
        self._study.enqueue_trial({parameter.name: value for parameter, value in uniform})
        trials = [self._study.ask(self._ranges) for _ in range(count)]
        tried = evaluate(
            [tuple(parameter.drawn(trial.params[parameter.name]) for parameter in self._parameters) for trial in trials]
        )
        self._tried += tried
        lost_ratio = lost_ratio_of(self._tried)
        for trial, item in zip(trials, tried, strict=True):
            if item.refusal:
                self._study.tell(trial, state=self._failed)
            else:
                self._study.tell(trial, min(item.badness, lost_ratio))
        return tried


def lost_ratio_of(tried: Sequence[TriedPoint]) -> float:
    """Return the ratio that is reported to the sampler, and shown, for a drive without the figure.

    The ratio is the largest ratio of the points, and at least `LOST_RATIO`.
    """
    return max([LOST_RATIO, *(item.ratio for item in tried if item.ratio is not None)])


def tried_points(chooser: Chooser, evaluate: Evaluate, count: int, batch: int) -> Iterator[TriedPoint]:
    """Yield `count` points with their results, in the order of the search."""
    for begin in range(0, count, batch):
        yield from chooser.run_batch(min(batch, count - begin), evaluate)


def reduced(found: TriedPoint, parameters: Sequence[Parameter], evaluate: Evaluate) -> TriedPoint:
    """Return a point with fewer and smaller changes of the scenario than `found` that still misses the limit.

    First, the usual values of the parameters are tried one after the other, and a parameter keeps its usual value if
    the case still fails. Then each remaining parameter is moved towards its usual value by bisection, in `BISECTIONS`
    steps. A different order of the parameters may give a smaller change. If `found` meets the limit, it is returned.
    """
    if not found.fails:
        return found
    case = found
    for index, parameter in enumerate(parameters):
        if case.point[index] != parameter.usual:
            (tried,) = evaluate([_with(case.point, index, parameter.usual)])
            case = tried if tried.fails else case
    for index, parameter in enumerate(parameters):
        holds, fails = parameter.usual, case.point[index]
        for _ in range(BISECTIONS):
            between = parameter.rounded(0.5 * (holds + fails))
            if between in (holds, fails):
                break
            (tried,) = evaluate([_with(case.point, index, between)])
            if tried.fails:
                case = tried
                fails = between
            else:
                holds = between
    return case


def _with(point: Point, index: int, value: float) -> Point:
    return (*point[:index], value, *point[index + 1 :])


def slices_of(
    parameters: Sequence[Parameter], case: TriedPoint, count: int, evaluate: Evaluate, lost_ratio: float
) -> list[SliceRecord]:
    """Return slices through a case for each pair of `sliced_parameters`. Ratios are at most `lost_ratio`."""
    slices = []
    for first, second in combinations(sliced_parameters(parameters, case), 2):
        x = _grid(parameters[first], count)
        y = _grid(parameters[second], count)
        tried = evaluate([_with(_with(case.point, first, at_x), second, at_y) for at_y, at_x in product(y, x)])
        ratios = [None if item.refusal else min(item.badness, lost_ratio) for item in tried]
        rows = [ratios[begin : begin + len(x)] for begin in range(0, len(ratios), len(x))]
        slices.append(SliceRecord(first, second, list(x), list(y), rows))
    return slices


def _grid(parameter: Parameter, count: int) -> tuple[float, ...]:
    values = (parameter.drawn(value) for value in np.linspace(parameter.low, parameter.high, count))
    return tuple(dict.fromkeys(values))


def sliced_parameters(parameters: Sequence[Parameter], case: TriedPoint) -> list[int]:
    """Return at most three parameters: first those that the case changes, then the others in the order of the file."""
    numbers = range(len(parameters))
    order = sorted(numbers, key=lambda index: case.point[index] == parameters[index].usual)
    return sorted(order[:MAX_SLICED])


def coverage_of(parameters: Sequence[Parameter], points: Sequence[Point]) -> list[CoverageRecord]:
    """Return the coverage of each combination of parameters, one from each of the first three sections."""
    sections: dict[str, list[int]] = {}
    for index, parameter in enumerate(parameters):
        sections.setdefault(parameter.section, []).append(index)
    chosen = list(sections.values())[:3]
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
