"""Verdicts of `sfr suite run`: every planned drive and every limit counts, and copies of a drive count once."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from helpers.cli_result import Sfr
from helpers.made_scene import write_folder
from helpers.made_suites import made_suite
from helpers.made_suites import straight as made_drive
from helpers.scored_drives import POSITION, SHORT, straight, write_files
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.tables.trajectory_file import read_trajectory_file
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.stored.score_json import from_json, from_plain, to_json

POSITION_OVER_1_M = {
    "minimum_independent": 1,
    "trajectory": [{"condition": "distance=1", "position_mean_plus_3sigma_m": 0.5}],
}


@pytest.mark.slow
def test_a_suite_judges_every_planned_drive(sfr: Sfr, tmp_path: Path, scheduler: str) -> None:
    """A short drive with one bad sub-trajectory and one with none are not left out of the pool."""
    limits = {"trajectory": [{"condition": "distance=1", "position_mean_plus_3sigma_m": 0.5}], "minimum_independent": 2}
    suite = made_suite(tmp_path / "suite", 1, poses=101, limits=limits)
    content = yaml.safe_load(suite.read_text())
    good = tmp_path / "suite" / "truth0.csv"
    rows = good.read_text().splitlines(keepends=True)
    for name, count in (("one", 14), ("none", 8)):
        (tmp_path / "suite" / f"truth_{name}.csv").write_text("".join(rows[:count]))
        true = read_trajectory_file(tmp_path / "suite" / f"truth_{name}.csv").trajectory
        bad = replace(true, positions=1.9 * true.positions)
        save_trajectory(tmp_path / "suite" / f"drive_{name}.csv", bad)
    codes = {}
    for name in ("good", "one", "none"):
        added = [] if name == "good" else [{"estimate": f"drive_{name}.csv", "truth": f"truth_{name}.csv"}]
        suite.write_text(yaml.safe_dump({**content, "sources": [*content["sources"], *added]}))
        done = sfr("suite", "run", suite, "--out", tmp_path / name, "--scheduler", scheduler, "--json", "-")
        assert done.out, done.err
        codes[name] = done.code, json.loads(done.out)["verdict"]
    assert codes["good"] == (0, "pass")
    assert codes["one"][1] in ("fail", "not enough data", "incomplete")
    assert codes["none"][0] == 3
    assert codes["none"][1] in ("not enough data", "incomplete")


@pytest.mark.slow
def test_a_suite_judges_every_limit_and_counts_drives_by_their_truth(sfr: Sfr, tmp_path: Path, scheduler: str) -> None:
    """Five estimates of one truth, or of its copies, are one drive; a limit on maps has not enough data without one."""
    write_files(tmp_path)
    names = [f"d{number}.csv" for number in range(5)]
    truth = straight()
    for number, name in enumerate(names):
        save_trajectory(tmp_path / name, straight(scale=SHORT + 1e-9 * number))
        copy = Trajectory(truth.stamps_ns, truth.positions + 1e-5 * number, truth.quats_xyzw)
        save_trajectory(tmp_path / f"t{name}", copy)
    pairs = [{"estimate": name, "truth": "truth.csv"} for name in names]
    copies = [{"estimate": name, "truth": f"t{name}"} for name in names]
    bound = {"limit": 0.05, "prob": 0.6, "confidence": 0.8, "interpretation": "ensemble"}  # 4 drives would pass
    of_bound = {"minimum_independent": 1, "trajectory": [{"condition": "distance=5", "position_bound_m": bound}]}
    for number, (sources, rules, code) in enumerate(
        (
            (pairs, POSITION, 0),
            (pairs, POSITION | {"map": {"coverage_min": 0.99}}, 3),
            (pairs, {"map": {"coverage_min": 0.99}}, 3),
            (pairs, of_bound, 3),
            (copies, of_bound, 3),
        )
    ):
        suite = tmp_path / f"suite{number}.yaml"
        suite.write_text(yaml.safe_dump({"sources": sources, "limits": rules}))
        done = sfr("suite", "run", suite, "--out", tmp_path / f"out{number}", "--scheduler", scheduler)
        assert done.code == code, (number, done.out, done.err)


@pytest.mark.slow
def test_copies_of_a_drive_do_not_dilute_an_estimate_that_misses(sfr: Sfr, tmp_path: Path, scheduler: str) -> None:
    """Fourteen estimates of one truth meet the limit and another misses it."""
    write_files(tmp_path)
    names = [f"d{number}.csv" for number in range(15)]
    for number, name in enumerate(names):
        scale = SHORT + 1e-9 * number - 0.0104 * (number == 4)
        save_trajectory(tmp_path / name, straight(scale=scale))
    suite, out = tmp_path / "suite.yaml", tmp_path / "out"
    sources = [{"estimate": name, "truth": "truth.csv"} for name in names]
    suite.write_text(yaml.safe_dump({"sources": sources, "limits": POSITION}))
    done = sfr("suite", "run", suite, "--out", out, "--scheduler", scheduler)
    assert done.code == 1, done.out + done.err
    assert json.loads((out / "suite.json").read_text())["copies"] == [names]
    assert ", ".join(names[1:]) in (out / "report.html").read_text(), "the page lists the copies"


@pytest.mark.slow
def test_the_drives_of_a_group_are_of_one_item_under_test(sfr: Sfr, tmp_path: Path, scheduler: str) -> None:
    """The best method for each drive could be chosen, so that the group has no verdict in common.

    Without a name, it is unknown whether the methods differ, which is a deviation of the suite.
    """
    suite = made_suite(tmp_path / "suite", 2, limits=POSITION_OVER_1_M)
    header = "stamp_ns,processing_time_s,state,method,method_version,method_kind"
    for name, code in (("mine", 0), ("other", 3)):
        for number, method in enumerate(("mine", name)):
            rows = [f"{100_000_000 * (row + 1)},0.1,tracking,{method},1,python" for row in range(60)]
            stats = tmp_path / "suite" / f"drive{number}.stats.csv"
            stats.write_text("\n".join([header, *rows, ""]))
        done = sfr("suite", "run", suite, "--out", tmp_path / name, "--scheduler", scheduler, "--json", "-")
        assert done.code == code, done.out + done.err
        verdicts = [item["name"] for group in json.loads(done.out)["groups"] for item in group["verdicts"]]
        assert ("items_under_test_max" in verdicts) == (name == "other")
        assert not any(text.startswith("The results do not name their item") for text in texts_of(done.out))
    for stats in suite.parent.glob("*.stats.csv"):
        stats.unlink()
    done = sfr("suite", "run", suite, "--out", tmp_path / "unnamed", "--scheduler", scheduler, "--json", "-")
    assert texts_of(done.out)[0].startswith("The results do not name their item")


def texts_of(summary: str) -> list[str]:
    """Return the deviations in the JSON of a suite."""
    return [item["text"] for item in json.loads(summary)["deviations"]]


@pytest.mark.slow
def test_the_order_of_the_drives_in_the_file_decides_nothing(sfr: Sfr, tmp_path: Path, scheduler: str) -> None:
    """One of three drives is bad. The first drive decides; drives are taken in the order of their hashes."""
    folder, found = tmp_path / "suite", []
    made_suite(folder, 3, 1e-3)
    save_trajectory(folder / "drive0.csv", made_drive(60, 0.1, 9))
    content = yaml.safe_load((folder / "suite.yaml").read_text())
    bound = {"limit": 0.02, "prob": 0.5, "confidence": 0.5, "power": 0.5, "good": 0.0, "interpretation": "ensemble"}
    content["limits"] = {"trajectory": [{"condition": "distance=1", "position_bound_m": bound}]}
    for number, step in enumerate((1, -1)):
        suite = folder / f"suite{number}.yaml"
        suite.write_text(yaml.safe_dump({**content, "sources": content["sources"][::step]}))
        sfr("suite", "run", suite, "--out", tmp_path / f"out{number}", "--scheduler", scheduler)
        found.append(json.loads((tmp_path / f"out{number}" / "suite.json").read_text()))
    first, second = ([item for group in suite["groups"] for item in group["verdicts"]] for suite in found)
    assert first == second
    assert found[0]["groups"] == found[1]["groups"]


@pytest.mark.slow
def test_a_suite_of_maps_passes_a_limit_on_the_mapping_call(sfr: Sfr, tmp_path: Path, scheduler: str) -> None:
    """The pairs of its sources are expected, so that the calls are known to be complete; a deleted pair is missing."""
    rules = {"map": {"point_error_p95_m": 10.0, "coverage_min": 0.1}, "timing": {"mapping_call_s": 100.0}}
    by = {"tasks": ["map"], "configurations": {"sgbm": {"mapping": {"method": "sgbm"}}}, "limits": rules}
    for name, code in (("whole", 0), ("part", 3)):
        folder, suite = write_folder(tmp_path / name, 0, 2), tmp_path / f"{name}.yaml"
        if name == "part":
            (folder / "left" / "000001.png").unlink()
        suite.write_text(yaml.safe_dump({"sources": [name], **by}))
        done = sfr("suite", "run", suite, "--out", tmp_path / f"out_{name}", "--scheduler", scheduler)
        assert done.code == code, done.out + done.err


@pytest.mark.slow
def test_a_suite_refuses_the_result_of_another_job_and_of_none(sfr: Sfr, tmp_path: Path, scheduler: str) -> None:
    """The result of a good estimate is copied over that of a bad one; then it does not name its job."""
    write_files(tmp_path)
    save_trajectory(tmp_path / "bad.csv", straight(scale=1.5))
    suite, out = tmp_path / "suite.yaml", tmp_path / "out"
    pairs = [{"estimate": name, "truth": "truth.csv"} for name in ("estimate.csv", "bad.csv")]
    suite.write_text(yaml.safe_dump({"sources": pairs, "limits": POSITION}))
    assert sfr("suite", "run", suite, "--out", out, "--scheduler", scheduler).code == 1
    first, second = (out / "results").glob("*.json")
    good, bad = (first, second) if from_json(first.read_text()).verdict == "pass" else (second, first)
    of_bad = bad.read_text()
    bad.write_text(good.read_text())
    assert sfr("suite", "report", out, "--overwrite").code == 2
    score = json.loads(of_bad)
    del score["provenance"]["configuration"]["suite.key"]
    bad.write_text(to_json(from_plain(Score, score)))
    done = sfr("suite", "report", out, "--overwrite")
    assert done.code == 2
    assert "does not name its job" in done.err
