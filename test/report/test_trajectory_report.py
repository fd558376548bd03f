"""`sfr report` of trajectories, and the exchange of trajectories with other tools."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from helpers import ROOT
from helpers.cli_result import Sfr
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory
from sfr_loc_map.metrics.config import AlignedErrorConfig
from sfr_loc_map.report.path_plot import curves_of, path_plot


def straight(count: int = 20) -> Trajectory:
    positions = np.column_stack((np.arange(count) * 0.5, np.zeros(count), np.sin(np.arange(count))))
    return Trajectory(10**18 + np.arange(count) * 10**8, positions, np.tile([0.0, 0, 0, 1], (count, 1)))


def aside() -> Trajectory:
    """Return the same path 0.25 m to the left."""
    return replace(straight(), positions=straight().positions + np.array([0.0, 0.25, 0.0]))


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    """Return an estimate that is 0.25 m aside, as KITTI poses without stamps, and its truth."""
    save_trajectory(tmp_path / "e.kitti", aside())
    (tmp_path / "e.times.txt").unlink()
    save_trajectory(tmp_path / "truth.tum", straight())
    return tmp_path / "e.kitti", tmp_path / "truth.tum"


SAMPLE = ROOT / "sample" / "sample.mcap"


def test_a_page_shows_paths_and_errors(files: tuple[Path, Path], tmp_path: Path, sfr: Sfr) -> None:
    done = sfr("report", files[0], "--truth", files[1], "-o", tmp_path / "p.html")
    assert done.code == 0, done.err
    text = (tmp_path / "p.html").read_text()
    assert "position error, mm" in text
    assert "<title>Trajectories</title>" in text
    assert "Plotly" in text
    assert sfr("report", files[0], "-o", tmp_path / "p.html").code == 2, "is there already"
    source = sfr("report", SAMPLE, "-o", tmp_path / "sample.html")  # of a source the truth is drawn
    assert source.code == 0, source.err


def test_the_figure_holds_the_distance_to_the_truth() -> None:
    estimate = aside()
    curves = curves_of({"<b>mine</b>": estimate}, straight(), AlignedErrorConfig(align="none"))
    plot = path_plot(curves)
    error = plot.data[-1]
    assert error["y"] == [250.0] * 20
    assert error["x"][:2] == [0.0, 0.1]
    assert error["name"] == "&lt;b&gt;mine&lt;/b&gt;"
    aligned = curves_of({"mine": estimate}, straight(), AlignedErrorConfig(align="origin"))
    assert aligned[1].error_m is not None
    assert aligned[1].error_m.max() < 1e-12
