"""APE and RPE: laws of the alignment, and the figures of evo on the same trajectories."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from helpers.trajectory_pairs import PAIRS, TENTHS
from sfr_loc_map.errors import ConfigError, MetricsError
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.metrics.config import AlignedErrorConfig
from sfr_loc_map.metrics.frames.umeyama import umeyama
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.trajectory.aligned_error import aligned_errors

ALIGNMENTS = ("none", "origin", "se3", "sim3")
STATISTICS = {"rmse": "rmse", "mean": "mean", "median": "p50", "max": "max"}
DELTAS = ("frames=1", "distance=0.7")
GOLDEN = json.loads((Path(__file__).parent / "evo_golden.json").read_text())
"""By `evo.main_ape.ape` and `evo.main_rpe.rpe` on the same poses as TUM files; evo is GPL and never needed to run."""


@pytest.mark.parametrize("name", PAIRS)
def test_figures_are_those_that_evo_gave(name: str) -> None:
    pair = PAIRS[name]()
    assert GOLDEN.keys() == PAIRS.keys()
    for delta in DELTAS:
        for align in ALIGNMENTS:
            found = Score(figures=aligned_errors(*pair, AlignedErrorConfig(align=align, rpe_delta=delta)).figures)
            for key, theirs in GOLDEN[name][delta][align].items():
                metric, _, part = key.partition(".")
                row = found.figure(metric, part=part.removesuffix("_deg"))
                ours = {name: row.statistic(column) for name, column in STATISTICS.items()} | {"count": row.n}
                if row.n > 1:  # theirs is over n
                    ours["std"] = row.sigma * math.sqrt((row.n - 1) / row.n)
                assert ours == pytest.approx({name: theirs[name] for name in ours}, rel=0, abs=1e-9), (delta, align)


@pytest.mark.parametrize("with_scale", [False, True])
def test_alignment_finds_what_was_applied(with_scale: bool) -> None:
    rotation, scale = matrix_from_rotvec([0.3, -1.2, 2.0]), 1.7 if with_scale else 1.0
    targets = scale * TENTHS.positions @ rotation.T + [1.0, -20.0, 3.0]
    found = umeyama(TENTHS.positions, targets, with_scale=with_scale)
    assert found.scale == pytest.approx(scale, abs=1e-12)
    assert np.abs(found.rotation - rotation).max() < 1e-12
    assert np.abs(found.translation - [1.0, -20.0, 3.0]).max() < 1e-12


def test_a_mirrored_path_is_aligned_by_a_rotation_and_a_straight_one_not_at_all() -> None:
    found = umeyama(TENTHS.positions, TENTHS.positions * [1.0, 1.0, -1.0], with_scale=True)
    assert np.linalg.det(found.rotation) == pytest.approx(1.0)
    line = np.outer(np.arange(5.0), [1.0, 0.0, 0.0])
    with pytest.raises(MetricsError, match="on a line"):
        umeyama(line, line, with_scale=False)


def test_a_straight_path_in_any_direction_has_no_alignment_whatever_its_length_and_place() -> None:
    """Rounding makes the covariance of an oblique line a matrix of full rank."""
    rng = np.random.default_rng(2)
    for length_m in (1.0, 100.0, 1e4):
        direction = rng.normal(size=3)
        line = np.outer(np.linspace(0.0, length_m, 500), direction / np.linalg.norm(direction))
        for path in (line, line + rng.normal(0.0, 100.0, 3), np.round(line, 8)):
            with pytest.raises(MetricsError, match="on a line"):
                umeyama(path, path, with_scale=False)
        across = np.cross(direction, [1.0, 0.0, 0.0])
        curved = line + np.outer(1e-4 * length_m * np.sin(np.arange(500.0)), across / np.linalg.norm(across))
        assert np.abs(umeyama(curved, curved, with_scale=False).rotation - np.eye(3)).max() < 1e-6


def test_nothing_in_common_and_wrong_lengths() -> None:
    late = Trajectory(TENTHS.stamps_ns + 10**12, TENTHS.positions, TENTHS.quats_xyzw)
    with pytest.raises(MetricsError, match="increase the option max_difference"):
        aligned_errors(late, TENTHS, AlignedErrorConfig())
    for delta in ("time=3", "turn=5", "displacement=1", "frames=1,distance=1"):
        with pytest.raises(ConfigError, match="frames=NUMBER or distance=METRES is required"):
            AlignedErrorConfig(rpe_delta=delta)
    far = aligned_errors(TENTHS, TENTHS, AlignedErrorConfig(rpe_delta="distance=1000"))
    row = Score(figures=far.figures).figure("rpe", part="translation")
    assert (row.n, row.rmse) == (0, None)


@pytest.mark.parametrize("align", ALIGNMENTS)
@pytest.mark.parametrize("has_true_attitude", [True, False])
def test_an_estimate_without_attitudes_has_no_pose_errors(align: str, has_true_attitude: bool) -> None:
    positions = replace(TENTHS, quats_xyzw=np.zeros_like(TENTHS.quats_xyzw))
    truth = TENTHS if has_true_attitude else positions
    with pytest.raises(MetricsError, match="only positions"):
        aligned_errors(positions, truth, AlignedErrorConfig(align=align))
