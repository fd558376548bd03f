"""All commands accept the configuration that the doctor accepts; without it there is no verdict."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import NamedTuple

import pytest
import yaml

from campaigns.recordings.drive import Drive, load_drive
from campaigns.recordings.rows import ROWS
from helpers.cli_result import Sfr, run_sfr
from helpers.score_rows import number
from sfr_loc_map.io.source_config import NAME
from sfr_loc_map.metrics.judging.limits_file import load_limits

EXTRINSICS = {"translation_m": [0.3, 0.0, 0.6], "quat_xyzw": [0.0, 0.3826834323650898, 0.0, 0.9238795325112867]}


@pytest.fixture(scope="module")
def drive() -> Drive:
    return load_drive(12)


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory, drive: Drive) -> Path:
    """A complete recording, which its tests only read."""
    return ROWS["plain"].make(tmp_path_factory.mktemp("plain"), drive).source


def commands(source: Path, out: Path) -> list[tuple[object, ...]]:
    """Return the commands that read the pairs of a source."""
    out.mkdir(exist_ok=True)
    return [
        ("localise", source, "-o", out / "e.csv", "--overwrite"),
        ("convert", source, out / "data", "--overwrite"),
        ("convert", source, out / "pairs.sfrp", "--overwrite"),
        ("simulate", out / "faulty", "--from", source, "--fault", "black:share=0.1", "--overwrite"),
        ("bench", "localise", source, "--repeat", 1, "--condition", "frames=5", "--lenient"),
    ]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["realsense_without_p3", "side_by_side", "constant_offset"])
def test_what_the_doctor_fixes_every_command_accepts(sfr: Sfr, tmp_path: Path, drive: Drive, name: str) -> None:
    """All commands read one recording; the commands that read all pairs in order read the others, too."""
    made = ROWS[name].make(tmp_path, drive)
    count = 5 if name == "realsense_without_p3" else 2
    given = ("--calibration", made.calibration) if made.calibration is not None else ()
    for words in commands(made.source, tmp_path / "without"):
        result = sfr(*words)
        assert result.code == 2, words
        assert "sfr info" in result.err
    first = sfr("info", made.source, *given, "--json", "-")
    assert first.code == 1
    assert any("--write" in issue["fix"] for issue in json.loads(first.out)["issues"] if issue["is_blocking"])
    fixed = sfr("info", made.source, "--write", *given)
    assert fixed.code == 0, fixed.err
    assert sfr("info", made.source).code == 0
    assert json.loads(sfr("info", made.source, "--json", "-").out)["rate_hz"] == pytest.approx(10.0)
    for words in commands(made.source, tmp_path / "with")[:count]:
        result = sfr(*words)
        assert result.code == 0, (words, result.err)
    score = ("score", tmp_path / "with" / "e.csv", made.source, "--condition", "frames=5", "--json", "-")
    assert number(json.loads(sfr(*score).out), "position", "mean") < 0.01


FORMS = {
    "section": {"extrinsics": EXTRINSICS},
    "name of the parameter": {"T_rb_locsb": EXTRINSICS},
    "for all nodes": {"/**": {"ros__parameters": {"T_rb_locsb": EXTRINSICS}}},
    "for a node": {"/rover1/localisation_node": {"ros__parameters": {"T_rb_locsb": EXTRINSICS}}},
    "dotted": {"localisation_node": {"ros__parameters": {f"T_rb_locsb.{n}": v for n, v in EXTRINSICS.items()}}},
}


class WithoutExtrinsics(NamedTuple):
    """A data set whose rig lacks the extrinsics, and the estimate with the extrinsics in a file after `--config`."""

    folder: Path
    estimate: bytes


@pytest.fixture(scope="module")
def without_extrinsics(tmp_path_factory: pytest.TempPathFactory, plain: Path) -> WithoutExtrinsics:
    place = tmp_path_factory.mktemp("without_extrinsics")
    folder, file, estimate = place / "data", place / "mine.yaml", place / "e.csv"
    assert run_sfr("convert", plain, folder).code == 0
    rig_file = folder / "loc" / "rig.json"
    rig = json.loads(rig_file.read_text())
    del rig["T_rb_locsb"]
    rig_file.write_text(json.dumps(rig))
    assert run_sfr("info", folder).code == 1
    assert run_sfr("localise", folder, "-o", estimate).code == 2
    file.write_text(yaml.safe_dump(FORMS["section"]))
    assert run_sfr("info", folder, "--config", file).code == 0
    assert run_sfr("localise", folder, "-o", estimate, "--config", file).code == 0
    return WithoutExtrinsics(folder, estimate.read_bytes())


@pytest.mark.parametrize("form", FORMS)
def test_extrinsics_in_each_form_are_taken_by_doctor_and_commands(
    sfr: Sfr, tmp_path: Path, without_extrinsics: WithoutExtrinsics, form: str
) -> None:
    folder = shutil.copytree(without_extrinsics.folder, tmp_path / "data")
    (folder / NAME).write_text(yaml.safe_dump(FORMS[form]))
    assert sfr("info", folder).code == 0
    assert sfr("localise", folder, "-o", tmp_path / "e.csv").code == 0
    assert (tmp_path / "e.csv").read_bytes() == without_extrinsics.estimate


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "extrinsic: {translation_m: [0, 0, 0]}\ntopics: {a: /b}",
            "unknown section 'extrinsic' \\(did you mean 'extrinsics'",
        ),
        ("sync: {stamp_tolerance: 0.1}", "sync: unknown key 'stamp_tolerance'.*stamp_tolerance_s"),
        ("topics: {loc/left/image_rect: 3}", "the name of a topic"),
        ("calibration: {file: gone.yaml}", "gone.yaml"),
        ("truth: {source: gone.csv}", "neither a file nor a topic"),
        ("sync: [1]", "sync"),
        ("conditions: 5\n", "conditions"),
    ],
)
def test_a_wrong_configuration_is_one_line(sfr: Sfr, tmp_path: Path, plain: Path, text: str, words: str) -> None:
    file = tmp_path / "sfr.yaml"
    file.write_text(text)
    command = ("replay", plain) if "conditions" in text else ("localise", plain, "-o", tmp_path / "e.csv")
    result = sfr(*command, "--config", file)
    assert result.code == 2
    assert len(result.err.strip().splitlines()) == 1
    assert re.search(words, result.err), result.err


def test_a_fix_is_written_where_the_configuration_was_read(sfr: Sfr, tmp_path: Path, drive: Drive) -> None:
    made = ROWS["realsense_without_p3"].make(tmp_path, drive)
    beside = tmp_path / NAME
    beside.write_text("truth: {sigma_m: 0.02}\nlimits: limits.yaml\n")
    (tmp_path / "limits.yaml").write_text("trajectory: [{condition: frames=1, position_mean_m: 1.0}]\n")
    result = sfr("info", made.source, "--write", "--set", "truth.sigma_deg=0.5")
    assert result.code == 0, result.err
    assert f"{beside}, updated" in result.err
    assert not (made.source / NAME).exists()
    lines = beside.read_text().splitlines()
    for line in ("  sigma_m: 0.02  # as before", "  sigma_deg: 0.5  # given", "limits: limits.yaml  # as before"):
        assert line in lines
    written = yaml.safe_load(beside.read_text())
    assert written["extrinsics"]["translation_m"] == pytest.approx(drive.rig.T_rb_sb.translation.tolist())  # type: ignore[union-attr]


def test_limits_that_were_edited_are_kept(sfr: Sfr, tmp_path: Path, drive: Drive) -> None:
    made = ROWS["zed"].make(tmp_path, drive)
    limits, init = tmp_path / "mine" / "limits.yaml", ("init", tmp_path / "mine", "--from", made.source)
    assert sfr(*init).code == 0
    assert load_limits(limits).conditions == ["frames=1"]  # of 12 pairs; starts are 10 apart
    assert sfr(*init, "--overwrite", "--set", "conditions=[time=1]").code == 0
    assert load_limits(limits).conditions == ["time=1"]  # the file was not edited
    edited = limits.read_text().replace(": 0.1", ": 0.2")
    limits.write_text(edited)
    result = sfr(*init, "--overwrite")
    assert limits.read_text() == edited
    assert "kept" in result.out
    assert "placeholders" not in (tmp_path / "mine" / NAME).read_text()


@pytest.mark.parametrize("name", ["truth_pose", "truth_nav_sat_fix"])
def test_a_tracked_body_is_named_and_its_verdict_can_be_judged(sfr: Sfr, tmp_path: Path, name: str) -> None:
    drive = load_drive(70)  # five independent sub-trajectories of 1 m
    made = ROWS[name].make(tmp_path, drive)
    result = sfr("init", tmp_path, "--from", made.source)
    assert result.code == 0, result.err
    for text in (result.err, (tmp_path / NAME).read_text()):
        assert "is assumed to track RB (lever arm 0): give --set 'truth.lever_arm_m=" in text
    keys = {limit.name for limit in load_limits(tmp_path / "limits.yaml").limits}
    assert ("chord_mean_plus_3sigma_m" in keys) == ("attitude_mean_plus_3sigma_deg" not in keys) == ("fix" in name)
    assert sfr("localise", made.source, "-o", tmp_path / "e.csv").code == 0
    scored = sfr("score", tmp_path / "e.csv", made.source, "--json", "-")
    assert json.loads(scored.out)["verdicts"]
    assert scored.code in (0, 1), scored.err  # 3 if a limit could not be judged
    again = sfr("init", tmp_path, "--from", made.source, "--overwrite", "--set", "truth.lever_arm_m=[0, 0, 1]")
    assert "lever arm 0" not in again.err


def test_init_writes_nothing_of_what_is_no_source(sfr: Sfr, tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    for source in ("photos", "gone"):
        result = sfr("init", tmp_path / "new", "--from", tmp_path / source)
        assert result.code == 2
        assert re.search(r"has no supported format|cannot read", result.err)
    assert [item.name for item in tmp_path.iterdir()] == ["photos"]


def test_a_calibration_beside_is_named_by_where_it_lies(sfr: Sfr, tmp_path: Path, drive: Drive) -> None:
    made = ROWS["rig_json"].make(tmp_path, drive)
    assert sfr("info", made.source).code == 1  # reports the missing calibration
    unfixed = sfr("info", made.source, "--calibration", made.calibration)
    assert f"--write --calibration {made.calibration}" in unfixed.out
    assert sfr("init", tmp_path, "--from", made.source, "--calibration", made.calibration).code == 0
    assert yaml.safe_load((tmp_path / NAME).read_text())["calibration"]["file"] == made.calibration.name  # type: ignore[union-attr]
    assert sfr("info", made.source).code == 0


def test_two_frames_that_could_be_the_rovers_are_named(sfr: Sfr, tmp_path: Path, drive: Drive) -> None:
    made = ROWS["two_base_frames"].make(tmp_path, drive)
    result = sfr("init", tmp_path / "mine", "--from", made.source)
    assert re.search("could also be base_footprint: .*--set frames.base=NAME", result.err)
    assert (
        "could also be"
        not in sfr("init", tmp_path / "m", "--from", made.source, "--set", "frames.base=base_footprint").err
    )
