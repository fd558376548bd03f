"""One configuration for every command: what the doctor accepts, all accept; without it none gives a verdict."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
import yaml
from cli_result import Sfr
from drive import Drive, load_drive
from rows import ROWS, write_rig

from sfr_loc_map.io.source_config import NAME

EXTRINSICS = {"translation_m": [0.3, 0.0, 0.6], "quat_xyzw": [0.0, 0.3826834323650898, 0.0, 0.9238795325112867]}


@pytest.fixture(scope="module")
def drive() -> Drive:
    whole = load_drive(12)
    return Drive(whole.rig, whole.images, whole.positions, whole.quats_xyzw, whole.nav_rig, whole.nav)


def commands(source: Path, out: Path) -> list[tuple[object, ...]]:
    """Return the commands that read the pairs of a source."""
    out.mkdir(exist_ok=True)
    return [
        ("localise", source, "-o", out / "e.csv", "--overwrite"),
        ("convert", source, out / "data", "--overwrite"),
        ("convert", source, out / "pairs.sfrp", "--overwrite"),
        ("perturb", source, out / "faulty", "--fault", "black:share=0.1", "--overwrite"),
        ("bench", "localise", source, "--repeat", 1, "--condition", "frames=5", "--lenient"),
    ]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["realsense_without_p3", "side_by_side", "constant_offset"])
def test_what_the_doctor_fixes_every_command_accepts(sfr: Sfr, tmp_path: Path, drive: Drive, name: str) -> None:
    made = ROWS[name].make(tmp_path, drive)
    given = ("--calibration", made.calibration) if made.calibration is not None else ()
    for words in commands(made.source, tmp_path / "without"):
        result = sfr(*words)
        assert result.code == 2, words
        assert "sfr doctor" in result.err
    first = sfr("doctor", made.source, *given, "--json", "-")
    assert first.code == 1
    assert any("--fix" in finding["cure"] for finding in json.loads(first.out)["findings"] if finding["stops"])
    fixed = sfr("doctor", made.source, "--fix", *given)
    assert fixed.code == 0, fixed.err
    assert sfr("doctor", made.source).code == 0
    assert json.loads(sfr("info", made.source, "--json", "-").out)["rate_hz"] == pytest.approx(10.0)
    for words in commands(made.source, tmp_path / "with"):
        result = sfr(*words)
        assert result.code == 0, (words, result.err)
    score = ("score", tmp_path / "with" / "e.csv", made.source, "--condition", "frames=5", "--json", "-")
    assert json.loads(sfr(*score).out)["trajectory"]["position_m"]["mean"] < 0.01


FORMS = {
    "section": {"extrinsics": EXTRINSICS},
    "name of the parameter": {"T_rb_locsb": EXTRINSICS},
    "for all nodes": {"/**": {"ros__parameters": {"T_rb_locsb": EXTRINSICS}}},
    "for a node": {"/rover1/localisation_node": {"ros__parameters": {"T_rb_locsb": EXTRINSICS}}},
    "dotted": {"localisation_node": {"ros__parameters": {f"T_rb_locsb.{n}": v for n, v in EXTRINSICS.items()}}},
}


@pytest.mark.parametrize("form", FORMS)
def test_extrinsics_in_each_form_are_taken_by_doctor_and_commands(
    sfr: Sfr, tmp_path: Path, drive: Drive, form: str
) -> None:
    rig = json.loads(write_rig(tmp_path, drive).read_text())
    assert "T_rb_locsb" in rig
    made = ROWS["plain"].make(tmp_path, drive)
    folder = tmp_path / "data"
    assert sfr("convert", made.source, folder).code == 0
    place = folder / "loc" / "rig.json"
    place.write_text(
        json.dumps({name: value for name, value in json.loads(place.read_text()).items() if name != "T_rb_locsb"})
    )
    assert sfr("doctor", folder).code == 1
    assert sfr("localise", folder, "-o", tmp_path / "a.csv").code == 2
    file = tmp_path / "mine.yaml"
    file.write_text(yaml.safe_dump(FORMS[form]))
    assert sfr("doctor", folder, "--config", file).code == 0
    assert sfr("localise", folder, "-o", tmp_path / "b.csv", "--config", file).code == 0
    (folder / NAME).write_text(file.read_text())
    assert sfr("localise", folder, "-o", tmp_path / "c.csv").code == 0
    assert (tmp_path / "b.csv").read_bytes() == (tmp_path / "c.csv").read_bytes()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "extrinsic: {translation_m: [0, 0, 0]}\ntopics: {a: /b}",
            "unknown section 'extrinsic' \\(did you mean 'extrinsics'",
        ),
        ("sync: {stamp_tolerance: 0.1}", "sync: unknown key 'stamp_tolerance'.*stamp_tolerance_s"),
        ("topics: {loc/left/image_rect: 3}", "must be the name of a topic"),
        ("calibration: {file: gone.yaml}", "gone.yaml"),
        ("truth: {source: gone.csv}", "neither a file nor a topic"),
        ("sync: [1]", "sync"),
        ("conditions: 5\n", "conditions"),
    ],
)
def test_a_wrong_configuration_is_one_line(sfr: Sfr, tmp_path: Path, drive: Drive, text: str, words: str) -> None:
    made = ROWS["plain"].make(tmp_path, drive)
    file = tmp_path / "sfr.yaml"
    file.write_text(text)
    command = ("replay", made.source) if "conditions" in text else ("localise", made.source, "-o", tmp_path / "e.csv")
    result = sfr(*command, "--config", file)
    assert result.code == 2
    assert len(result.err.strip().splitlines()) == 1
    assert re.search(words, result.err), result.err
