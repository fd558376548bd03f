"""The benchmark of faults: what it counts, and that the localiser survives the faults."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sfr_loc_map.bench.fault_benchmark import fault_figures, jump_sigmas
from sfr_loc_map.cli.main import main
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState, lost_covariance
from sfr_loc_map.metrics.config import TrajectoryScoreConfig

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


@pytest.mark.slow
def test_benchmark_has_the_drive_without_and_with_each_fault(
    long_drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "faults.json"
    faults = (
        "black:camera=left,start=4",
        "blinded:share=0.3,camera=left,start=4",
        "swapped:start=4",
        "repeated:start=4",
        "dropped:start=4",
    )
    options = [option for fault in faults for option in ("--fault", fault)]
    arguments = [long_drive, *options, "--condition", "frames=3", "--spacing", 1, "--json", out]
    monkeypatch.setattr(sys, "argv", ["sfr", "bench", "faults", *map(str, arguments)])
    assert main() == 0
    entries = json.loads(out.read_text())["entries"]
    assert set(entries) == {"none", *faults}
    assert entries["none"]["lost"] == 0
    assert entries["none"]["position_m"] < 0.01
    assert entries["dropped:start=4"]["pairs"] < entries["none"]["pairs"]
    assert entries["swapped:start=4"]["lost"] > 0
    for name, entry in entries.items():
        assert entry["silent_jumps"] == 0, name
        assert entry["longest_lost"] <= 3, name
        assert abs(entry["vertical_offset_px"]) < 0.1, name
        if not name.startswith("repeated"):  # there the rover moves unseen
            assert entry["position_m"] < 0.02, name
