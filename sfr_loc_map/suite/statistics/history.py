"""Detect changes of a suite's figures from night to night (docs/decisions/0008-history.md).

The last night and the mean of the last four nights are compared with up to 30 reference nights. Each figure of a job
is divided by its mean over the reference nights (paired ratio). The mean over all jobs is divided likewise, so that a
small change that is common to all jobs is detected. Each ratio has a prediction interval of Student's t from the
scatter of the reference nights. A change is reported if the interval excludes 1. The level of the intervals is divided
by the number of ratios of a night (Bonferroni), so that without a change at most one night in 365 raises an alarm.

A job is a source with its task, faults, configuration and repeat, which each night runs again.
"""

from __future__ import annotations

import json
import shlex
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import combinations, pairwise
from operator import itemgetter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from sfr_loc_map.errors import InputError, MetricsError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.inputs import refusing
from sfr_loc_map.metrics.statistics.intervals import Interval
from sfr_loc_map.metrics.stored.comparison import Outcome
from sfr_loc_map.metrics.stored.score_json import to_plain
from sfr_loc_map.suite.statistics.figures import ComparedKind, FigureName
from sfr_loc_map.suite.statistics.pairing import PairKey, have_one_configuration, without_configuration
from sfr_loc_map.suite.statistics.summary import SCHEMA

MAX_NUMBER = 1e100  #: Maximum number of a figure; its squares and sums are finite.
WINDOWS = (1, 4)  #: Lengths of the mean, nights: 1 detects large changes immediately, 4 detects small changes later.
FALSE_ALARM_RATE = 1.0 / 365.0  #: Probability of an alarm in a night without a change, over all figures and jobs.
REFERENCE = 30  #: Maximum number of reference nights.
MIN_REFERENCE = 5  #: Minimum number of reference nights to estimate their scatter.
MIN_JOBS_OF_SCATTER = 6  #: Minimum number of jobs whose scatter replaces that of too few nights.
MAX_FREEDOM = 5.0  #: Upper bound of the degrees of freedom: nights have heavier tails than a normal distribution.
FALSE_NAMES = 0.1  #: Probability that an alarm names any job that did not change.


@dataclass(frozen=True, slots=True)
class Scale:
    """Scale on which a kind of figure is compared: logarithm, count or identity."""

    apply: Callable[[FloatArray], FloatArray]  #: Converts values to the scale; NaN if undefined.
    #: Converts a mean on the scale to the reported mean; None if the reported mean is that of the values.
    undo: Callable[[float], float] | None
    floor: float  #: Minimum standard deviation of a job from night to night.
    of_host: bool = False  #: Whether the figure depends on the host, which all jobs of a night share.


def log_scale(floor: float, *, of_host: bool = False) -> Scale:
    """Return the scale of positive values, whose logarithms are compared; values that are not positive are missing."""
    return Scale(lambda x: np.log(np.where(x > 0.0, x, np.nan)), lambda value: float(np.exp(value)), floor, of_host)


COUNT = Scale(lambda x: 2.0 * np.sqrt(x + 0.375), None, 1.0)
"""Scale of a count n: `2 sqrt(n + 3/8)`, whose standard deviation is about 1 for Poisson counts (Anscombe 1948).

The scale is for the test only, because a mean of roots is far below the mean of counts that differ between jobs.
"""
#: The minimum standard deviations (`Scale.floor`) were chosen by hand: 5 % of an error or a time, 10 % of a NEES, 2 %
#: of memory, and 10 % of the jobs.
SCALES: Mapping[ComparedKind, Scale] = {
    ComparedKind.ACCURACY: log_scale(0.05),
    ComparedKind.NEES: log_scale(0.1),
    ComparedKind.LOST: COUNT,
    ComparedKind.DEGRADED: COUNT,
    ComparedKind.MISSING: COUNT,
    ComparedKind.FAILED: Scale(np.copy, float, 0.1),
    ComparedKind.TIME: log_scale(0.05, of_host=True),
    ComparedKind.MEMORY: log_scale(0.02, of_host=True),
}
SHORT_COMMIT = 9
WITHOUT_RESULT = FigureName(ComparedKind.FAILED, "jobs without a result, share")


def _figure(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= MAX_NUMBER:
        raise ValueError(f"a figure is {value!r:.40}: a number of at least 0 is required")
    return float(value)


@dataclass(frozen=True, slots=True)
class Night:
    """One suite of a history. Labels, paths and figures are by job; a job without a result has no figures."""

    name: str
    commit: str | None
    labels: Mapping[PairKey, str]
    paths: Mapping[PairKey, str]  #: Paths of the sources.
    figures: Mapping[PairKey, Mapping[FigureName, float]]
    time: str = ""  #: Time of the run, ISO 8601 in UTC; empty if unknown.
    waiting: tuple[str, ...] = ()  #: Labels of the jobs that were not run, and paths of the refused sources.

    @property
    def without_result(self) -> tuple[str, ...]:
        """Labels of the planned jobs without a result, and paths of the refused sources."""
        failed = (label for key, label in self.labels.items() if key not in self.figures)
        return (*failed, *self.waiting)

    def is_copy_of(self, other: Night) -> bool:
        """Return whether two folders have the same night: the same time, commit and figures."""
        is_equal = (self.time, self.commit, self.figures) == (other.time, other.commit, other.figures)
        return bool(self.time) and is_equal

    @classmethod
    def read(cls, folder: Path) -> Night:
        """Read the night from `suite.json` of a folder."""
        path = folder / "suite.json"
        with refusing(f"cannot read the figures of '{path}'", f"make it with sfr suite report '{folder}'"):
            content = json.loads(path.read_text(encoding="utf-8"))
            if content["schema"] != SCHEMA:
                raise ValueError(f"its schema is {content['schema']}: {SCHEMA} is required")
            results = {PairKey(item["pairing"], item["configuration"]): item for item in content["drives"]}
            failures = {PairKey(item["pairing"], item["configuration"]): item for item in content["failures"]}
            jobs = results | failures
            labels = {key: item["label"] for key, item in jobs.items()}
            paths = {key: item.get("path") or item["source"] for key, item in jobs.items()}
            figures = {
                key: {FigureName(ComparedKind(kind), name): _figure(value) for kind, name, value in item["figures"]}
                for key, item in results.items()
            }
            commit = content["git"]["commit"]
            time = str(content.get("time") or "")
            refused = [str(item["path"]) for item in content.get("refusals", ())]
            waiting = (*map(str, content.get("waiting_jobs", ())), *refused)
        return cls(str(folder), commit, labels, paths, figures, time, waiting)

    def without_configurations(self) -> Night:
        """Return the night with jobs that are identified by their work and data only, not by their configuration."""
        labels = {without_configuration(key): label for key, label in self.labels.items()}
        paths = {without_configuration(key): path for key, path in self.paths.items()}
        figures = {without_configuration(key): of_job for key, of_job in self.figures.items()}
        return replace(self, labels=labels, paths=paths, figures=figures)


def check_order(nights: Sequence[Night]) -> None:
    """Raise MetricsError if a night is given twice, or is older than the night before.

    Nights without a time are not compared by their time.
    """
    places = [Path(night.name).resolve() for night in nights]
    for first, second in combinations(range(len(nights)), 2):
        if places[first] == places[second] or nights[first].is_copy_of(nights[second]):
            raise MetricsError(
                f"'{nights[first].name}' and '{nights[second].name}' are the same night: give each night once"
            )
    timed = [night for night in nights if night.time]
    for before, after in pairwise(timed):
        if after.time < before.time:
            raise MetricsError(
                f"'{after.name}' ({after.time}) is older than '{before.name}' ({before.time}): give the suites in the "
                "order of their time"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """A change of a figure from one night to the next."""

    night: str  #: First night after the change.
    before_night: str  #: Last night before the change in which a changed job has the figure.
    #: Commits of `before_night` and of `night`. A commit after the first, up to the second, made the change.
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

    @property
    def range(self) -> str:
        """Range of commits that contains the change, in the notation of git."""
        return "..".join((commit or "unknown")[:SHORT_COMMIT] for commit in self.commits)

    @property
    def text(self) -> str:
        """The change in words."""
        which = "all jobs" if len(self.jobs) == self.of else ", ".join(self.jobs)
        size = f"{self.before:.4g} to {self.after:.4g}"
        return f"{self.figure} {self.outcome} since {self.night} ({self.range}), {size}, of {which}; {self.command}"

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
    tested: int  #: Number of figures of the last night whose scatter is known, so that a change would be detected.
    without_result: tuple[str, ...]  #: Planned jobs and sources of the last night that have no result.

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
        return {"schema": "sfr-history/4", **to_plain(replace(self, changes=())), "changes": changes}


def find_changes(nights: Sequence[Night]) -> History:
    """Return the changes over nights in chronological order.

    Raise a MetricsError for fewer than two nights, and an InputError if there is no result.
    """
    if len(nights) < 2:
        raise MetricsError(f"a history requires at least two suites, found {len(nights)}: give several folders")
    if have_one_configuration(night.labels for night in nights):
        nights = [night.without_configurations() for night in nights]
    keys = list(dict.fromkeys(key for night in nights for key in night.labels))
    if not keys:
        raise InputError(f"none of the {len(nights)} suites has a result: give folders of finished suites")
    tables = _figure_tables(nights, keys)
    last_night = {key: night for night in nights for key in night.labels}
    changes: list[tuple[int, Change]] = []
    series = {}
    tested = 0
    for name, table in tables.items():
        scale = SCALES[name.kind]
        has_figure = np.asarray(np.isfinite(table).any(axis=1))
        jobs = [key for key, has in zip(keys, has_figure, strict=True) if has]
        x = scale.apply(table[has_figure])
        means = _mean(table[has_figure]) if scale.undo is None else np.array([*map(scale.undo, _mean(x).tolist())])
        series[name.name] = tuple(mean if np.isfinite(mean) else None for mean in means.tolist())
        if name != WITHOUT_RESULT and is_last_night_tested(x, scale):
            tested += 1
        for found in changes_of(x, scale, FALSE_ALARM_RATE / len(tables)):
            changed = [jobs[index] for index in found.jobs]
            labels = [last_night[key].labels[key] for key in changed]
            paths = [last_night[key].paths[key] for key in changed]
            changes.append((found.night, _described_change(found, table[has_figure], name, nights, labels, paths)))
    return History(
        nights=tuple(night.name for night in nights),
        commits=tuple(night.commit for night in nights),
        false_alarm_rate=FALSE_ALARM_RATE,
        changes=tuple(change for _, change in sorted(changes, key=itemgetter(0))),
        figures=series,
        tested=tested,
        without_result=nights[-1].without_result,
    )


def _figure_tables(nights: Sequence[Night], keys: Sequence[PairKey]) -> dict[FigureName, FloatArray]:
    """Return the values `(job, night)` of each figure, NaN if missing, and whether a job has no result."""
    names = sorted({name for night in nights for figures in night.figures.values() for name in figures})
    tables = {
        name: np.array([[night.figures.get(key, {}).get(name, np.nan) for night in nights] for key in keys])
        for name in names
    }
    has_result = np.array([[key in night.figures for night in nights] for key in keys])
    is_planned = np.array([[key in night.labels for night in nights] for key in keys])
    since_planned = np.maximum.accumulate(is_planned, axis=1)
    tables[WITHOUT_RESULT] = np.where(since_planned, 1.0 - has_result, np.nan)  # an omitted job has no result, either
    return tables


def _described_change(
    found: FoundChange,
    table: FloatArray,
    name: FigureName,
    nights: Sequence[Night],
    labels: Sequence[str],
    paths: Sequence[str],
) -> Change:
    """Return a change of a figure `(job, night)` in its unit, with the labels and paths of the changed jobs."""
    undo = SCALES[name.kind].undo
    is_nees = name.kind is ComparedKind.NEES
    is_worse = abs(found.after) > abs(found.before) if is_nees else found.after > found.before
    ci95 = None
    if undo is None:
        changed = table[list(found.jobs)]
        before, after = (
            float(_mean(_mean(changed[:, first:end].T))) for first, end in (found.nights_before, found.nights_after)
        )
    else:
        before, after = undo(found.before), undo(found.after)
        low, high = undo(found.after - found.half_width), undo(found.after + found.half_width)
        ci95 = (low / before, high / before) if before > 0.0 else None
    last, first = nights[found.last_before], nights[found.night]
    return Change(
        night=first.name,
        before_night=last.name,
        commits=(last.commit, first.commit),
        kind=name.kind,
        figure=name.name,
        outcome=Outcome.WORSE if is_worse else Outcome.BETTER,
        jobs=tuple(labels),
        paths=tuple(dict.fromkeys(paths)),
        of=found.of,
        before=before,
        after=after,
        ratio=after / before if before > 0.0 else None,
        ci95=ci95,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Shift:
    """A change of the mean of nights relative to reference nights, on the scale of the comparison."""

    jobs: tuple[int, ...]  #: Changed jobs.
    of: int  #: Number of jobs with values before and after.
    before: float  #: Mean over the changed jobs before the change.
    after: float
    half_width: float  #: Half-width of the 95 % prediction interval of `after` from the reference nights.
    window: int  #: Number of nights whose mean revealed the change.


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundChange(Shift):
    """A change of values `(job, night)` with its nights."""

    night: int  #: First night after the change.
    last_before: int  #: Last night before the change in which a changed job has a value.
    detected: int  #: Night at which the change was detected.
    nights_before: tuple[int, int]  #: First night of the values before the change, and the night after the last night.
    nights_after: tuple[int, int]  #: The same for the values after the change.
    is_return: bool = False  #: Whether the figure returned to its level before the previous change.


def changes_of(x: FloatArray, scale: Scale, false_alarm_rate: float) -> list[FoundChange]:
    """Return the changes of values `(D, T)` of jobs and nights, NaN if missing.

    Without a change, each night is compared with the nights since `start`. The nights after a change are compared with
    the same reference as the change. If the figure returns to its old level within `MIN_REFERENCE` nights, the return
    is a second change. Otherwise the new level becomes the reference. A night without a value of the changed jobs
    is not evidence of a return.
    """
    found: list[FoundChange] = []
    start, changed_at = 0, None
    for night in range(1, x.shape[1]):
        if changed_at is not None and night - changed_at >= MIN_REFERENCE:
            start, changed_at = changed_at, None
        if changed_at is not None:
            last = found[-1]
            changed = x[list(last.jobs)]
            if not np.isfinite(changed[:, night]).any():
                continue
            after = x[:, max(changed_at, night + 1 - last.window) : night + 1]
            reference = x[:, max(start, changed_at - REFERENCE) : changed_at]
            if compare_nights(reference, after, scale, false_alarm_rate / len(WINDOWS)) is None:
                returned = replace(
                    last,
                    night=night,
                    detected=night,
                    last_before=_last_with_value(changed[:, :night]),
                    before=last.after,
                    after=float(_mean(changed[:, night])),
                    nights_before=last.nights_after,
                    nights_after=(night, night + 1),
                    is_return=True,
                )
                found.append(returned)
                changed_at = None
            continue
        for window in WINDOWS:
            first = night + 1 - window
            if first <= start:
                break
            begin = max(start, first - REFERENCE)
            reference = x[:, begin:first]
            change = compare_nights(reference, x[:, first : night + 1], scale, false_alarm_rate / len(WINDOWS))
            if change is not None:
                changed = x[list(change.jobs)]
                changed_at = first + _start_of_change(changed[:, begin:first], changed[:, first : night + 1])
                found.append(
                    FoundChange(
                        **asdict(change),
                        night=changed_at,
                        last_before=_last_with_value(changed[:, :changed_at]),
                        detected=night,
                        nights_before=(begin, first),
                        nights_after=(first, night + 1),
                    )
                )
                break
    return found


def is_last_night_tested(x: FloatArray, scale: Scale) -> bool:
    """Return whether the scatter of values `(D, T)` of jobs and nights is known, so that the last night is tested."""
    jobs = _JobShifts.of(x[:, :-1], x[:, -1:], scale)
    return bool(len(jobs.indices)) and bool(np.isfinite(jobs.scatter_of_mean(scale)[0]))


def compare_nights(before: FloatArray, after: FloatArray, scale: Scale, false_alarm_rate: float) -> Shift | None:
    """Return the change of the mean of nights `(D, W)` relative to reference nights `(D, N)`, None without a change.

    Half of the false-alarm rate is assigned to the mean over the jobs, the other half to the single jobs.
    """
    jobs = _JobShifts.of(before, after, scale)
    count = len(jobs.indices)
    if not count:
        return None
    sigma, freedom = jobs.scatter_of_mean(scale)
    has_mean_changed = abs(float(jobs.shifts.mean())) > sigma * float(_quantile(false_alarm_rate / 2, freedom))
    if not has_mean_changed and not jobs.exceeding(false_alarm_rate / 2).any():
        return None
    named = jobs.exceeding(FALSE_NAMES)
    number_named = int(named.sum())
    if 0 < number_named <= count / 2:
        sigma = float(np.sqrt(np.mean(np.square(jobs.sigmas[named])) / number_named))
        freedom = float(jobs.nights.max() - 1)
    else:
        named = np.ones(count, np.bool_)
        sigma = sigma if np.isfinite(sigma) else scale.floor / np.sqrt(count)
    return Shift(
        jobs=tuple(jobs.indices[named].tolist()),
        of=count,
        before=float(jobs.usual[named].mean()),
        after=float(jobs.present[named].mean()),
        half_width=sigma * float(_quantile(0.05, freedom)),
        window=jobs.window,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _JobShifts:
    """Shifts of the jobs that have values in the reference nights and in the compared nights."""

    indices: NDArray[np.intp]
    usual: FloatArray  #: Mean of each job over the reference nights.
    present: FloatArray  #: Mean of each job over the compared nights.
    deviations: FloatArray  #: Values of the reference nights minus their mean, `(job, night)`.
    nights: FloatArray  #: Number of reference nights of each job.
    per_compared_night: FloatArray  #: Inverse of the number of compared nights in which a job has a value.
    sigmas: FloatArray  #: Standard deviation of each shift.
    window: int  #: Number of compared nights.

    @classmethod
    def of(cls, before: FloatArray, after: FloatArray, scale: Scale) -> _JobShifts:
        """Return the shifts of the compared nights, `after` `(D, W)`, from the reference nights, `before` `(D, N)`."""
        usual, present = _mean(before.T), _mean(after.T)
        indices = np.flatnonzero(np.isfinite(present - usual))
        deviations = before[indices] - usual[indices, None]
        nights = np.asarray(np.isfinite(deviations).sum(axis=1), np.float64)
        variances = np.nansum(np.square(deviations), axis=1) / np.maximum(nights - 1, 1)
        is_long = nights >= MIN_REFERENCE
        if is_long.any():  # variances below the median, such as that of a job that never varied, become the median
            variances = np.maximum(variances, np.median(variances[is_long]))
        variances = np.maximum(variances, scale.floor**2)
        per_compared_night = 1.0 / np.isfinite(after[indices]).sum(axis=1)
        sigmas = np.sqrt(variances * (per_compared_night + 1.0 / nights))
        return cls(
            indices=indices,
            usual=usual[indices],
            present=present[indices],
            deviations=deviations,
            nights=nights,
            per_compared_night=per_compared_night,
            sigmas=sigmas,
            window=after.shape[1],
        )

    @property
    def shifts(self) -> FloatArray:
        """Shift of each job."""
        return self.present - self.usual

    def exceeding(self, false_alarm_rate: float) -> NDArray[np.bool_]:
        """Return which jobs changed, with the given rate of false alarms over all jobs together."""
        sizes = np.where(self.nights >= MIN_REFERENCE, np.abs(self.shifts) / self.sigmas, 0.0)
        return np.asarray(sizes > _quantile(false_alarm_rate / len(self.indices), self.nights - 1.0))

    def scatter_of_mean(self, scale: Scale) -> tuple[float, float]:
        """Return the standard deviation of the mean shift and its degrees of freedom; infinity if unknown.

        The scatter follows from the reference nights, or from the jobs if there are too few nights. The scatter of
        the jobs does not contain the speed of the host, which all jobs of a night share.
        """
        means = _mean(self.deviations)
        means = means[np.isfinite(means)]
        nights, jobs = len(means), len(self.indices)
        if nights >= MIN_REFERENCE:
            per_night = float(self.per_compared_night.mean())
            sigma, freedom = float(np.std(means, ddof=1)) * np.sqrt(per_night + 1.0 / nights), nights - 1.0
        elif jobs >= MIN_JOBS_OF_SCATTER and not scale.of_host:
            sigma, freedom = float(np.std(self.shifts, ddof=1) / np.sqrt(jobs)), jobs - 1.0
        else:
            sigma, freedom = np.inf, 1.0
        return max(sigma, scale.floor / np.sqrt(jobs)), freedom


def _start_of_change(before: FloatArray, after: FloatArray) -> int:
    """Return the night of `after` `(D, W)` from which the shift from the reference nights `(D, N)` is most significant.

    The shift of a night is relative to the level of each job, so that a night without the result of a job is not
    shifted. A change cannot start in a night without a value.
    """
    levels = _mean(before.T)
    shifts = _mean(after - levels[:, None])
    sizes = np.full(len(shifts), -np.inf)
    for night in np.flatnonzero(np.isfinite(shifts)):
        later = shifts[night:][np.isfinite(shifts[night:])]
        sizes[night] = abs(later.mean()) / np.sqrt(1.0 / len(later) + 1.0 / before.shape[1])
    return int(np.argmax(sizes))


def _last_with_value(x: FloatArray) -> int:
    """Return the last night in which a job has a value."""
    return int(np.flatnonzero(np.isfinite(x).any(axis=0))[-1])


def _quantile(two_sided: float, freedom: FloatArray | float) -> FloatArray:
    """Return the two-sided quantile of Student's t for a probability of exceedance."""
    return np.asarray(-stdtrit(np.clip(freedom, 1.0, MAX_FREEDOM), 0.5 * two_sided))


def _mean(nights: FloatArray) -> FloatArray:
    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):
        return np.asarray(np.nanmean(nights, axis=0))
