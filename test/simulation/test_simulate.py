"""A simulated data set: read back, identical for any number of workers, continued after a kill."""

import gc
import hashlib
import signal
import subprocess
import sys
import time
import weakref
from pathlib import Path

import numpy as np
import psutil
import pytest

from helpers.cli_result import Sfr
from sfr_loc_map.configuration.parameters import build
from sfr_loc_map.configuration.yaml_file import load_yaml
from sfr_loc_map.errors import OutputError
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.sequence import drive_of, panorama_of
from sfr_loc_map.simulation.config import SimulationConfig
from sfr_loc_map.simulation.plan import Plan
from sfr_loc_map.simulation.simulate import SETTINGS, settings_text, simulate
from sfr_loc_map.simulation.world import World

pytestmark = pytest.mark.slow

pytest.importorskip("embreex")

TINY = {
    "terrain.coarseness": 8.0,
    "rocks.cover": 0.01,
    "rocks.smallest_m": 0.2,
    "drive.segments": ["straight 1"],
    "drive.pairs": 3,
    "panorama.enabled": True,
    "panorama.pan_deg": [5.0],
    "panorama.tilt_deg": [25.0],
    **{f"{rig}.{name}": value for rig in ("loc", "nav") for name, value in (("width", 48), ("height", 40))},
    "loc.focal_px": 40.0,
    "nav.focal_px": 40.0,
    "sensor.samples": 1,
}
CONFIG = build(SimulationConfig, TINY)


def digest(folder: Path) -> dict[str, str]:
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("made") / "both"
    assert simulate(CONFIG, out, workers=1) == 4
    return out


def test_folder_reads_back_with_the_plans_truth_and_two_workers_make_the_same_bytes(made: Path, tmp_path: Path) -> None:
    source, plan = open_source(made), Plan.make(CONFIG)
    drive = drive_of(source)
    assert np.array_equal(drive.ground_truth.positions, plan.trajectory().positions)
    assert [pair.left.std() > 3 for pair in drive.pairs()] == [True] * 3
    (nav,) = panorama_of(source).pairs()
    assert np.allclose(nav.T_lm_navsb.matrix, plan.lm_pose(0).matrix, atol=1e-12)
    simulate(CONFIG, tmp_path / "two", workers=2)
    assert digest(tmp_path / "two") == digest(made)


def test_the_world_is_released_after_a_run_in_this_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A worker of a suite that has simulated a drive does not hold its meshes."""
    built: list[weakref.ref[World]] = []

    class RecordedWorld(World):
        def __init__(self, plan: Plan) -> None:
            super().__init__(plan)
            built.append(weakref.ref(self))

    monkeypatch.setattr("sfr_loc_map.simulation.simulate.World", RecordedWorld)
    simulate(CONFIG, tmp_path / "made", workers=1)
    gc.collect()
    assert [world() for world in built] == [None]


def workers_at_work(pid: int, end: float) -> list[psutil.Process]:
    """Wait until both workers of a run have worked for half a second."""
    found: list[psutil.Process] = []
    while time.monotonic() < end and (len(found) < 2 or any(sum(item.cpu_times()[:2]) < 0.5 for item in found)):
        found = [item for item in psutil.Process(pid).children() if "spawn_main" in " ".join(item.cmdline())]
        time.sleep(0.05)
    return found


def start(config: Path, out: Path, stderr: int = subprocess.DEVNULL) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "sfr_loc_map", "simulate", str(config), str(out), "--workers", "2"]
    return subprocess.Popen(command, stderr=stderr)


def test_killed_run_continues_to_the_same_bytes(tmp_path: Path, sfr: Sfr) -> None:
    """The run is killed amid rendering, with images done and others not; what is done is not made again."""
    slow = build(SimulationConfig, {**TINY, "drive.pairs": 4, "sensor.samples": 36})
    whole, out, config = tmp_path / "whole", tmp_path / "killed", tmp_path / "config.yaml"
    config.write_text(settings_text(slow))
    simulate(slow, whole, workers=1)
    process = start(config, out)
    end = time.monotonic() + 100
    while time.monotonic() < end and process.poll() is None:
        if any(out.glob("loc/*/*.png")):
            break
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not (out / "loc" / "pairs.csv").exists()
    done = {path: path.stat().st_mtime_ns for path in out.glob("loc/*/*.png")}
    assert 0 < len(done) < 8
    assert sfr("simulate", config, out, "--workers", "1").code == 0
    assert all(path.stat().st_mtime_ns == made_ns for path, made_ns in done.items())
    assert digest(out) == digest(whole)


def test_ctrl_c_ends_a_run_at_once_and_says_how_to_continue(tmp_path: Path) -> None:
    """An image of this run takes far longer than that."""
    slow = build(SimulationConfig, {**TINY, "loc.width": 2048, "loc.height": 2048, "sensor.samples": 64})
    out, config = tmp_path / "out", tmp_path / "config.yaml"
    config.write_text(settings_text(slow))
    with start(config, out, subprocess.PIPE) as process:
        end = time.monotonic() + 100
        while time.monotonic() < end and not list(out.glob("loc/left")):
            time.sleep(0.05)
        workers = workers_at_work(process.pid, end)
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 130  # 0.2 s where nothing else runs
        assert "repeat the command to render the others" in process.stderr.read().decode().splitlines()[-1]
    assert not any(worker.is_running() for worker in workers)


def test_a_folder_of_another_simulation_is_refused_and_a_finished_one_is_unchanged(made: Path, tmp_path: Path) -> None:
    before = digest(made)
    assert simulate(CONFIG, made, workers=1) == 4
    assert digest(made) == before
    with pytest.raises(OutputError, match="other settings"):
        simulate(build(SimulationConfig, {**TINY, "seed": 9}), made)
    other = tmp_path / "other"
    other.mkdir()
    (other / SETTINGS).write_text(settings_text(CONFIG).partition("\n")[2])
    with pytest.raises(OutputError, match="by another version of the code"):
        simulate(CONFIG, other)
    (other / SETTINGS).write_text("seed: [")
    with pytest.raises(OutputError, match="settings cannot be read"):
        simulate(CONFIG, other)
    (tmp_path / "a.txt").write_text("a")
    with pytest.raises(OutputError, match="is not a simulation"):
        simulate(CONFIG, tmp_path)
    assert build(SimulationConfig, load_yaml(made / SETTINGS)) == CONFIG
