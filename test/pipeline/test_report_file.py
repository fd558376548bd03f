"""The report that the monitor saves."""

import os
from pathlib import Path

import pytest

from sfr_loc_map.errors import InputError, OutputError
from sfr_loc_map.pipeline.monitor_score import ReportFile


def report(name: str) -> str:
    return f'{{"schema": "sfr-score/1", "warnings": ["{name}"]}}'


def test_the_report_of_a_run_before_is_kept_once(tmp_path: Path) -> None:
    path = tmp_path / "score.json"
    file = ReportFile(str(path))
    file.keep_previous()
    assert file.save(report("first")) == path
    file.keep_previous()
    assert not path.exists()
    file.save(report("second"))
    assert (path.read_text(), (tmp_path / "score.before.json").read_text()) == (report("second"), report("first"))
    ReportFile(str(path)).keep_previous()
    assert (tmp_path / "score.before.json").read_text() == report("second")
    assert len(list(tmp_path.iterdir())) == 1


def test_without_a_path_nothing_can_be_saved() -> None:
    file = ReportFile("")
    file.check()
    file.keep_previous()
    with pytest.raises(InputError, match="save_file is empty"):
        file.save("text")


def make_folder(path: Path) -> None:
    path.mkdir()
    (path / "thesis.tex").write_text("years of work")


def listing(folder: Path) -> list[tuple[str, int, int]]:
    return [(str(path), (info := path.lstat()).st_ino, info.st_mtime_ns) for path in sorted(folder.rglob("*"))]


STRANGERS = {
    "folder": (make_folder, "a folder that is not empty"),
    "pipe": (os.mkfifo, "a named pipe"),
    "link to a device": (lambda path: path.symlink_to("/dev/null"), "a device"),
    "text": (lambda path: path.write_text("years of work"), "is not a report"),
    "other json": (lambda path: path.write_text('{"schema": "mine"}'), "is not a report"),
    "deep json": (lambda path: path.write_text("[" * 100_000), "is not a report"),
    "image": (lambda path: path.write_bytes(b"\x89PNG\xff"), "is not a report"),
}


@pytest.mark.parametrize("name", ["score.json", "score.before.json"])
@pytest.mark.parametrize("kind", STRANGERS)
def test_what_is_no_report_is_refused_and_stays(tmp_path: Path, kind: str, name: str) -> None:
    make, words = STRANGERS[kind]
    make(tmp_path / name)
    before = listing(tmp_path)
    file = ReportFile(str(tmp_path / "score.json"))
    words = words if name == "score.json" else r"score.before.json' (is|cannot be read).*only reports are replaced"
    for action in (file.check, file.keep_previous):
        with pytest.raises(OutputError, match=words):
            action()
    assert listing(tmp_path) == before


def test_a_missing_folder_is_told_at_once(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="there is no folder"):
        ReportFile(str(tmp_path / "none" / "score.json")).check()
