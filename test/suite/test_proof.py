"""What a worker proves: code, method, configuration and data, each read again only when its files change."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import pytest

from helpers.made_suites import JOB
from sfr_loc_map.inputs import Task, hash_path
from sfr_loc_map.suite import proof
from sfr_loc_map.suite.job import Job


@pytest.fixture
def job(tmp_path: Path) -> Job:
    (tmp_path / "drive").mkdir()
    (tmp_path / "drive" / "left.png").write_text("left")
    (tmp_path / "mine.py").write_text("class Mine: pass")
    method = f"{tmp_path}/mine.py:Mine"
    parameters = {"localisation.method": method, "localisation.method_config": ""}
    parameters["localisation.method_sha256"] = proof.method_hash(method, Task.LOCALISATION, "")
    source = replace(JOB.source, path=str(tmp_path / "drive"), sha256=hash_path(tmp_path / "drive"))
    return replace(JOB, source=source, code=proof.code_fingerprint(), parameters=parameters)


def test_each_difference_is_named(job: Job, tmp_path: Path) -> None:
    assert proof.lacking(job, job.key) == ""
    assert "other code" in proof.lacking(replace(job, code="0"), job.key)
    assert "another configuration" in proof.lacking(replace(job, start="identity"), job.key)
    (tmp_path / "mine.py").write_text("class Mine: pass  # faster")
    assert "another method" in proof.lacking(job, job.key)
    (tmp_path / "mine.py").write_text("class Mine: pass")
    (tmp_path / "drive" / "left.png").write_text("LEFT")
    assert "other data" in proof.lacking(job, job.key)
    (tmp_path / "drive" / "left.png").unlink()
    assert "other data" in proof.lacking(job, job.key)
    (tmp_path / "drive").rmdir()
    assert "there is no" in proof.lacking(job, job.key)


def test_a_file_is_read_again_when_path_size_time_or_inode_differ(tmp_path: Path) -> None:
    path, reads = tmp_path / "a", []

    def read(found: Path) -> int:
        reads.append(found)
        return len(reads)

    path.write_text("one")
    assert [proof.known(path, read), proof.known(path, read)] == [1, 1]
    before = path.stat()
    (tmp_path / "b").write_text("two")
    os.replace(tmp_path / "b", path)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert proof.known(path, read) == 2, "another inode of the same size and time"
    os.utime(path, ns=(0, 1))
    assert proof.known(path, read) == 3
