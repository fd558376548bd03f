"""Signals end a command cleanly: finished results are written, existing files are kept, no process remains."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from campaigns.signals import end_at_random
from helpers.cli_result import Sfr
from helpers.made_scene import write_folder
from helpers.processes import Process, wait_until
from sfr_loc_map.io.registry import open_source


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_folder(tmp_path_factory.mktemp("drive") / "source", 120, 3)


def test_localise_writes_the_poses_that_were_finished(source: Path, tmp_path: Path) -> None:
    out, film = tmp_path / "y.csv", tmp_path / "v.avi"
    words = ("-m", "sfr_loc_map", "localise", str(source), "-o", str(out), "--video", str(film))
    with Process(tmp_path / "log", *words) as run:
        wait_until(lambda: any(path.stat().st_size > 1e5 for path in tmp_path.glob(".v.avi.*/*")), "some frames")
        assert run.end(signal.SIGINT, signal.SIGINT, pause_s=0.0) == 130, run.text
    count = int(run.text.split(" poses, ")[0].splitlines()[-1])
    assert 1 <= count < 120
    assert len(out.read_text().splitlines()) == count + 1
    assert f"{count} of 120 pairs were localised and written" in run.text
    assert film.stat().st_size > 1e5


def test_an_interrupt_in_executed_text_as_in_the_import_of_a_dataclass_exits_with_the_usual_code(
    tmp_path: Path,
) -> None:
    lines = (
        "from sfr_loc_map.cli import main as cli",
        "cli.app = lambda **_: exec('import signal; signal.raise_signal(signal.SIGINT)')",
        "raise SystemExit(cli.main())",
    )
    (tmp_path / "interrupted.py").write_text("\n".join(lines))
    done = subprocess.run(
        [sys.executable, "-m", "interrupted"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (130, "sfr: interrupted: nothing was finished\n")


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGKILL])
def test_what_is_overwritten_stays_until_the_new_one_is_whole(
    source: Path, tmp_path: Path, sfr: Sfr, number: signal.Signals
) -> None:
    place = write_folder(tmp_path / "old", 5, 0)
    with Process(tmp_path / "log", "-m", "sfr_loc_map", "convert", str(source), str(place), "--overwrite") as run:
        wait_until(lambda: list(tmp_path.glob(".old.*.part/*")), "the new one")
        assert len(open_source(place).loc or ()) == 5
        assert run.end(number) == (130 if number is not signal.SIGKILL else -number)
    assert len(open_source(place).loc or ()) == 5
    assert sfr("convert", source, place, "--overwrite").code == 0
    assert len(open_source(place).loc or ()) == 120
    assert sorted(path.name for path in tmp_path.iterdir()) == ["log", "old"]


@pytest.mark.skipif(os.geteuid() != 0, reason="only root mounts a small disk")
def test_a_film_on_a_full_disk_costs_the_film_alone(tmp_path: Path) -> None:
    source = write_folder(tmp_path / "source", 40, 0)
    small, out = tmp_path / "small", tmp_path / "y.csv"
    small.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=120k", "none", small], check=False).returncode:
        pytest.skip("no disk can be mounted here")
    try:
        words = ["localise", str(source), "-o", str(out), "--video", str(small / "v.avi")]
        done = subprocess.run(
            [sys.executable, "-m", "sfr_loc_map", *words], capture_output=True, text=True, check=False
        )
        assert not list(small.iterdir())
    finally:
        subprocess.run(["umount", small], check=True)
    assert done.returncode == 2
    assert len(out.read_text().splitlines()) == 41
    assert "frames were kept; is the disk full?" in done.stderr
    assert len(done.stderr.splitlines()) < 6


@pytest.mark.slow
def test_signals_at_random_times_lose_and_leave_nothing(source: Path, tmp_path: Path) -> None:
    rng = random.Random(int.from_bytes(os.urandom(2), "big"))
    found = [end_at_random(name, source, tmp_path / name, rng) for name in ("map", "simulate-faults")]
    assert [ending for ending in found if ending.problem] == []
