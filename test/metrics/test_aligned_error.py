"""APE and RPE: laws of the alignment, and the figures of evo on the same trajectories."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from evo_golden import ALIGNMENTS, DELTAS, STATISTICS, Figures, by_evo
from trajectory_pairs import PAIRS, TENTHS, drifted

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.metrics.aligned_error import aligned_errors, nearest_pairs, umeyama
from sfr_loc_map.metrics.config import AlignedErrorConfig
from sfr_loc_map.metrics.score import AlignedError

GOLDEN = json.loads((Path(__file__).parent / "evo_golden.json").read_text())


def by_us(estimate: Trajectory, truth: Trajectory, align: str, delta: str) -> Figures:
    found = aligned_errors(estimate, truth, AlignedErrorConfig(align=align, rpe_delta=delta))
    figures = {}
    for metric, part in (("ape", found.ape), ("rpe", found.rpe)):
        for name in ("translation", "rotation_deg"):
            values = getattr(part, name)
            figures[f"{metric}.{name}"] = {key: getattr(values, key) for key in STATISTICS} | {"count": part.count}
    return figures


def largest_difference(ours: Figures, theirs: Figures) -> float:
    assert ours.keys() == theirs.keys()
    return max(abs(ours[name][key] - theirs[name][key]) for name in ours for key in ours[name])


@pytest.mark.parametrize("name", PAIRS)
def test_figures_are_those_that_evo_gave(name: str) -> None:
    pair = PAIRS[name]()
    for delta in DELTAS:
        for align in ALIGNMENTS:
            assert largest_difference(by_us(*pair, align, delta), GOLDEN[name][delta][align]) < 1e-9


@pytest.mark.parametrize(("number", "name"), list(enumerate(PAIRS)))
def test_figures_are_those_of_evo_itself(number: int, name: str, tmp_path: Path) -> None:
    pytest.importorskip("evo", reason="evo is not installed: it is GPL, and only compared with")
    pair, delta = PAIRS[name](), DELTAS[number % 2]
    for align, figures in by_evo(pair, tmp_path, delta, [ALIGNMENTS[(number + 2) % 4]]):
        assert largest_difference(by_us(*pair, align, delta), figures) < 1e-9


def test_ten_pairs_are_compared() -> None:
    assert len(PAIRS) == 10
    assert GOLDEN.keys() == PAIRS.keys()


@pytest.mark.parametrize("with_scale", [False, True])
def test_alignment_finds_what_was_applied(with_scale: bool) -> None:
    rotation, scale = matrix_from_rotvec([0.3, -1.2, 2.0]), 1.7 if with_scale else 1.0
    targets = scale * TENTHS.positions @ rotation.T + [1.0, -20.0, 3.0]
    found = umeyama(TENTHS.positions, targets, with_scale=with_scale)
    assert found.scale == pytest.approx(scale, abs=1e-12)
    assert np.abs(found.rotation - rotation).max() < 1e-12
    moved = found.scale * TENTHS.positions @ found.rotation.T + found.translation
    assert np.abs(moved - targets).max() < 1e-12


def test_a_mirrored_path_is_aligned_by_a_rotation() -> None:
    found = umeyama(TENTHS.positions, TENTHS.positions * [1.0, 1.0, -1.0], with_scale=True)
    assert np.linalg.det(found.rotation) == pytest.approx(1.0)


def test_a_straight_path_has_no_alignment() -> None:
    line = np.outer(np.arange(5.0), [1.0, 0.0, 0.0])
    with pytest.raises(MetricsError, match="on a line"):
        umeyama(line, line, with_scale=False)


def test_the_nearest_stamp_counts_and_the_earlier_of_two() -> None:
    stamps, others = np.array([0, 10, 20, 35, 90]), np.array([5, 19, 30, 40, 91, 92])
    chosen, nearest = nearest_pairs(stamps, others, 5)
    assert chosen.tolist() == [0, 1, 2, 3, 4]
    assert nearest.tolist() == [0, 0, 1, 2, 4]
    assert nearest_pairs(stamps, others, 4)[0].tolist() == [2, 4]


def test_the_description_names_metric_alignment_and_association() -> None:
    found = aligned_errors(drifted(TENTHS, 0.1), TENTHS, AlignedErrorConfig(align="sim3", rpe_delta="distance=2"))
    for part, word in ((found.ape, "APE (ATE)"), (found.rpe, "RPE over 2 m")):
        assert isinstance(part, AlignedError)
        assert part.description.startswith(word)
        assert "sim3 aligned" in part.description
        assert part.description.endswith("120 poses paired by the nearest stamp within 0.01 s")
        assert "\n" not in part.description
    assert found.ape.transform is not None
    assert found.ape.transform.scale == pytest.approx(1.0, abs=0.05)


def test_nothing_in_common_and_wrong_lengths() -> None:
    late = Trajectory(TENTHS.stamps_ns + 10**12, TENTHS.positions, TENTHS.quats_xyzw)
    with pytest.raises(MetricsError, match="give another --max-difference"):
        aligned_errors(late, TENTHS, AlignedErrorConfig())
    with pytest.raises(MetricsError, match="over 3 s is not defined"):
        aligned_errors(TENTHS, TENTHS, AlignedErrorConfig(rpe_delta="time=3"))
    far = aligned_errors(TENTHS, TENTHS, AlignedErrorConfig(rpe_delta="distance=1000"))
    assert far.rpe.count == 0
    assert far.rpe.translation.rmse is None
