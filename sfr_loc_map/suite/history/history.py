"""Changes of a suite's figures from night to night (docs/decisions/0008-history.md).

The shift of a figure of a job is its mean over the last nights minus its mean over reference nights, on the scale of
the figure (`scales.py`). On a logarithmic scale, a shift is a ratio. The shifts are also averaged over all jobs, so
that a small change that is common to all jobs is detected. Each shift has a prediction interval of Student's t from the
scatter of the reference nights (`shifts.py`). A change is reported if the interval excludes a shift of 0. The level of
the intervals is divided by the number of shifts of a night (Bonferroni), so that without a change at most one night in
365 raises an alarm.

A job is a source with its task, faults, configuration and repeat, which each night runs again.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter, itemgetter

import numpy as np

from sfr_loc_map.errors import InputError, MetricsError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.metrics.comparison import Outcome
from sfr_loc_map.metrics.statistics.intervals import Interval
from sfr_loc_map.metrics.stored.score_json import to_plain
from sfr_loc_map.suite.history.night import Night, NightJob
from sfr_loc_map.suite.history.scales import SCALES, Scale
from sfr_loc_map.suite.history.shifts import (
    MIN_JOBS_OF_SCATTER,
    MIN_REFERENCE,
    Shift,
    find_shifts,
    is_last_night_tested,
    known_mean,
)
from sfr_loc_map.suite.jobs.job import PairKey, with_common_keys
from sfr_loc_map.suite.statistics.figures import ComparedFigure, ComparedKind

FALSE_ALARM_RATE = 1.0 / 365.0  #: Probability of an alarm in a night without a change, over all figures and jobs.
SHORT_COMMIT = 9
WITHOUT_RESULT = ComparedFigure(ComparedKind.FAILED, "jobs without a result, share", "jobs_without_result", "value")


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """A change of a figure from one night to the next."""

    night: str  #: First night after the change; for a slow change, the first of the last nights that revealed it.
    #: Last night before the change in which a changed job has the figure; for a slow change, the last of the reference
    #: nights.
    before_night: str
    #: Commits of `before_night` and of `night`. The change is due to a commit after the first, up to and including the
    #: second.
    commits: tuple[str | None, str | None]
    kind: ComparedKind
    figure: str  #: Name with unit.
    outcome: Outcome
    jobs: tuple[str, ...]  #: Changed jobs; all jobs if no single job or more than half of them show the change.
    paths: tuple[str, ...]  #: Sources of the changed jobs.
    of: int  #: Number of jobs that have the figure.
    before: float  #: Mean over the changed jobs before the change; geometric except for counts and fractions.
    after: float  #: Mean over the changed jobs after the change.
    ratio: float | None  #: `after / before`; None if `before` is 0.
    ci95: Interval | None  #: 95 % interval of the ratio; None for counts.
    is_slow: bool  #: Whether the figure changed slowly over many nights, so that no single night is that of the change.

    @property
    def range(self) -> str:
        """Range of commits that contains the change, in the notation of git."""
        return "..".join((commit or "unknown")[:SHORT_COMMIT] for commit in self.commits)

    @property
    def since(self) -> str:
        """Night since which the figure has changed."""
        return self.before_night if self.is_slow else self.night

    @property
    def kind_of_change(self) -> str:
        """The outcome, and whether the change was slow."""
        return f"slowly {self.outcome}" if self.is_slow else str(self.outcome)

    @property
    def text(self) -> str:
        """The change in words."""
        which = "all jobs" if len(self.jobs) == self.of else ", ".join(self.jobs)
        size = f"{self.before:.4g} to {self.after:.4g}"
        what = f"{self.figure} {self.kind_of_change} since {self.since} ({self.range})"
        return f"{what}, {size}, of {which}; {self.command}"

    @property
    def command(self) -> str:
        """Command that displays the change, for a shell."""
        return shlex.join(("sfr", "report", self.before_night, self.night))


@dataclass(frozen=True, slots=True, kw_only=True)
class History:
    """The nights of a suite, in chronological order, with the detected changes."""

    nights: tuple[str, ...]  #: Names of the nights.
    commits: tuple[str | None, ...]
    false_alarm_rate: float  #: Maximum probability of an alarm in a night without a change.
    changes: tuple[Change, ...]  #: Changes in the order of the nights.
    figures: Mapping[str, tuple[float | None, ...]]  #: Mean over the jobs of each night, by figure.
    #: Number of figures of the last night whose scatter is known, without the fraction of jobs without a result.
    tested: int
    #: Jobs and sources without a result in the last night, which it or the night before had planned.
    without_result: tuple[str, ...]

    @property
    def shortage(self) -> str:
        """Why no figure of the last night could be tested; empty if a figure was tested."""
        if self.tested:
            return ""
        return (
            f"no figure of the last night could be tested: {MIN_REFERENCE} earlier nights with the figure are "
            f"required, or {MIN_JOBS_OF_SCATTER} jobs if the figure does not depend on the host"
        )

    @property
    def worse(self) -> tuple[Change, ...]:
        """The changes for the worse that are the last change of the figure for at least one of their jobs.

        A change for the better therefore closes a change for the worse only for the jobs that became better.
        """
        last = {(change.figure, job): change for change in self.changes for job in change.jobs}
        worse = [change for change in self.changes if change.outcome is Outcome.WORSE]
        return tuple(change for change in worse if any(last[change.figure, job] is change for job in change.jobs))

    def to_dict(self) -> dict[str, object]:
        """Return the history as JSON values."""
        changes = [to_plain(change) | {"command": change.command} for change in self.changes]
        return {"schema": "sfr-history/4", **to_plain(self), "changes": changes}


def find_changes(nights: Sequence[Night]) -> History:
    """Return the changes over nights in chronological order.

    Raise a MetricsError for fewer than two nights, and an InputError if there is no result.
    """
    if len(nights) < 2:
        raise MetricsError(f"a history requires at least two suites, found {len(nights)}: give several folders")
    jobs_of_nights = with_common_keys([night.jobs for night in nights])
    latest = {key: job for jobs in jobs_of_nights for key, job in jobs.items()}
    if not latest:
        raise InputError(f"none of the {len(nights)} suites has a result: give folders of finished suites")
    tables = _figure_tables(jobs_of_nights, [*latest])
    changes: list[tuple[int, Change]] = []  # with the number of the night
    series = {}
    tested = 0
    for figure, table in tables.items():
        scale = SCALES[figure.kind]
        has_figure = np.asarray(np.isfinite(table).any(axis=1))
        jobs = [job for job, has in zip(latest.values(), has_figure, strict=True) if has]
        values = table[has_figure]
        x = scale.apply(values)
        series[figure.name] = _means_of_nights(values, scale)
        if figure != WITHOUT_RESULT and is_last_night_tested(x, scale):
            tested += 1
        for shift in find_shifts(x, scale, FALSE_ALARM_RATE / len(tables)):
            shifted = [jobs[index] for index in shift.jobs]
            changes.append((shift.night, _change(shift, values, figure, nights, shifted)))
    return History(
        nights=tuple(night.name for night in nights),
        commits=tuple(night.commit for night in nights),
        false_alarm_rate=FALSE_ALARM_RATE,
        changes=tuple(change for _, change in sorted(changes, key=itemgetter(0))),
        figures=series,
        tested=tested,
        without_result=(*nights[-1].without_result, *_no_longer_planned(nights[-1], *jobs_of_nights[-2:])),
    )


def _no_longer_planned(
    night: Night, before: Mapping[PairKey, NightJob], jobs: Mapping[PairKey, NightJob]
) -> Iterator[str]:
    """Yield the labels of the jobs of the night before that a night plans neither by their key nor by their label."""
    planned = night.planned_labels
    yield from (job.label for key, job in before.items() if key not in jobs and job.label not in planned)


def _means_of_nights(values: FloatArray, scale: Scale) -> tuple[float | None, ...]:
    """Return the mean of a figure `(job, night)` over the jobs of each night; None if no job has the figure."""
    if scale.undo is None:
        means = known_mean(values).tolist()
    else:
        means = [scale.undo(mean) for mean in known_mean(scale.apply(values)).tolist()]
    return tuple(mean if np.isfinite(mean) else None for mean in means)


def _figure_tables(
    jobs_of_nights: Sequence[Mapping[PairKey, NightJob]], keys: Sequence[PairKey]
) -> dict[ComparedFigure, FloatArray]:
    """Return the values `(job, night)` of each figure, NaN if missing.

    The further figure `WITHOUT_RESULT` is 1 in a night without a result of a job, 0 with a result, and missing before
    the first night that plans the job. The name of a figure is that of the last night with the figure.
    """
    found = [  # by job, for each night
        {key: job.figures for key, job in jobs.items() if job.figures is not None} for jobs in jobs_of_nights
    ]
    latest = {figure: figure for results in found for figures in results.values() for figure in figures}
    tables = {
        figure: np.array([[results.get(key, {}).get(figure, np.nan) for results in found] for key in keys])
        for figure in sorted(latest.values(), key=attrgetter("kind", "name"))
    }
    has_result = np.array([[key in results for results in found] for key in keys])
    is_planned = np.array([[key in jobs for jobs in jobs_of_nights] for key in keys])
    since_planned = np.maximum.accumulate(is_planned, axis=1)
    tables[WITHOUT_RESULT] = np.where(since_planned, 1.0 - has_result, np.nan)
    return tables


def _change(
    shift: Shift, values: FloatArray, figure: ComparedFigure, nights: Sequence[Night], jobs: Sequence[NightJob]
) -> Change:
    """Return a shift of the values `(job, night)` of a figure as a change in the unit of the figure.

    `jobs` are the shifted jobs, each as in the last night that contains the job.
    """
    undo = SCALES[figure.kind].undo
    is_nees = figure.kind is ComparedKind.NEES
    is_worse = abs(shift.after) > abs(shift.before) if is_nees else shift.after > shift.before
    ci95 = None
    if undo is None:
        shifted = values[list(shift.jobs)]
        before, after = _mean_in(shifted[:, shift.nights.before]), _mean_in(shifted[:, shift.nights.after])
    else:
        before, after = undo(shift.before), undo(shift.after)
        low, high = undo(shift.after - shift.half_width), undo(shift.after + shift.half_width)
        ci95 = (low / before, high / before) if before > 0.0 else None
    last, first = nights[shift.last_before], nights[shift.night]
    return Change(
        night=first.name,
        before_night=last.name,
        commits=(last.commit, first.commit),
        kind=figure.kind,
        figure=figure.name,
        outcome=Outcome.WORSE if is_worse else Outcome.BETTER,
        jobs=tuple(job.label for job in jobs),
        paths=tuple(dict.fromkeys(job.path for job in jobs)),
        of=shift.of,
        before=before,
        after=after,
        ratio=after / before if before > 0.0 else None,
        ci95=ci95,
        is_slow=shift.nights.is_slow,
    )


def _mean_in(values: FloatArray) -> float:
    """Return the mean over jobs of values `(job, night)`, first over the nights of a job."""
    return float(known_mean(known_mean(values.T)))
