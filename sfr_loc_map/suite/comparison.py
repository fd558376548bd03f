"""Two suites: which is better over the drives that both have, with a correction for the number of comparisons."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.metrics.comparison import Outcome
from sfr_loc_map.metrics.score import Interval
from sfr_loc_map.metrics.score_json import to_plain
from sfr_loc_map.metrics.statistics import holm
from sfr_loc_map.suite.figure_table import FigureKind, FigureName, by_pairing, figures_of
from sfr_loc_map.suite.groups import Drive
from sfr_loc_map.suite.pooling import drawn_weights
from sfr_loc_map.suite.sign_flip import sign_flip_p
from sfr_loc_map.suite.summary import Summary

SCHEMA = "sfr-suite-comparison/1"
SIGNIFICANCE = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveRatio:
    """One figure of one drive in both suites.

    Attributes:
        label: Name of the task.
        first: Value in the first suite.
        other: Value in the other.
    """

    label: str
    first: float
    other: float


@dataclass(frozen=True, slots=True, kw_only=True)
class FigureComparison:
    """One figure over all drives run alike.

    Attributes:
        runs: Task, configuration and faults.
        kind: Accuracy, time or memory.
        figure: Name with unit.
        drives: Drives in both suites.
        ratio: Geometric mean of other over first; below 1 the other suite is better.
        ci95: 95 % interval of the ratio, by resampling drives.
        p: Probability of such a ratio by chance (sign-flip test).
        p_corrected: The same, corrected for the number of comparisons (Holm).
        outcome: What follows at 5 %.
        worst: Drive with the largest ratio.
    """

    runs: str
    kind: FigureKind
    figure: str
    drives: int
    ratio: float
    ci95: Interval | None
    p: float | None
    p_corrected: float | None
    outcome: Outcome
    worst: DriveRatio


@dataclass(frozen=True, slots=True, kw_only=True)
class SuiteComparison:
    """Two suites.

    Attributes:
        names: Their names.
        common: Drives in both.
        left_out: Drives of the first and of the other that are not in both.
        figures: By runs and figure.
    """

    names: tuple[str, str]
    common: int
    left_out: tuple[int, int]
    figures: tuple[FigureComparison, ...]

    def to_dict(self) -> dict[str, object]:
        """Return it as JSON values."""
        return {"schema": SCHEMA, **to_plain(self)}


def compare_suites(first: Summary, other: Summary, names: tuple[str, str]) -> SuiteComparison:
    """Return the comparison of two suites.

    Args:
        first: The reference.
        other: What is compared with it.
        names: Their names.

    Raises:
        MetricsError: If no drive is in both.
    """
    one = all(len({drive.configuration for drive in item.drives}) == 1 for item in (first, other))
    mine, theirs = (by_pairing(item.drives, one_configuration=one) for item in (first, other))
    common = [(drive, theirs[key]) for key, drive in mine.items() if key in theirs]
    if not common:
        raise MetricsError(
            f"'{names[0]}' and '{names[1]}' have no drive in common: run the same sources, faults and conditions"
        )
    figures = list(_figures(common))
    corrected = holm([item.p for item in figures])
    decided = [_decided(item, p) for item, p in zip(figures, corrected, strict=True)]
    left_out = (len(mine) - len(common), len(theirs) - len(common))
    return SuiteComparison(names=names, common=len(common), left_out=left_out, figures=tuple(decided))


def log_ratios(pairs: Sequence[DriveRatio]) -> FloatArray:
    """Return the logarithm of other over first `(D,)`."""
    return np.array([np.log(item.other / item.first) for item in pairs])


def ratio_interval(logs: FloatArray) -> Interval | None:
    """Return the 95 % interval of the geometric mean ratio by resampling drives; None with too few."""
    if len(logs) < 5:
        return None
    means = drawn_weights(len(logs)) @ logs / len(logs)
    low, high = np.quantile(means, (0.025, 0.975))
    return float(np.exp(low)), float(np.exp(high))


def _figures(common: Sequence[tuple[Drive, Drive]]) -> Iterator[FigureComparison]:
    pairs: dict[tuple[str, FigureName], list[DriveRatio]] = {}
    for mine, theirs in common:
        ours, others = figures_of(mine.score), figures_of(theirs.score)
        runs = ", ".join(part for part in (mine.task, mine.configuration, mine.faults) if part)
        for name in ours:
            if name in others:
                ratio = DriveRatio(label=mine.label, first=ours[name], other=others[name])
                pairs.setdefault((runs, name), []).append(ratio)
    for (runs, name), items in pairs.items():
        logs = log_ratios(items)
        yield FigureComparison(
            runs=runs,
            kind=name.kind,
            figure=name.name,
            drives=len(items),
            ratio=float(np.exp(logs.mean())),
            ci95=ratio_interval(logs),
            p=sign_flip_p(logs),
            p_corrected=None,
            outcome=Outcome.EQUAL if not logs.any() else Outcome.NOT_ENOUGH_DATA,
            worst=items[int(logs.argmax())],
        )


def _decided(item: FigureComparison, p: float | None) -> FigureComparison:
    if item.outcome is Outcome.EQUAL or p is None:
        return replace(item, p_corrected=p)
    better = Outcome.BETTER if item.ratio < 1.0 else Outcome.WORSE
    return replace(item, p_corrected=p, outcome=better if p < SIGNIFICANCE else Outcome.NO_DIFFERENCE)
