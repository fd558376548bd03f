"""The files of a configuration are part of the key of a job, and a worker compares them with its own files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from helpers.made_suites import JOB
from sfr_loc_map.errors import InputError
from sfr_loc_map.suite.jobs.configurations import Configuration, check_input_files
from sfr_loc_map.suite.planning.specification import load_specification

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


def configuration_in(suite: Path) -> Configuration:
    return load_specification(suite).configurations["mine"]


def key_of(configuration: Configuration) -> str:
    return replace(JOB, parameters=configuration.parameters, input_files=configuration.input_files).key


@pytest.mark.parametrize("name", FILES)
def test_other_files_of_a_method_are_another_job(suite: Path, name: str) -> None:
    before = configuration_in(suite)
    check_input_files(before)
    (suite.parent / "method" / name).write_text("# other")
    assert key_of(configuration_in(suite)) != key_of(before)
    with pytest.raises(InputError, match="differs from that of the plan"):
        check_input_files(before)


def test_a_worker_without_the_files_of_a_method_refuses_the_job(suite: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    configuration = configuration_in(suite)
    monkeypatch.delenv("SFR_METHOD_FILES")
    with pytest.raises(InputError, match="SFR_METHOD_FILES"):
        check_input_files(configuration)


def test_the_files_of_methods_do_not_change_a_built_in_method(suite: Path) -> None:
    content = yaml.safe_load(suite.read_text())
    content["configurations"] = {"mine": {"localisation": {"method": "opencv"}}}
    suite.write_text(yaml.safe_dump(content))
    before = configuration_in(suite)
    (suite.parent / "method/weights.bin").write_text("other")
    assert configuration_in(suite) == before


def test_a_worker_with_another_mask_refuses_the_job(tmp_path: Path) -> None:
    (tmp_path / "drive.mcap").touch()
    mask = tmp_path / "mask.png"
    mask.write_bytes(b"mask")
    suite = tmp_path / "suite.yaml"
    configurations = {"mine": {"localisation": {"left_mask": "mask.png"}}}
    suite.write_text(yaml.safe_dump({"sources": ["drive.mcap"], "configurations": configurations}))
    configuration = configuration_in(suite)
    check_input_files(configuration)
    mask.write_bytes(b"another mask")
    with pytest.raises(InputError, match="left_mask"):
        check_input_files(configuration)
