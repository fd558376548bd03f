"""Outputs are whole or not there."""

from __future__ import annotations

import os
import socket
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from sfr_loc_map.errors import OutputError
from sfr_loc_map.io.atomic import atomic_path, check_output


def test_file_and_folder_take_their_names_at_the_end(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_text("old")
    with atomic_path(tmp_path / "a.ply") as temporary:
        assert temporary.suffix == ".ply"
        temporary.write_text("new")
        assert (tmp_path / "a.ply").read_text() == "old"
    assert (tmp_path / "a.ply").read_text() == "new"
    with atomic_path(tmp_path / "d") as temporary:
        temporary.mkdir()
        (temporary / "x").write_text("1")
        assert not (tmp_path / "d").exists()
    assert (tmp_path / "d" / "x").read_text() == "1"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.ply", "d"]


def test_nothing_is_left_of_an_error(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("old")

    def fail(name: str) -> None:
        with atomic_path(tmp_path / name) as temporary:
            temporary.write_text("half")
            raise RuntimeError("boom")

    for name in ("a", "b"):
        with pytest.raises(RuntimeError, match="boom"):
            fail(name)
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("a", "old")]


def test_what_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "x").write_text("")
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").write_text("")
    for name, words in (("full", "not empty"), ("none/x", "there is no folder"), ("file/x", "there is no folder")):
        with pytest.raises(OutputError, match=words), atomic_path(tmp_path / name):
            pass
    with pytest.raises(OutputError, match="cannot write"), atomic_path(tmp_path / "nothing written"):
        pass
    with atomic_path(tmp_path / "empty") as temporary:
        temporary.mkdir()
        (temporary / "y").write_text("")
    assert (tmp_path / "empty" / "y").exists()


def test_what_is_no_file_is_never_replaced(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(tmp_path / "socket"))
    (tmp_path / "nowhere").symlink_to(tmp_path / "gone")
    (tmp_path / "circle").symlink_to(tmp_path / "circle")
    (tmp_path / "to null").symlink_to("/dev/null")
    before = sorted(tmp_path.iterdir())
    places = ("pipe", "socket", "nowhere", "circle", "to null", "/dev/null")
    words = ("a named pipe", "a socket", "a link to nothing", "a link to nothing", "a device", "a device")
    for place, word in zip(places, words, strict=True):
        with pytest.raises(OutputError, match=word), atomic_path(tmp_path / place) as temporary:
            temporary.write_text("new")
        with pytest.raises(OutputError, match=word):
            check_output(tmp_path / place)
    assert sorted(tmp_path.iterdir()) == before
    assert stat.S_ISCHR(Path("/dev/null").stat().st_mode)


def test_what_comes_while_it_is_written_is_not_replaced_either(tmp_path: Path) -> None:
    def write() -> None:
        with atomic_path(tmp_path / "a") as temporary:
            temporary.write_text("new")
            os.mkfifo(tmp_path / "a")

    with pytest.raises(OutputError, match="a named pipe"):
        write()
    assert (tmp_path / "a").is_fifo()


def test_a_link_stays_and_its_file_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "1.csv").write_text("old")
    (tmp_path / "latest.csv").symlink_to("runs/1.csv")
    with atomic_path(tmp_path / "latest.csv") as temporary:
        temporary.write_text("new")
    assert (tmp_path / "latest.csv").is_symlink()
    assert (tmp_path / "runs" / "1.csv").read_text() == "new"


def test_what_a_killed_run_left_is_removed_by_the_next_and_what_is_at_work_is_not(tmp_path: Path) -> None:
    killed = "import os, signal, sys; from pathlib import Path; from sfr_loc_map.io.atomic import atomic_path\n"
    killed += (
        "with atomic_path(Path(sys.argv[1])) as path: path.write_text('half'); os.kill(os.getpid(), signal.SIGKILL)"
    )
    subprocess.run([sys.executable, "-c", killed, str(tmp_path / "a[1].csv")], check=False)
    (left,) = tmp_path.iterdir()
    assert left.suffix == ".part"
    other = tmp_path / ".a[1].csv.notours.part"
    other.mkdir()
    with atomic_path(tmp_path / "a[1].csv") as at_work:
        at_work.write_text("at work")
        assert not left.exists()
        with atomic_path(tmp_path / "a[1].csv") as second:
            second.write_text("second")
        check_output(tmp_path / "a[1].csv")
        assert at_work.read_text() == "at work"
    assert (tmp_path / "a[1].csv").read_text() == "at work"
    assert sorted(tmp_path.iterdir()) == [other, tmp_path / "a[1].csv"]
