"""Reports of several scores and of scores without limits, by `sfr report`: which have a verdict in common."""

from __future__ import annotations

import csv
import json
import subprocess
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
import yaml

from helpers.cli_result import Sfr
from helpers.judge import OVER_5_M, POSES, Judge
from helpers.made_scene import write_folder
from helpers.made_scores import of_map, whole_score
from helpers.made_suites import SFR
from helpers.scored_drives import LOOSE, POSITION, limits, wandering
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory
from sfr_loc_map.metrics.figures.records import InputFile, Provenance
from sfr_loc_map.metrics.judging.judge import judged_by
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.metrics.judging.several_scores import difference_of
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.stored.score_json import from_json, from_plain, to_json
from sfr_loc_map.report.deviations import deviations_of


def test_scores_of_several_runs_have_no_pass_in_common(tmp_path: Path, sfr: Sfr) -> None:
    """Other items, versions, configurations and sources: each score passes, and the test report has no verdict."""
    paths = tmp_path / "e.csv", tmp_path / "t.csv"
    save_trajectory(paths[1], wandering(0.0))
    save_trajectory(paths[0], wandering(1e-4))
    header = "stamp_ns,processing_time_s,state,method,method_version,method_kind"
    stamps = wandering(0.0).stamps_ns

    def scored(name: str, *options: str, version: str = "1", truth: Path = paths[1]) -> Path:
        rows = [f"{stamp},0.1,tracking,mine,{version},python" for stamp in stamps]
        calls, found = tmp_path / f"{name}.stats.csv", tmp_path / f"{name}.json"
        calls.write_text("\n".join([header, *rows]) + "\n")
        given = ("--stats", calls, "--limits", rules, *options)
        assert sfr("score", paths[0], truth, *given, "--json", found).code == 0
        return found

    rules, moved = limits(tmp_path, LOOSE), tmp_path / "moved.csv"
    other = wandering(0.0)
    save_trajectory(moved, Trajectory(stamps, other.positions + 1.0, other.quats_xyzw))
    first, same = scored("first"), scored("same")
    changed = json.loads(first.read_text())
    changed["provenance"]["version"] = "0.0.1"
    (tmp_path / "version.json").write_text(to_json(from_plain(Score, changed)))
    (tmp_path / "unknown.json").write_text(to_json(from_plain(Score, {**changed, "provenance": None})))
    save_trajectory(tmp_path / "e2.csv", wandering(2e-4))
    (tmp_path / "e2.stats.csv").write_text((tmp_path / "first.stats.csv").read_text())
    second = tmp_path / "second.json"
    assert sfr("score", tmp_path / "e2.csv", paths[1], "--limits", rules, "--json", second).code == 0
    mixed = {
        "several estimates": second,
        "2 items under test": scored("item", version="2"),
        "several versions": tmp_path / "version.json",
        "not every score states its inputs and version": tmp_path / "unknown.json",
        "several configurations (trajectory.spacing)": scored("spacing", "--spacing", "5"),
        "several ground truths": scored("source", truth=moved),
    }
    page = tmp_path / "report.html"
    assert sfr("report", first, same, "--test-report", page).code == 0
    for text, path in mixed.items():
        done = sfr("report", first, path, "--test-report", page, "--overwrite")
        assert (done.code, text in done.err) == (3, True), (text, done.err)
        assert "<strong>NO COMMON VERDICT" in page.read_text()


def test_a_report_of_scores_passes_only_what_limits_judged(tmp_path: Path, files: tuple[Path, Path], sfr: Sfr) -> None:
    """A score without limits beside one that passes, and a score that contradicts its truth."""
    good, bare, turned = (tmp_path / f"{name}.json" for name in ("good", "bare", "turned"))
    options = ["--test-report", tmp_path / "t.html", "--junit", tmp_path / "t.xml", "--overwrite"]
    assert sfr("score", *files, "--limits", limits(tmp_path, POSITION), "--json", good).code == 0
    assert sfr("score", *files, "--json", bare).code == 0
    assert sfr("report", good, bare, *options).code == 3
    assert (tmp_path / "t.xml").read_text().count("<error") == 1
    assert sfr("report", good, *options).code == 0
    score = from_json(bare.read_text())
    turned.write_text(to_json(judged_by(msgspec.structs.replace(score, contradiction="conjugated"), None)))
    assert sfr("report", turned, *options).code == 3
    assert sfr("report", turned, "-o", tmp_path / "page.html").code == 3


def test_nothing_that_is_signed_is_green_without_limits(tmp_path: Path, files: tuple[Path, Path], sfr: Sfr) -> None:
    bare, xml, table = tmp_path / "s.json", tmp_path / "j.xml", tmp_path / "c.csv"
    assert sfr("score", *files, "--json", bare).code == 0
    assert sfr("score", *files, "--junit", xml).code == 3
    assert '<error message="the score was not judged by limits"' in xml.read_text()
    for options in (("--junit", xml), ("--control", table), ("--test-report", tmp_path / "t.html")):
        done = sfr("report", bare, *options, "--overwrite")
        assert (done.code, "the score was not judged by limits" in done.err) == (3, True), options
    assert xml.read_text().count("<error") == 1


def test_a_report_keeps_the_drive_that_cannot_be_judged(judge: Judge) -> None:
    """Two drives by one limits file: that of the short one stays `not enough data`, and so does the report."""
    paths, folder = [], judge.folder
    for name, rows in (("short", slice(0, 50)), ("long", slice(None))):
        judge.folder = folder / name
        judge.folder.mkdir()
        estimate, truth = (each[rows] for each in (judge.estimate, judge.truth))
        _, score = judge(limits=OVER_5_M + "1\n", estimate=estimate, truth=truth)
        paths.append(judge.folder / f"{name}.json")
        paths[-1].write_text(json.dumps(score))
    report = judge.folder / "t.html"
    result = judge.sfr("report", *paths, "--test-report", report)
    assert result.code == 3
    text = report.read_text()
    assert "<strong>NOT ENOUGH DATA</strong>" in text
    assert "1 not enough data, 1 pass" in text


def test_a_missed_limit_of_the_map_is_missed_beside_a_score_of_the_map(judge: Judge) -> None:
    """A drive with one slow mapping call fails, whatever the calls of another score; without the call it is omitted."""
    content = {
        "trajectory": [{"condition": "distance=5", "position_mean_plus_3sigma_m": 1.0}],
        "timing": {"mapping_call_s": 0.5},
    }
    surface, control = judge.folder / "map.json", judge.folder / "c.csv"
    surface.write_text(to_json(judged_by(of_map(whole_score()), parse_limits(content, "test"))))
    stamp, states = int(judge.truth.stamps_ns[0]), {}
    for name, seconds in (("slow", [2.0]), ("fast", [0.1]), ("none", [])):
        stats = judge.folder / "mapping.csv"
        rows = [f"{stamp},{each},mapped_set" for each in seconds] or [f"{stamp},0.1,tracking"]
        stats.write_text("\n".join(["stamp_ns,processing_time_s,state", *rows, ""]))
        result, score = judge("--stats", stats, limits=yaml.safe_dump(content))
        assert result.code == {"slow": 1, "fast": 3, "none": 3}[name], result.err
        drive = judge.folder / f"{name}.json"
        drive.write_text(json.dumps(score))
        done = judge.sfr("report", drive, surface, "--control", control, "--overwrite")
        assert done.code == result.code, done.err
        every = list(csv.DictReader(control.read_text().splitlines()))
        states[name] = [row["compliance"] for row in every if row["requirement"] == "mapping_call_s"]
    assert states["slow"][0] == "not compliant"
    assert len(states["fast"]) == 2
    assert states["none"] == states["fast"][1:]


def test_a_difference_that_may_be_chance_is_neither_better_nor_worse(sfr: Sfr, judge: Judge) -> None:
    """One rule: the interval and p corrected for the number of comparisons have to say it both."""
    paths, rng = [], np.random.default_rng(7)
    for number in range(6):
        noise = np.cumsum(rng.normal(0.0, 0.0025 if number else 0.002, (POSES, 3)), axis=0)
        paths.append(judge.folder / f"{number}.json")
        estimate = judge.poses("e.csv", replace(judge.truth, positions=judge.truth.positions + noise))
        options = ("--condition", "distance=1", "--json", paths[-1])
        assert sfr("score", estimate, judge.poses("t.csv", judge.truth), *options).code == 0
    result = sfr("report", *paths, "--json", "-")
    assert result.code == 0, result.err
    pairs = [item for item in json.loads(result.out)["pairs"] if item["ci95"] is not None]
    clear = [item for item in pairs if not item["ci95"][0] <= 0.0 <= item["ci95"][1]]
    assert any(item["p_corrected"] > 0.05 for item in clear)  # the interval alone would say it
    for item in pairs:
        told = item["verdict"] in ("better", "worse")
        assert told == (item in clear and item["p_corrected"] <= 0.05)


def test_runs_of_our_method_by_several_configurations_have_no_pass_in_common(tmp_path: Path, sfr: Sfr) -> None:
    """One run meets the limits of memory and the other those of time; a map of another configuration is of its own."""
    folder, config, page = write_folder(tmp_path / "data", 12, 1), tmp_path / "few.yaml", tmp_path / "r.html"
    config.write_text(yaml.safe_dump({"localisation": {"max_features": 300}}))
    rules = {
        name: limits(tmp_path, {name: {f"localisation_{number}": 1e11}}).rename(tmp_path / f"{name}.yaml")
        for name, number in (("timing", "p95_s"), ("memory", "peak_bytes"))
    }
    found, hashes = {}, {}
    for name, options in (("default", ()), ("few", ("--config", config))):
        estimate = tmp_path / f"{name}.csv"
        # in a process of its own, because memory that this process frees would hide that of the calls
        words = ("localise", str(folder), "-o", str(estimate), "--start", "truth", *map(str, options))
        subprocess.run([*SFR, *words], check=True)
        for kind, path in rules.items():
            found[name, kind] = tmp_path / f"{name}-{kind}.json"
            words = ("--condition", "frames=2", "--limits", path, "--json", found[name, kind])
            done = sfr("score", estimate, folder, *words)
            assert done.code == 0, done.out + done.err
        hashes[name] = json.loads(found[name, kind].read_text())["method"].get("config_sha256")
    assert hashes["default"] is None
    assert hashes["few"] is not None
    together = sfr("report", found["few", "timing"], found["few", "memory"], "--test-report", page)
    assert together.code == 0, together.err
    mixed = sfr("report", found["default", "timing"], found["few", "memory"], "--test-report", page, "--overwrite")
    assert (mixed.code, "the item under test had several configurations" in mixed.err) == (3, True), mixed.err


@pytest.mark.parametrize(
    ("drive", "of_map", "is_different"),
    [
        (("run.mcap", "a"), ("run.mcap", "a"), False),
        (("run", "a"), ("copy of run", "a"), False),
        (("/run/loc/groundtruth.csv", "a"), ("/run", "b"), False),
        (("/run.mcap", "a"), ("/flat.mcap", "b"), True),
        (("/run.mcap", "a"), ("/run.mcap", "b"), True),
        (("other/gt.csv", "a"), (".", "b"), True),
        (("(in memory)", "a"), ("(in memory)", "b"), True),
    ],
)
def test_a_drive_and_a_map_of_different_recordings_have_no_common_verdict(
    drive: tuple[str, str], of_map: tuple[str, str], is_different: bool
) -> None:
    """The map of a simple scene does not complete the drive of another recording; in one score it is a deviation.

    A relative path and an input in memory have no resolved path. Of equal paths, the content may have changed.
    """
    given = {"truth": drive, "map_truth": of_map}
    files = {
        role: InputFile(path=path, resolved=path if path.startswith("/") else None, sha256=sha256)
        for role, (path, sha256) in given.items()
    }
    scores = [with_inputs({role: file}) for role, file in files.items()]
    assert ("different recordings" in (difference_of(scores) or "")) == is_different
    text = " ".join(deviations_of(with_inputs(files)))
    assert (f"different recordings: '{drive[0]}' and '{of_map[0]}'" in text) == is_different


def with_inputs(files: dict[str, InputFile]) -> Score:
    return msgspec.structs.replace(whole_score(), provenance=Provenance(version="0.3.0", inputs=files))
