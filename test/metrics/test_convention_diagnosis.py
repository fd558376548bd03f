"""Each mistake is found among the others; a correct pair is never accused."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sfr_loc_map.geometry.pose_convention import PoseConvention
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.metrics.association import Estimates, associate
from sfr_loc_map.metrics.config import AssociationConfig
from sfr_loc_map.metrics.convention import OPTICAL_IN_RB, converted_estimates, diagnose, disagreement

CAMERA = Transform(Rotation.from_euler("y", 20, degrees=True).as_matrix() @ OPTICAL_IN_RB, np.array([0.45, 0.12, 0.30]))
Poses = tuple[Any, Any, Any]


def rover(seed: int, frames: int = 300, noise: float = 1.0) -> tuple[Poses, Poses]:
    """A drive over rolling ground at changing speed, and an estimate with drift, in a world frame of its own."""
    rng = np.random.default_rng(seed)
    time = np.arange(frames) * 0.2
    phase = rng.uniform(0, 6.28, 6)
    speed = 0.15 + 0.1 * np.sin(0.35 * time + phase[0]) + 0.04 * np.sin(1.3 * time + phase[5])
    yaw = rng.uniform(-3, 3) + 1.2 * np.sin(0.13 * time + phase[1]) + 0.02 * rng.uniform(-1, 1) * time
    pitch = 0.08 * np.sin(0.5 * time + phase[2])
    roll = 0.08 * np.sin(0.4 * time + phase[3])
    true = Rotation.from_euler("ZYX", np.column_stack((yaw, pitch, roll)))
    moves = true.apply(np.column_stack((0.2 * speed, 0 * speed, 0 * speed)))
    positions = np.cumsum(moves, axis=0)
    turned = Rotation.from_rotvec(np.cumsum(rng.normal(0, 2e-4 * noise, (frames, 3)), axis=0))
    drifted = np.cumsum(
        turned.apply(moves * (1 + 2e-3 * noise * rng.normal())) + rng.normal(0, 3e-4 * noise, (frames, 3)), axis=0
    )
    world = Rotation.from_euler("z", rng.uniform(-3, 3))
    stamps = np.round(time * 1e9).astype(np.int64) + 1_700_000_000_000_000_000
    estimate = world.apply(drifted) + rng.normal(0, 3, 3), (world * turned * true).as_quat()
    return (stamps, positions, true.as_quat()), (stamps, *estimate)


def conjugated(poses: Poses) -> Poses:
    return poses[0], poses[1], poses[2] * [-1, -1, -1, 1]


def scalar_first(poses: Poses) -> Poses:
    return poses[0], poses[1], poses[2][:, [3, 0, 1, 2]]


def inverted(poses: Poses) -> Poses:
    turn = Rotation.from_quat(poses[2]).inv()
    return poses[0], -turn.apply(poses[1]), turn.as_quat()


def optical(poses: Poses) -> Poses:
    return poses[0], poses[1], (Rotation.from_quat(poses[2]) * Rotation.from_matrix(OPTICAL_IN_RB)).as_quat()


def optical_world_too(poses: Poses) -> Poses:
    axes = Rotation.from_matrix(OPTICAL_IN_RB)
    return poses[0], axes.inv().apply(poses[1]), (axes.inv() * Rotation.from_quat(poses[2]) * axes).as_quat()


def camera(poses: Poses) -> Poses:
    turn = Rotation.from_quat(poses[2])
    where = poses[1] + turn.apply(CAMERA.translation)
    return poses[0], where, (turn * Rotation.from_matrix(CAMERA.rotation)).as_quat()


def camera_place(poses: Poses) -> Poses:
    return poses[0], poses[1] + Rotation.from_quat(poses[2]).apply(CAMERA.translation), poses[2]


def millimetres(poses: Poses) -> Poses:
    return poses[0], poses[1] * 1000, poses[2]


def kilometres(poses: Poses) -> Poses:
    return poses[0], poses[1] / 1000, poses[2]


def late(poses: Poses) -> Poses:
    return poses[0] + 1_234_000_000, poses[1], poses[2]


def late_in_step(poses: Poses) -> Poses:
    return poses[0] - 800_000_000, poses[1], poses[2]


def other_clock(poses: Poses) -> Poses:
    return poses[0] - poses[0][0], poses[1], poses[2]


def swapped(poses: Poses) -> Poses:
    return poses[0], -poses[1], poses[2]


def mirrored(poses: Poses) -> Poses:
    return poses[0], poses[1] * [1, -1, 1], poses[2] * [-1, 1, -1, 1]


CASES: list[tuple[Callable[[Poses], Poses], str]] = [
    (conjugated, "conjugated quaternion"),
    (scalar_first, "scalar first"),
    (inverted, "inverted poses"),
    (optical, "optical axes"),
    (optical_world_too, "optical axes"),
    (camera, "left camera"),
    (camera_place, "left camera"),
    (millimetres, "millimetres"),
    (kilometres, "kilometres"),
    (late, "time offset"),
    (late_in_step, "time offset"),
    (other_clock, "time offset"),
    (swapped, "swapped left and right images"),
    (mirrored, "mirrored left and right"),
]


def found(estimate: Poses, truth: Poses, T_rb_left: Transform | None = None) -> tuple[str | None, str]:
    diagnosis = diagnose(Trajectory(*estimate), Trajectory(*truth), AssociationConfig(), T_rb_left)
    return (diagnosis.found.mismatch, diagnosis.found.sentence) if diagnosis.found else (None, "")


@pytest.mark.slow
@pytest.mark.parametrize("known_rig", [False, True])
@pytest.mark.parametrize(("mistake", "name"), CASES, ids=lambda item: getattr(item, "__name__", ""))
def test_each_mismatch_is_found_among_the_others(mistake: Callable[[Poses], Poses], name: str, known_rig: bool) -> None:
    for seed in range(2):
        truth, estimate = rover(seed)
        got, sentence = found(mistake(estimate), truth, CAMERA if known_rig else None)
        assert got == name, (seed, got, sentence)
        assert "\n" not in sentence


@pytest.mark.slow
@pytest.mark.parametrize(("mistake", "name"), CASES, ids=lambda item: getattr(item, "__name__", ""))
def test_the_setting_that_is_named_corrects_it(mistake: Callable[[Poses], Poses], name: str) -> None:
    truth, estimate = rover(2)
    config, true = AssociationConfig(), Trajectory(*truth)
    wrong = Trajectory(*mistake(estimate))
    diagnosis = diagnose(wrong, true, config)
    assert diagnosis.found is not None
    if name == "swapped left and right images":
        assert not diagnosis.found.setting  # nothing corrects images
        return
    convention = PoseConvention.parse([diagnosis.found.setting])
    corrected = converted_estimates(Estimates.of(wrong), convention, convention.T_rb_child(None), true).trajectory
    frames = associate(Estimates.of(corrected), true, config)[0]
    after = disagreement((frames.gt_pos, frames.gt_quat), (frames.est_pos, frames.est_quat))
    left, tolerance = diagnosis.found.disagreement, 0.2 if name == "time offset" else 1e-6
    assert after == pytest.approx(left, rel=tolerance)
    if name == "time offset":
        assert corrected.stamps_ns.tolist() == estimate[0].tolist()


@pytest.mark.slow
def test_a_correct_pair_is_never_accused() -> None:
    for seed in range(12):
        truth, estimate = rover(seed, noise=(0.0, 0.3, 1.0, 5.0)[seed % 4])
        assert found(estimate, truth, CAMERA if seed % 3 else None)[0] is None, seed


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["straight", "turning on the spot", "standing", "stop and go"])
def test_plain_drives_are_not_accused_either(kind: str) -> None:
    for seed in range(6):
        rng = np.random.default_rng(seed)
        frames = int(rng.integers(20, 400))
        step = np.full(frames, 0.0 if kind in ("turning on the spot", "standing") else 0.1)
        if kind == "stop and go":
            step[(np.arange(frames) // 20) % 2 == 0] = 0.0
        turn = np.full(frames, 0.02 if kind == "turning on the spot" else 0.0)
        true = Rotation.from_rotvec(np.column_stack((0 * turn, 0 * turn, np.cumsum(turn))))
        moves = true.apply(np.column_stack((step, 0 * step, 0 * step)))
        drift = Rotation.from_rotvec(np.cumsum(rng.normal(0, 3e-4, (frames, 3)), axis=0))
        wander = np.cumsum(drift.apply(moves) + rng.normal(0, 1e-3, (frames, 3)), axis=0)
        stamps = np.arange(frames) * 200_000_000
        truth = stamps, np.cumsum(moves, axis=0), true.as_quat()
        assert found((stamps, wander, (drift * true).as_quat()), truth, CAMERA if seed % 2 else None)[0] is None, seed


def test_a_bad_estimate_is_not_excused() -> None:
    """Pure noise has no single mistake."""
    for seed in range(5):
        truth, _ = rover(seed)
        rng = np.random.default_rng(seed)
        noise = truth[0], rng.normal(0, 3, (300, 3)), Rotation.random(300, random_state=seed).as_quat()
        assert found(noise, truth)[0] is None, seed


def test_the_time_offset_is_told() -> None:
    truth, estimate = rover(3)
    assert "-1.23" in found(late(estimate), truth)[1]


def test_a_few_poses_say_nothing() -> None:
    truth, estimate = rover(4, frames=5)
    assert found(millimetres(estimate), truth)[0] is None
