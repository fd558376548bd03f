"""The report that the monitor saves."""

from pathlib import Path

import pytest

from sfr_loc_map.errors import InputError, OutputError
from sfr_loc_map.pipeline.online.report_file import ReportFile


def test_the_report_of_a_run_before_is_kept_once(tmp_path: Path) -> None:
    path = tmp_path / "score.json"
    file = ReportFile(str(path))
    file.keep_previous()
    assert file.save("first") == path
    file.keep_previous()
    assert not path.exists()
    file.save("second")
    assert (path.read_text(), (tmp_path / "score.before.json").read_text()) == ("second", "first")
    assert len(list(tmp_path.iterdir())) == 2


def test_without_a_path_nothing_can_be_saved() -> None:
    file = ReportFile("")
    file.keep_previous()
    with pytest.raises(InputError, match="save_file is empty"):
        file.save("text")


def test_a_report_that_cannot_be_kept_is_reported(tmp_path: Path) -> None:
    (tmp_path / "score.json").write_text("old")
    (tmp_path / "score.before.json").mkdir()
    with pytest.raises(OutputError, match="of the run before"):
        ReportFile(str(tmp_path / "score.json")).keep_previous()
