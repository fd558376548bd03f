"""Deviations from the source document that a test report lists: of settings, of limits, and of unknown inputs."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from helpers.cli_result import Sfr
from helpers.judge import FEW_INDEPENDENT, OVER_5_M, Judge
from helpers.made_scene import true_cloud, write_folder
from helpers.scored_drives import POSITION, limits, straight, write_calls_of
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.clouds.cloud_file import save_cloud
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.metrics.stored.score_json import from_json
from sfr_loc_map.report.deviations import deviations_of


def test_deviations_are_found_by_comparison_with_the_document(judge: Judge) -> None:
    """Spacing, reading, host, and what the limits allow: what was used, not what was meant."""
    calls = judge.calls(judge.estimate.stamps_ns)
    limits = f"{FEW_INDEPENDENT}{OVER_5_M}1\n  missing_max_share: 0.5\ntiming:\n  localisation_max_s: 1\n"
    result, _ = judge("--spacing", "20", "--stats", calls, limits=limits)
    assert result.code == 0, result.err
    report = judge.folder / "t.html"
    options = ("--test-report", report, "--number", "TR-7", "--issue", "2")
    assert judge.sfr("report", judge.folder / "score.json", *options).code == 0
    text = report.read_text()
    for said in (
        "start every 20 frames; the specification states 10",
        "by the reading &#39;pose&#39; of the specification, which literally compares displacements",
        "was measured on the host; the specification requires the target",
        "The limits allow missing_max_share 0.5; the default is 0.",
        "The limits require 2 independent sub-trajectories; the default is 5.",
        "Number TR-7, issue 2",
        "SHA-256 ",
        "kernel ",
        "<th>Independent</th>",
    ):
        assert said in text, said


@pytest.mark.parametrize(
    ("terms", "count"),
    [("confidence: 0.95", 0), ("prob: 0.5", 1), ("confidence: 0.5", 1), ("prob: 0.9, normal: true", 2)],
)
def test_relaxed_terms_of_a_bound_are_deviations(judge: Judge, terms: str, count: int) -> None:
    bound = f"position_bound_m: {{limit: 9, {terms}}}"
    _, score = judge(limits=f"{FEW_INDEPENDENT}trajectory:\n  - {{condition: distance=5, {bound}}}\n")
    found = [text for text in deviations_of(from_json(json.dumps(score), "")) if "position_bound_m" in text]
    assert len(found) == count, found


@pytest.mark.parametrize(
    ("figure", "value", "is_deviation"),
    [
        ("position_mean_plus_3sigma_m", 4.9, False),
        ("position_mean_plus_3sigma_m", 100, True),
        ("chord_p95_m", 5, True),
        ("attitude_mean_plus_3sigma_deg", 179, False),
        ("heading_mean_plus_3sigma_deg", 1000, True),
    ],
)
def test_a_limit_that_an_estimate_without_motion_meets_is_a_deviation(
    tmp_path: Path, files: tuple[Path, Path], sfr: Sfr, figure: str, value: float, is_deviation: bool
) -> None:
    rules = limits(tmp_path, {"trajectory": [{"condition": "distance=5", figure: value}]})
    done = sfr("score", *files, "--limits", rules)
    assert (done.code, "an estimate without motion can meet" in done.out) == (0, is_deviation), done.out


def test_other_ranges_of_coverage_are_a_deviation(tmp_path: Path, sfr: Sfr) -> None:
    folder, cloud = write_folder(tmp_path / "data", 0, 1), tmp_path / "c.ply"
    points = true_cloud()
    save_cloud(cloud, replace(points, xyz=points.xyz + np.float32(0.001)))
    rules = limits(tmp_path, {"map": {"coverage_min": 0.1}})
    for options, is_deviation in (((), False), (("--range", "0.5", "9"), True)):
        score, page = tmp_path / "s.json", tmp_path / "r.html"
        done = sfr("score", cloud, folder, "--limits", rules, "--json", score, "--overwrite", *options)
        assert done.code == 0, done.err
        sfr("report", score, "--test-report", page, "--overwrite")
        assert ("Coverage counts true points from 0.5 m to 9 m" in page.read_text()) == is_deviation


def test_settings_that_change_the_truth_are_a_deviation(tmp_path: Path, sfr: Sfr) -> None:
    """The truth is a second late; the setting that corrects it is listed and stands in the control document."""
    late, truth, score = straight(), straight(scale=1.001), tmp_path / "s.json"
    late = Trajectory(late.stamps_ns + NS_PER_S, late.positions, late.quats_xyzw)
    paths = tmp_path / "e.csv", tmp_path / "t.csv"
    for path, poses in zip(paths, (late, truth), strict=True):
        save_trajectory(path, poses)
    setting = "truth.clock_offset_s=1.0"
    done = sfr("score", *paths, "--limits", limits(tmp_path, POSITION), "--json", score, "--set", setting)
    assert done.code == 0, done.err
    page, table = tmp_path / "r.html", tmp_path / "c.csv"
    sfr("report", score, "--test-report", page, "--control", table)
    assert all(f"The ground truth was read with {setting}" in path.read_text() for path in (page, table))


def test_another_truth_than_that_of_the_recording_is_a_deviation(tmp_path: Path, sfr: Sfr) -> None:
    folder, other, score = write_folder(tmp_path / "data", 40, 1), tmp_path / "mine.csv", tmp_path / "s.json"
    truth = open_source(folder).truth
    assert truth is not None
    save_trajectory(other, replace(truth, positions=1.05 * truth.positions))
    save_trajectory(tmp_path / "e.csv", replace(truth, positions=1.0501 * truth.positions))
    content = {"minimum_independent": 1, "trajectory": [{"condition": "frames=4", "position_mean_plus_3sigma_m": 1.0}]}
    options = ("--limits", limits(tmp_path, content), "--set", f"truth.source={other}", "--json", score)
    done = sfr("score", tmp_path / "e.csv", folder, *options)
    assert done.code == 0, done.out + done.err
    sfr("report", score, "--test-report", tmp_path / "r.html")
    assert "mine.csv&#39; (truth.source), not those of the recording" in (tmp_path / "r.html").read_text()


def test_any_other_setting_of_a_score_is_a_deviation(judge: Judge) -> None:
    for options, is_deviation in (((), False), (("--max-gap", "60"), True)):
        judge(*options, limits=OVER_5_M + "1\n")
        report = judge.folder / "t.html"
        judge.sfr("report", judge.folder / "score.json", "--test-report", report, "--overwrite")
        told = "The setting trajectory.association.max_gap_s is 60; the default is 1." in report.read_text()
        assert told == is_deviation


def test_unknown_calls_are_a_deviation(tmp_path: Path, files: tuple[Path, Path], sfr: Sfr) -> None:
    rules, score, page = limits(tmp_path, POSITION), tmp_path / "s.json", tmp_path / "r.html"
    stats = write_calls_of(tmp_path / "calls.csv", "mine")
    for options, is_deviation in (((), True), (("--stats", stats), False)):
        assert sfr("score", *files, "--limits", rules, "--json", score, "--overwrite", *options).code == 0
        assert sfr("report", score, "--test-report", page, "--overwrite").code == 0
        assert ("The localisation calls of the run are unknown" in page.read_text()) == is_deviation
        of_any_run = "the calls (--stats) have no positions" in page.read_text().lower()
        assert of_any_run != is_deviation, "these calls have nothing in common with the estimate but stamps"


def test_calls_of_a_part_of_the_pairs_are_a_deviation(judge: Judge, images: Path, localised: Trajectory) -> None:
    """A finding in a call that is not listed would be hidden."""
    estimate, report = judge.poses("estimate.csv", localised), judge.folder / "t.html"
    for stamps, is_deviation in ((localised.stamps_ns, False), (localised.stamps_ns[:10], True)):
        score = judge.folder / "score.json"
        rules = judge.limits(f"minimum_independent: 1\n{OVER_5_M}1\n")
        options = ("--stats", judge.calls(stamps), "--limits", rules, "--json", score, "--overwrite")
        assert judge.sfr("score", estimate, images / "all", *options).code == 0
        assert judge.sfr("report", score, "--test-report", report, "--overwrite").code == 0
        assert ("of the pairs have no measured localisation call" in report.read_text()) == is_deviation


def test_unknown_calls_of_a_map_are_a_deviation(tmp_path: Path, sfr: Sfr) -> None:
    folder, cloud, score = write_folder(tmp_path / "data", 0, 1), tmp_path / "c.ply", tmp_path / "s.json"
    points = true_cloud()
    save_cloud(cloud, replace(points, xyz=points.xyz + np.float32(0.001)))
    rules, page = limits(tmp_path, {"map": {"coverage_min": 0.1}}), tmp_path / "r.html"
    assert sfr("score", cloud, folder, "--limits", rules, "--json", score).code == 0
    sfr("report", score, "--test-report", page)
    assert "The mapping calls of the run are unknown" in page.read_text()


def test_a_sparse_truth_and_unknown_images_are_conditions_of_the_verdict(tmp_path: Path, sfr: Sfr) -> None:
    """Every second true pose is absent: nothing shows whether there was one."""
    truth, score, page = straight(), tmp_path / "s.json", tmp_path / "r.html"
    save_trajectory(tmp_path / "e.csv", straight(scale=0.999))
    save_trajectory(tmp_path / "t.csv", Trajectory(truth.stamps_ns[::2], truth.positions[::2], truth.quats_xyzw[::2]))
    rules = limits(tmp_path, {**POSITION, "minimum_independent": 2})
    done = sfr("score", tmp_path / "e.csv", tmp_path / "t.csv", "--limits", rules, "--json", score)
    assert (done.code, "errors between them are not in the figures" in done.err) == (0, True), done.err
    sfr("report", score, "--test-report", page)
    for text in ("errors between them are not in the figures", "The images of the drive are unknown", "150 estimates"):
        assert text in page.read_text()


@pytest.mark.parametrize("cut", [slice(5, 25), slice(0, 20), slice(20, 40), slice(5, 13)])
def test_a_true_path_without_images_is_a_deviation(tmp_path: Path, sfr: Sfr, cut: slice) -> None:
    """A single score of a list of pairs that was cut, with the estimate of the pairs that are left."""
    folder, poses, page = write_folder(tmp_path / "data", 40, 1), tmp_path / "e.csv", tmp_path / "t.html"
    truth, table, score = open_source(folder).truth, folder / "loc" / "pairs.csv", tmp_path / "s.json"
    assert truth is not None
    is_cut = np.isin(np.arange(40), np.arange(40)[cut])
    header, *rows = table.read_text().splitlines(keepends=True)
    table.write_text("".join([header, *(row for row, is_out in zip(rows, is_cut, strict=True) if not is_out)]))
    kept = (truth.stamps_ns[~is_cut], 0.999 * truth.positions[~is_cut], truth.quats_xyzw[~is_cut])
    save_trajectory(poses, Trajectory(*kept))
    content = {"minimum_independent": 1, "trajectory": [{"condition": "frames=4", "position_mean_plus_3sigma_m": 1.0}]}
    done = sfr("score", poses, folder, "--limits", limits(tmp_path, content), "--json", score)
    assert done.code == 0, done.out + done.err
    sfr("report", score, "--test-report", page)
    assert "of the true path has no images, so no estimate is expected there" in page.read_text()
    stated = limits(tmp_path, content | {"completeness": {"path_without_images_max_share": 0.05}})
    assert sfr("score", poses, folder, "--limits", stated).code == 1


def test_true_poses_with_repeated_stamps_are_a_deviation(tmp_path: Path, sfr: Sfr) -> None:
    """Two of 300 stamps have a second pose, which is too few for a second truth."""
    truth, score, page = straight(), tmp_path / "s.json", tmp_path / "r.html"
    rows = np.sort(np.append(np.arange(300), [100, 200]))
    positions = truth.positions[rows]
    positions[[101, 202], 2] += 0.01
    save_trajectory(tmp_path / "e.csv", straight(scale=0.999))
    save_trajectory(tmp_path / "t.csv", Trajectory(truth.stamps_ns[rows], positions, truth.quats_xyzw[rows]))
    done = sfr("score", tmp_path / "e.csv", tmp_path / "t.csv", "--limits", limits(tmp_path, POSITION), "--json", score)
    assert done.code == 0, done.err
    sfr("report", score, "--test-report", page)
    assert "True poses that were ignored because a later true pose has the same stamp: 2." in page.read_text()


ROWS = np.arange(300)


@pytest.mark.parametrize(
    ("kept", "is_uneven"),
    [
        ((ROWS < 200) | (ROWS % 10 == 0), True),  # sparse in the last third
        ((ROWS < 150) | (ROWS % 2 == 0), True),  # twice as dense in the first half
        ((ROWS % 4 == 0) | (ROWS // 30 == 2), True),  # dense in a tenth
        ((ROWS % 4 == 0) | (np.abs(ROWS - 150) < 15), True),  # dense in a tenth in the middle
        (ROWS % 5 != 2, False),  # every fifth image was not processed
        (ROWS != 77, False),
    ],
)
def test_uneven_estimates_are_a_deviation_if_the_images_are_unknown(
    tmp_path: Path, sfr: Sfr, kept: NDArray[np.bool_], is_uneven: bool
) -> None:
    """Estimates at another rate in a part of the drive."""
    estimate, score, page = straight(scale=0.999), tmp_path / "s.json", tmp_path / "r.html"
    rows = ROWS[kept]
    save_trajectory(
        tmp_path / "e.csv", Trajectory(estimate.stamps_ns[rows], estimate.positions[rows], estimate.quats_xyzw[rows])
    )
    save_trajectory(tmp_path / "t.csv", straight())
    options = ("--limits", limits(tmp_path, {**POSITION, "minimum_independent": 2}), "--partial", "--json", score)
    assert sfr("score", tmp_path / "e.csv", tmp_path / "t.csv", *options).code == 0
    sfr("report", score, "--test-report", page)
    assert ("frames of denser parts have more weight in the figures" in page.read_text()) == is_uneven
