"""Facts of sources in the cache: they are read again if a file of the source, the code or the cache has changed."""

from __future__ import annotations

from pathlib import Path

import pytest

from sfr_loc_map.suite.jobs.digests import hash_of
from sfr_loc_map.suite.planning import source_inspection
from sfr_loc_map.suite.planning.source_inspection import RecordingFacts, facts_of, files_of_source


@pytest.fixture
def reads(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Replace the reading of sources; return the sources that were read."""
    found: list[Path] = []

    def read(path: Path) -> RecordingFacts:
        found.append(path)
        return RecordingFacts(sha256=hash_of(files_of_source(path)), pairs=1, nav_pairs=0)

    monkeypatch.setattr(source_inspection, "read_facts", read)
    return found


def test_a_source_is_read_once(tmp_path: Path, reads: list[Path]) -> None:
    drive = tmp_path / "drive.mcap"
    drive.write_text("drive")
    first = facts_of(drive, tmp_path / "cache")
    assert facts_of(drive, tmp_path / "cache") == first
    assert reads == [drive]


@pytest.mark.parametrize("changed", ["drive/0.png", "mytruth.csv", "drive/sfr.yaml"])
def test_a_source_is_read_again_when_a_file_changes(tmp_path: Path, reads: list[Path], changed: str) -> None:
    (tmp_path / "drive").mkdir()
    files = {"drive/0.png": "image", "mytruth.csv": "truth", "drive/sfr.yaml": "truth: {source: ../mytruth.csv}\n"}
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    cache = tmp_path / "cache"
    before = facts_of(tmp_path / "drive", cache)
    (tmp_path / changed).write_text(files[changed] + "\n")
    assert facts_of(tmp_path / "drive", cache).sha256 != before.sha256
    assert len(reads) == 2


def test_a_source_is_read_again_with_other_code(
    tmp_path: Path, reads: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Other code may detect copies of a drive by other features."""
    drive = tmp_path / "drive.mcap"
    drive.write_text("drive")
    for code in ("before", "before", "after"):
        monkeypatch.setattr(source_inspection, "code_fingerprint", lambda code=code: code)
        facts_of(drive, tmp_path / "cache")
    assert len(reads) == 2


@pytest.mark.parametrize("text", ["", "{", "[]", '{"state": 1}', "[" * 10_000, "\xff"])
def test_a_damaged_file_of_the_cache_is_written_again(tmp_path: Path, reads: list[Path], text: str) -> None:
    drive = tmp_path / "drive.mcap"
    drive.write_text("drive")
    cache = tmp_path / "cache"
    first = facts_of(drive, cache)
    (file,) = (tmp_path / "cache/facts").glob("*.json")
    file.write_bytes(text.encode("latin-1"))
    assert facts_of(drive, cache) == facts_of(drive, cache) == first
    assert len(reads) == 2
