"""How much of a drive an estimate covers, by `sfr score`: an estimate, or a truth, of a part is incomplete."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from helpers import score_rows
from helpers.cli_result import Sfr
from helpers.judge import FEW_INDEPENDENT, OVER_5_M, POSES, Judge
from helpers.made_scene import loc_pair, true_cloud, write_folder
from helpers.scored_drives import COUNT, PERIOD_NS, POSITION, SHORT, limits, straight
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.clouds.cloud_file import load_cloud, save_cloud
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory


@pytest.mark.clause("4.1.1")
def test_half_a_drive_is_incomplete_unless_asked_for(judge: Judge) -> None:
    half = judge.estimate[:201]
    result, score = judge(limits=FEW_INDEPENDENT + OVER_5_M + "1\n", estimate=half)
    assert result.code == 3
    assert {item["verdict"] for item in score["verdicts"]} == {"incomplete"}
    assert "not judged: incomplete data (drive)" in result.err
    assert "verdict: incomplete. Incomplete: the estimate covers 50.12 % of the true poses" in result.out
    assert (result.out + result.err).count("the estimate covers 50.12 %") == 1
    assert score_rows.number(score, "missing", part="count") == 200

    result, score = judge("--partial", limits=FEW_INDEPENDENT + OVER_5_M + "1\n", estimate=half)
    assert (result.code, [item["verdict"] for item in score["verdicts"]]) == (0, ["pass"])
    assert "judged although data is missing" in result.err
    assert judge(estimate=half)[0].code == 3  # without limits too
    assert (
        judge(limits=FEW_INDEPENDENT + OVER_5_M + "0.001\n", estimate=half)[0].code == 1
    )  # a missed limit counts before


def test_one_missing_estimate_of_four_hundred_is_incomplete_only_by_limits(judge: Judge) -> None:
    """Without limits a small gap is not evidence of a partial drive; a verdict requires every estimate."""
    most = judge.estimate[np.flatnonzero(np.arange(POSES) != 200)]
    assert judge(estimate=most)[0].code == 0
    result, score = judge(limits=FEW_INDEPENDENT + OVER_5_M + "1\n", estimate=most)
    assert (result.code, score_rows.number(score, "missing", part="count")) == (3, 1)


def test_partial_judging_states_each_shortfall_that_it_accepts(judge: Judge) -> None:
    """A shortfall that is one only with limits is stated as well."""
    most = judge.estimate[np.flatnonzero(np.arange(POSES) != 200)]
    for changed in ({"estimate": most}, {"truth": judge.truth[:300]}):
        result, score = judge("--partial", limits=FEW_INDEPENDENT + OVER_5_M + "1\n", **changed)
        assert (result.code, score["verdict"]) == (0, "pass")
        assert any("judged although data is missing" in text for text in score["warnings"])


def test_a_share_may_be_missing_where_a_limit_says_so(judge: Judge) -> None:
    half = judge.estimate[:201]
    for share, code in ((0.6, 0), (0.4, 1)):
        for text in (
            f"completeness:\n  missing_max_share: {share}\n",
            f"completeness:\n  - missing_max_share: {share}\n    id: A\n  - doubled_max_share: 0\n",
            f"{FEW_INDEPENDENT}{OVER_5_M}1\n  missing_max_share: {share}\n",
            f"{FEW_INDEPENDENT}{OVER_5_M}1\n  missing_max_share: {{limit: {share}, id: A, certain: true}}\n",
        ):
            result, score = judge(limits=text, estimate=half)
            assert result.code == code, text
            found = next(item for item in score["verdicts"] if item["name"] == "missing_max_share")
            assert found["value"] == pytest.approx(0.5, abs=0.003)


def test_wrong_poses_with_other_stamps_are_missing(tmp_path: Path, files: tuple[Path, Path], sfr: Sfr) -> None:
    """No figure contains the error of a pose whose stamp agrees with no truth."""
    rules, drive = limits(tmp_path, POSITION), straight(scale=SHORT)
    assert sfr("score", *files, "--limits", rules).code == 0
    is_moved = (np.arange(COUNT) >= 100) & (np.arange(COUNT) < 140)
    away = drive.positions + 2.0 * is_moved[:, None]
    for shift_ns, code in ((0, 1), (3 * PERIOD_NS // 10, 3)):
        moved = replace(drive, positions=away, stamps_ns=drive.stamps_ns + shift_ns * is_moved)
        save_trajectory(files[0], moved)
        assert sfr("score", *files, "--limits", rules).code == code


def test_what_belongs_to_nothing_has_limits(sfr: Sfr, judge: Judge, source: Path, cloud: Path) -> None:
    """Estimates without truth, doubled stamps, and mapping pairs that the cloud leaves out."""
    part, twice = judge.truth[:300], judge.estimate[np.r_[0:POSES, 0:20]]
    for name, options, share in (
        ("unmatched", {"truth": part}, 101 / POSES),
        ("doubled", {"estimate": twice}, 20 / (POSES + 20)),
    ):
        for limit, code in ((share + 0.01, 0), (share - 0.01, 1)):
            result, score = judge(limits=f"{OVER_5_M}1\n  {name}_max_share: {limit}\n", **options)
            assert result.code == code, result.err
            assert score["verdicts"][1]["value"] == pytest.approx(share)
    whole = load_cloud(cloud).cloud
    assert whole is not None
    first = whole.pair == 0
    columns = (getattr(whole, name)[first] for name in ("xyz", "sigma", "intensity", "u", "v", "pair"))
    save_cloud(cloud, PointCloud(*columns, fused=False))
    limits = judge.limits("map:\n  pairs_without_cloud_max_share: 0.4\n")
    result = sfr("score", cloud, source, "--limits", limits, "--json", "-")
    assert (result.code, json.loads(result.out)["verdicts"][-1]["value"]) == (1, 0.5)


def test_two_runs_in_one_file_are_refused(judge: Judge) -> None:
    moved = judge.estimate.positions + np.array([100.0, 0.0, 0.0])
    twice = (np.concatenate([part, part]) for part in (judge.estimate.stamps_ns, judge.estimate.quats_xyzw))
    stamps, quats = twice
    result, _ = judge(estimate=Trajectory(stamps, np.concatenate([judge.estimate.positions, moved]), quats))
    assert result.code == 2
    assert result.err.count("\n") == 1
    assert "one run is required" in result.err


def test_the_images_of_the_source_are_what_has_to_be_covered(sfr: Sfr, judge: Judge, source: Path) -> None:
    stamps = np.array([loc_pair(index).stamp_ns for index in range(12)])
    positions = np.column_stack([0.02 * np.arange(12), np.zeros((12, 2))])
    whole = Trajectory(stamps, positions, np.tile([0.0, 0.0, 0.0, 1.0], (12, 1)))
    for rows, code in ((slice(12), 0), (slice(8), 3)):
        result, score = judge("--condition", "frames=3", "--spacing", 1, estimate=whole[rows], truth=source)
        assert result.code == code, result.err
        covered = score["association"]
        assert (covered["images"], covered["matched"]) == (12, len(stamps[rows]))
        assert score_rows.number(score, "judged") == pytest.approx(len(stamps[rows]) / 12)


ONE_M = "trajectory:\n- condition: distance=1\n  position_mean_plus_3sigma_m: 1\n"


@pytest.mark.parametrize(
    ("truth", "rows", "code", "without_truth"),
    [
        ("all", slice(None), 0, 0.0),
        ("half", slice(None), 3, 0.5),
        ("all", slice(None, None, 5), 3, 0.0),
        ("all", slice(None, None, 6), 3, 0.0),
    ],
    ids=["complete", "the truth ends after half of the images", "every fifth pose", "every sixth pose"],
)
def test_each_image_of_a_source_needs_a_pose_and_a_truth(
    judge: Judge, images: Path, localised: Trajectory, truth: str, rows: slice, code: int, without_truth: float
) -> None:
    """Chosen poses have a period of their own, which is not that of the images."""
    limits = "" if rows == slice(None) else FEW_INDEPENDENT
    result, score = judge(limits=limits + ONE_M, estimate=localised[rows], truth=images / truth)
    assert (result.code, score["verdict"]) == (code, "incomplete" if code else "pass"), result.err
    assert score_rows.number(score, "images_without_truth") == pytest.approx(without_truth, abs=0.01)
    assert ("% of the images" in result.out) == (code == 3)


def test_pairs_whose_images_were_deleted_are_expected_all_the_same(tmp_path: Path, sfr: Sfr) -> None:
    """Their stamps are listed in pairs.csv: an estimate and a map of the other pairs are incomplete."""
    folder, poses, cloud = write_folder(tmp_path / "data", 40, 2), tmp_path / "e.csv", tmp_path / "c.ply"
    truth = open_source(folder).truth
    assert truth is not None
    is_kept = np.arange(len(truth)) % 4 > 0
    kept = (truth.stamps_ns[is_kept], 0.999 * truth.positions[is_kept], truth.quats_xyzw[is_kept])
    save_trajectory(poses, Trajectory(*kept))
    content = {"minimum_independent": 1, "map": {"point_error_p95_m": 1.0}}
    content |= {"trajectory": [{"condition": "frames=4", "position_mean_plus_3sigma_m": 1.0}]}
    rules = limits(tmp_path, content)
    for row in np.flatnonzero(~is_kept):
        (folder / "loc" / "left" / f"{row:06d}.png").unlink()
    score = tmp_path / "s.json"
    assert sfr("score", poses, folder, "--limits", rules, "--json", score).code == 3
    missing = [row for row in json.loads(score.read_text())["figures"] if row["figure"] == "missing"]
    assert [(row["n"], row["value"]) for row in missing] == [(40, 0.25), (40, 10.0)]
    save_cloud(cloud, true_cloud(0))
    (folder / "nav" / "right" / "000001.png").unlink()
    done = sfr("score", cloud, folder, "--limits", rules)
    assert done.code == 3
    assert "50 % of the mapping pairs have no point in the cloud" in done.out


@pytest.mark.parametrize("kept", [slice(None, -30), slice(30, None)])
def test_a_truth_that_is_shorter_than_the_estimate_is_incomplete(tmp_path: Path, sfr: Sfr, kept: slice) -> None:
    """The estimate is wrong by metres where the truth was cut."""
    estimate, truth = straight(scale=SHORT), straight()
    is_cut = np.ones(COUNT, np.bool_)
    is_cut[kept] = False
    wrong = estimate.positions + np.array([0.0, 3.0, 0.0]) * is_cut[:, None]
    save_trajectory(tmp_path / "e.csv", Trajectory(estimate.stamps_ns, wrong, estimate.quats_xyzw))
    columns = (truth.stamps_ns[kept], truth.positions[kept], truth.quats_xyzw[kept])
    save_trajectory(tmp_path / "t.csv", Trajectory(*columns))
    rules = limits(tmp_path, {**POSITION, "minimum_independent": 4})
    done = sfr("score", tmp_path / "e.csv", tmp_path / "t.csv", "--limits", rules)
    assert done.code == 3
    assert "Incomplete: 9.699 % of the images (of the poses, if the images are unknown) cannot be judged" in done.out
    assert sfr("score", tmp_path / "e.csv", tmp_path / "t.csv", "--limits", rules, "--partial").code == 0


def test_one_period_beyond_the_truth_is_covered(tmp_path: Path, files: tuple[Path, Path], sfr: Sfr) -> None:
    truth = straight(COUNT - 1)
    save_trajectory(tmp_path / "t.csv", truth)
    assert sfr("score", files[0], tmp_path / "t.csv", "--limits", limits(tmp_path, POSITION)).code == 0


@pytest.mark.clause("4.1.1")
def test_frames_that_are_true_poses_not_images_are_said(judge: Judge) -> None:
    sparse = judge.truth[::5]
    result, score = judge(truth=sparse)
    assert (result.code, score["association"]["matched"]) == (0, 81)
    assert "the truth has only 81 poses for 401 estimates" in result.err
    result, score = judge("--frames", "images", truth=sparse)
    assert (result.code, score["association"]["matched"]) == (0, POSES)
    assert score["association"]["mode"] == "interpolate"
    assert "81 poses" not in result.err
    holed = sparse[np.r_[0:30, 50:81]]  # 10.5 s without truth
    assert judge("--frames", "images", truth=holed)[1]["association"]["matched"] == POSES - 104
    assert judge("--frames", "images", "--associate", "match", truth=sparse)[0].code == 2


@pytest.mark.parametrize(("frames", "code"), [(30, 3), (4, 0)])
def test_an_estimate_in_a_hole_of_the_truth_is_not_judged(tmp_path: Path, sfr: Sfr, frames: int, code: int) -> None:
    """The estimate is wrong by metres there; a truth with a short outage is honest."""
    estimate, truth = straight(scale=0.999), straight()
    is_cut = (np.arange(COUNT) > 121) & (np.arange(COUNT) <= 121 + frames)
    wrong = estimate.positions + np.array([0.0, 3.0, 0.0]) * (is_cut & (frames > 4))[:, None]
    save_trajectory(tmp_path / "e.csv", Trajectory(estimate.stamps_ns, wrong, estimate.quats_xyzw))
    columns = (truth.stamps_ns[~is_cut], truth.positions[~is_cut], truth.quats_xyzw[~is_cut])
    save_trajectory(tmp_path / "t.csv", Trajectory(*columns))
    content = {**POSITION, "minimum_independent": 3}
    done = sfr("score", tmp_path / "e.csv", tmp_path / "t.csv", "--limits", limits(tmp_path, content))
    assert (
        done.code,
        "9.396 % of the images (of the poses, if the images are unknown) cannot be judged" in done.out,
    ) == (code, code == 3), done.out + done.err
    allowed = limits(tmp_path, content | {"completeness": {"unmatched_max_share": 0.2}})
    assert sfr("score", tmp_path / "e.csv", tmp_path / "t.csv", "--limits", allowed).code == 0
