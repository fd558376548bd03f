"""The benchmark of faults on maps: what counts as silent, what is refused, and its command."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_scene import NAV_RIG, nav_pair, write_folder

from sfr_loc_map.bench.honesty import Honesty
from sfr_loc_map.bench.map_fault_benchmark import LIMIT_SHARE, MapFaultFigures, _of_all_pairs, map_fault_figures
from sfr_loc_map.cli.main import main
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.config import CalibrationUncertainty, MappingConfig

NONE = CalibrationUncertainty(0.0, 0.0, 0.0, 0.0, 0.0)


def test_a_wrong_map_is_silent_unless_a_warning_or_a_refusal_says_so() -> None:
    figures = MapFaultFigures(3, 0, (), 0.9, beyond_share=2 * LIMIT_SHARE)
    assert figures.honesty is Honesty.SILENT
    assert replace(figures, beyond_share=0.5 * LIMIT_SHARE).honesty is Honesty.STATED
    assert replace(figures, warnings=("poses disagree",)).honesty is Honesty.SAID
    assert replace(figures, refused=1).honesty is Honesty.SAID


def test_faults_of_images_affect_all_pairs_unless_their_text_says_otherwise() -> None:
    assert [(f.share, f.start) for f in map(_of_all_pairs, ("noisy", "torn:share=0.5", "black:start=2"))] == [
        (1.0, 0),
        (0.5, 1),
        (1.0, 2),
    ]


def test_errors_are_over_the_stated_three_sigma_and_pairs_that_are_refused_keep_the_truth_in_its_place() -> None:
    pairs = [nav_pair(index) for index in range(3)]
    right = map_fault_figures(pairs, NAV_RIG, NAV_RIG, MappingConfig())
    assert (right.pairs, right.refused) == (3, 0)
    assert right.beyond_share == 0.0
    flat = pairs[0].pair.left * 0 + 90
    broken = [replace(pairs[0], pair=StereoPair(pairs[0].pair.stamp_ns, flat, flat)), *pairs[1:]]
    figures = map_fault_figures(broken, NAV_RIG, NAV_RIG, MappingConfig())
    assert (figures.pairs, figures.refused, figures.honesty) == (2, 1, Honesty.SAID)
    assert figures.mean_error_m == pytest.approx(right.mean_error_m or 0.0, rel=0.3)
    assert figures.coverage == pytest.approx(right.coverage * 2 / 3, rel=0.1)


def test_a_pose_that_is_not_that_of_the_pair_is_beyond_its_sigma() -> None:
    item = nav_pair(0)
    moved = Transform(item.T_lm_navsb.rotation, item.T_lm_navsb.translation + np.array([1.0, 0.0, 0.0]))
    figures = map_fault_figures([replace(item, T_lm_navsb=moved)], NAV_RIG, NAV_RIG, MappingConfig(calibration=NONE))
    assert figures.mean_error_m == pytest.approx(1.0, abs=0.05)
    assert (figures.largest_ratio or 0.0) > (figures.ratio_p99 or 0.0) > (figures.median_ratio or 0.0) > 5.0
    assert figures.honesty is Honesty.SILENT


def test_the_command_writes_figures_of_each_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    source, path = write_folder(tmp_path / "source", 0, 2), tmp_path / "f.json"
    arguments = [
        "bench",
        "faults",
        "--map",
        str(source),
        "--fault",
        "identical",
        "--fault",
        "noisy",
        "--json",
        str(path),
    ]
    monkeypatch.setattr(sys, "argv", ["sfr", *arguments])
    assert main() == 0
    result = json.loads(path.read_text())
    assert result["kind"] == "map-faults"
    assert list(result["entries"]) == ["none", "identical", "noisy"]
    assert (result["entries"]["identical"]["refused"], result["entries"]["identical"]["honesty"]) == (2, "said")
    assert "beyond 5 times" in capsys.readouterr().out
    monkeypatch.setattr(sys, "argv", ["sfr", *arguments, "--random", "3"])
    assert main() == 2
