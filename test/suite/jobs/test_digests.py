"""Digests of code and data: each differs when its files do, and files are read again only when they change."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from sfr_loc_map.suite.jobs import digests
from sfr_loc_map.suite.planning import source_inspection
from sfr_loc_map.suite.workers import worker


def test_data_that_differ_have_other_digests(tmp_path: Path) -> None:
    found = []
    for text in ("left", "LEFT", "left"):
        (tmp_path / "left.png").write_text(text)
        found.append(digests.hash_of(source_inspection.files_of_source(tmp_path)))
    assert found[0] == found[2]
    assert found[0] != found[1]


def test_the_files_of_a_linked_folder_are_data_of_the_source(tmp_path: Path) -> None:
    """Recordings are often laid out by links to their image folders. A link may also lead to a folder above."""
    drive, images = tmp_path / "drive", tmp_path / "images"
    drive.mkdir()
    images.mkdir()
    (drive / "left").symlink_to(images)
    (images / "back").symlink_to(drive)
    found = []
    for text in ("first", "other one"):
        (images / "0.png").write_text(text)
        found.append((digests.hash_of(source_inspection.files_of_source(drive)), digests.file_state(drive)))
    assert found[0][0] != found[1][0]
    assert found[0][1] != found[1][1]


def test_calls_are_data_of_their_estimate(tmp_path: Path) -> None:
    for name in ("drive.csv", "truth.csv", "drive.stats.csv"):
        (tmp_path / name).write_text(name)
    paths = (tmp_path / "drive.csv", tmp_path / "truth.csv")
    before = digests.hash_of(source_inspection.files_of_estimate(*paths))
    (tmp_path / "drive.stats.csv").write_text("with a finding")
    assert digests.hash_of(source_inspection.files_of_estimate(*paths)) != before


@pytest.mark.parametrize("setting", ["truth: {source: mytruth.csv}", "calibration: {file: mytruth.csv}"])
def test_the_files_that_a_configuration_names_are_data_of_the_source(setting: str, tmp_path: Path) -> None:
    (tmp_path / "drive.csv").write_text("drive")
    (tmp_path / "truth.csv").write_text("truth")
    (tmp_path / "sfr.yaml").write_text(setting)
    found = []
    for text in ("first", "another"):
        (tmp_path / "mytruth.csv").write_text(text)
        found.append(
            digests.hash_of(source_inspection.files_of_estimate(tmp_path / "drive.csv", tmp_path / "truth.csv"))
        )
    assert found[0] != found[1]


def test_a_worker_with_other_code_lacks_something() -> None:
    facts = digests.code_facts()
    assert worker.about_here(facts)["lacks"] == ""
    assert "other code" in worker.about_here(facts | {"sfr_loc_map": "0"})["lacks"]
    assert "numpy" in worker.about_here(facts | {"numpy": "0"})["lacks"]


def test_a_file_is_read_again_when_path_size_time_or_inode_differ(tmp_path: Path) -> None:
    path, reads = tmp_path / "a", []

    def read(found: Path) -> int:
        reads.append(found)
        return len(reads)

    path.write_text("one")
    assert [digests.cached(path, read), digests.cached(path, read)] == [1, 1]
    before = path.stat()
    (tmp_path / "b").write_text("two")
    os.replace(tmp_path / "b", path)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert digests.cached(path, read) == 2, "another inode of the same size and time"
    os.utime(path, ns=(0, 1))
    assert digests.cached(path, read) == 3


@pytest.mark.parametrize(
    ("place", "is_hashed"),
    [
        ("cli/replay.py", True),  # a task `replay` runs the command line
        ("nodes/monitor_node.py", True),
        ("suite/planning/specification.py", True),
        ("faults/injector.py", True),
        ("mapping/disparity/validity/jump_network.json", True),
        ("report/page.py", False),
        ("suite/pages/tables.py", False),
    ],
)
def test_the_digest_covers_all_code_that_a_result_depends_on(place: str, is_hashed: bool, tmp_path: Path) -> None:
    for name in (place, "inputs.py"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("before")
    before = digests.hash_package(tmp_path)
    (tmp_path / place).write_text("after")
    assert (digests.hash_package(tmp_path) != before) is is_hashed


def test_the_places_that_count_are_those_of_the_package() -> None:
    for folder in digests.EVALUATION_ONLY:
        assert (digests.PACKAGE / folder).is_dir()
