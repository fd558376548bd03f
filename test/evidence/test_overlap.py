"""Maps of two pairs that see the same wall: they agree with true poses, and a wrong pose is found."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from helpers.cli_result import Sfr
from helpers.made_scene import NAV_RIG, nav_pair
from sfr_loc_map.evidence.check_result import MAPS, Check, CheckResult, combined
from sfr_loc_map.evidence.check_tables import OVERLAP_TABLE
from sfr_loc_map.evidence.overlap import Overlap, find_overlaps, overlap_rows
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.io.source_format import SourceFormat
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.metrics.score.score import Score


@dataclass(frozen=True)
class Pairs:
    """Mapping pairs in memory."""

    kept: Sequence[PosedStereoPair]
    rig: StereoRig = NAV_RIG
    missing_ns: Sequence[int] = ()

    @property
    def stamps_ns(self) -> list[int]:
        return [item.pair.stamp_ns for item in self.kept]

    def __len__(self) -> int:
        return len(self.kept)

    def pairs(self) -> Iterator[PosedStereoPair]:
        return iter(self.kept)


def two_pairs(turn_deg: float = 0.0, forward_m: float = 0.0) -> Pairs:
    """Return two pairs; the stated pose of the second one is off by a yaw and a distance towards the wall."""
    first, other = nav_pair(0), nav_pair(1)
    error = Transform(matrix_from_rotvec([0.0, 0.0, np.radians(turn_deg)]), np.array([forward_m, 0.0, 0.0]))
    return Pairs([first, replace(other, T_lm_navsb=other.T_lm_navsb @ error)])


def test_maps_with_true_poses_agree() -> None:
    (overlap,) = find_overlaps(two_pairs(), MappingConfig())
    assert (overlap.first, overlap.other) == (0, 1)
    assert overlap.fraction > 0.5
    assert overlap.ratio < 1.8
    assert overlap.difference_m < 0.03
    assert overlap.result is CheckResult.CONSISTENT
    assert overlap.disagreement == ""


@pytest.mark.parametrize(("turn_deg", "forward_m"), [(1.0, 0.0), (0.0, 0.3)])
def test_a_wrong_pose_is_found(turn_deg: float, forward_m: float) -> None:
    (usual,) = find_overlaps(two_pairs(), MappingConfig())
    (overlap,) = find_overlaps(two_pairs(turn_deg, forward_m), MappingConfig())
    assert overlap.result is CheckResult.INCONSISTENT
    assert "pairs 0 and 1" in overlap.disagreement
    if forward_m:
        assert overlap.difference_m == pytest.approx(forward_m, abs=0.02 + usual.difference_m)


def test_pairs_that_do_not_overlap_are_not_enough_data() -> None:
    overlaps = find_overlaps(two_pairs(turn_deg=120.0), MappingConfig())
    assert combined(overlap.result for overlap in overlaps) is CheckResult.NOT_ENOUGH_DATA
    (usual,) = find_overlaps(two_pairs(), MappingConfig())
    assert usual._replace(points=999).result is CheckResult.NOT_ENOUGH_DATA
    assert usual._replace(points=1000).result is CheckResult.CONSISTENT


def test_one_comparison_with_enough_data_suffices_and_the_number_of_these_is_stated() -> None:
    consistent, few, inconsistent = CheckResult.CONSISTENT, CheckResult.NOT_ENOUGH_DATA, CheckResult.INCONSISTENT
    assert combined([few, inconsistent, consistent]) is inconsistent
    assert combined([consistent, consistent]) is consistent
    assert combined([few, few]) is combined([]) is few
    overlaps = [Overlap(0, number, 0.4, points, 0.01, 1.0, 0.2) for number, points in enumerate((10, 5000, 10), 1)]
    figures = tuple(row for overlap in overlaps for row in overlap_rows(overlap))
    check = Check(figures=figures, pairs={MAPS: 2}, pairs_of_source={MAPS: 2})
    assert (check.result, check.counts) == (consistent, {MAPS: (1, 3)})


def test_figures_and_table_have_each_overlap() -> None:
    (overlap,) = find_overlaps(two_pairs(), MappingConfig())
    figures = tuple(overlap_rows(overlap._replace(grey_ratio=float("nan"))))
    score = Score(figures=figures)
    assert score.number("overlap_difference", "value", part="pairs 0 and 1") == overlap.difference_m
    (row,) = OVERLAP_TABLE.of(figures).rows
    values = (overlap.fraction, None, overlap.difference_m, overlap.ratio, None, overlap.points)
    assert [cell.value for cell in row[1:]] == list(values)


@pytest.mark.parametrize(("forward_m", "code", "result"), [(0.0, 0, "consistent"), (0.3, 1, "inconsistent")])
def test_the_command_checks_a_source_of_maps_alone(
    sfr: Sfr, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, forward_m: float, code: int, result: str
) -> None:
    opened = Source(tmp_path, SourceFormat.FOLDER, None, two_pairs(forward_m=forward_m))
    monkeypatch.setattr("sfr_loc_map.io.registry.open_source", lambda *_: opened)
    found = sfr("check", tmp_path, "--json", tmp_path / "check.json")
    assert found.code == code
    content = json.loads((tmp_path / "check.json").read_text())
    assert content["results"] == {"maps": result}
    assert content["result"] == result
    assert content["checked"] == {"maps": "1 of 1"}
    assert content["pairs"] == content["pairs_of_source"] == {"maps": 2}
    assert f"maps: {result} (2 of 2 pairs; 1 of 1 comparisons" in found.out
