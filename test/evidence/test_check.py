"""`sfr check` over a small drive: the five runs, what they compare, and that a broken one is found."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from helpers.cli_result import Sfr
from helpers.loc_drive import drive, run
from helpers.made_scene import LOC_RIG
from sfr_loc_map.errors import ConfigError, InputError
from sfr_loc_map.evidence.calibration import Advice, CameraOffset, corrected_drive
from sfr_loc_map.evidence.check import check_drive
from sfr_loc_map.evidence.check_tables import AGREEMENT_TABLE, calibration_table, items_with
from sfr_loc_map.evidence.localiser_runs import ComparedRun, PairsInMemory
from sfr_loc_map.evidence.recording import names_of_estimates
from sfr_loc_map.evidence.report_evidence import read_evidence
from sfr_loc_map.faults.injector import FaultInjector
from sfr_loc_map.faults.kinds import parse_fault
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.hashes import hash_path
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.io.source_format import SourceFormat
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.metrics.conditions import Condition
from sfr_loc_map.metrics.figures.rows import figure_row
from sfr_loc_map.metrics.frames.association import Estimates
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.runs.localiser_run import trajectory_of


def test_a_drive_agrees_with_itself_and_every_comparison_is_a_row() -> None:
    sequence = PairsInMemory(LOC_RIG, drive(40))
    condition = Condition.parse("frames=5")
    found = check_drive(sequence, LocalisationConfig(), [condition], 40)
    assert found.results == {"drive": "consistent"}
    names = ["forward - backward", "forward - every second pair", "left half - right half"]
    score = Score(figures=found.figures)
    for name in names:
        assert score.figure("agreement", part=name).n >= 3
        row = score.figure("error_at_least", part=name)
        assert row.value == pytest.approx(0.5 * score.figure("difference", part=name).rmse)
        assert row.value < 0.05
    assert [row[0].text for row in AGREEMENT_TABLE.of(found.figures).rows] == names


def faulty(*faults: str) -> PairsInMemory:
    """Return the drive with faults of the calibration."""
    injector = FaultInjector([parse_fault(fault) for fault in faults], 1, 40, LOC_RIG)
    return PairsInMemory(LOC_RIG, [pair for _, pair in injector.pairs(drive(40))])


def test_a_wrong_calibration_is_to_be_redone_and_its_cost_is_measured() -> None:
    """The drive with the offsets taken back has no such offset, and its positions differ by the stated cost."""
    amounts = {"pitch": 0.3, "roll": 0.4}
    sequence = faulty(*(f"{angle}:amount={amount}" for angle, amount in amounts.items()))
    found = check_drive(sequence, LocalisationConfig(), [Condition.parse("frames=5")], 40)
    assert sorted(name for name, word in found.advice.items() if word is Advice.REDO) == sorted(amounts)
    score = Score(figures=found.figures)
    table = calibration_table(found.figures, found.advice)
    advice = {row[0].text: row[-1].text for row in table.rows}
    offsets = []
    for angle, amount in amounts.items():
        degrees = float(np.degrees(score.number("right_camera", "value", part=angle) / LOC_RIG.fx))
        offsets.append(CameraOffset(angle, 4, 0.0, 0.0, 0.0, degrees))
        assert abs(degrees) == pytest.approx(amount, abs=0.03)
        assert advice[f"right camera, {angle}"] == "redo"
    both = "pitch and roll"
    assert 0.0 < score.number("calibration_cost", "value", part=both) < 0.05
    assert advice[f"shift of positions by correction of {both} over 5 frames"] == "-"
    corrected = corrected_drive(sequence, offsets)
    again = check_drive(corrected, LocalisationConfig(), [Condition.parse("frames=5")], 40)
    assert again.calibration == ()
    assert not [row for row in again.figures if row.figure == "calibration_cost"]
    advice = {row[0].text: row[-1].text for row in calibration_table(again.figures, again.advice).rows}
    assert advice["right camera, pitch"] == advice["right camera, roll"] == "keep"
    assert advice["right camera, yaw"] == "unclear", "a drive in front of a wall shows no yaw"


def test_a_yaw_is_taken_back_in_the_images() -> None:
    """The localiser reports a negative yaw of a camera that looks to the left (docs/measurements.md)."""
    clean, sequence = drive(1)[0].right, faulty("yaw:amount=0.3")
    (corrected,) = corrected_drive(
        replace(sequence, kept=sequence.kept[:1]), [CameraOffset("yaw", 4, 0.0, 0.0, 0.0, -0.3)]
    ).kept
    inner = (slice(5, -5), slice(5, -5))
    before, after = (
        np.abs(image[inner].astype(float) - clean[inner]).mean() for image in (sequence.kept[0].right, corrected.right)
    )
    assert after < 0.2 * before


def test_an_estimate_of_another_clock_is_refused_after_the_first_run() -> None:
    sequence, calls = PairsInMemory(LOC_RIG, drive(20)), []
    poses = Trajectory(np.array([1, 2]), np.zeros((2, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (2, 1)))
    other = ComparedRun("wheels.csv", Estimates.of(poses))
    with pytest.raises(InputError, match="same clock"):
        check_drive(
            sequence, LocalisationConfig(), [Condition.parse("frames=5")], 40, [other], lambda: calls.append(None)
        )
    assert len(calls) == 20


def test_the_command_writes_rows_and_takes_two_other_estimates(
    sfr: Sfr, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The drive of the suite's own tests with two noisy estimates: three sigmas, or null for each.

    The estimate of the forward run itself is refused.
    """
    pairs = drive(40)
    truth = trajectory_of(run(pairs))
    rng = np.random.default_rng(2)
    noisy = replace(truth, positions=truth.positions + rng.normal(0, 0.01, truth.positions.shape))
    less_noisy = replace(truth, positions=truth.positions + rng.normal(0, 1e-4, truth.positions.shape))
    for name, poses in (("own.csv", truth), ("a.csv", less_noisy), ("b.csv", noisy)):
        save_trajectory(tmp_path / name, poses)
    (tmp_path / "drive").mkdir()
    (tmp_path / "drive" / "calibration.yaml").write_text("")
    opened = Source(tmp_path / "drive", SourceFormat.FOLDER, PairsInMemory(LOC_RIG, pairs), None)
    monkeypatch.setattr("sfr_loc_map.io.registry.open_source", lambda *_: opened)
    options = ("--condition", "frames=5", "--json", tmp_path / "check.json")
    found = sfr("check", tmp_path, *options, "--estimate", tmp_path / "a.csv", "--estimate", tmp_path / "b.csv")
    assert found.code in (0, 1)
    content = json.loads((tmp_path / "check.json").read_text())
    assert content["results"]["drive"] == "consistent"
    assert content["result"] == ("inconsistent" if found.code else "consistent")
    assert content["pairs"] == content["pairs_of_source"] == {"drive": len(pairs)}
    rows = {(row["figure"], row.get("part")): row for row in content["figures"]}
    assert {("hat_sigma", name) for name in ("forward", "a.csv", "b.csv")} <= set(rows)
    assert 0.0 < rows["difference", "forward - a.csv"]["rmse"] < 1e-3
    assert rows["difference", "forward - b.csv"]["rmse"] > 1e-3
    assert content["advice"]["yaw"] == "unclear"
    assert "does not prove accuracy" in found.out
    assert "Other estimates" in found.out
    made = content["provenance"]
    assert made["configuration"]["check.conditions"] == ["frames=5"]
    assert made["inputs"]["source"]["sha256"] == hash_path(tmp_path / "drive")
    assert made["inputs"]["estimate a.csv"]["sha256"] == hash_path(tmp_path / "a.csv")
    assert made["version"]
    assert made["time"]
    (evidence,) = read_evidence([tmp_path / "check.json"])
    assert evidence.provenance is not None
    assert evidence.facts["Command"] == made["command"]
    assert rows["depth_error", "at 4 m"].get("value") is None, "the yaw is unclear"
    own = sfr("check", tmp_path, *options, "--overwrite", "--estimate", tmp_path / "own.csv")
    assert own.code == 2
    assert "has the same poses" in own.err
    assert sfr("check", tmp_path, *["--estimate", tmp_path / "a.csv"] * 3).code == 2
    assert sfr("check", tmp_path, *["--estimate", tmp_path / "a.csv"] * 2).code == 2, "one estimate is given twice"


def test_a_short_drive_has_not_enough_data(sfr: Sfr, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = Source(tmp_path, SourceFormat.FOLDER, PairsInMemory(LOC_RIG, drive(10)), None)
    monkeypatch.setattr("sfr_loc_map.io.registry.open_source", lambda *_: opened)
    found = sfr("check", tmp_path, "--json", tmp_path / "check.json")
    assert found.code == 3
    assert "10 pairs" in found.err
    (evidence,) = read_evidence([tmp_path / "check.json"])
    assert "not enough data" in evidence.results[0]


def test_estimates_with_the_same_file_name_are_named_by_their_paths() -> None:
    left, right = Path("a/wheels.csv"), Path("b/wheels.csv")
    assert names_of_estimates([left, Path("c.csv")]) == {left: "wheels.csv", Path("c.csv"): "c.csv"}
    with pytest.raises(ConfigError, match="rename the file"):
        names_of_estimates([left, Path("b/backward")])
    with pytest.raises(ConfigError, match=r"b/wheels\.csv"):
        names_of_estimates([left, right, right])
    assert names_of_estimates([left, right]) == {left: "a/wheels.csv", right: "b/wheels.csv"}
    rows = [figure_row("difference", "distance=1", f"forward - {name}", n=2, rmse=0.1) for name in "ab"]
    assert len(items_with("difference", rows)) == 2
    with pytest.raises(InputError, match="forward - a"):
        items_with("difference", [*rows, rows[0]])
