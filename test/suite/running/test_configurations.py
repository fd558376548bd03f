"""The files of a configuration are part of the key of a job, and a worker compares them with its own files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from helpers.made_suites import JOB
from sfr_loc_map.errors import InputError
from sfr_loc_map.suite.running.configurations import check_masks, chosen_method
from sfr_loc_map.suite.running.job import Job
from sfr_loc_map.suite.running.specification import load_specification
from sfr_loc_map.suite_names import Task

FILES = ("mine.py", "beside.py", "weights.bin", "more/net.bin")


@pytest.fixture
def suite(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write a suite of a method with further modules and weights."""
    (tmp_path / "method/more").mkdir(parents=True)
    for name in FILES:
        (tmp_path / "method" / name).write_text("")
    named = [str(tmp_path / "method" / name) for name in ("weights.bin", "more")]
    monkeypatch.setenv("SFR_METHOD_FILES", ":".join(named))
    (tmp_path / "drive.mcap").touch()
    path = tmp_path / "suite.yaml"
    configurations = {"mine": {"localisation": {"method": "method/mine.py:Mine"}}}
    path.write_text(yaml.safe_dump({"sources": ["drive.mcap"], "configurations": configurations}))
    return path


def job_of(suite: Path) -> Job:
    return replace(JOB, parameters=load_specification(suite).configurations["mine"])


def section_of(job: Job) -> dict[str, object]:
    return {name.removeprefix("localisation."): value for name, value in job.parameters.items()}


@pytest.mark.parametrize("name", FILES)
def test_other_files_of_a_method_are_another_job(suite: Path, name: str) -> None:
    before = job_of(suite)
    assert chosen_method(section_of(before), Task.LOCALISATION) is not None
    (suite.parent / "method" / name).write_text("# other")
    assert job_of(suite).key != before.key
    with pytest.raises(InputError, match="differs from that of the plan"):
        chosen_method(section_of(before), Task.LOCALISATION)


def test_a_worker_without_the_files_of_a_method_refuses_the_job(suite: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    job = job_of(suite)
    monkeypatch.delenv("SFR_METHOD_FILES")
    with pytest.raises(InputError, match="SFR_METHOD_FILES"):
        chosen_method(section_of(job), Task.LOCALISATION)


def test_the_files_of_methods_do_not_change_a_built_in_method(suite: Path) -> None:
    content = yaml.safe_load(suite.read_text())
    content["configurations"] = {"mine": {"localisation": {"method": "opencv"}}}
    suite.write_text(yaml.safe_dump(content))
    before = job_of(suite)
    (suite.parent / "method/weights.bin").write_text("other")
    assert job_of(suite).key == before.key


def test_a_worker_with_another_mask_refuses_the_job(tmp_path: Path) -> None:
    (tmp_path / "drive.mcap").touch()
    mask = tmp_path / "mask.png"
    mask.write_bytes(b"mask")
    suite = tmp_path / "suite.yaml"
    configurations = {"mine": {"localisation": {"left_mask": "mask.png"}}}
    suite.write_text(yaml.safe_dump({"sources": ["drive.mcap"], "configurations": configurations}))
    section = section_of(job_of(suite))
    check_masks(section)
    mask.write_bytes(b"another mask")
    with pytest.raises(InputError, match="left_mask"):
        check_masks(section)
