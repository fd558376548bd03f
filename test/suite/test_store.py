"""The folder of a suite: results and failures without a job are reported, and a plan is compared with its files."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest
from msgspec.structs import replace as struct_replace

from helpers.json_mutations import mutations
from helpers.made_suites import JOB, recording, save_jobs
from sfr_loc_map.errors import ConfigError, InputError, OutputError
from sfr_loc_map.metrics.figures.records import Provenance
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.stored.score_json import hash_of_values, json_line, to_json
from sfr_loc_map.suite import store as store_module
from sfr_loc_map.suite.jobs.job import Job
from sfr_loc_map.suite.jobs.job_outcome import FailureCause, JobOutcome, WorkerRecord
from sfr_loc_map.suite.jobs.sources import Recording, Simulation
from sfr_loc_map.suite.planning.plan import Plan
from sfr_loc_map.suite.planning.specification import Refusal
from sfr_loc_map.suite.run import PlannedRun
from sfr_loc_map.suite.statistics.scored_job import ResultReader
from sfr_loc_map.suite.statistics.summary import summarise
from sfr_loc_map.suite.store import Store

CRASHED = JobOutcome(cause=FailureCause.DIED, message="its worker process was killed or crashed")


def result_of(job: Job) -> JobOutcome:
    provenance = Provenance(version="", configuration=job.description.to_provenance())
    return JobOutcome(result=to_json(Score(figures=(), provenance=provenance)))


def test_a_source_that_was_run_and_is_in_no_job_is_reported(tmp_path: Path) -> None:
    store = Store(tmp_path)
    bad = replace(JOB, source=recording("b", "1", "b.mcap"))
    gone = replace(JOB, source=recording("c", "2", "c.mcap"))
    again = replace(JOB, repeat=1)
    for job in (JOB, bad, again):
        store.save(job, result_of(job))
    store.save(gone, JobOutcome(cause=FailureCause.BAD_INPUT, message="cut off"))
    save_jobs(store, [JOB, bad, gone, again])
    assert not store.left_over()
    save_jobs(store, [JOB])
    assert sorted(item.name for item in store.left_over()) == ["a", "b", "c"], "a repeat is work of its own"
    save_jobs(store, [replace(job, code="other", fault_seed=7) for job in (JOB, bad, gone, again)])
    assert not store.left_over(), "with other code, and with a seed of no faults, the same work is done again"


def test_a_failure_has_the_names_of_the_plan(tmp_path: Path) -> None:
    """A renamed configuration or source keeps its failure, because names are not part of the key of a job."""
    store = Store(tmp_path)
    store.save(JOB, CRASHED)
    renamed = replace(JOB, configuration="fast", source=recording("b", path="b.mcap"))
    assert renamed.key == JOB.key
    failure = store.failure(renamed)
    assert (failure.configuration, failure.label, failure.source) == ("fast", renamed.label, "b.mcap")
    assert failure.cause is CRASHED.cause


@pytest.mark.parametrize("removed", ["seed", "fault", "repeat"])
def test_a_failed_job_cannot_be_removed_from_a_suite(removed: str, tmp_path: Path) -> None:
    """All seeds of a scenario have one path, and a fault or a repeat has the path of the source without it."""
    seeds = [
        Simulation(name=f"rocky-{seed}", path="rocky.yaml", sha256=f"{seed}", drive="", settings={}, seed=seed)
        for seed in (1, 2)
    ]
    first = replace(JOB, source=seeds[0])
    failed = {
        "seed": replace(first, source=seeds[1]),
        "fault": replace(first, faults="black"),
        "repeat": replace(first, repeat=1),
    }[removed]
    store = Store(tmp_path)
    store.save(failed, CRASHED)
    save_jobs(store, [first, failed])
    assert not store.left_over()
    save_jobs(store, [first, replace(failed, code="other")])
    assert not store.left_over(), "the job is repeated with other code"
    save_jobs(store, [first])
    assert [item.name for item in store.left_over()] == [failed.source.name]


@pytest.mark.parametrize("folder", ["results", "failures"])
def test_a_damaged_file_of_no_job_is_refused(folder: str, tmp_path: Path) -> None:
    store = Store(tmp_path)
    save_jobs(store, [JOB])
    (tmp_path / folder).mkdir()
    (tmp_path / folder / "other.json").write_text("[]")
    with pytest.raises(
        InputError, match=r"cannot read '.*other\.json': Expected `object`, got `array`; delete this file"
    ):
        store.left_over()


def test_a_failure_without_a_description_is_refused(tmp_path: Path) -> None:
    """The work of this failure is unknown, so that no job of the plan could be recognised as its repetition."""
    store = Store(tmp_path)
    save_jobs(store, [JOB])
    failure = {"key": "other", "label": "localise c", "source": "c.mcap", "cause": "bad input", "message": "cut off"}
    store.failures.mkdir()
    (store.failures / "other.json").write_text(json.dumps(failure))
    with pytest.raises(InputError, match="missing required field `description`; delete this file"):
        store.left_over()


def fetched(sha256: str) -> Recording:
    """Return a recording from a server, whose path in the cache depends on the version of its data."""
    path = f"cache/fetched/{sha256}/a.mcap"
    return struct_replace(recording(sha256=sha256, path=path), url="https://host/a.mcap")


def test_another_source_of_the_same_name_supersedes_nothing(tmp_path: Path) -> None:
    store = Store(tmp_path)
    bad = replace(JOB, source=recording(path="bad/a.mcap"))
    store.save(bad, result_of(bad))
    others = {
        "another drive": recording(sha256="1", path="good/a.mcap"),
        "new data": recording(sha256="1", path="bad/a.mcap"),
        "the same data elsewhere": recording(path="moved/a.mcap"),
        "from a server": fetched("1"),
    }
    found = {}
    for name, source in others.items():
        save_jobs(store, [replace(bad, source=source, code="other")])
        found[name] = [item.name for item in store.left_over()]
    assert found == {"another drive": ["a"], "new data": [], "the same data elsewhere": [], "from a server": ["a"]}
    before = replace(bad, source=fetched("1"))
    (store.results / f"{bad.key}.json").unlink()
    store.save(before, result_of(before))
    save_jobs(store, [replace(bad, source=fetched("3"), code="other")])
    assert not store.left_over(), "a server has a new version of its file"


def test_a_result_whose_hash_was_removed_is_refused(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.save(JOB, result_of(JOB))
    assert store.score(JOB).figures == ()
    path = store.results / f"{JOB.key}.json"
    content = json.loads(path.read_text())
    del content["content_sha256"]
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match="has no content_sha256"):
        store.score(JOB)


def test_a_plan_that_could_not_be_read_again_is_not_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(store_module, "MAX_JSON_BYTES", 1000)
    with pytest.raises(ConfigError, match="the plan of 9 jobs exceeds"):
        save_jobs(Store(tmp_path), [JOB] * 9)
    assert not (tmp_path / "plan.json").exists()


def test_one_process_at_a_time_has_the_lock(tmp_path: Path) -> None:
    first, second = Store(tmp_path), Store(tmp_path)
    with first.locked(), second.locked_if_free() as is_locked:
        assert not is_locked
        with pytest.raises(OutputError, match="another run uses"), second.locked():
            pass
    with second.locked_if_free() as is_locked:
        assert is_locked


def test_a_plan_is_compared_with_its_files(tmp_path: Path) -> None:
    limits, suite = tmp_path / "limits.yaml", tmp_path / "suite.yaml"
    suite.write_text("limits: limits.yaml\n")
    limits.write_text("memory: {localisation_peak_bytes: 5}\n")
    store = Store(tmp_path / "out")
    save_jobs(store, [JOB], files=(suite, limits))
    store.check_files()
    limits.write_text("memory: {localisation_peak_bytes: 6}\n")
    with pytest.raises(InputError, match="has changed since"):
        store.check_files()
    limits.unlink()
    store.check_files()


def test_a_folder_that_is_only_read_is_not_created(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"plan\.json"):
        summarise(Store(tmp_path / "absent"))
    assert not (tmp_path / "absent").exists()
    (tmp_path / "listed" / "cache").mkdir(parents=True)
    Store(tmp_path / "listed")  # the cache of a dry run


def test_an_edited_plan_is_refused(tmp_path: Path) -> None:
    """A suite would pass if a job and its result could be deleted, or if its limits could be edited."""
    store = Store(tmp_path / "out")
    save_jobs(store, [JOB, replace(JOB, repeat=1)], limits={"memory": {"localisation_peak_bytes": 5}})
    assert Store(store.folder).plan == store.plan
    plan = json.loads(store.plan_file.read_text())
    edits = [
        {"jobs": plan["jobs"][:1]},
        {"jobs": [*plan["jobs"], plan["jobs"][0] | {"repeat": 2}]},
        {"limits": {"memory": {"localisation_peak_bytes": 6}}},
        {"limits": {}},
        {"files": [{"path": "other.yaml", "sha256": "0"}]},
        {"content_sha256": None},
    ]
    for edit in edits:
        store.plan_file.write_text(json.dumps(plan | edit))
        with pytest.raises(InputError, match="was edited or is of another version, as its content_sha256 shows"):
            summarise(Store(store.folder))
    save_jobs(store, [JOB])
    assert Store(store.folder).plan.jobs == (JOB,), "a run replaces an edited plan"


@pytest.mark.parametrize("edited", ["plan", "workers", "result", "left-over result", "failure", "left-over failure"])
def test_an_edited_file_of_a_suite_is_read_or_refused(tmp_path: Path, edited: str) -> None:
    done, failed, gone, lost = (replace(JOB, source=recording(name, sha256=name)) for name in "abcd")
    suite = tmp_path / "suite.yaml"
    suite.write_text("sources: [a]\nlimits: {memory: {localisation_peak_bytes: 5}}\n")
    folder = tmp_path / "out"
    store = Store(folder)
    limits = {"memory": {"localisation_peak_bytes": 5}}
    refusals = [Refusal("gone.mcap", "source 'gone.mcap': no match")]
    save_jobs(store, [done, failed], refusals, limits, files=[suite])
    store.add_workers([WorkerRecord(worker="tcp://127.0.0.1:1")])
    for job in (done, gone):
        store.save(job, result_of(job))
    for job in (failed, lost):
        store.save(job, CRASHED)
    path = {
        "plan": store.plan_file,
        "workers": folder / "workers.json",
        "result": store.results / f"{done.key}.json",
        "left-over result": store.results / f"{gone.key}.json",
        "failure": store.failures / f"{failed.key}.json",
        "left-over failure": store.failures / f"{lost.key}.json",
    }[edited]
    assert summarise(Store(folder)).counts.jobs == 2
    for content in mutations(json.loads(path.read_text())):
        if edited == "plan" and isinstance(content, dict):
            content["content_sha256"] = hash_of_values(content)  # otherwise each edit is refused by the hash alone
        path.write_text(json.dumps(content))
        with suppress(InputError, ConfigError):
            json_line(summarise(Store(folder)).to_dict())


@pytest.mark.parametrize("text", ["", "null", "[" * 10_000, "{", "\xff", '{"sources": ' + "1" * 5000 + "}"])
@pytest.mark.parametrize("name", ["plan.json", "workers.json", "results/other.json", "failures/other.json"])
def test_a_damaged_file_of_a_suite_is_refused_in_one_line(tmp_path: Path, name: str, text: str) -> None:
    store = Store(tmp_path)
    save_jobs(store, [JOB])
    store.save(JOB, result_of(JOB))
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError, match=r"^cannot read '.*json': [^\n]*; delete this file and run the suite again$"):
        summarise(Store(tmp_path))


def test_a_folder_belongs_to_one_file(tmp_path: Path) -> None:
    suite, other = tmp_path / "suite.yaml", tmp_path / "other.yaml"
    suite.write_text("sources: []\n")
    other.write_text("sources: []\n")
    of_suite, of_search = Store(tmp_path / "a"), Store(tmp_path / "b")
    save_jobs(of_suite, [JOB], files=[suite])
    of_search.save_plan(Plan.of_search(suite))
    of_suite.check_owner(suite)
    of_search.check_owner(suite, is_search=True)
    for store, file, is_search in ((of_suite, other, False), (of_suite, suite, True), (of_search, suite, False)):
        with pytest.raises(OutputError, match="choose another folder"):
            store.check_owner(file, is_search=is_search)
    suite.rename(tmp_path / "moved.yaml")
    of_suite.check_owner(tmp_path / "moved.yaml")


def test_a_damaged_result_is_found_before_a_run(tmp_path: Path) -> None:
    store = Store(tmp_path)
    save_jobs(store, [JOB])
    store.save(JOB, result_of(JOB))

    def check() -> None:
        PlannedRun(plan=store.plan, reader=ResultReader(store, None), jobs=[]).check_finished(store)

    check()
    path = store.results / f"{JOB.key}.json"
    path.write_text(path.read_text().replace('"figures":[]', '"figures":[1]'))
    with pytest.raises(InputError, match="delete this file and run the suite again") as refused:
        check()
    assert "sfr score" not in str(refused.value)
