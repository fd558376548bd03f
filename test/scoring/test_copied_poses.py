"""Poses that were copied, from the ground truth or from another pose of the estimate, judged by `sfr score`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, Slerp

from helpers.cli_result import Sfr
from helpers.scored_drives import COUNT, LOOSE, PERIOD_NS, limits, wandering
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory


def test_a_copy_of_the_truth_is_found_if_it_is_changed_rounded_resampled_or_moved(tmp_path: Path, sfr: Sfr) -> None:
    paths, truth = (tmp_path / "e.csv", tmp_path / "t.csv"), wandering(0.0)
    save_trajectory(paths[1], truth)
    fine_ns = truth.stamps_ns[:-1] + 3 * PERIOD_NS // 7
    at_s, time_s = fine_ns * 1e-9, truth.stamps_ns * 1e-9
    linear = np.stack([np.interp(at_s, time_s, axis) for axis in truth.positions.T], axis=1)
    moved = truth.positions @ np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]).T + 3.0
    half = np.sqrt(0.5)
    x, y, z, w = truth.quats_xyzw.T
    turned = np.column_stack((half * (x - y), half * (x + y), half * (z + w), half * (w - z)))
    part = wandering(1e-4).positions
    part[100:200] = part[100] - truth.positions[100] + truth.positions[100:200]
    copies = {
        "itself": (truth.stamps_ns, truth.positions, truth.quats_xyzw),
        "every second pose": (truth.stamps_ns[::2], truth.positions[::2], truth.quats_xyzw[::2]),
        "a bit": (truth.stamps_ns, np.nextafter(truth.positions, 9.0), truth.quats_xyzw),
        "own attitudes": (truth.stamps_ns, truth.positions, wandering(1e-4).quats_xyzw),
        "linear": (fine_ns, linear, truth.quats_xyzw[:-1]),
        "spline": (fine_ns, CubicSpline(time_s, truth.positions)(at_s), truth.quats_xyzw[:-1]),
        "moved": (truth.stamps_ns, moved, turned),
        "a third of the drive": (truth.stamps_ns, part, truth.quats_xyzw),
    }
    for digits in (3, 4, 5, 6):
        copies[f"{digits} decimals"] = (truth.stamps_ns, np.round(truth.positions, digits), truth.quats_xyzw)
    for name, columns in copies.items():
        save_trajectory(paths[0], Trajectory(*columns))
        for option in ((), ("--partial",)) if name == "itself" else (("--partial",),):
            done = sfr("score", *paths, "--limits", limits(tmp_path, LOOSE), *option)
            assert (done.code, "of the steps equal those of the ground truth" in done.out) == (3, True), (
                name,
                done.err,
            )
    save_trajectory(paths[0], truth)
    assert sfr("score", *paths).code == 0, "without limits there is no verdict"
    labelled = limits(tmp_path, {**LOOSE, "completeness": {"poses_of_truth_max_share": 1.0}})
    assert sfr("score", *paths, "--limits", labelled).code == 0, "a simulated estimate without an error says so"


HELD = {"no pose": slice(0, 0), "a third": slice(100, 200), "each pose twice": slice(None)}


@pytest.mark.parametrize("case", HELD)
def test_true_poses_that_are_repeated_while_the_estimate_moves_are_reported(
    tmp_path: Path, sfr: Sfr, case: str
) -> None:
    paths, truth = (tmp_path / "e.csv", tmp_path / "t.csv"), wandering(0.0)
    rows = np.arange(COUNT)
    rows[HELD[case]] = 100 if case == "a third" else rows[HELD[case]] // 2 * 2
    save_trajectory(paths[0], wandering(1e-4))
    save_trajectory(paths[1], Trajectory(truth.stamps_ns, truth.positions[rows], truth.quats_xyzw[rows]))
    done = sfr("score", *paths)
    assert ("the truth repeats a pose exactly" in done.err) == (case != "no pose")


def test_a_constant_attitude_of_the_estimate_is_reported(tmp_path: Path, sfr: Sfr) -> None:
    paths, truth = (tmp_path / "e.csv", tmp_path / "t.csv"), wandering(0.0)
    for quats in (truth.quats_xyzw, np.tile([0.0, 0.0, 0.0, 1.0], (COUNT, 1))):
        save_trajectory(paths[0], Trajectory(truth.stamps_ns, truth.positions, quats))
        save_trajectory(paths[1], truth)
        assert ("its attitudes are placeholders" in sfr("score", *paths).err) == (not quats[:, :3].any())


def test_a_stationary_drive_has_no_motion_that_a_limit_on_copies_could_require(tmp_path: Path, sfr: Sfr) -> None:
    paths = tmp_path / "e.csv", tmp_path / "t.csv"
    drive, noise = wandering(0.0), np.random.default_rng(1).normal(0.0, 1e-4, (COUNT, 3))
    for path, positions in zip(paths, (noise, np.zeros((COUNT, 3))), strict=True):
        save_trajectory(path, Trajectory(drive.stamps_ns, positions, np.tile([0.0, 0.0, 0.0, 1.0], (COUNT, 1))))
    stationary = {"trajectory": [{"condition": "time=5", "position_max_m": 1.0}]}
    for completeness in ({}, {"poses_of_truth_max_share": 1.0, "errors_of_truth_max_share": 1.0}):
        rules = limits(tmp_path, {**stationary, "completeness": completeness, "minimum_independent": 1})
        done = sfr("score", *paths, "--limits", rules)
        assert done.code == 0, done.out + done.err


@pytest.mark.parametrize(("allowed", "code"), [(0.0, 3), (0.5, 3), (1.0, 0)])
def test_true_poses_at_the_judged_frames_are_accepted_only_by_a_limit_above_their_fraction(
    tmp_path: Path, sfr: Sfr, allowed: float, code: int
) -> None:
    """All other poses have a noise of 10 mm, so that few steps between neighbouring poses are those of the truth."""
    paths, truth = (tmp_path / "e.csv", tmp_path / "t.csv"), wandering(0.0)
    positions = wandering(1e-2).positions
    positions[::10] = truth.positions[::10]
    for path, poses in zip(paths, (positions, truth.positions), strict=True):
        save_trajectory(path, Trajectory(truth.stamps_ns, poses, truth.quats_xyzw))
    completeness = {"poses_of_truth_max_share": allowed, "errors_beyond_max_share": 1.0}
    frames = {**LOOSE, "trajectory": [{"condition": "frames=50", "position_max_m": 1.0}]}
    rules = limits(tmp_path, {**frames, "completeness": completeness})
    done = sfr("score", *paths, "--limits", rules)
    assert done.code == code, done.out + done.err


def test_a_copy_of_eight_poses_is_found(tmp_path: Path, sfr: Sfr) -> None:
    paths, whole = (tmp_path / "e.csv", tmp_path / "t.csv"), wandering(0.0)
    every = COUNT // 8
    few = Trajectory(whole.stamps_ns[::every][:8], whole.positions[::every][:8], whole.quats_xyzw[::every][:8])
    for path in paths:
        save_trajectory(path, few)
    rules = tmp_path / "limits.yaml"
    rules.write_text("trajectory:\n  - {condition: frames=1, position_max_m: 1}\n", encoding="utf-8")
    done = sfr("score", *paths, "--limits", rules, "--spacing", 1)
    assert done.code == 3
    assert "equal those of the ground truth" in done.out


@pytest.mark.parametrize("kept", [10, 2])
def test_true_poses_at_starts_and_ends_alone_are_a_copy(tmp_path: Path, sfr: Sfr, kept: int) -> None:
    """Sub-trajectories of 5 m start and end at every tenth frame; no two successive poses are of the truth."""
    paths, truth, own = (tmp_path / "e.csv", tmp_path / "t.csv"), wandering(0.0), wandering(1e-4)
    is_true = np.arange(COUNT) % kept == 0
    positions = np.where(is_true[:, None], truth.positions, own.positions)
    quats = np.where(is_true[:, None], truth.quats_xyzw, own.quats_xyzw)
    save_trajectory(paths[0], Trajectory(truth.stamps_ns, positions, quats))
    save_trajectory(paths[1], truth)
    condition = {"condition": "frames=50", "position_mean_plus_3sigma_m": 1.0}
    for option in ((), ("--partial",)):
        done = sfr("score", *paths, "--limits", limits(tmp_path, {"trajectory": [condition]}), *option)
        assert (done.code, "of the judged motions from a start to an end" in done.out) == (3, True), done.err


def test_a_rover_that_returns_to_its_start_has_no_true_motion(tmp_path: Path, sfr: Sfr) -> None:
    """It stands for a third of the drive, where estimate and truth agree exactly."""
    paths, truth, own = (tmp_path / "e.csv", tmp_path / "t.csv"), wandering(0.0), wandering(1e-3)
    stands = np.minimum(np.arange(COUNT), 200)
    for path, drive in zip(paths, (own, truth), strict=True):
        save_trajectory(path, Trajectory(drive.stamps_ns, drive.positions[stands], drive.quats_xyzw[stands]))
    condition = {"condition": "frames=20", "position_mean_plus_3sigma_m": 1.0}
    assert sfr("score", *paths, "--limits", limits(tmp_path, {"trajectory": [condition]})).code == 0


@pytest.mark.parametrize("digits", [3, 4, 6, 12])
@pytest.mark.parametrize("sigma_m", [1e-4, 1e-3])
def test_an_excellent_estimate_is_no_copy_of_the_truth(tmp_path: Path, sfr: Sfr, sigma_m: float, digits: int) -> None:
    """Noise of 0.1 mm a step of 100 mm: at the end of 30 m the error is a few mm."""
    paths, good = (tmp_path / "e.csv", tmp_path / "t.csv"), wandering(sigma_m)
    save_trajectory(paths[1], wandering(0.0))
    save_trajectory(paths[0], Trajectory(good.stamps_ns, np.round(good.positions, digits), good.quats_xyzw))
    done = sfr("score", *paths, "--limits", limits(tmp_path, LOOSE))
    assert done.code == 0, done.err


def test_every_stamp_that_occurs_twice_and_every_pose_that_repeats_another_counts(tmp_path: Path, sfr: Sfr) -> None:
    """One pose of 300 is enough; a pose that is reported as lost may repeat another."""
    paths, score = (tmp_path / "e.csv", tmp_path / "t.csv"), tmp_path / "s.json"
    truth, good = wandering(0.0), wandering(1e-4)
    save_trajectory(paths[1], truth)
    again = np.insert(np.arange(COUNT), 50, 49)
    doubled = Trajectory(good.stamps_ns[again], good.positions[again], good.quats_xyzw[again])
    copied = np.arange(COUNT)
    copied[101:104] = 100
    repeated = Trajectory(good.stamps_ns, good.positions[copied], good.quats_xyzw[copied])
    for estimate, figure, count, code in (
        (good, "doubled", 0, 0),
        (doubled, "doubled", 1, 3),
        (repeated, "poses_repeated", 3, 3),
    ):
        save_trajectory(paths[0], estimate)
        for more, expected in (({}, code), ({"completeness": {f"{figure}_max_share": 0.02}}, 0)):
            rules = limits(tmp_path, {**LOOSE, **more})
            assert sfr("score", *paths, "--limits", rules, "--json", score, "--overwrite").code == expected, figure
            (row,) = (
                row
                for row in json.loads(score.read_text())["figures"]
                if (row["figure"], row.get("part")) == (figure, "count")
            )
            assert row["value"] == count
    calls = tmp_path / "e.stats.csv"
    states = ["lost" if row in (101, 102, 103) else "tracking" for row in range(COUNT)]
    rows = [f"{stamp},0.1,{state}" for stamp, state in zip(good.stamps_ns, states, strict=True)]
    calls.write_text("\n".join(["stamp_ns,processing_time_s,state", *rows]) + "\n")
    assert sfr("score", *paths, "--limits", limits(tmp_path, LOOSE)).code == 0, "reported as lost"


def test_a_rover_that_stands_and_a_slow_start_repeat_no_pose(tmp_path: Path, sfr: Sfr) -> None:
    """The truth has noise of 1 mm; the estimate knows that the rover stands."""
    truth, good = wandering(0.0), wandering(1e-3)
    stands = np.minimum(np.arange(COUNT), 250)
    noise = np.random.default_rng(2).normal(0.0, 1e-3, (COUNT, 3))
    save_trajectory(tmp_path / "t.csv", Trajectory(truth.stamps_ns, truth.positions[stands] + noise, truth.quats_xyzw))
    save_trajectory(tmp_path / "e.csv", Trajectory(good.stamps_ns, good.positions[stands], good.quats_xyzw[stands]))
    rules = limits(tmp_path, {**LOOSE, "minimum_independent": 1})
    assert sfr("score", tmp_path / "e.csv", tmp_path / "t.csv", "--limits", rules).code == 0


def test_copied_attitudes_are_found_beside_measured_positions_and_affect_limits_on_attitudes(
    tmp_path: Path, sfr: Sfr
) -> None:
    paths, truth, own = (tmp_path / "e.csv", tmp_path / "t.csv"), turning(0.0), turning(1e-3)
    save_trajectory(paths[1], truth)
    condition = "distance=5"
    attitude = {"trajectory": [{"condition": condition, "attitude_mean_plus_3sigma_deg": 1.0}]}
    for quats, rules, code in (
        (own.quats_xyzw, attitude, 0),
        (np.round(truth.quats_xyzw, 6), attitude, 3),
        (-truth.quats_xyzw, attitude, 3),
        (truth.quats_xyzw, LOOSE, 0),
        (truth.quats_xyzw, {**attitude, "completeness": {"attitudes_of_truth_max_share": 1.0}}, 0),
    ):
        save_trajectory(paths[0], Trajectory(own.stamps_ns, own.positions, quats))
        done = sfr("score", *paths, "--limits", limits(tmp_path, {**rules, "minimum_independent": 1}))
        assert (done.code, "of the rotations equal those of the ground truth" in done.out) == (code, code == 3), (
            done.err
        )


@pytest.mark.parametrize(("share", "code"), [(0, 0), (4, 3)])
def test_poses_interpolated_between_others_are_missing(tmp_path: Path, sfr: Sfr, share: int, code: int) -> None:
    """Every fifth to tenth pose is a knot; an estimate of which none is interpolated is judged."""
    paths, own = (tmp_path / "e.csv", tmp_path / "t.csv"), turning(1e-3)
    save_trajectory(paths[1], turning(0.0))
    is_kept = np.arange(COUNT) % 10 >= share
    is_kept[[0, -1]] = True
    knots_ns, rotations = own.stamps_ns[is_kept], Rotation.from_quat(own.quats_xyzw[is_kept])
    positions = [np.interp(own.stamps_ns, knots_ns, axis) for axis in own.positions[is_kept].T]
    quats = Slerp(knots_ns, rotations)(own.stamps_ns).as_quat()
    save_trajectory(paths[0], Trajectory(own.stamps_ns, np.stack(positions, axis=1), quats))
    for more, expected in (({}, code), ({"completeness": {"missing_max_share": 0.5}}, 0)):
        rules = limits(tmp_path, {**LOOSE, **more, "minimum_independent": 1})
        done = sfr("score", *paths, "--limits", rules)
        assert (done.code, "interpolated between other poses" in done.out) == (expected, expected == 3), done.err


def turning(sigma: float) -> Trajectory:
    """Return the wandering drive with attitudes that change in each step, and errors of each attitude in rad."""
    drive = wandering(sigma)
    place = np.arange(COUNT)
    noise = np.random.default_rng(4).normal(0.0, sigma, (COUNT, 3))
    turned = Rotation.from_euler("ZY", np.column_stack((0.4 * np.sin(0.07 * place), 0.1 * np.sin(0.3 * place))))
    return Trajectory(drive.stamps_ns, drive.positions, (turned * Rotation.from_rotvec(noise)).as_quat())
