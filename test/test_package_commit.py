"""The commit in reports is the commit of the built package or of the clone."""

import subprocess
from pathlib import Path

import pytest

from helpers import ROOT
from sfr_loc_map import package_commit as module
from sfr_loc_map.package_commit import PackageCommit, package_commit


def test_the_commit_of_a_clone_is_asked_of_git() -> None:
    if not (ROOT / ".git").exists():
        pytest.skip("this is not a clone")
    expected = subprocess.run(["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=True)
    commit, branch, date = package_commit()
    assert commit is not None
    assert commit.removesuffix("-dirty") == expected.stdout.strip()
    assert None not in (branch, date)


def test_the_commit_of_a_built_package_is_that_of_its_build(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "commit.txt").write_text("0123abc-dirty\nmain\n2026-11-28T12:00:00+00:00\n")
    monkeypatch.setattr(module, "_COMMIT_FILE", tmp_path / "commit.txt")
    assert package_commit.__wrapped__() == PackageCommit("0123abc-dirty", "main", "2026-11-28T12:00:00+00:00")


def test_the_commit_of_a_package_outside_of_a_clone_is_unknown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_COMMIT_FILE", tmp_path / "commit.txt")
    monkeypatch.setattr(module, "_PACKAGE", tmp_path / "sfr_loc_map")
    assert package_commit.__wrapped__() == PackageCommit()
