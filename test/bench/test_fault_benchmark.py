"""The benchmark of faults: what it counts and calls silent, and that the localiser survives the faults."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sfr_loc_map.bench.fault_benchmark import fault_figures, jump_sigmas
from sfr_loc_map.bench.fault_campaign import DrivePart, plan_drives
from sfr_loc_map.bench.honesty import Honesty, stated_errors
from sfr_loc_map.cli.bench_faults import _judge
from sfr_loc_map.cli.main import main
from sfr_loc_map.errors import FailedVerdictError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState, lost_covariance
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.simulation.faults import AMOUNTS, parse_fault, random_faults

SCORING = TrajectoryScoreConfig(conditions=("frames=2",), spacing=1)
SIGMA_M = 0.01


def at(x: float) -> Transform:
    return Transform(np.eye(3), np.array([x, 0.0, 0.0]))


def drive(errors_m: list[float], covariance: FloatArray | None = None) -> tuple[list[PoseEstimate], Trajectory]:
    """A drive of 1 m a pair, its estimates too far forward by the errors."""
    covariance = np.eye(6) * SIGMA_M**2 / 3 if covariance is None else covariance
    truth = Trajectory.from_poses((k, at(float(k))) for k in range(len(errors_m)))
    poses = [at(k + error) for k, error in enumerate(errors_m)]
    return [PoseEstimate(k, pose, covariance, TrackingState.TRACKING) for k, pose in enumerate(poses)], truth


def test_a_jump_is_measured_in_stated_sigmas() -> None:
    estimates, truth = drive([0.0, 0.0, 0.04, 0.04, 0.04])
    assert jump_sigmas(estimates, truth) == pytest.approx([0.0, 4.0, 0.0, 0.0])
    figures = fault_figures(estimates, truth, SCORING)
    assert (figures.pairs, figures.lost, figures.silent_jumps) == (5, 0, 1)
    assert figures.largest_jump_sigma == pytest.approx(4.0)


def test_lost_pairs_are_counted_and_are_no_jumps() -> None:
    estimates, truth = drive([0.0, 0.0, 9.0, 9.0, 0.0, 0.0, 9.0, 0.0])
    gone = (2, 3, 6)
    reported = [
        replace(e, state=TrackingState.LOST, covariance=lost_covariance()) if e.stamp_ns in gone else e
        for e in estimates
    ]
    figures = fault_figures(reported, truth, SCORING)
    assert (figures.lost, figures.longest_lost, figures.silent_jumps) == (3, 2, 0)


def test_an_error_beyond_five_times_the_stated_3_sigma_is_silent_where_it_is_called_tracking() -> None:
    """The stated 3 sigma is 0.03 m: an error of 0.16 m is more than 5 times as large, one of 0.14 m is not."""
    estimates, truth = drive([0.0, 0.14, 0.14, 0.14])
    stated = stated_errors(estimates, truth)
    assert stated.position_ratio == pytest.approx(0.14 / 0.03)
    assert (stated.beyond_share, stated.honesty) == (0.0, Honesty.STATED)
    estimates, truth = drive([0.0, 0.16, 0.0, 0.0])
    silent = stated_errors(estimates, truth)
    assert (silent.beyond_share, silent.honesty) == (0.25, Honesty.SILENT)
    estimates[1] = replace(estimates[1], state=TrackingState.LOST, covariance=lost_covariance())
    said = stated_errors(estimates, truth)
    assert (said.tracking, said.lost, said.beyond_share, said.honesty) == (3, 1, 0.0, Honesty.SAID)


def test_attitude_is_judged_as_well() -> None:
    estimates, truth = drive([0.0, 0.0])
    turned = Transform(matrix_from_rotvec(np.array([0.0, 0.0, 16 * SIGMA_M])), estimates[1].T_ds_rb.translation)
    stated = stated_errors([estimates[0], replace(estimates[1], T_ds_rb=turned)], truth)
    assert stated.attitude_ratio == pytest.approx(16 / 3)
    assert stated.honesty is Honesty.SILENT


def test_silent_faults_end_with_exit_1_and_their_names() -> None:
    _judge([])
    with pytest.raises(FailedVerdictError, match="body"):
        _judge(["body"])


def test_random_faults_are_those_of_the_seed_and_can_be_read() -> None:
    texts = [random_faults(np.random.default_rng([5, k]), 40) for k in range(200)]
    assert texts == [random_faults(np.random.default_rng([5, k]), 40) for k in range(200)]
    assert texts[0] != random_faults(np.random.default_rng([6, 0]), 40)
    kinds = {parse_fault(part).kind for text in texts for part in text.split("+")}
    assert kinds == set(AMOUNTS)


def test_campaign_plans_all_sources_clean_and_parts_of_them_with_faults(long_drive: Path) -> None:
    sequence = open_source(long_drive, {}).loc
    assert sequence is not None
    plans = plan_drives({"a": sequence, "b": sequence}, 7, 3, 12)
    assert [plan.faults for plan in plans[:2]] == ["none", "none"]
    assert [plan.pairs for plan in plans] == [30, 30, *[12] * 7]
    assert all(0 <= plan.first <= 18 for plan in plans)
    assert plans == plan_drives({"a": sequence, "b": sequence}, 7, 3, 12)
    part = DrivePart(sequence, 5, 12)
    assert len(list(part.pairs())) == 12
    assert part.ground_truth.stamps_ns[0] == next(part.pairs()).stamp_ns


@pytest.mark.slow
def test_campaign_reports_each_drive(
    long_drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "campaign.json"
    arguments = ["bench", "faults", long_drive, "--random", 3, "--pairs", 10, "--seed", 1, "--json", out]
    monkeypatch.setattr(sys, "argv", ["sfr", *map(str, arguments)])
    code = main()
    result = json.loads(out.read_text())
    assert code == (1 if result["entries"]["with faults"]["silent"] else 0)
    assert result["entries"]["clean"]["stated"] == 1
    assert result["entries"]["with faults"]["drives"] == 3
    drives = result["drives"]
    assert len(drives) == 4
    assert [max(d["position_ratio"] or 0, d["attitude_ratio"] or 0) for d in drives] == sorted(
        (max(d["position_ratio"] or 0, d["attitude_ratio"] or 0) for d in drives), reverse=True
    )
    assert "4 of 4 drives" in capsys.readouterr().err


@pytest.mark.slow
def test_benchmark_has_the_drive_without_and_with_each_fault(
    long_drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, page = tmp_path / "faults.json", tmp_path / "faults.md"
    faults = (
        "black:camera=left,start=4",
        "blinded:share=0.3,camera=left,start=4",
        "swapped:start=4",
        "repeated:start=4",
        "dropped:start=4",
    )
    options = [option for fault in faults for option in ("--fault", fault)]
    arguments = [long_drive, *options, "--condition", "frames=3", "--spacing", 1, "--json", out, "--markdown", page]
    monkeypatch.setattr(sys, "argv", ["sfr", "bench", "faults", *map(str, arguments)])
    assert main() == 0
    entries = json.loads(out.read_text())["entries"]
    assert page.read_text().count("| said |") == sum(entry["honesty"] == "said" for entry in entries.values()) > 0
    assert set(entries) == {"none", *faults}
    assert entries["none"]["lost"] == 0
    assert entries["none"]["position_m"] < 0.01
    assert entries["dropped:start=4"]["pairs"] < entries["none"]["pairs"]
    assert entries["swapped:start=4"]["lost"] > 0
    for name, entry in entries.items():
        assert entry["silent_jumps"] == 0, name
        assert entry["honesty"] != "silent", name
        assert entry["longest_lost"] <= 3, name
        assert abs(entry["vertical_offset_px"]) < 0.1, name
        if not name.startswith("repeated"):  # there the rover moves unseen
            assert entry["position_m"] < 0.02, name
