"""Jobs of a suite: all combinations, and a key that depends on the inputs of the result alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from helpers.made_suites import made_suite, save_jobs
from sfr_loc_map.errors import ConfigError, InputError
from sfr_loc_map.suite.jobs.job import Job, JobTask
from sfr_loc_map.suite.jobs.job_outcome import FailureCause, JobOutcome
from sfr_loc_map.suite.jobs.sources import Simulation
from sfr_loc_map.suite.planning import source_inspection
from sfr_loc_map.suite.planning.plan import Plan, make_plan
from sfr_loc_map.suite.planning.source_inspection import RecordingFacts
from sfr_loc_map.suite.planning.specification import Refusal, load_specification
from sfr_loc_map.suite.statistics.summary import copies_in
from sfr_loc_map.suite.store import Store


@pytest.fixture(autouse=True)
def _facts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source_inspection, "facts_of", facts)


def facts(path: Path, cache: Path) -> RecordingFacts:
    if path.name.startswith("broken"):
        raise InputError(f"'{path}' is broken")
    return RecordingFacts(sha256=path.read_text(), pairs=5, nav_pairs=0 if path.name.startswith("drive") else 3)


def plan_of(folder: Path, **content: object) -> tuple[list[Job], list[Refusal]]:
    suite = folder / "suite.yaml"
    suite.write_text(yaml.safe_dump(content))
    plan = make_plan(load_specification(suite), folder / "cache")
    return [*plan.jobs], [*plan.refusals]


def test_every_combination_once(tmp_path: Path) -> None:
    for name in ("drive1", "drive2", "both"):
        (tmp_path / name).write_text(name)
    jobs, _refusals = plan_of(
        tmp_path,
        sources=["drive*", "both"],
        perturb=["black"],
        configurations={"a": {}, "b": {"localisation": {"max_features": 400}}},
        repeats=2,
    )
    localise = [job for job in jobs if job.task is JobTask.LOCALISE]
    mapped = [job for job in jobs if job.task is JobTask.MAP]
    assert len(localise) == 3 * 2 * 2 * 2
    assert len(mapped) == 1 * 2 * 1 * 2, "a parameter of the localiser changes no map: configuration b is a"
    assert len({job.key for job in jobs}) == len(jobs)
    assert {job.source.name for job in localise} == {"drive1", "drive2", "both"}


def test_a_source_without_data_for_a_requested_task_is_refused(tmp_path: Path) -> None:
    """Without `tasks`, each source is run with the tasks for which it has data."""
    for name in ("drive1", "both"):
        (tmp_path / name).write_text(name)
    for tasks, refused in ((["localise", "map"], ["drive1"]), (["map"], ["drive1"]), (None, [])):
        given = {} if tasks is None else {"tasks": tasks}
        jobs, refusals = plan_of(tmp_path, sources=["drive1", "both"], **given)
        assert [item.name for item in refusals] == refused
        assert {job.source.name for job in jobs} >= {"both"}


def test_simulations_by_seed_and_settings(tmp_path: Path) -> None:
    (tmp_path / "flat.yaml").write_text("drive: {pairs: 7}\npanorama: {enabled: false}\n")
    seeds = [{"simulate": "flat.yaml", "seeds": [1, 2], "set": {"drive.pairs": 3}}]
    first, second = plan_of(tmp_path, sources=seeds)[0]
    assert (first.source.name, second.source.name) == ("flat-1", "flat-2")
    assert isinstance(first.source, Simulation)
    assert (first.source.settings["drive.pairs"], first.source.settings["seed"]) == (3, 1)
    assert first.key != second.key
    other = plan_of(tmp_path, sources=[{"simulate": "flat.yaml", "seeds": [1]}])[0][0]
    assert other.key != first.key


def test_simulations_with_equal_names_are_named_by_the_settings_that_differ(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "flat.yaml").write_text(
            f"drive: {{pairs: {7 + (folder == 'b')}, segments: [straight 1]}}\npanorama: {{enabled: false}}\n"
        )
    alone = {"simulate": "a/flat.yaml", "seeds": [1, 2], "set": {"drive.pairs": 3}}
    longer = {"simulate": "a/flat.yaml", "seeds": [1], "set": {"drive.pairs": 4}}
    elsewhere = {"simulate": "b/flat.yaml", "seeds": [1]}

    def names(*sources: object, **content: object) -> list[str]:
        return [job.source.name for job in plan_of(tmp_path, sources=list(sources), **content)[0]]

    assert names(alone, alone) == ["flat-1", "flat-2"], "equal simulations are one source"
    assert names(alone, longer) == ["flat-1 (drive.pairs=3)", "flat-2", "flat-1 (drive.pairs=4)"]
    assert names(alone, elsewhere) == ["a/flat-1", "flat-2", "b/flat-1"]
    assert names(alone, longer, elsewhere) == [
        "a/flat-1 (drive.pairs=3)",
        "flat-2",
        "a/flat-1 (drive.pairs=4)",
        "b/flat-1",
    ]
    budget = {"image noise": {"without": {"sensor.full_well": 0}}, "yaw": {"fault": "yaw", "sigma": 0.02}}
    variants = names(alone, longer, budget=budget, tasks=["localise"])
    assert set(variants) == set(names(alone, longer)), "the variants of a simulation have its name"
    assert len(variants) > 3


def test_a_budget_with_a_source_that_does_not_change_the_scenario_is_refused(tmp_path: Path) -> None:
    (tmp_path / "flat.yaml").write_text("panorama: {enabled: false}\nsensor: {full_well: 0}\n")
    budget = {"image noise": {"without": {"sensor.full_well": 0}}, "yaw": {"fault": "yaw", "sigma": 0.02}}
    sources = [{"simulate": "flat.yaml", "seeds": [1]}]
    with pytest.raises(ConfigError, match="of 'flat-1' are equal"):
        plan_of(tmp_path, sources=sources, budget=budget, tasks=["localise"])


def test_a_simulation_with_changed_settings_cannot_be_removed_from_a_suite(tmp_path: Path) -> None:
    (tmp_path / "flat.yaml").write_text("panorama: {enabled: false}\n")
    good, bad = ({"simulate": "flat.yaml", "set": {"drive.pairs": count}} for count in (3, 4))
    jobs = plan_of(tmp_path, sources=[good, bad])[0]
    store = Store(tmp_path / "out")
    for job in jobs:
        store.save(job, JobOutcome(cause=FailureCause.DIED, message="crashed"))
    save_jobs(store, jobs)
    assert not store.left_over()
    save_jobs(store, plan_of(tmp_path, sources=[good])[0])
    assert [item.name for item in store.left_over()] == ["flat-0 (drive.pairs=4)"]


def test_a_simulation_that_another_simulation_renames_is_the_same_source(tmp_path: Path) -> None:
    (tmp_path / "flat.yaml").write_text("panorama: {enabled: false}\n")
    first, added = ({"simulate": "flat.yaml", "set": {"drive.pairs": count}} for count in (3, 4))
    store = Store(tmp_path / "out")
    for job in plan_of(tmp_path, sources=[first])[0]:
        store.save(job, JobOutcome(cause=FailureCause.DIED, message="crashed"))
    save_jobs(store, [replace(job, code="other") for job in plan_of(tmp_path, sources=[first, added])[0]])
    assert not store.left_over(), "the work is repeated with other code and with the name 'flat-0 (drive.pairs=3)'"


def test_the_key_follows_from_what_the_result_depends_on(tmp_path: Path) -> None:
    (tmp_path / "drive1").write_text("content")
    (tmp_path / "copy").mkdir()
    (tmp_path / "copy" / "drive_elsewhere").write_text("content")
    job = plan_of(tmp_path, sources=["drive1"])[0][0]
    assert plan_of(tmp_path, sources=["copy/drive_elsewhere"])[0][0].key == job.key
    (both,) = plan_of(tmp_path, sources=["drive1", "copy/drive_elsewhere"])[0]
    assert [*copies_in([both])] == [("drive1", "drive_elsewhere")]
    limits = {"trajectory": [{"condition": "distance=5", "position_mean_m": 0.1}]}
    assert plan_of(tmp_path, sources=["drive1"], limits=limits)[0][0].key == job.key
    terms = {"limit": 10.0, "prob": 0.9, "confidence": 0.9, "interpretation": "ensemble"}
    bound = {"trajectory": [{"condition": "distance=5", "position_bound_m": terms}]}
    assert plan_of(tmp_path, sources=["drive1"], limits=bound)[0][0].key != job.key, "it needs all errors"
    assert plan_of(tmp_path, sources=["drive1"], memory_mb=900, timeout_s=5.0)[0][0].key == job.key
    changes = {"spacing": 3, "start": "identity", "conditions": ["time=3"], "threads": 2}
    for name, value in changes.items():
        assert plan_of(tmp_path, sources=["drive1"], **{name: value})[0][0].key != job.key, name
    assert replace(job, code="other").key != job.key
    parameters = {"localisation.max_features": 400}
    others = [replace(job, code="other"), replace(job, parameters=parameters), replace(job, faults="black")]
    assert [other.pairing == job.pairing for other in others] == [True, True, False]
    assert replace(job, fault_seed=9).pairing == job.pairing, "without faults, their seed has no effect"
    assert replace(others[2], fault_seed=9).pairing != others[2].pairing
    (tmp_path / "drive1").write_text("other content")
    assert plan_of(tmp_path, sources=["drive1"])[0][0].key != job.key


def test_estimates_of_one_name_and_truth_are_paired(tmp_path: Path) -> None:
    """Otherwise two suites of estimates by different methods would have no job in common."""
    (tmp_path / "truth.csv").write_text("truth")
    found: dict[str, Job] = {}
    for folder in ("before", "after"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "drive.csv").write_text(folder)
        source = {"estimate": f"{folder}/drive.csv", "truth": "truth.csv"}
        (found[folder],) = plan_of(tmp_path, sources=[source])[0]
    assert found["before"].key != found["after"].key
    assert found["before"].pairing == found["after"].pairing
    (tmp_path / "truth.csv").write_text("another truth")
    assert plan_of(tmp_path, sources=[source])[0][0].pairing != found["after"].pairing


def test_drives_that_are_added_to_a_suite_come_after_the_others(tmp_path: Path) -> None:
    """A copy of an earlier drive is not a new drive. The order within an extension is that of the hashes."""
    suite = made_suite(tmp_path, 6)
    content = yaml.safe_load(suite.read_text())
    copied = {"estimate": "drive0.csv", "truth": "copy.csv"}
    (tmp_path / "copy.csv").write_text((tmp_path / "truth0.csv").read_text() + "\n")

    def extended(sources: list[dict[str, str]], earlier: Plan | None) -> Plan:
        suite.write_text(yaml.safe_dump(content | {"sources": sources}))
        return make_plan(load_specification(suite), tmp_path / "cache", earlier)

    first = extended(content["sources"][:3], None)
    second = extended([copied, *content["sources"]], first)
    assert {job.extension for job in first.jobs} == {0}
    assert [job.extension for job in second.jobs] == [0, 0, 0, 0, 1, 1, 1]
    order = sorted(dict.fromkeys(job.drive_order for job in second.jobs))
    assert [place.extension for place in order] == [0, 0, 0, 1, 1, 1]
    assert [job.extension for job in extended(content["sources"][:3], second).jobs] == [0, 0, 0]


def test_a_source_elsewhere_is_known_by_its_content(tmp_path: Path) -> None:
    memory = pytest.importorskip("fsspec", reason="needs the extra [suite]").filesystem("memory")
    memory.pipe("/plan/drive.mcap", b"content")
    (job,) = plan_of(tmp_path, sources=["memory://plan/drive.mcap"])[0]
    assert Path(job.source.path).read_text() == "content"
    (tmp_path / "drive1").write_text("content")
    assert plan_of(tmp_path, sources=["drive1"])[0][0].key == job.key
    (refusal,) = plan_of(tmp_path, sources=["memory://plan/missing"])[1]
    assert "cannot read 'memory://plan/missing'" in refusal.reason
