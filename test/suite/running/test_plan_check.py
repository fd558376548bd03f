"""Comparison of a stored plan with the suite's file: sources that cannot be read now are named, others must match."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from sfr_loc_map.errors import InputError
from sfr_loc_map.suite.run import plan_run
from sfr_loc_map.suite.running import facts_cache
from sfr_loc_map.suite.running.digests import files_hash
from sfr_loc_map.suite.running.plan_check import check_plan
from sfr_loc_map.suite.running.source_readers import SourceFacts
from sfr_loc_map.suite.running.specification import load_specification
from sfr_loc_map.suite.running.store import Store


@pytest.fixture(autouse=True)
def _facts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Files that begin with `bad` cannot be read; all others have localisation pairs."""

    def inspect(path: Path) -> SourceFacts:
        if path.read_text().startswith("bad"):
            raise InputError(f"'{path}' is broken")
        return SourceFacts(sha256=files_hash(path), pairs=5, nav_pairs=0)

    monkeypatch.setattr(facts_cache, "inspect_file", inspect)


def planned(folder: Path, sources: list[str], **content: object) -> Store:
    """Return the folder of a suite whose plan was written."""
    suite = folder / "suite.yaml"
    suite.write_text(yaml.safe_dump({"sources": sources, **content}))
    specification, store = load_specification(suite), Store(folder / "out")
    made = plan_run(specification, store, retry_failed=False)
    store.save_plan(made.all_jobs, made.refusals, specification.stated_limits, specification.files)
    return store


def drives(folder: Path, count: int) -> list[Path]:
    paths = [folder / f"drive{number}.mcap" for number in range(count)]
    for path in paths:
        path.write_text(path.name)
    return paths


@pytest.mark.parametrize("entry", ["drive*.mcap", "drive[01].mcap", "./drive?.mcap", "**/drive*.mcap"])
@pytest.mark.parametrize("how", ["removed", "damaged"])
def test_a_source_of_a_glob_that_cannot_be_read_now_is_named(tmp_path: Path, entry: str, how: str) -> None:
    first, second = drives(tmp_path, 2)
    store = planned(tmp_path, [entry])
    assert check_plan(store) == []
    if how == "removed":
        second.unlink()
    else:
        second.write_text("bad")
    assert check_plan(store) == [f"The plan was not compared with '{second}', which cannot be read now."]
    first.unlink()
    second.unlink(missing_ok=True)
    assert "which cannot be read now" in check_plan(store)[0]


def test_a_source_with_other_data_differs(tmp_path: Path) -> None:
    first, _ = drives(tmp_path, 2)
    store = planned(tmp_path, ["drive*.mcap"])
    first.write_text("other data")
    with pytest.raises(InputError, match="has other inputs; run the suite again"):
        check_plan(store)


def test_a_new_source_is_missing_in_the_plan(tmp_path: Path) -> None:
    drives(tmp_path, 1)
    store = planned(tmp_path, ["drive*.mcap"])
    drives(tmp_path, 2)
    with pytest.raises(InputError, match="is missing in the plan"):
        check_plan(store)


def test_a_remote_source_whose_server_does_not_answer_is_named(tmp_path: Path) -> None:
    memory = pytest.importorskip("fsspec", reason="needs the extra [suite]").filesystem("memory")
    memory.pipe("/check/far.mcap", b"far")
    store = planned(tmp_path, ["memory://check/far.mcap"])
    assert check_plan(store) == []
    memory.rm("/check/far.mcap")
    (text,) = check_plan(store)
    assert "far.mcap', which cannot be read now" in text


def test_a_report_does_not_require_the_files_of_a_method(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The variable SFR_METHOD_FILES may be unset, and the method may be removed."""
    drives(tmp_path, 1)
    method, weights = tmp_path / "mine.py", tmp_path / "weights.bin"
    method.touch()
    weights.touch()
    monkeypatch.setenv("SFR_METHOD_FILES", str(weights))
    configurations = {"mine": {"localisation": {"method": "mine.py:Mine"}}}
    store = planned(tmp_path, ["drive0.mcap"], configurations=configurations)
    monkeypatch.delenv("SFR_METHOD_FILES")
    assert check_plan(store) == []
    method.unlink()
    (text,) = check_plan(store)
    assert text.startswith("The plan was not compared with the sources of the suite, which cannot be read now")
