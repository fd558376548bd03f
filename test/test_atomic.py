"""An output is either complete or missing."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from sfr_loc_map import atomic
from sfr_loc_map.atomic import atomic_path, check_output
from sfr_loc_map.errors import OutputError


def test_file_and_folder_take_their_names_at_the_end(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_text("old")
    (tmp_path / "latest.ply").symlink_to("a.ply")  # a link stays, and its file is replaced
    (tmp_path / "d").mkdir()
    with atomic_path(tmp_path / "latest.ply") as temporary:
        temporary.write_text("new")
        assert (tmp_path / "a.ply").read_text() == "old"
    with atomic_path(tmp_path / "d") as temporary:
        temporary.mkdir()
        (temporary / "x").write_text("1")
        assert not (tmp_path / "d" / "x").exists()
    assert (tmp_path / "a.ply").read_text() == "new"
    assert (tmp_path / "latest.ply").is_symlink()
    assert (tmp_path / "d" / "x").read_text() == "1"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.ply", "d", "latest.ply"]


@pytest.mark.parametrize("name", ["a", "b"])
def test_nothing_is_left_of_an_error(tmp_path: Path, name: str) -> None:
    (tmp_path / "a").write_text("old")

    def fail() -> None:
        with atomic_path(tmp_path / name) as temporary:
            temporary.write_text("half")
            raise RuntimeError("boom")

    with pytest.raises(RuntimeError, match="boom"):
        fail()
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("a", "old")]


@pytest.mark.parametrize(
    ("place", "words"),
    [
        *(("full", "not empty"), ("none/x", "does not exist"), ("file/x", "does not exist")),
        *(("pipe", "a named pipe"), ("socket", "a socket"), ("/dev/null", "a device"), ("to null", "a device")),
        *(("nowhere", "a broken link"), ("circle", "a broken link")),
    ],
)
def test_what_is_no_file_is_never_replaced(tmp_path: Path, place: str, words: str) -> None:
    (tmp_path / "full" / "x").mkdir(parents=True)
    (tmp_path / "file").write_text("")
    os.mkfifo(tmp_path / "pipe")
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(tmp_path / "socket"))
    for link, target in (("nowhere", "gone"), ("circle", "circle"), ("to null", "/dev/null")):
        (tmp_path / link).symlink_to(target)
    before = sorted(tmp_path.iterdir())
    with pytest.raises(OutputError, match=words), atomic_path(tmp_path / place) as temporary:
        temporary.write_text("new")
    with pytest.raises(OutputError, match=words):
        check_output(tmp_path / place)
    assert sorted(tmp_path.iterdir()) == before
    assert Path("/dev/null").is_char_device()


def test_what_a_killed_run_left_is_removed_by_the_next_and_what_is_at_work_is_not(tmp_path: Path) -> None:
    output = tmp_path / "a[1].csv"
    killed = (
        "import os, signal, sys; from pathlib import Path; from sfr_loc_map.atomic import atomic_path\n"
        "with atomic_path(Path(sys.argv[1])) as path: path.write_text('half'); os.kill(os.getpid(), signal.SIGKILL)"
    )
    subprocess.run([sys.executable, "-c", killed, str(output)], check=False)
    (left,) = tmp_path.iterdir()
    assert left.suffix == ".part"
    other = tmp_path / ".a[1].csv.notours.part"
    other.mkdir()
    with atomic_path(output) as at_work:
        at_work.write_text("at work")
        assert not left.exists()
        with atomic_path(output) as second:
            second.write_text("second")
        check_output(output)
        assert at_work.read_text() == "at work"
    assert output.read_text() == "at work"
    assert sorted(tmp_path.iterdir()) == [other, output]


def test_a_signal_while_the_new_one_takes_its_place_comes_after_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    exchange, place = atomic.exchange, tmp_path / "out"
    place.mkdir()
    (place / "old").touch()

    def interrupted(new: Path, target: Path, before: Path) -> None:
        signal.raise_signal(signal.SIGINT)
        exchange(new, target, before)

    monkeypatch.setattr(atomic, "exchange", interrupted)
    with pytest.raises(KeyboardInterrupt), atomic_path(place, any_folder=True) as new:  # noqa: PT012
        new.mkdir()
        (new / "new").touch()
    assert [path.relative_to(tmp_path).as_posix() for path in sorted(tmp_path.rglob("*"))] == ["out", "out/new"]
