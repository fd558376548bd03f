"""Compare two suites figure by figure over their common drives.

The test statistic of a figure is the mean log ratio over the drives. If two suites are equally good, each log ratio is
as likely positive as negative. A sign-flip test therefore compares the mean with its distribution over all choices of
signs (Fisher 1935), exactly for up to 14 drives and with random choices for more. The test does not assume a
distribution of the errors, and a single bad drive cannot decide the outcome.

A drive whose error is missing in one of the suites, because the estimate was lost, counts in the test as the largest
change of all drives, in favour of the other suite. Otherwise a method that loses difficult drives would appear better.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from typing import Any

import numpy as np
from msgspec import Struct

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.metrics.comparison import Outcome
from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.statistics.intervals import Interval, holm
from sfr_loc_map.metrics.stored.score_json import to_plain
from sfr_loc_map.suite.jobs.job import PairKey, with_common_keys
from sfr_loc_map.suite.statistics.common_deviations import CommonDeviation
from sfr_loc_map.suite.statistics.figures import ComparedFigure, ComparedKind, figures_of
from sfr_loc_map.suite.statistics.resampling import MIN_DRIVES, drawn_weights, half_width
from sfr_loc_map.suite.statistics.summary import Summary

SIGNIFICANCE = 0.05  #: Level of the corrected p-values below which a difference is reported.
COMPARED = (ComparedKind.ACCURACY, ComparedKind.MEMORY)  #: Times are excluded because they depend on the host's load.
COUNTED = (ComparedKind.LOST, ComparedKind.DEGRADED, ComparedKind.MISSING)
"""Counts of frames, which are added over the drives. Their ratios are undefined, because most drives have a count of 0.
"""
DRAWS = 20_000
"""Number of random sign choices. The standard error of a p-value of 0.05 is sqrt(0.05 * 0.95 / DRAWS), here 0.0015."""
SEED = 20260202  #: Seed of the random sign choices; an arbitrary number. Fixed, so that results are repeatable.
MIN_TESTED = 6  #: With fewer drives, no p-value can be below 0.03.


@dataclass(frozen=True, slots=True, kw_only=True)
class JobRatio:
    """A figure of a job in both suites; None in a suite without the figure."""

    label: str
    first: float | None
    other: float | None

    @property
    def log(self) -> float | None:
        """Logarithm of other / first; None if a suite lacks the figure."""
        return None if self.first is None or self.other is None else float(np.log(self.other / self.first))


class FigureComparison(Struct, frozen=True, kw_only=True):
    """A figure over the common drives of two suites.

    `ratio` is the second suite divided by the first, the baseline; below 1, the second suite is better.
    """

    group: str  #: Task, configuration and faults.
    baseline: str  #: Name of the reference suite.
    kind: ComparedKind
    figure: str  #: Name with unit.
    drives: int  #: Number of common drives that have the figure in at least one suite.
    without: tuple[int, int]  #: Numbers of these drives without the figure in the first suite, and in the second.
    ratio: float | None  #: Geometric mean of other / first over the drives with both values; None without such a drive.
    ci95: Interval | None  #: 95 % confidence interval of the ratio, by resampling drives.
    p: float | None  #: p-value of the sign-flip test.
    p_corrected: float | None  #: p-value corrected for the number of comparisons (Holm).
    outcome: Outcome
    worst: JobRatio  #: Job that lacks the figure only in the second suite; else the job with the largest ratio.


class CountComparison(Struct, frozen=True, kw_only=True):
    """A count of frames, added over the common results for which both suites have the count."""

    group: str  #: Task, configuration and faults.
    figure: str  #: Name with unit.
    results: int  #: Number of common results with the count.
    first: int  #: Sum in the first suite, the baseline.
    other: int  #: Sum in the second suite.


class SuiteState(Struct, frozen=True, kw_only=True):
    """What a reader must know about a compared suite: its verdict, missing results and deviations."""

    name: str
    verdict: VerdictState | None  #: None if the suite is not judged.
    without_result: int  #: Number of jobs and sources without a result.
    deviations: tuple[CommonDeviation, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class SuiteComparison:
    """Two suites and the comparison of their common results."""

    names: tuple[str, str]
    suites: tuple[SuiteState, SuiteState]
    common: int  #: Number of common results.
    left_out: tuple[int, int]  #: Numbers of results that only the first suite has, and that only the second suite has.
    figures: tuple[FigureComparison, ...]
    counts: tuple[CountComparison, ...]  #: Lost, degraded and missing frames.

    def to_dict(self) -> dict[str, object]:
        """Return the comparison as JSON values."""
        return {"schema": "sfr-suite-comparison/2", **to_plain(self)}


def compare_suites(first: Summary, other: Summary, names: tuple[str, str]) -> SuiteComparison:
    """Compare the second suite with the first, the reference; raise MetricsError if no drive is common to both."""
    first_results, other_results = with_common_keys(
        [
            {PairKey(result.job.pairing, result.job.configuration): result for result in suite.results}
            for suite in (first, other)
        ]
    )
    common = [(result, other_results[key]) for key, result in first_results.items() if key in other_results]
    if not common:
        raise MetricsError(
            f"'{names[0]}' and '{names[1]}' have no drive in common: run the same sources, faults and conditions"
        )
    # by group and figure, the ratios of the repeats of each drive
    ratios: dict[tuple[str, ComparedFigure], dict[str, list[JobRatio]]] = {}
    counts: dict[tuple[str, ComparedFigure], list[tuple[float, float]]] = {}
    for first_result, other_result in common:
        group = first_result.job.group.text
        other_figures = figures_of(other_result.score)
        first_figures = figures_of(first_result.score)
        for figure in dict.fromkeys((*first_figures, *other_figures)):
            in_both = figure in first_figures and figure in other_figures
            if figure.kind in COMPARED and (in_both or figure.kind is ComparedKind.ACCURACY):
                ratio = JobRatio(
                    label=first_result.job.label, first=first_figures.get(figure), other=other_figures.get(figure)
                )
                ratios.setdefault((group, figure), {}).setdefault(first_result.job.drive_key, []).append(ratio)
            if figure.kind in COUNTED and in_both:
                counts.setdefault((group, figure), []).append((first_figures[figure], other_figures[figure]))
    left_out = (len(first_results) - len(common), len(other_results) - len(common))
    return SuiteComparison(
        names=names,
        suites=(_state_of(first, names[0]), _state_of(other, names[1])),
        common=len(common),
        left_out=left_out,
        figures=tuple(_compared(ratios, names[0])),
        counts=tuple(_added(group, figure.name, pairs) for (group, figure), pairs in counts.items()),
    )


def _state_of(suite: Summary, name: str) -> SuiteState:
    return SuiteState(
        name=name,
        verdict=suite.verdict,
        without_result=suite.counts.failed + suite.counts.waiting + len(suite.refusals),
        deviations=suite.deviations,
    )


def _added(group: str, figure: str, pairs: Sequence[tuple[float, float]]) -> CountComparison:
    first, other = (int(sum(counts)) for counts in zip(*pairs, strict=True))
    return CountComparison(group=group, figure=figure, results=len(pairs), first=first, other=other)


def _compared(
    ratios: Mapping[tuple[str, ComparedFigure], Mapping[str, Sequence[JobRatio]]], baseline: str
) -> Iterator[FigureComparison]:
    """Yield the comparison of each figure of each group; `ratios` has those of the repeats and copies of each drive.

    The ratios of one drive are averaged, because the largest of them would be biased although nothing has changed.
    """
    log_ratios = [_log_ratios(drives.values()) for drives in ratios.values()]
    p_values = [sign_flip_p(logs) for logs in log_ratios]
    rows = zip(ratios.items(), log_ratios, p_values, holm(p_values), strict=True)
    for ((group, figure), drives), logs, p, corrected in rows:
        outcome = Outcome.NOT_ENOUGH_DATA if logs.any() else Outcome.EQUAL
        if corrected is not None and logs.any():
            direction = Outcome.WORSE if logs.mean() > 0.0 else Outcome.BETTER
            outcome = Outcome.NO_DIFFERENCE if corrected >= SIGNIFICANCE else direction
        logs_in_both = [[item.log for item in items if item.log is not None] for items in drives.values()]
        means = np.array([np.mean(of_drive) for of_drive in logs_in_both if of_drive])
        yield FigureComparison(
            group=group,
            baseline=baseline,
            kind=figure.kind,
            figure=figure.name,
            drives=len(drives),
            without=(
                sum(any(item.first is None for item in items) for items in drives.values()),
                sum(any(item.other is None for item in items) for items in drives.values()),
            ),
            ratio=float(np.exp(means.mean())) if len(means) else None,
            ci95=ratio_interval(means),
            p=p,
            p_corrected=corrected,
            outcome=outcome,
            worst=max(chain(*drives.values()), key=partial(_log_ratio, loss=np.inf)),
        )


def _log_ratios(drives: Collection[Sequence[JobRatio]]) -> FloatArray:
    """Return the mean log ratio of each drive. A missing figure counts as the largest log ratio of all drives.

    The size of this log ratio does not depend on which suite lacks the figure, as the sign-flip test requires.
    """
    loss = max((abs(item.log) for item in chain(*drives) if item.log is not None), default=1.0) or 1.0

    return np.array([np.mean([_log_ratio(item, loss) for item in items]) for items in drives])


def _log_ratio(item: JobRatio, loss: float) -> float:
    """Return the log ratio; `loss` if only the second suite lacks the figure, `-loss` if only the first lacks it."""
    if item.log is not None:
        return item.log
    return loss if item.other is None else -loss


def ratio_interval(log_ratios: FloatArray) -> Interval | None:
    """Return the 95 % interval of the geometric mean ratio of log ratios `(D,)`; None for fewer than `MIN_DRIVES`."""
    drives = len(log_ratios)
    if drives < MIN_DRIVES:
        return None
    mean, half = float(log_ratios.mean()), half_width(drawn_weights(drives) @ log_ratios / drives, drives)
    return float(np.exp(mean - half)), float(np.exp(mean + half))


def sign_flip_p(log_ratios: FloatArray) -> float | None:
    """Return the two-sided p-value of the sum of log ratios `(D,)`; None for fewer than `MIN_TESTED` drives."""
    if len(log_ratios) < MIN_TESTED:
        return None
    from scipy.stats import permutation_test  # slow import

    def size(logs: FloatArray, axis: int) -> FloatArray:
        return np.asarray(np.abs(logs.sum(axis=axis)))

    options: dict[str, Any] = {"permutation_type": "samples", "n_resamples": DRAWS, "batch": DRAWS // 10}
    options |= {"vectorized": True, "alternative": "greater", "random_state": np.random.default_rng(SEED)}
    return float(permutation_test((log_ratios,), size, **options).pvalue)
