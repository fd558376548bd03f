"""Changes in a history: night, figure, drives and commits of a change, and the rate of false alarms."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from helpers.cli_result import Sfr
from helpers.json_mutations import mutations
from sfr_loc_map.errors import InputError, MetricsError
from sfr_loc_map.metrics.comparison import Outcome
from sfr_loc_map.metrics.stored.score_json import json_line, to_plain
from sfr_loc_map.suite.history.history import FALSE_ALARM_RATE, Change, History, find_changes
from sfr_loc_map.suite.history.night import Night, NightJob, read_nights
from sfr_loc_map.suite.history.scales import SCALES
from sfr_loc_map.suite.history.shifts import Compared, compare, find_shifts
from sfr_loc_map.suite.jobs.job import PairKey
from sfr_loc_map.suite.pages.history_page import render_history
from sfr_loc_map.suite.statistics.figures import ComparedFigure, ComparedKind
from sfr_loc_map.suite.statistics.summary import SCHEMA

DRIVES = [f"drive {number}" for number in range(45)]
NAMES = {
    ComparedKind.ACCURACY: "position over 5 m, m",
    ComparedKind.LOST: "lost, frames",
    ComparedKind.TIME: "localisation mean, s",
    ComparedKind.NEES: "NEES over 5 m, over that expected",
}
FIGURES = {kind: ComparedFigure(kind, name, name, "value") for kind, name in NAMES.items()}


def nights(count: int, seed: int = 0) -> dict[ComparedKind, np.ndarray]:
    rng = np.random.default_rng(seed)
    shape = (len(DRIVES), count)
    level = np.exp(rng.normal(0.0, 0.5, (len(DRIVES), 1)))
    return {
        ComparedKind.ACCURACY: 0.01 * level * np.exp(rng.normal(0.0, 0.03, shape)),
        ComparedKind.LOST: rng.poisson(0.5, shape) * 1.0,
        ComparedKind.TIME: 0.1 * np.exp(rng.normal(0.0, 0.02, shape) + rng.normal(0.0, 0.03, count)),
        ComparedKind.NEES: np.exp(rng.normal(0.0, 0.1, shape)),
    }


def found(tables: dict[ComparedKind, np.ndarray], gone: tuple[int, int] | None = None) -> History:
    """Return the changes of nights; of `gone` drives there is no result from a night on."""
    made = []
    for night in range(next(iter(tables.values())).shape[1]):
        there = DRIVES[gone[0] :] if gone and night >= gone[1] else DRIVES
        figures = {
            PairKey(key, ""): {FIGURES[kind]: float(x[DRIVES.index(key), night]) for kind, x in tables.items()}
            for key in there
        }
        keys = {key: PairKey(key, "") for key in DRIVES}
        jobs = {key: NightJob(name, name, figures.get(key)) for name, key in keys.items()}
        made.append(Night(f"night {night}", f"commit{night}", jobs))
    return find_changes(made)


CHANGED_NIGHT = 12
ACCURACY, LOST, NEES = ComparedKind.ACCURACY, ComparedKind.LOST, ComparedKind.NEES


def change_of(history: History, figure: str) -> Change:
    """Return the only change, which is for the worse, after a check of its figure, night, commits and command."""
    (change,) = history.worse
    assert (change.figure, change.night, change.commits) == (figure, "night 12", ("commit11", "commit12"))
    assert change.command == "sfr report 'night 11' 'night 12'"
    return change


@pytest.mark.parametrize(("drives", "factor"), [(DRIVES[4:7], 5.0), (DRIVES[8:9], 10.0)], ids=["three", "one"])
def test_a_change_of_a_few_drives_names_these_drives(drives: list[str], factor: float) -> None:
    tables = nights(20)
    first = DRIVES.index(drives[0])
    tables[ACCURACY][first : first + len(drives), CHANGED_NIGHT:] *= factor
    change = change_of(found(tables), NAMES[ACCURACY])
    assert set(change.jobs) == set(drives)
    assert change.after / change.before == pytest.approx(factor, rel=0.1)


@pytest.mark.parametrize(
    ("kind", "factor", "more"), [(ACCURACY, 1.1, 0.0), (LOST, 1.0, 8.0), (NEES, 1 / 3, 0.0)], ids=str
)
def test_a_change_of_all_drives_names_all_drives(kind: ComparedKind, factor: float, more: float) -> None:
    """A covariance that is too large (a small NEES) is as wrong as a covariance that is too small."""
    tables = nights(20)
    tables[kind][:, CHANGED_NIGHT:] = tables[kind][:, CHANGED_NIGHT:] * factor + more
    change = change_of(found(tables), NAMES[kind])
    assert len(change.jobs) > 0.9 * len(DRIVES)
    assert (change.after > change.before) == (kind is not NEES)


def test_counts_are_reported_by_their_mean() -> None:
    """Nine drives lose no frame and one drive loses 100: the mean is 10 frames."""
    counts = np.zeros((len(DRIVES), 20))
    counts[::10] = 90.0
    counts[:, CHANGED_NIGHT:] += 20.0
    history = found(nights(20) | {LOST: counts})
    change = change_of(history, NAMES[LOST])
    assert change.before == pytest.approx(counts[:, 0].mean())
    assert change.after == pytest.approx(counts[:, -1].mean())
    assert change.ratio == pytest.approx(change.after / change.before)
    assert change.ci95 is None
    assert history.figures[NAMES[LOST]] == pytest.approx(counts.mean(axis=0).tolist())


def test_a_missing_result_before_a_change_widens_the_range_of_commits() -> None:
    """Without the result of night 11, the commits of nights 11 and 12 are both suspects."""
    tables = nights(20)
    tables[ACCURACY][4, CHANGED_NIGHT:] *= 4.0
    tables[ACCURACY][4, CHANGED_NIGHT - 1] = np.nan
    (change,) = found(tables).worse
    assert (change.jobs, change.night, change.range) == ((DRIVES[4],), "night 12", "commit10..commit12")
    assert change.command == "sfr report 'night 10' 'night 12'"


def test_a_missing_result_of_a_drive_does_not_date_a_change() -> None:
    """Without the drive with the small errors, the mean over the drives of night 14 is larger."""
    x = np.random.default_rng(0).normal([[0.0], [5.0]], 0.02, (2, 20))
    x[:, CHANGED_NIGHT:] += 0.26
    x[0, CHANGED_NIGHT + 2] = np.nan
    (shift,) = find_shifts(x, SCALES[ACCURACY], FALSE_ALARM_RATE)
    assert (shift.night, shift.last_before) == (CHANGED_NIGHT, CHANGED_NIGHT - 1)
    assert shift.nights.after == slice(CHANGED_NIGHT, CHANGED_NIGHT + 4)


@pytest.mark.parametrize("night", [CHANGED_NIGHT + 1, CHANGED_NIGHT + 2])
def test_a_missing_result_after_a_change_is_not_a_return(night: int) -> None:
    tables = nights(20)
    tables[ACCURACY][4, CHANGED_NIGHT:] *= 5.0
    tables[ACCURACY][4, night] = np.nan
    history = found(tables)
    assert [(item.night, item.jobs) for item in history.changes] == [("night 12", (DRIVES[4],))]


def test_drives_without_a_result_are_a_change_and_are_named() -> None:
    change = change_of(found(nights(20), gone=(15, CHANGED_NIGHT)), "jobs without a result, share")
    assert set(change.jobs) == set(DRIVES[:15])


def test_slower_calls_need_more_nights_since_nights_differ() -> None:
    tables = nights(40)
    tables[ComparedKind.TIME][:, 30:] *= 1.3
    (change,) = found(tables).worse
    assert (change.figure, change.night) == (NAMES[ComparedKind.TIME], "night 30")


SLOW = {
    "errors of all drives": (ACCURACY, slice(None), 1.005, 0.0),
    "errors of one drive": (ACCURACY, slice(4, 5), 1.03, 0.0),
    "times": (ComparedKind.TIME, slice(None), 1.01, 0.0),
    "covariances": (NEES, slice(None), 1.01, 0.0),
    "lost frames": (LOST, slice(None), 1.0, 0.1),
}


@pytest.mark.parametrize("name", SLOW)
def test_a_slow_change_is_detected_although_it_inflates_the_scatter(name: str) -> None:
    kind, drives, growth, more = SLOW[name]
    values = nights(60)[kind]
    since_start = np.arange(60)
    values[drives] = values[drives] * growth**since_start + more * since_start
    history = found({kind: values})
    assert history.worse
    assert {(change.figure, change.is_slow) for change in history.changes} == {(NAMES[kind], True)}
    (first, *_) = history.changes
    assert first.before_night == "night 9", "the last of the first nights"
    assert set(DRIVES[drives]) >= set(first.jobs)
    assert "slowly worse since night 9" in first.text


def test_a_slow_change_that_returns_is_closed() -> None:
    errors = nights(80)[ACCURACY] * 1.01 ** np.minimum(np.arange(80), 40)
    assert found({ACCURACY: errors}).worse
    errors[:, 60:] /= 1.01**40
    assert not found({ACCURACY: errors}).worse


def test_a_small_change_that_persists_does_not_return() -> None:
    """The shift is close to the smallest detected shift, so that many of the nights after it are not significant."""
    for seed in (10, 14, 23, 28):  # returned by the first condition alone
        rng = np.random.default_rng([seed, 20])
        x = rng.normal(0.0, 0.08, (20, 36)) + rng.normal(0.0, 0.03, 36)
        x[:, 30:] += 0.15
        shifts = [shift for shift in find_shifts(x, SCALES[ACCURACY], FALSE_ALARM_RATE) if shift.night >= 28]
        assert shifts
        assert all(shift.after > shift.before for shift in shifts), "a return lowers the figure"


def test_a_change_in_a_step_is_not_slow() -> None:
    errors = nights(60)[ACCURACY]
    errors[:, 20:] *= 1.5
    history = found({ACCURACY: errors})
    assert [(change.night, change.is_slow) for change in history.changes] == [("night 20", False)]


def test_a_change_for_the_better_closes_the_previous_change_and_is_the_new_reference() -> None:
    errors = nights(40)[ACCURACY]
    errors[:, 15:30] *= 1.5
    history = found({ACCURACY: errors})
    assert [(item.outcome, item.night) for item in history.changes] == [
        (Outcome.WORSE, "night 15"), (Outcome.BETTER, "night 30"),
    ]  # fmt: skip
    assert not history.worse


def test_an_improvement_of_another_drive_closes_no_regression() -> None:
    errors = nights(60)[ACCURACY]
    errors[4, 12:] *= 5.0
    errors[10, 30:] /= 5.0
    history = found({ACCURACY: errors})
    assert [(item.outcome, item.jobs) for item in history.changes] == [
        (Outcome.WORSE, ("drive 4",)), (Outcome.BETTER, ("drive 10",)),
    ]  # fmt: skip
    assert [change.jobs for change in history.worse] == [("drive 4",)]
    errors[4, 45:] /= 5.0
    assert not found({ACCURACY: errors}).worse


def test_false_alarms_do_not_grow_with_the_history() -> None:
    """At three times the rate the halves have 12 and 9 alarms; `history-power` simulates longer histories."""
    alarms = np.zeros(2, int)
    for seed in range(4):
        rng = np.random.default_rng([7, seed])
        x = rng.standard_t(5, (20, 200)) * 0.1 + rng.normal(0.0, 0.05, 200)
        shifts = find_shifts(x, SCALES[ACCURACY], 0.05)
        for before, shift in zip((None, *shifts), shifts, strict=False):
            is_return = before is not None and shift.nights.before == before.nights.after
            alarms[shift.night // 100] += not is_return
    assert alarms.max() <= 5


def test_an_alarm_of_one_night_has_the_stated_rate() -> None:
    """Normal nights: the mean over the drives, and each drive by itself, have half of the rate each."""
    rng, rate, runs = np.random.default_rng(3), 0.05, 600
    alarms = 0
    for _ in range(runs):
        x = rng.normal(0.0, 0.2, (10, 9))
        nights = Compared(slice(8), slice(8, 9))
        alarms += compare(x, nights, SCALES[ACCURACY], rate / nights.share) is not None
    assert 0.01 * runs < alarms < rate * runs + 3 * np.sqrt(rate * runs)


def test_few_nights_are_judged_by_the_scatter_of_drives() -> None:
    tables = nights(4)
    tables[ACCURACY][:, 2:] *= 1.3
    tables[ComparedKind.TIME][:, 2:] *= 1.3
    (change,) = found(tables).worse
    assert (change.kind, change.night) == (ComparedKind.ACCURACY, "night 2"), "two hosts may differ in speed"
    with pytest.raises(MetricsError, match="two suites"):
        find_changes([Night("a", None, {})])


def written(folder: Path, commits: list[str], tables: dict[ComparedKind, np.ndarray]) -> list[Path]:
    """Write the `suite.json` of nights."""
    for night, commit in enumerate(commits):
        results = [
            {
                "label": key, "path": f"/data/{key}", "pairing": key, "configuration": "default",
                "figures": [[kind.value, NAMES[kind], float(x[number, night])] for kind, x in tables.items()],
            }
            for number, key in enumerate(DRIVES[: len(next(iter(tables.values())))])
        ]  # fmt: skip
        (folder / f"night{night:02}").mkdir()
        content = {"schema": SCHEMA, "git": {"commit": commit}, "results": results, "failures": []}
        content["compared_figures"] = [to_plain(FIGURES[kind]) for kind in tables]
        (folder / f"night{night:02}" / "suite.json").write_text(json.dumps(content))
    return sorted(folder.glob("night*"))


@pytest.mark.parametrize("names", [["default", "fast"], ["default"], ["other"]])
def test_a_night_with_other_configurations_loses_no_drive(names: list[str]) -> None:
    keys = [f"{number:032x}" for number in range(45)]
    value = {FIGURES[ACCURACY]: 0.01}
    made = []
    for night in range(20):
        in_night = [PairKey(key, name) for key in keys for name in (names if night > 12 else ["default"])]
        made.append(Night(f"night {night}", None, {key: NightJob("job", "path", value) for key in in_night}))
    assert not find_changes(made).changes


def test_a_night_of_an_earlier_version_is_refused_in_one_line(sfr: Sfr, tmp_path: Path) -> None:
    folders = written(tmp_path, ["a" * 40] * 2, nights(2))
    path = folders[0] / "suite.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"schema": "sfr-suite/9"}))
    done = sfr("suite", "history", *folders)
    assert done.code == 2
    assert len(done.err.strip().splitlines()) == 1
    assert "its schema is sfr-suite/9: sfr-suite/1 is required" in done.err


def test_an_edited_night_is_read_or_refused(tmp_path: Path) -> None:
    """An unknown value of another type would otherwise fail in the statistics or in the page."""
    first, last = written(tmp_path, ["a" * 40] * 2, {kind: x[:2] for kind, x in nights(2).items()})
    path = last / "suite.json"
    content = json.loads(path.read_text()) | {
        "time": "2026-01-01T00:00:00+00:00",
        "waiting_jobs": ["drive 45"],
        "refusals": [{"path": "gone.mcap", "reason": "no match"}],
    }
    content["failures"] = [content["results"].pop()]
    refused = 0
    for edited in mutations(content):
        path.write_text(json.dumps(edited))
        try:
            result = find_changes(read_nights([first, last]))
        except (InputError, MetricsError):
            refused += 1
        else:
            assert json_line(result.to_dict())
            assert render_history(result)
    assert refused > 50


@pytest.mark.parametrize("value", ["NaN", "Infinity", "-1", "1e101", "true", "null", '"1"'])
def test_a_figure_that_is_no_number_of_at_least_0_is_refused(tmp_path: Path, value: str) -> None:
    (folder,) = written(tmp_path, ["a" * 40], {ACCURACY: np.array([[0.125]])})
    path = folder / "suite.json"
    path.write_text(path.read_text().replace("0.125", value))
    with pytest.raises(InputError, match="cannot read the figures of"):
        read_nights([folder])


def test_a_history_without_a_test_is_not_judged(sfr: Sfr, tmp_path: Path) -> None:
    """The error of the only drive grows tenfold, but one earlier night has no scatter."""
    folders = written(tmp_path, ["a" * 40] * 2, {ACCURACY: np.array([[0.01, 0.1]])})
    done = sfr("suite", "history", *folders)
    assert done.code == 3
    assert "No figure changed" not in done.out
    assert sfr("suite", "history", *folders, "--lenient").code == 0


@pytest.mark.parametrize("count", [1, 45])
def test_a_planned_job_without_a_result_in_the_last_night_is_worse(sfr: Sfr, tmp_path: Path, count: int) -> None:
    folders = written(tmp_path, ["a" * 40] * 2, {ACCURACY: nights(2)[ACCURACY][:count]})
    path = folders[1] / "suite.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"waiting_jobs": ["drive 45"]}))
    done = sfr("suite", "history", *folders)
    assert done.code == 1
    assert "drive 45" in done.err


def test_a_drive_that_is_no_longer_planned_is_missing_unless_its_limits_were_decided(sfr: Sfr, tmp_path: Path) -> None:
    """A drive with other data but the same label is not missing, nor is one that a sequential test did not require."""
    folders = written(tmp_path, ["a" * 40] * 2, {ACCURACY: nights(2)[ACCURACY]})
    path = folders[1] / "suite.json"
    night = json.loads(path.read_text())
    *others, last = night["results"]
    for results, not_run, code in (
        (others, [], 1),
        (others, [last["label"]], 0),
        ([*others, last | {"pairing": "other"}], [], 0),
        ([*others, last | {"label": "other"}], [], 0),
    ):
        path.write_text(json.dumps(night | {"results": results, "not_run": not_run}))
        done = sfr("suite", "history", *folders)
        assert done.code == code, done.err
        assert (f"last night: {last['label']}" in done.err) is (code == 1)


def test_a_night_that_is_given_twice_is_refused(sfr: Sfr, tmp_path: Path) -> None:
    folders = written(tmp_path, ["a" * 40] * 2, {ACCURACY: nights(1)[ACCURACY].repeat(2, axis=1)})
    assert sfr("suite", "history", folders[0], folders[0] / ".." / folders[0].name).code == 2


def test_nights_in_the_wrong_order_are_refused(sfr: Sfr, tmp_path: Path) -> None:
    """A change for the worse would otherwise be a change for the better."""
    folders = written(tmp_path, ["a" * 40] * 2, nights(2))
    for number, folder in enumerate(folders):
        content = json.loads((folder / "suite.json").read_text()) | {"time": f"2026-01-0{number + 1}T00:00:00+00:00"}
        (folder / "suite.json").write_text(json.dumps(content))
    assert sfr("suite", "history", *folders).code == 0
    done = sfr("suite", "history", *reversed(folders))
    assert done.code == 2
    assert "give the suites in the order of their time" in done.err


def test_the_command_names_commits_and_its_json_the_interval(sfr: Sfr, tmp_path: Path) -> None:
    tables = nights(20)
    tables[ACCURACY][3:5, 12:] *= 6.0
    folders = written(tmp_path, ["a" * 40] * 12 + ["b" * 40] * 8, tables)
    done = sfr("suite", "history", *folders, "--json", "-")
    assert done.code == 1
    assert f"since {folders[12]} (aaaaaaaaa..bbbbbbbbb)" in done.err
    (change,) = json.loads(done.out)["changes"]
    assert change["jobs"] == ["drive 3", "drive 4"]
    assert change["ci95"][0] < change["ratio"] < change["ci95"][1]
    assert change["ratio"] == pytest.approx(6.0, rel=0.1)


RENAMED = ComparedFigure(ACCURACY, "the former name, m", "position", "mean_plus_3sigma", "distance=5")


def test_a_figure_with_a_former_name_is_the_same_figure(tmp_path: Path) -> None:
    folders = written(tmp_path, ["a" * 40] * 2, {ACCURACY: np.array([[0.5, 0.25]])})
    for folder, figure in zip(folders, (RENAMED, replace(RENAMED, name=NAMES[ACCURACY])), strict=True):
        content = json.loads((folder / "suite.json").read_text())
        content["results"][0]["figures"][0][1] = figure.name
        content["compared_figures"] = [to_plain(figure)]
        (folder / "suite.json").write_text(json.dumps(content))
    figures = find_changes(read_nights(folders)).figures
    assert figures[NAMES[ACCURACY]] == pytest.approx((0.5, 0.25))
    assert len(figures) == 2, "the other figure is the fraction of jobs without a result"
