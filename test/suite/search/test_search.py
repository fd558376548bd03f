"""A search in the folder of a suite: results are reused, and a failure of the host is not a worst case."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest
import yaml

from helpers.made_suites import save_jobs
from sfr_loc_map.errors import ConfigError, InputError, OutputError
from sfr_loc_map.metrics.figures.records import Association, Provenance
from sfr_loc_map.metrics.figures.rows import figure_row
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.stored.score_json import to_json
from sfr_loc_map.suite import run_search
from sfr_loc_map.suite.jobs.job import Job
from sfr_loc_map.suite.jobs.job_outcome import FailureCause, JobOutcome
from sfr_loc_map.suite.pages.search_page import render_search
from sfr_loc_map.suite.planning.plan import make_plan
from sfr_loc_map.suite.planning.specification import load_specification
from sfr_loc_map.suite.search.search import case_file, find_worst_case
from sfr_loc_map.suite.search.specification import SearchSpecification, load_search
from sfr_loc_map.suite.search.worst_case import BISECTIONS, TriedPoint
from sfr_loc_map.suite.store import Store

pytest.importorskip("optuna")
ASSOCIATION = Association(matched=100, estimate_poses=100, truth_poses=100)


@pytest.fixture
def specification(tmp_path: Path) -> SearchSpecification:
    (tmp_path / "scenario.yaml").write_text("light: {sun_elevation_deg: 40}\n")
    content = {"scenario": "scenario.yaml", "limit": 0.1, "points": 12, "slices": 0, "set": {"drive.pairs": 20}}
    content["ranges"] = {"light.sun_elevation_deg": [5, 60], "yaw": {"fault": "yaw", "range": [-0.2, 0.2]}}
    (tmp_path / "search.yaml").write_text(yaml.safe_dump(content))
    return load_search(tmp_path / "search.yaml")


class Host:
    """Gives a score to each job: the error grows as the sun sinks. Jobs beyond a number exceed their time."""

    def __init__(self, store: Store, most: int = 10**6, *, has_pieces: bool = True) -> None:
        self.store, self.most, self.done, self.has_pieces = store, most, 0, has_pieces

    def run(self, jobs: Sequence[Job]) -> None:
        for job in jobs:
            self.done += 1
            elevation = job.source.settings["light.sun_elevation_deg"]
            assert isinstance(elevation, float)
            row = figure_row("position", "distance=5", "pose", n=30, mean_plus_3sigma=1.0 / elevation)
            if not self.has_pieces:
                row = figure_row("position", "distance=5", "pose", n=0)
            provenance = Provenance(version="", configuration={"suite.key": job.key})
            outcome = JobOutcome(result=to_json(Score(figures=(row,), association=ASSOCIATION, provenance=provenance)))
            if self.done > self.most:
                outcome = JobOutcome(cause=FailureCause.TIME, message="over the time limit")
            self.store.save(job, outcome)


def test_the_worst_case_is_reduced_and_runs_again(specification: SearchSpecification, tmp_path: Path) -> None:
    store = Store(tmp_path / "out")
    host = Host(store)
    result = find_worst_case(specification, store, host.run)
    record = result.record
    elevation = record.case.point["light.sun_elevation_deg"]
    assert record.usual.ratio == pytest.approx(0.25)
    assert record.found.fails
    assert record.case.point["yaw"] == 0.0, "the yaw is not needed"
    step = (40.0 - record.found.point["light.sun_elevation_deg"]) / 2.0**BISECTIONS
    assert 10.0 - step <= elevation <= 10.0, "the sun is as high as it may be"
    (tmp_path / "case.yaml").write_text(result.case_file)
    (source,) = load_specification(tmp_path / "case.yaml").sources
    assert source.settings["light.sun_elevation_deg"] == elevation
    assert source.settings["drive.pairs"] == 20

    again = Host(store)
    assert find_worst_case(specification, store, again.run) == result
    assert again.done == 0


def test_an_unchanged_scenario_that_misses_the_limit_is_the_worst_case(
    specification: SearchSpecification, tmp_path: Path
) -> None:
    store = Store(tmp_path / "out")

    def run(jobs: Sequence[Job]) -> None:
        for job in jobs:
            error = 0.05 + 0.1 * (job.source.settings["light.sun_elevation_deg"] == 40.0 and not job.faults)
            row = figure_row("position", "distance=5", "pose", n=30, mean_plus_3sigma=error)
            provenance = Provenance(version="", configuration={"suite.key": job.key})
            score = Score(figures=(row,), association=ASSOCIATION, provenance=provenance)
            store.save(job, JobOutcome(result=to_json(score)))

    record, _ = find_worst_case(specification, store, run)
    assert record.found == record.case == record.usual
    assert record.found.fails


def test_the_case_repeats_the_faults_and_the_settings_of_the_jobs(tmp_path: Path) -> None:
    """Faults of a fraction of the pairs hit the same pairs again, because the case states the seed of the faults."""
    running = {"seed": 7, "start": "identity", "spacing": 2, "rebase": "displacement", "partial": True, "threads": 2}
    content = {"scenario": "scenario.yaml", "limit": 0.1, "points": 4, "slices": 0, "seeds": [1, 2], "running": running}
    content["ranges"] = {"light.sun_elevation_deg": [5, 9], "blur": {"fault": "blurred:share=0.3", "range": [2, 4]}}
    (tmp_path / "scenario.yaml").write_text("light: {sun_elevation_deg: 6}\n")
    (tmp_path / "search.yaml").write_text(yaml.safe_dump(content))
    specification = load_search(tmp_path / "search.yaml")
    store = Store(tmp_path / "out")
    point = (7.0, 3.0)
    (tmp_path / "case.yaml").write_text(case_file(specification, TriedPoint(point, 1.5), 2))
    planned = make_plan(load_specification(tmp_path / "case.yaml"), store.cache).jobs
    assert all(job.faults.startswith("blurred:share=0.3,amount=") for job in planned)
    searched = [job for job in specification.jobs_at(point) if job.source.seed == 2]
    assert [job.key for job in planned] == [job.key for job in searched]


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({}, "position_mean_plus_3sigma_m"),
        ({"figure": "localisation", "statistic": "p95"}, "localisation_p95_s"),
        ({"figure": "peak", "statistic": "value", "part": "localisation"}, "localisation_peak_bytes"),
        ({"figure": "heap_peak", "statistic": "value", "part": "localisation"}, "localisation_heap_peak_bytes"),
        ({"figure": "missing", "statistic": "value"}, "missing_max_share"),
        ({"figure": "calls_missing", "statistic": "value", "part": "localisation"}, "calls_missing_max_share"),
        ({"figure": "missing", "statistic": "value", "limit": 2.0}, None),
        ({"figure": "position", "part": "along"}, None),
        ({"figure": "processor_share", "statistic": "value"}, None),
    ],
)
def test_the_case_has_the_limit_of_the_search_or_a_warning(
    specification: SearchSpecification,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
    settings: dict[str, object],
    expected: str | None,
) -> None:
    file = specification.path
    file.write_text(yaml.safe_dump(yaml.safe_load(file.read_text()) | settings))
    (tmp_path / "case.yaml").write_text(case_file(load_search(file), TriedPoint((10.0, 0.1), 1.5), 1))
    limits = load_specification(tmp_path / "case.yaml").limits
    found = [] if limits is None else [(limit.name, limit.limit) for limit in limits.limits]
    assert found == ([] if expected is None else [(expected, 0.1)])
    assert ("without a verdict" in caplog.text) == (expected is None)


@pytest.mark.parametrize("name", ["repeats", "stop_when_decided", "nominal"])
def test_settings_without_effect_in_a_search_are_refused(specification: SearchSpecification, name: str) -> None:
    file = specification.path
    file.write_text(yaml.safe_dump(yaml.safe_load(file.read_text()) | {"running": {name: 1}}))
    with pytest.raises(ConfigError, match=f"'{name}'"):
        load_search(file)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"ranges": {"seed": [1, 5]}}, "'seed' in 'ranges' has no effect"),
        ({"set": {"seed": 3}}, "'seed' in 'set' has no effect"),
        ({"set": False}, "'set' is False"),
        ({"running": 0}, "'running' is 0"),
        ({"ranges": {"drive.pairs": [20.4, 20.6]}}, "whole bounds are required"),
        ({"ranges": {"yaw": {"fault": "jaw", "range": [0, 1]}}}, "search.yaml: 'yaw'"),
        ({"condition": "distance"}, "search.yaml: 'condition'"),
        ({"figure": "point_error"}, "not a figure of a localised drive"),
        ({"figure": "lost"}, "value is required"),
        ({"part": "sideways"}, "not a part of position"),
        ({"seeds": [-1]}, "'seeds'"),
        ({"seeds": [1, 1]}, "different whole numbers"),
        ({"ranges": {"loc.width": {"fault": "yaw", "range": [0, 1]}}}, "give the fault another name"),
        ({"ranges": {name: {"fault": "yaw", "range": [0, 1]} for name in "ab"}}, "'a' and 'b' are ranges of the fault"),
        ({"point": 3}, "did you mean 'points'"),
        ({"ranges": {"yaw": {"fault": "yaw:amount=3", "range": [0, 1]}}}, "omit 'amount'"),
        ({"figure": "heading", "part": "x"}, "not a part of heading"),
        ({"figure": "peak", "statistic": "value"}, "localisation is required"),
    ],
)
def test_what_has_no_effect_or_no_result_in_a_search_is_refused(
    specification: SearchSpecification, change: dict[str, object], words: str
) -> None:
    file = specification.path
    file.write_text(yaml.safe_dump(yaml.safe_load(file.read_text()) | change))
    with pytest.raises(ConfigError, match=words):
        load_search(file)


def test_a_fault_that_has_an_effect_at_every_amount_is_no_parameter(specification: SearchSpecification) -> None:
    """A search could not include the unchanged scenario."""
    file = specification.path
    ranges = {"frozen images": {"fault": "frozen", "range": [0.0, 5.0]}}
    file.write_text(yaml.safe_dump(yaml.safe_load(file.read_text()) | {"ranges": ranges}))
    with pytest.raises(ConfigError, match="'frozen' has an effect at every amount"):
        load_search(file)


def test_a_search_refuses_the_folder_of_a_suite(specification: SearchSpecification, tmp_path: Path) -> None:
    """Its plan would replace that of the suite."""
    store = Store(tmp_path / "out")
    save_jobs(store, [], files=(specification.path,))
    before = store.plan_file.read_text()
    with pytest.raises(OutputError, match="is the folder of the suite"):
        run_search(specification, store)
    assert store.plan_file.read_text() == before


def test_a_search_that_is_killed_at_its_start_keeps_its_folder(
    specification: SearchSpecification, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def killed(*_: object, **__: object) -> None:
        raise SystemExit

    monkeypatch.setattr("sfr_loc_map.suite.search.search.find_worst_case", killed)
    with pytest.raises(SystemExit):
        run_search(specification, Store(tmp_path / "out"))
    other = tmp_path / "other.yaml"
    other.touch()
    with pytest.raises(OutputError, match="is the folder of the search"):
        Store(tmp_path / "out").check_owner(other, is_search=True)


def test_a_change_of_the_code_during_a_search_changes_no_job(
    specification: SearchSpecification, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = specification.jobs_at(specification.usual)
    monkeypatch.setattr("sfr_loc_map.suite.search.specification.code_fingerprint", lambda: "changed")
    assert specification.jobs_at(specification.usual) == before


def test_a_failed_job_is_not_the_worst_case_and_the_search_continues(
    specification: SearchSpecification, tmp_path: Path
) -> None:
    store = Store(tmp_path / "out")
    with pytest.raises(InputError, match="time"):
        find_worst_case(specification, store, Host(store, most=6).run)
    whole = Store(tmp_path / "whole")
    continued = find_worst_case(specification, store, Host(store).run)
    assert continued == find_worst_case(specification, whole, Host(whole).run)


def test_a_search_can_be_about_a_part_of_a_figure(specification: SearchSpecification) -> None:
    file = specification.path
    change = {"figure": "peak", "statistic": "value", "part": "localisation", "limit": 4.0}
    file.write_text(yaml.safe_dump(yaml.safe_load(file.read_text()) | change))
    rows = (figure_row("peak", part="mapping", value=9.0), figure_row("peak", part="localisation", value=2.0))
    assert load_search(file).ratio_of(Score(figures=rows)) == 0.5


def test_a_scenario_that_cannot_be_run_is_no_worst_case(specification: SearchSpecification, tmp_path: Path) -> None:
    """A low sun, at which the limit would be missed, is refused."""
    store = Store(tmp_path / "out")

    def run(jobs: Sequence[Job]) -> None:
        Host(store).run(jobs)
        for job in jobs:
            elevation = job.source.settings["light.sun_elevation_deg"]
            assert isinstance(elevation, float)
            if elevation < 12.0:
                store.save(job, JobOutcome(cause=FailureCause.BAD_INPUT, message="the sun is too low"))

    record, _ = find_worst_case(specification, store, run)
    assert not record.found.fails
    assert record.left_out
    assert all(item.point["light.sun_elevation_deg"] < 12.0 for item in record.left_out)
    assert {item.reason for item in record.left_out} == {"the sun is too low"}
    assert len(record.points) + len(record.left_out) == specification.settings.points
    assert not any(item.point == left.point for item in record.points for left in record.left_out)


def test_a_lost_drive_is_a_miss(specification: SearchSpecification, tmp_path: Path) -> None:
    store = Store(tmp_path / "out")

    def run(jobs: Sequence[Job]) -> None:
        for job in jobs:
            elevation = job.source.settings["light.sun_elevation_deg"]
            assert isinstance(elevation, float)
            Host(store, has_pieces=elevation > 12.0).run([job])

    record, _ = find_worst_case(specification, store, run)
    assert not record.left_out
    assert record.found.ratio is None
    assert record.found.fails
    lost = TriedPoint(specification.usual)
    assert "a drive without the figure" in case_file(specification, lost, 1)
    assert "no figure" in render_search(record)


def test_a_lost_drive_is_worse_than_any_drive_with_the_figure(
    specification: SearchSpecification, tmp_path: Path
) -> None:
    """A low sun gives three times the limit, a very low sun no figure; the search approaches the lost drives."""
    file = specification.path
    file.write_text(yaml.safe_dump(yaml.safe_load(file.read_text()) | {"limit": 1 / 30}))
    specification = load_search(file)
    store = Store(tmp_path / "out")

    def run(jobs: Sequence[Job]) -> None:
        for job in jobs:
            elevation = job.source.settings["light.sun_elevation_deg"]
            assert isinstance(elevation, float)
            Host(store, has_pieces=elevation > 8.0).run([job])

    record, _ = find_worst_case(specification, store, run)
    finite = [item.ratio for item in record.points if item.ratio is not None]
    assert max(finite) > 2.0
    assert record.found.ratio is None
    assert record.found.point["light.sun_elevation_deg"] <= 8.0
    assert record.lost_ratio == max(finite)


@pytest.mark.parametrize(("change", "has_pieces"), [({"figure": "nees", "statistic": "max"}, True), ({}, False)])
def test_a_figure_that_the_scenario_does_not_have_is_no_worst_case(
    specification: SearchSpecification, tmp_path: Path, change: dict[str, str], has_pieces: bool
) -> None:
    file = specification.path
    file.write_text(yaml.safe_dump(yaml.safe_load(file.read_text()) | change))
    store = Store(tmp_path / "out")
    host = Host(store, has_pieces=has_pieces)
    with pytest.raises(InputError, match="the unchanged scenario has no"):
        find_worst_case(load_search(file), store, host.run)
    assert host.done == 1
