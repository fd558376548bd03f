"""Where the figures of a suite changed, night by night (docs/decisions/0008-history.md).

Of each figure the last 1, 2, 4, 8 and 16 nights are compared with up to 30 nights before them: the mean over all
drives, which shows a small change of all, and each drive by itself, which shows a large change of a few. Each
comparison gives an e-value, a number whose expectation is at most one while nothing changes: the Bayes factor of
Student's t (Gönen, Johnson, Lu, Westfall 2005; an e-value by Pérez-Ortiz, Lardy, de Heide, Grünwald 2024). Their mean
is one as well, whatever their dependence (Vovk, Wang 2021), so that it exceeds 365 in one of 365 nights at most
(Markov), however long the history is.
"""

from __future__ import annotations

import json
import os
import subprocess
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from sfr_loc_map.errors import InputError, MetricsError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.inputs import one_line, refusing
from sfr_loc_map.metrics.comparison import Outcome
from sfr_loc_map.metrics.score_json import MAX_NUMBER, to_plain
from sfr_loc_map.suite.figures import FigureKind, FigureName

ALARM = 365.0  #: Least mean e-value of a change: nights between two false alarms, at least, on average.
WINDOWS = (1, 2, 4, 8, 16)  #: Nights that are compared with those before.
LOCATED_WITHIN = 32  #: Nights before an alarm among which the change is looked for.
REFERENCE = 30  #: Nights before, at most.
MIN_REFERENCE = 5  #: With fewer, how much nights differ is not known.
MIN_DRIVES = 6  #: With so many drives, their scatter stands for that of nights where those are few.
SPREAD = 100.0  #: Variance of a change that is looked for, in variances of a night.
MAX_FREEDOM = 8.0  #: Degrees of freedom: nights have heavier tails than a normal distribution.
FALSE_DRIVES = 0.1  #: Share of drives named that did not change, on average (e-BH; Wang, Ramdas 2022).


@dataclass(frozen=True, slots=True)
class Scale:
    """How a kind of figure is compared: in logarithms, as a count, or as it is."""

    apply: Callable[[FloatArray], FloatArray]  #: Values as they are compared; NaN where undefined.
    undo: Callable[[float], float]  #: The value that is compared as a number.
    floor: float  #: Least standard deviation of a drive from night to night, however equal the nights are.
    of_host: bool = False  #: Whether all drives of a night share what it depends on.


LOG = partial(Scale, lambda x: np.log(np.where(x > 0.0, x, np.nan)), lambda value: float(np.exp(value)))
COUNT = Scale(lambda x: 2.0 * np.sqrt(x + 0.375), lambda value: max(0.0, (0.5 * value) ** 2 - 0.375), 1.0)
"""`2 sqrt(n + 3/8)` (Anscombe 1948): of deviation 1."""
SCALES: Mapping[FigureKind, Scale] = {
    FigureKind.ACCURACY: LOG(0.05),
    FigureKind.NEES: LOG(0.1),
    FigureKind.LOST: COUNT,
    FigureKind.DEGRADED: COUNT,
    FigureKind.MISSING: COUNT,
    FigureKind.FAILED: Scale(np.copy, float, 0.1),
    FigureKind.TIME: LOG(0.05, of_host=True),
    FigureKind.MEMORY: LOG(0.02, of_host=True),
}
SHORT_COMMIT = 9
WITHOUT_RESULT = FigureName(FigureKind.FAILED, "drives without a result, share")


def _figure(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= MAX_NUMBER:
        raise ValueError(f"a figure is {value!r:.40}: a number from 0 on is needed")
    return float(value)


@dataclass(frozen=True, slots=True)
class Night:
    """One suite of a history: its name, its commit, and by drive the name, path and figures; none without a result."""

    name: str
    commit: str | None
    labels: Mapping[str, str]
    paths: Mapping[str, str]
    figures: Mapping[str, Mapping[FigureName, float]]

    @classmethod
    def read(cls, folder: Path) -> Night:
        """Return the night whose results a folder holds, from its `suite.json`."""
        path = folder / "suite.json"
        with refusing(f"no figures in '{path}'", f"make it with sfr suite report '{folder}'"):
            content = json.loads(path.read_text(encoding="utf-8"))
            drives = [*content["drives"], *content["failures"]]
            keys = [f"{drive['pairing']} {drive['configuration']}" for drive in drives]
            figures = [
                {FigureName(FigureKind(kind), name): _figure(value) for kind, name, value in drive["figures"]}
                for drive in content["drives"]
            ]
            labels = {key: drive["label"] for key, drive in zip(keys, drives, strict=True)}
            paths = {key: drive.get("path") or drive["source"] for key, drive in zip(keys, drives, strict=True)}
            commit = content["git"]["commit"]
        return cls(str(folder), commit, labels, paths, dict(zip(keys, figures, strict=False)))

    def without_configurations(self) -> Night:
        """Return it with drives that are known by their data alone."""
        of_drives = ({key.partition(" ")[0]: value for key, value in part.items()}
                     for part in (self.labels, self.paths, self.figures))  # fmt: skip
        return Night(self.name, self.commit, *of_drives)  # type: ignore[arg-type]


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """A change of one figure, from one night to the next."""

    night: str  #: First night after it.
    before_night: str  #: Last night before it.
    found: str  #: Night at which it was certain.
    commits: tuple[str | None, str | None]  #: Of the last night before and the first after.
    kind: FigureKind
    figure: str  #: Name with unit.
    outcome: Outcome
    drives: tuple[str, ...]  #: Drives that changed; all if none shows it by itself, or more than half do.
    paths: tuple[str, ...]  #: Their sources.
    of: int  #: Drives that have the figure.
    before: float  #: Mean over these drives before; geometric but for counts and shares.
    after: float  #: The same after.
    evidence: float  #: Mean e-value of the night at which it was found.

    @property
    def range(self) -> str:
        """The commits among which it is, as git takes them."""
        return "..".join((commit or "unknown")[:SHORT_COMMIT] for commit in self.commits)

    @property
    def text(self) -> str:
        """The change in words."""
        which = "all drives" if len(self.drives) == self.of else ", ".join(self.drives)
        size = f"{self.before:.4g} to {self.after:.4g}"
        return f"{self.figure} {self.outcome} since {self.night} ({self.range}), {size}, of {which}; {self.command}"

    @property
    def command(self) -> str:
        """The command that shows it."""
        return f"sfr suite compare {self.before_night} {self.night}"


@dataclass(frozen=True, slots=True, kw_only=True)
class History:
    """Nights in their order."""

    nights: tuple[str, ...]  #: Their names.
    commits: tuple[str | None, ...]
    alarm: float  #: Evidence from which on a change is certain.
    changes: tuple[Change, ...]  #: In the order in which they were found.
    figures: Mapping[str, tuple[float | None, ...]]  #: Mean over the drives by night, by figure.

    @property
    def worse(self) -> tuple[Change, ...]:
        """Changes for the worse that no later change of the figure followed."""
        last = {change.figure: change for change in self.changes}
        return tuple(change for change in last.values() if change.outcome is Outcome.WORSE)

    def to_dict(self) -> dict[str, object]:
        """Return it as JSON values."""
        changes = [to_plain(change) | {"command": change.command} for change in self.changes]
        return {"schema": "sfr-history/2", **to_plain(replace(self, changes=())), "changes": changes}


def find_changes(nights: Sequence[Night]) -> History:
    """Return how the figures changed over nights in the order of time; MetricsError for fewer than two."""
    if len(nights) < 2:
        raise MetricsError(f"a history needs two suites or more, found {len(nights)}: give several folders")
    if all(len({key.partition(" ")[2] for key in night.labels}) < 2 for night in nights):  # another name is no change
        nights = [night.without_configurations() for night in nights]
    keys = list(dict.fromkeys(key for night in nights for key in night.labels))
    if not keys:
        raise InputError(f"no drive in {len(nights)} suites: give suites with a result each")
    names = sorted({name for night in nights for figures in night.figures.values() for name in figures})
    tables = {
        name: np.array([[night.figures.get(key, {}).get(name, np.nan) for night in nights] for key in keys])
        for name in names
    }
    there = np.array([[key in night.figures for night in nights] for key in keys])
    since = np.maximum.accumulate(np.array([[key in night.labels for night in nights] for key in keys]), axis=1)
    tables[WITHOUT_RESULT] = np.where(since, 1.0 - there, np.nan)  # a drive that is left out has none either
    last = {key: night for night in nights for key in night.labels}
    changes, series = [], {}
    for name, table in tables.items():
        scale = SCALES[name.kind]
        having = np.isfinite(table).any(axis=1)
        x, drives = scale.apply(table[having]), [key for key, has in zip(keys, having, strict=True) if has]
        series[name.name] = tuple(scale.undo(mean) if np.isfinite(mean) else None for mean in _mean(x).tolist())
        for found in changes_of(x, scale, ALARM * len(tables)):
            changed = [drives[index] for index in found.drives]
            before, after = scale.undo(found.before), scale.undo(found.after)
            worse = abs(found.after) > abs(found.before) if name.kind is FigureKind.NEES else after > before
            pair = nights[found.night - 1], nights[found.night]
            change = Change(
                night=pair[1].name,
                before_night=pair[0].name,
                found=nights[found.found].name,
                commits=(pair[0].commit, pair[1].commit),
                kind=name.kind,
                figure=name.name,
                outcome=Outcome.WORSE if worse else Outcome.BETTER,
                drives=tuple(last[key].labels[key] for key in changed),
                paths=tuple(dict.fromkeys(last[key].paths[key] for key in changed)),
                of=found.of,
                before=before,
                after=after,
                evidence=found.evidence / len(tables),
            )
            changes.append((found.found, change))
    return History(
        nights=tuple(night.name for night in nights),
        commits=tuple(night.commit for night in nights),
        alarm=ALARM,
        changes=tuple(change for _, change in sorted(changes, key=lambda item: item[0])),
        figures=series,
    )


@dataclass(frozen=True, slots=True)
class FoundChange:
    """A change in values `(drive, night)` as they are compared."""

    night: int  #: First night after it.
    found: int  #: Night at which it was certain.
    drives: tuple[int, ...]  #: Drives that changed.
    of: int  #: Drives with values before and after.
    before: float  #: Mean over these drives before.
    after: float
    evidence: float


def changes_of(x: FloatArray, scale: Scale, alarm: float) -> list[FoundChange]:
    """Return the changes in values `(D, T)`, NaN where there is none; each begins the reference of the next."""
    found: list[FoundChange] = []
    start = searched = 0
    while len(nights := x[:, start:].T) > 1:
        total = np.mean([_of_window(x[:, start:], scale, window)[0] for window in WINDOWS], axis=0)
        total[: searched - start] = 0.0
        if not (alarms := np.flatnonzero(total >= alarm)).size:
            break
        at = int(alarms[0])
        until = x[:, start : start + at + 1]
        within = [_of_window(until, scale, window) for window in range(1, min(LOCATED_WITHIN, at) + 1)]
        window = int(np.argmax([both[-1] for both, _ in within])) + 1
        first = at + 1 - window
        before = _mean(nights[max(0, first - REFERENCE) : first])
        after = _mean(nights[first : at + 1])
        there = np.flatnonzero(np.isfinite(after - before))
        ranked = np.sort(each := within[window - 1][1][there, -1])[::-1]
        enough = np.flatnonzero(ranked * np.arange(1, len(ranked) + 1) >= len(there) / FALSE_DRIVES)  # e-BH
        alone = int(enough[-1]) + 1 if enough.size else 0
        drives = there[each >= ranked[alone - 1]] if 0 < alone <= len(there) / 2 else there
        means = float(before[drives].mean()), float(after[drives].mean())
        found.append(
            FoundChange(start + first, start + at, tuple(drives.tolist()), len(there), *means, float(total[at]))
        )
        start, searched = start + first, start + at + 1
    return found


def _mean(nights: FloatArray) -> FloatArray:
    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):
        return np.asarray(np.nanmean(nights, axis=0))


def _of_window(x: FloatArray, scale: Scale, window: int) -> tuple[FloatArray, FloatArray]:
    """Return e-values of a change of the last nights of each night: of all drives `(T)`, of each by itself `(D, T)`."""
    drives, nights = x.shape
    # each about its own mean, so that a drive that is missing moves no mean over the others
    centred = x - _mean(x.T)[:, None]
    n0, n1, difference, variance, freedom = _split(centred, window)
    long = n0 >= MIN_REFERENCE
    ranked = np.sort(np.where(long, variance, np.inf), axis=0)
    usual = ranked[np.maximum(long.sum(axis=0) - 1, 0) // 2, np.arange(nights)]  # that of the drive in the middle
    variance = np.maximum(variance, np.maximum(np.where(np.isfinite(usual), usual, 0.0), scale.floor**2))
    each = np.where(long, e_value(difference, variance, n0, n1, freedom), 0.0)

    m0, m1, shift, variance, freedom = (part[0] for part in _split(_mean(centred)[None], window))
    both = np.where(n0 * n1 > 0, difference, np.nan)
    count = np.isfinite(both).sum(axis=0)
    enough = m0 >= MIN_REFERENCE
    if drives >= MIN_DRIVES and not scale.of_host:  # how the drives of one night differ
        scatter = _mean(np.square(both - _mean(both))) / np.maximum(count - 1, 1)
        variance = np.where(enough, variance, scatter * m0 * m1 / np.maximum(m0 + m1, 1.0))
        freedom = np.where(enough, freedom, count - 1.0)
        enough |= count >= MIN_DRIVES
    variance = np.maximum(variance, scale.floor**2 / np.maximum(count, 1))
    pooled = np.where(enough, e_value(shift, variance, m0, m1, freedom), 0.0)
    return 0.5 * pooled + 0.5 * each.mean(axis=0), each


def _split(x: FloatArray, window: int) -> tuple[FloatArray, ...]:
    """Return counts before and in the last nights, difference of means, variance, its freedom, each `(D, T)`."""
    there = np.isfinite(x)
    values, end = np.where(there, x, 0.0), np.arange(x.shape[1]) + 1
    first = np.maximum(end - window, 0)
    low = np.maximum(first - REFERENCE, 0)
    sums = [np.pad(np.cumsum(part, axis=1), ((0, 0), (1, 0))) for part in (there * 1.0, values, np.square(values))]
    (n0, s0, q0), (n1, s1, q1) = (
        [part[:, b] - part[:, a] for part in sums] for a, b in ((low, first), (first, end))
    )  # fmt: skip
    mean0, mean1 = s0 / np.maximum(n0, 1.0), s1 / np.maximum(n1, 1.0)
    squares, freedom = np.maximum(q0 - s0 * mean0 + q1 - s1 * mean1, 0.0), n0 + n1 - 2.0
    return n0, n1, mean1 - mean0, squares / np.maximum(freedom, 1.0), freedom


def e_value(
    difference: FloatArray, variance: FloatArray, n0: FloatArray, n1: FloatArray, freedom: FloatArray
) -> FloatArray:
    """Return the Bayes factor of a difference of two means, 0 where either has no value: an e-value.

    The difference under change has the variance `SPREAD` times that of a night.
    """
    size = n0 * n1 / np.maximum(n0 + n1, 1.0)
    nu, wider = np.clip(freedom, 1.0, MAX_FREEDOM), 1.0 + SPREAD * size
    t2 = np.square(difference) * size / variance
    return np.where(size > 0, wider**-0.5 * ((1.0 + t2 / nu) / (1.0 + t2 / (nu * wider))) ** (0.5 * (nu + 1.0)), 0.0)


def find_commit(change: Change, command: str, repository: Path) -> str:
    """Return the first commit of a change for which a command of the shell fails (`git bisect run`).

    It has `SFR_DRIVES` (paths, one a line), `SFR_FIGURE`, `SFR_BEFORE`, `SFR_AFTER`. InputError if git cannot search.
    """
    good, bad = ((commit or "").partition("-")[0] for commit in change.commits)
    if not good or not bad or good == bad:
        raise InputError(f"no commits to search between '{change.before_night}' and '{change.night}': {change.range}")
    variables = {"DRIVES": "\n".join(change.paths), "FIGURE": change.figure}
    variables |= {"BEFORE": repr(change.before), "AFTER": repr(change.after)}
    environment = os.environ | {f"SFR_{name}": value for name, value in variables.items()}
    run = partial(
        subprocess.run, cwd=repository, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True
    )
    if (changed := run(["git", "status", "--porcelain", "--untracked-files=no"])).returncode or changed.stdout:
        what = changed.stderr.strip() or "files have changes"
        raise InputError(f"cannot search with git in '{repository.absolute()}': {what}; go to a clean checkout of it")
    try:
        for arguments in (("start", bad, good, "--"), ("run", "sh", "-c", command)):
            done = run(["git", "bisect", *arguments])
            if done.returncode:
                said = one_line(done.stderr.strip() or done.stdout.strip()[-500:])
                raise InputError(f"git bisect found no commit between {good} and {bad}: {said}")
        return run(["git", "log", "-1", "--format=%H %s", "refs/bisect/bad"]).stdout.strip()
    finally:
        run(["git", "bisect", "reset"])
