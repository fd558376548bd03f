"""Benchmarks from end to end on tiny sources, and methods that are missing or fail."""

from __future__ import annotations

import ast
import json
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_scene import LOC_RIG, loc_pair

from sfr_loc_map.bench.competitors import Competitors, competitors
from sfr_loc_map.bench.localisation_benchmark import BenchmarkSettings, benchmark_localisation
from sfr_loc_map.bench.passes import LIMITS, PassInput, run_pass
from sfr_loc_map.bench.results import OURS
from sfr_loc_map.bench.score_benchmark import WORKERS as SCORE_WORKERS
from sfr_loc_map.bench.score_benchmark import write_drive
from sfr_loc_map.cli.main import main
from sfr_loc_map.errors import BenchError, MethodError
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import Task
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.trajectory_file import load_trajectory
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.methods import registry
from sfr_loc_map.methods.isolated_method import IsolatedMethod
from sfr_loc_map.methods.registry import WORKERS, Method, lacks
from sfr_loc_map.metrics.calls import CallUsage
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.score import MethodKind

SCORE = TrajectoryScoreConfig(conditions=("frames=3",), spacing=2)
METHOD = """
import os, sys
class MadeMethod:
    version = "7"
    def __init__(self, setup):
        print("noise on standard output")
        {start}
    def prepare(self, left, right, order):
        {prepare}
        return lambda: (int(left.sum()), int(right.sum()))
    def report(self, answer, order):
        numbers = [*answer, order["since_start_s"]]
        return {{"T_ds_rb": None, "statistics": dict(zip(("left", "right", "since_start_s"), numbers))}}
open_method = MadeMethod
"""


@pytest.fixture(autouse=True)
def this_package(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let methods, which run as scripts, import the package under test: of an installed one no kernel is compiled."""
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[2]))


def sfr(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    monkeypatch.setattr(sys, "argv", ["sfr", *map(str, arguments)])
    return main()


def made_method(
    folder: Path, name: str = "made", *, start: str = "pass", prepare: str = "pass", background: bool = False
) -> Method:
    path = folder / f"{name}.py"
    path.write_text(METHOD.format(start=start, prepare=prepare), encoding="utf-8")
    # an absolute path stands for itself
    return Method(name, Task.LOCALISATION, MethodKind.PEER, str(path), background=background)


def called(localiser: IsolatedMethod, pair: StereoPair, since_start_s: float) -> tuple[Any, CallUsage, str]:
    _, call = localiser.localise(pair, {"since_start_s": since_start_s})
    return call.statistics, call.usage, call.finding


def given(count: int, rate_scale: float = 1.0, call: Any = called) -> PassInput[IsolatedMethod, Any]:
    def start(method: Method) -> IsolatedMethod:
        return IsolatedMethod(method, LOC_RIG, Transform.identity(), LIMITS)

    return PassInput(lambda: map(loc_pair, range(count)), start, call, rate_scale)


@pytest.mark.slow
def test_localise_shows_ours_and_opencv_and_names_what_is_missing(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "bench.json"
    options = ("--repeat", 1, "--sizes", 2, "--condition", "frames=3", "--spacing", 2)
    assert sfr(monkeypatch, "bench", "localise", drive, *options, "--json", out) == 0
    printed = capsys.readouterr().out
    assert "left out: orbslam3: not looked for: give --peer-python" in printed
    assert "host times" in printed
    result = json.loads(out.read_text())
    assert [(size["width"], size["height"]) for size in result["sizes"]] == [(160, 120), (80, 60)]
    assert set(result["growth"]) == {"ours", "opencv"}
    full = result["sizes"][0]
    for name, metres in (("ours", 0.01), ("opencv", 0.1)):
        entry = full["entries"][name]
        assert entry["calls"] == 12
        assert 0 < entry["accuracy"]["frames=3"]["position_m"] < metres
        assert 0 < entry["time_s"]["p50"] <= entry["time_s"]["p95"] <= entry["time_s"]["max"]
        assert 20e6 < entry["memory_bytes"]["peak"] < 1e9
        assert entry["lost"] == 0
    ours, other = full["entries"]["ours"], full["entries"]["opencv"]
    assert full["ratios"]["opencv"]["time_s"]["p50"] == pytest.approx(ours["time_s"]["p50"] / other["time_s"]["p50"])


@pytest.mark.slow
def test_localise_gives_the_accuracy_of_the_suite(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    sequence = open_source(drive).loc
    assert sequence is not None
    ours = Competitors(competitors(Task.LOCALISATION).present[:1], {})
    result = benchmark_localisation(sequence, LocalisationConfig(), ours, BenchmarkSettings(SCORE, repeat=2))
    entry = result.sizes[0].entries["ours"]
    estimate = tmp_path / "estimate.csv"
    assert sfr(monkeypatch, "localise", drive, "-o", estimate, "--start", "truth") == 0
    options = ("--condition", "frames=3", "--spacing", 2, "--json", "-")
    assert sfr(monkeypatch, "score", estimate, drive, *options) == 0
    score = json.loads(capsys.readouterr().out)["trajectory"]
    assert entry.figures.accuracy is not None
    errors = entry.figures.accuracy["frames=3"]
    for name in ("position_m", "attitude_deg", "heading_deg"):
        assert getattr(errors, name) == pytest.approx(score[name]["mean_plus_3sigma"], rel=1e-6)
    assert len(entry.runs) == 2
    assert entry.runs[0].accuracy == entry.runs[1].accuracy


@pytest.mark.slow
def test_map_shows_ours_and_sgbm(panorama: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "bench.json"
    assert sfr(monkeypatch, "bench", "map", panorama, "--repeat", 1, "--json", out) == 0
    result = json.loads(out.read_text())
    (size,) = result["sizes"]
    assert set(size["entries"]) == {"ours", "sgbm"}
    assert set(result["missing"]) == {"pandora"}
    for entry in size["entries"].values():
        assert entry["accuracy"]["density"] > 0.7
        assert entry["accuracy"]["sigma_px"] < 0.5
        assert abs(entry["accuracy"]["bias_px"]) < 0.3
        assert entry["calls"] == 2
    assert size["entries"]["ours"]["accuracy"]["sigma_px"] < size["entries"]["sgbm"]["accuracy"]["sigma_px"]


@pytest.mark.slow
def test_score_runs_ours_alone_where_evo_is_missing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if find_spec("evo"):
        pytest.skip("evo is installed here")
    assert sfr(monkeypatch, "bench", "score", "--poses", 400, "--peer-python", sys.executable, "--json", "-") == 0
    result = json.loads(capsys.readouterr().out)
    assert "not installed in" in result["missing"]["evo"]
    assert set(result["entries"]) == {"ours: distance=5", "ours: six"}
    for entry in result["entries"].values():
        assert entry["sub_trajectories_of_5_m"] == 300  # 5 cm a step: of 400 poses the last 100 start none
        assert entry["memory_bytes"]["peak"] > 20e6


def test_bench_alone_shows_its_help(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert sfr(monkeypatch, "bench") == 0
    assert "localise" in capsys.readouterr().out


def test_made_drive_has_steps_of_five_centimetres(tmp_path: Path) -> None:
    truth, estimate = (load_trajectory(path) for path in write_drive(tmp_path, 250))
    steps = np.linalg.norm(np.diff(truth.positions, axis=0), axis=1)
    np.testing.assert_allclose(steps, 0.05, atol=1e-6)
    assert len(truth) == len(estimate) == 250
    np.testing.assert_array_equal(truth.stamps_ns, estimate.stamps_ns)
    assert np.linalg.norm(truth.positions[-1] - estimate.positions[-1]) > 0.01


def test_images_arrive_and_output_of_a_method_is_ignored(tmp_path: Path) -> None:
    done = run_pass([made_method(tmp_path)], given(3))
    run = done.runs["made"]
    assert run.version == "7"
    for index, report in enumerate(run.results):
        pair = loc_pair(index)
        sums = {"left": int(pair.left.sum()), "right": int(pair.right.sum())}
        assert report == sums | {"since_start_s": pytest.approx(0.1 * index)}


def test_background_methods_get_their_pairs_at_the_rate(tmp_path: Path) -> None:
    import time

    method, times = made_method(tmp_path, background=True), []

    def timed(*arguments: Any) -> tuple[Any, CallUsage, str]:
        times.append(time.monotonic())
        return called(*arguments)

    run_pass([method], given(5, 0.5, timed))
    assert 0.7 < times[-1] - times[0] < 3.0  # four steps of 0.1 s at half the rate


@pytest.mark.parametrize(
    ("start", "prepare", "words"),
    [
        ("raise ValueError('no vocabulary')", "pass", "has ended with 1: ValueError: no vocabulary"),
        ("os._exit(3)", "pass", "has ended with 3"),
        (
            "pass",
            "if order['since_start_s'] > 0.1: sys.exit('out of memory')",
            "has ended with 1: out of memory",
        ),
    ],
)
def test_a_method_that_fails_is_named_and_the_others_go_on(
    tmp_path: Path, start: str, prepare: str, words: str
) -> None:
    bad = made_method(tmp_path, start=start, prepare=prepare)
    done = run_pass([bad, made_method(tmp_path, "good")], given(4))
    assert set(done.failed) == {"made"}
    assert words in done.failed["made"]
    assert len(done.runs["good"].seconds) == 4


def test_ours_must_run(drive: Path, tmp_path: Path) -> None:
    sequence = open_source(drive).loc
    assert sequence is not None
    broken = replace(made_method(tmp_path, start="sys.exit('broken')"), name=OURS)
    with pytest.raises(BenchError, match="ours has ended with 1: broken"):
        benchmark_localisation(sequence, LocalisationConfig(), Competitors((broken,), {}), BenchmarkSettings(SCORE))


def test_missing_methods_are_named(tmp_path: Path) -> None:
    here = Path(sys.executable)
    assert "pip install pyorbslam3" in competitors(Task.LOCALISATION).missing["orbslam3"]
    assert "not installed in" in competitors(Task.MAPPING, here).missing["pandora"]
    assert lacks(here, "json", "") is None
    with pytest.raises(MethodError, match="give a Python interpreter"):
        lacks(tmp_path / "none", "json", "")


def test_vocabulary_is_asked_for_where_the_wheel_is_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "lacks", lambda *_: None)
    here = Path(sys.executable)
    assert "--vocab" in competitors(Task.LOCALISATION, here).missing["orbslam3"]
    assert "no vocabulary" in competitors(Task.LOCALISATION, here, tmp_path / "none.txt").missing["orbslam3"]
    (tmp_path / "vocabulary.txt").touch()
    found = competitors(Task.LOCALISATION, here, tmp_path / "vocabulary.txt")
    assert [method.name for method in found.present if method.background] == ["ours", "orbslam3"]


@pytest.mark.parametrize("name", ["loop.py", "c_library.py", "peer_orbslam3.py", "peer_pandora.py", "measured.py"])
def test_what_runs_in_another_interpreter_needs_nothing_of_this_package(name: str) -> None:
    folder = SCORE_WORKERS if name == "measured.py" else WORKERS
    tree = ast.parse((folder / name).read_text(encoding="utf-8"))
    names = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    names |= {node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert not [item for item in names if item.startswith("sfr_loc_map")]
