"""Suites compared with each other, figure by figure, over the drives that both have.

A figure is compared by the mean of its log ratios over the drives, with a sign-flip test: where two runs are equally
good, each log ratio is as likely positive as negative, so the mean is compared with its distribution over all choices
of signs (Fisher 1935; exact for few drives, drawn for many). No distribution of the errors is assumed, and one bad
drive decides nothing.

In a history each run is compared with a baseline: the first run, later the last run that was certainly better. So a
slow decline adds up instead of hiding in small steps.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.metrics.comparison import Outcome
from sfr_loc_map.metrics.config import CallKind
from sfr_loc_map.metrics.limits import value_at
from sfr_loc_map.metrics.score import Interval, Score
from sfr_loc_map.metrics.score_json import to_plain
from sfr_loc_map.metrics.statistics import holm
from sfr_loc_map.suite.job import REFERENCE
from sfr_loc_map.suite.summary import ScoredJob, Summary, drawn_weights

SIGNIFICANCE = 0.05
HISTORY_LEVEL = 0.01
"""Largest probability of a false alarm in a whole history; shared by all runs and figures (Bonferroni)."""
MIN_RATIO = 1.01  #: In a history less than one per cent is no finding, however certain.
EXACT_DRIVES = 14
DRAWS, MAX_DRAWS = 20000, 200000
ENOUGH_EXCEEDED = 10
SEED = 20260202
MIN_TESTED = 6  #: With fewer drives no choice of signs has a probability under 0.03.


class FigureKind(StrEnum):
    """What a figure is about."""

    ACCURACY = "accuracy"
    TIME = "time"
    MEMORY = "memory"


@dataclass(frozen=True, slots=True, order=True)
class FigureName:
    """A figure, smaller is better: what it is about, and its name with unit, such as `position over 5 m, m`."""

    kind: FigureKind
    name: str


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveRatio:
    """One figure of one drive in both suites."""

    label: str
    first: float
    other: float


@dataclass(frozen=True, slots=True, kw_only=True)
class FigureComparison:
    """One figure over all drives run alike."""

    runs: str  #: Task, configuration and faults.
    kind: FigureKind
    figure: str  #: Name with unit.
    drives: int  #: Drives in both suites.
    ratio: float  #: Geometric mean of other over first; below 1 the other suite is better.
    ci95: Interval | None  #: 95 % interval of the ratio, by resampling drives.
    p: float | None  #: Probability of such a ratio by chance (sign-flip test).
    p_corrected: float | None  #: The same, corrected for the number of comparisons (Holm).
    outcome: Outcome  #: What follows at 5 %.
    worst: DriveRatio  #: Drive with the largest ratio.


@dataclass(frozen=True, slots=True, kw_only=True)
class SuiteComparison:
    """Two suites: their names, the drives in both, those of either that are not in both, and all figures."""

    names: tuple[str, str]
    common: int
    left_out: tuple[int, int]
    figures: tuple[FigureComparison, ...]

    def to_dict(self) -> dict[str, object]:
        """Return it as JSON values."""
        return {"schema": "sfr-suite-comparison/1", **to_plain(self)}


@dataclass(frozen=True, slots=True)
class HistoryRun:
    """One suite of a history: its name, and the figures of its drives by what they have in common with others."""

    name: str
    figures: Mapping[str, Mapping[FigureName, float]]

    @classmethod
    def of(cls, name: str, summary: Summary) -> HistoryRun:
        """Return the run that a suite is."""
        return cls(name, {key: figures_of(drive.score) for key, drive in _by_pairing(summary)[0].items()})


@dataclass(frozen=True, slots=True, kw_only=True)
class HistoryPoint:
    """One figure of one run, compared with its baseline."""

    run: str  #: Name of the run.
    kind: FigureKind
    figure: str  #: Name with unit.
    drives: int  #: Drives in both.
    median: float  #: Median of the figure over the drives.
    baseline: str  #: Name of the run that it is compared with.
    ratio: float  #: Geometric mean over the drives of this run over the baseline.
    ci95: Interval | None  #: Its 95 % interval.
    p: float | None  #: Probability of such a ratio by chance, uncorrected.
    outcome: Outcome  #: Worse or better where this is certain.


@dataclass(frozen=True, slots=True, kw_only=True)
class History:
    """Runs in their order."""

    runs: tuple[str, ...]  #: Names of the runs.
    level: float  #: Level of one comparison.
    points: tuple[HistoryPoint, ...]  #: By figure and run, from the second run on.
    first_worse: Mapping[str, str]  #: The first run of each kind of figure that is certainly worse, by kind.

    def to_dict(self) -> dict[str, object]:
        """Return it as JSON values."""
        return {"schema": "sfr-history/1", **to_plain(self)}


def compare_suites(first: Summary, other: Summary, names: tuple[str, str]) -> SuiteComparison:
    """Return the comparison of two suites, of which the first is the reference.

    Raises MetricsError if no drive is in both.
    """
    mine, theirs = _by_pairing(first, other)
    common = [(drive, theirs[key]) for key, drive in mine.items() if key in theirs]
    if not common:
        raise MetricsError(
            f"'{names[0]}' and '{names[1]}' have no drive in common: run the same sources, faults and conditions"
        )
    pairs: dict[tuple[str, FigureName], list[DriveRatio]] = {}
    for drive, same in common:
        others, runs = figures_of(same.score), ", ".join(part for part in drive.runs if part)
        for name, value in figures_of(drive.score).items():
            if name in others:
                ratio = DriveRatio(label=drive.job.label, first=value, other=others[name])
                pairs.setdefault((runs, name), []).append(ratio)
    ratios = [_log_ratios(items) for items in pairs.values()]
    chances = [sign_flip_p(logs) for logs in ratios]
    figures = [
        FigureComparison(
            runs=runs,
            kind=name.kind,
            figure=name.name,
            drives=len(items),
            ratio=_mean_ratio(logs),
            ci95=_ratio_interval(logs),
            p=p,
            p_corrected=corrected,
            outcome=_outcome(logs, corrected, SIGNIFICANCE),
            worst=items[int(logs.argmax())],
        )
        for ((runs, name), items), logs, p, corrected in zip(pairs.items(), ratios, chances, holm(chances), strict=True)
    ]
    left_out = (len(mine) - len(common), len(theirs) - len(common))
    return SuiteComparison(names=names, common=len(common), left_out=left_out, figures=tuple(figures))


def _by_pairing(*suites: Summary) -> list[dict[str, ScoredJob]]:
    """Return the drives of each suite by what they share with others; a name of the only configuration is no part."""
    one = all(len({drive.job.configuration for drive in suite.drives}) == 1 for suite in suites)
    return [
        {drive.job.pairing + ("" if one else f" {drive.job.configuration}"): drive for drive in suite.drives}
        for suite in suites
    ]


def find_changes(runs: Sequence[HistoryRun]) -> History:
    """Return how the figures changed over runs in the order of time.

    Raises MetricsError if there are fewer than two runs.
    """
    if len(runs) < 2:
        raise MetricsError(f"a history needs two suites or more, found {len(runs)}: give several folders")
    names = sorted({name for run in runs for figures in run.figures.values() for name in figures})
    level = HISTORY_LEVEL / max(1, len(names) * (len(runs) - 1))
    points = [point for name in names for point in _points(name, runs, level)]
    order = [run.name for run in runs]
    worse: dict[str, str] = {}
    for point in sorted(points, key=lambda item: order.index(item.run)):
        if point.outcome is Outcome.WORSE:
            worse.setdefault(point.kind.value, point.run)
    return History(runs=tuple(order), level=level, points=tuple(points), first_worse=worse)


def _points(name: FigureName, runs: Sequence[HistoryRun], level: float) -> Iterator[HistoryPoint]:
    """Yield one figure of each run after the first beside its baseline."""
    baseline = runs[0]
    for run in runs[1:]:
        pairs = [
            DriveRatio(label=key, first=baseline.figures[key][name], other=figures[name])
            for key, figures in run.figures.items()
            if name in figures and name in baseline.figures.get(key, {})
        ]
        if not pairs:
            continue
        logs = _log_ratios(pairs)
        p, ratio = sign_flip_p(logs), _mean_ratio(logs)
        # None where nothing could be found at this level, even if all drives agreed
        outcome = _outcome(logs, None if _smallest_p(len(logs)) > level else p, level)
        if outcome in (Outcome.BETTER, Outcome.WORSE) and 1.0 / MIN_RATIO < ratio < MIN_RATIO:
            outcome = Outcome.NO_DIFFERENCE
        yield HistoryPoint(
            run=run.name,
            kind=name.kind,
            figure=name.name,
            drives=len(pairs),
            median=float(np.median([item.other for item in pairs])),
            baseline=baseline.name,
            ratio=ratio,
            ci95=_ratio_interval(logs),
            p=p,
            outcome=outcome,
        )
        if outcome is Outcome.BETTER:
            baseline = run


def _outcome(log_ratios: FloatArray, p: float | None, level: float) -> Outcome:
    if not log_ratios.any():
        return Outcome.EQUAL
    if p is None:
        return Outcome.NOT_ENOUGH_DATA
    if p >= level:
        return Outcome.NO_DIFFERENCE
    return Outcome.WORSE if log_ratios.mean() > 0.0 else Outcome.BETTER


def figures_of(score: Score) -> dict[FigureName, float]:
    """Return the figures of a score that are defined and positive.

    Times count only where no other job ran beside; they are multiples of a fixed work measured in the same run.
    """
    return {name: value for name, value in _figures(score) if value is not None and value > 0.0}


def _figures(score: Score) -> Iterator[tuple[FigureName, float | None]]:
    accuracy = FigureKind.ACCURACY
    for part in () if score.trajectory is None else score.trajectory.conditions:
        over = f"over {part.condition.label}"
        yield FigureName(accuracy, f"position {over}, m"), part.position_m.mean_plus_3sigma
        yield FigureName(accuracy, f"attitude {over}, deg"), part.attitude_deg.mean_plus_3sigma
        yield FigureName(accuracy, f"heading {over}, deg"), part.heading_deg.mean_plus_3sigma
    yield FigureName(accuracy, "map point error, m"), value_at(score, "map.errors.point_error_m.mean_plus_3sigma")
    coverage = value_at(score, "map.coverage")
    yield FigureName(accuracy, "map not covered, share"), None if coverage is None else 1.0 - coverage
    reference_s = (value_at(score, "provenance.host") or {}).get(REFERENCE)
    for kind in (CallKind.LOCALISATION, CallKind.MAPPING):
        yield FigureName(FigureKind.MEMORY, f"{kind} peak, bytes"), value_at(score, f"memory.{kind}.peak_bytes")
        median_s = value_at(score, f"timing.{kind}.p50")
        share = None if median_s is None or reference_s is None else median_s / float(reference_s)
        yield FigureName(FigureKind.TIME, f"{kind} p50, of the reference"), share


def _log_ratios(pairs: Sequence[DriveRatio]) -> FloatArray:
    return np.array([np.log(item.other / item.first) for item in pairs])


def _mean_ratio(log_ratios: FloatArray) -> float:
    return float(np.exp(log_ratios.mean()))


def _ratio_interval(logs: FloatArray) -> Interval | None:
    """Return the 95 % interval of the geometric mean ratio by resampling drives; None with too few."""
    if len(logs) < 5:
        return None
    means = drawn_weights(len(logs)) @ logs / len(logs)
    low, high = np.quantile(means, (0.025, 0.975))
    return float(np.exp(low)), float(np.exp(high))


def sign_flip_p(log_ratios: FloatArray) -> float | None:
    """Return the two-sided probability of a mean log ratio as large by chance; None with too few drives.

    Args:
        log_ratios: `(D,)` one for each drive; 0 where both are equal.
    """
    count = len(log_ratios)
    if count < MIN_TESTED:
        return None
    if not log_ratios.any():
        return 1.0
    observed = abs(log_ratios.sum()) * (1.0 - 1e-12)
    if count <= EXACT_DRIVES:
        bits = (np.arange(2**count)[:, None] >> np.arange(count)) & 1
        sums = np.abs((2.0 * bits - 1.0) @ log_ratios)
        return float(np.mean(sums >= observed))
    rng = np.random.default_rng([SEED, count])
    exceeded = drawn = 0
    while exceeded < ENOUGH_EXCEEDED and drawn < MAX_DRAWS:  # few decide a large probability (Besag, Clifford 1991)
        signs = rng.integers(0, 2, (DRAWS, count), dtype=np.int8) * 2.0 - 1.0
        exceeded += int(np.count_nonzero(np.abs(signs @ log_ratios) >= observed))
        drawn += DRAWS
    return (1 + exceeded) / (1 + drawn)


def _smallest_p(count: int) -> float:
    """Return the smallest probability that so many drives can show."""
    return 2.0 ** (1 - count) if count <= EXACT_DRIVES else 1.0 / (1 + MAX_DRAWS)
