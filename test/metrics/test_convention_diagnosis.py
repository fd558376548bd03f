"""Each mistake is found among the others and its setting corrects it; a correct pair is never accused."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.honest_drives import honest_drive, positions_of
from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.stereo import OPTICAL_IN_BODY, StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory, Truth
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.metrics.config import AssociationConfig
from sfr_loc_map.metrics.conventions.convention_diagnosis import diagnose
from sfr_loc_map.metrics.conventions.disagreement import MAX_POSES, compared_poses, disagreements
from sfr_loc_map.metrics.conventions.pose_convention import PoseConvention, converted_estimates
from sfr_loc_map.metrics.frames.association import Estimates, associate
from sfr_loc_map.metrics.frames.covariance import UPPER

TILTED = Rotation.from_euler("y", 20, degrees=True).as_matrix()
CAMERA = Transform(TILTED @ OPTICAL_IN_BODY, np.array([0.45, 0.12, 0.30]))
RIG = StereoRig(640, 480, 500.0, 500.0, 320.0, 240.0, 0.2)
RIG = replace(RIG, T_rb_sb=CAMERA @ RIG.T_sb_left.inverse())
OPTICAL = Rotation.from_matrix(OPTICAL_IN_BODY)
OF_CAMERA = (*CAMERA.translation, *CAMERA.quat_xyzw)
Poses = tuple[Any, Any, Any]


def rover(seed: int, frames: int = 300, noise: float = 1.0, kind: str = "rolling") -> tuple[Poses, Poses]:
    """A drive, over rolling ground at changing speed or plain, and an estimate with drift in a world of its own."""
    rng = np.random.default_rng(seed)
    time, phase = np.arange(frames) * 0.2, rng.uniform(0, 6.28, 6)
    speed = 0.15 + 0.1 * np.sin(0.35 * time + phase[0]) + 0.04 * np.sin(1.3 * time + phase[5])
    yaw = rng.uniform(-3, 3) + 1.2 * np.sin(0.13 * time + phase[1]) + 0.02 * rng.uniform(-1, 1) * time
    angles = np.column_stack((yaw, 0.08 * np.sin(0.5 * time + phase[2]), 0.08 * np.sin(0.4 * time + phase[3])))
    if kind != "rolling":
        speed = np.full(frames, 0.0 if kind in ("turning on the spot", "standing") else 0.5)
        speed[(np.arange(frames) // 20) % 2 == 0] *= kind != "stop and go"
        angles = np.column_stack((0.1 * time * (kind == "turning on the spot"), 0 * time, 0 * time))
    true = Rotation.from_euler("ZYX", angles)
    moves = true.apply(np.column_stack((0.2 * speed, 0 * speed, 0 * speed)))
    turned = Rotation.from_rotvec(np.cumsum(rng.normal(0, 2e-4 * noise, (frames, 3)), axis=0))
    steps = turned.apply(moves * (1 + 2e-3 * noise * rng.normal())) + rng.normal(0, 3e-4 * noise, (frames, 3))
    world = Rotation.from_euler("z", rng.uniform(-3, 3))
    stamps = np.round(time * 1e9).astype(np.int64) + 1_700_000_000_000_000_000
    estimate = world.apply(np.cumsum(steps, axis=0)) + rng.normal(0, 3, 3), (world * turned * true).as_quat()
    return (stamps, np.cumsum(moves, axis=0), true.as_quat()), (stamps, *estimate)


def of_camera(s: Any, p: Any, q: Any, turn: Rotation) -> Poses:
    return s, p + Rotation.from_quat(q).apply(CAMERA.translation), (Rotation.from_quat(q) * turn).as_quat()


def inverted_motions(s: Any, p: Any, q: Rotation) -> Poses:
    return s, p[0] + (q[0] * q.inv()).apply(p[0] - p), (q[0] * q.inv() * q[0]).as_quat()


CASES: dict[str, tuple[Callable[..., Poses], str]] = {
    "conjugated": (lambda s, p, q: (s, p, q * [-1, -1, -1, 1]), "conjugated quaternion"),
    "scalar_first": (lambda s, p, q: (s, p, q[:, [3, 0, 1, 2]]), "scalar first"),
    "inverted": (
        lambda s, p, q: (s, -Rotation.from_quat(q).inv().apply(p), Rotation.from_quat(q).inv().as_quat()),
        "inverted poses",
    ),
    "inverted_motions": (lambda s, p, q: inverted_motions(s, p, Rotation.from_quat(q)), "inverted motions"),
    "optical": (lambda s, p, q: (s, p, (Rotation.from_quat(q) * OPTICAL).as_quat()), "optical axes"),
    "camera": (lambda s, p, q: of_camera(s, p, q, Rotation.from_matrix(CAMERA.rotation)), "left camera"),
    "camera_place": (lambda s, p, q: of_camera(s, p, q, Rotation.identity()), "left camera"),
    "millimetres": (lambda s, p, q: (s, p * 1000, q), "millimetres"),
    "late": (lambda s, p, q: (s + 1_234_000_000, p, q), "time offset"),
    "other_clock": (lambda s, p, q: (s - s[0], p, q), "time offset"),
    "swapped": (lambda s, p, q: (s, -p, q), "swapped left and right images"),
    "ned": (lambda s, p, q: (s, p * [1, -1, -1], q * [1, -1, -1, 1]), "axes of NED"),
    "mirrored": (lambda s, p, q: (s, p * [1, -1, 1], q * [-1, 1, -1, 1]), "mirrored left and right"),
}


def found(estimate: Poses, truth: Poses, rig: StereoRig | None = None) -> tuple[str | None, str]:
    diagnosis = diagnose(Trajectory(*estimate), Trajectory(*truth), AssociationConfig(), rig)
    return (diagnosis.found.mismatch, diagnosis.found.sentence) if diagnosis.found else (None, "")


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_each_mismatch_is_found_among_the_others_and_its_setting_corrects_it(case: str) -> None:
    mistake, name = CASES[case]
    config = AssociationConfig()
    for seed, rig in enumerate((RIG, None)):
        truth, estimate = rover(seed, 150)
        true, wrong = Trajectory(*truth), Trajectory(*mistake(*estimate))
        diagnosis = diagnose(wrong, true, config, rig)
        names = [item.mismatch for item in diagnosis.hypotheses]
        assert len(set(names)) == len(names), "the names of the hypotheses are unique"
        hypothesis = diagnosis.found
        assert hypothesis is not None
        expected = "another point" if name == "left camera" and rig is None else name
        point, _, axes = hypothesis.mismatch.partition(", ")
        assert (point, bool(axes)) == (expected, name == "left camera"), (seed, hypothesis)
        assert "\n" not in hypothesis.sentence
    if name == "swapped left and right images":
        assert not hypothesis.setting  # nothing corrects images
        return
    convention = PoseConvention.parse([hypothesis.setting])
    corrected = converted_estimates(Estimates.of(wrong), convention, convention.T_rb_child(None), true).trajectory
    frames = associate(corrected, true, config)[0]
    after = np.mean(disagreements((frames.true_position, frames.true_attitude), (frames.position, frames.attitude)))
    assert after == pytest.approx(hypothesis.disagreement, rel=0.2 if name == "time offset" else 1e-6)
    assert name != "time offset" or corrected.stamps_ns.tolist() == estimate[0].tolist()


def test_inverted_motions_refer_to_the_first_pose_of_the_estimate_also_if_it_has_no_true_pose() -> None:
    truth, estimate = rover(3)
    late = tuple(column[60:] for column in truth)
    assert found(CASES["inverted_motions"][0](*estimate), late)[0] == "inverted motions"


def test_extrinsics_that_the_convention_does_not_accept_are_not_proposed() -> None:
    """Estimate and truth are in millimetres, so that the lever arm of the camera is hundreds of units."""
    (stamps, positions, quats), estimate = rover(3)
    _, of_camera_mm, attitudes = CASES["camera"][0](*estimate)
    in_mm = Trajectory(stamps, 1000.0 * of_camera_mm, attitudes)
    hypothesis = diagnose(in_mm, Trajectory(stamps, 1000.0 * positions, quats), AssociationConfig()).found
    assert hypothesis is not None
    assert (hypothesis.mismatch, hypothesis.setting) == ("another point, tilted optical axes", "")


def test_the_disagreement_of_an_offset_is_that_of_its_setting() -> None:
    """The offset to the exact stamps of the truth is preferred to the nearest offset of the grid."""
    truth, (stamps, *poses) = rover(0)
    config, true, late = AssociationConfig(), Trajectory(*truth), Trajectory(stamps + 1_234_000_000, *poses)
    hypothesis = diagnose(late, true, config).found
    assert hypothesis is not None
    assert hypothesis.setting == "time_offset_ns=-1234000000"
    last = len(stamps) - 1  # without the last pose, after which the truth cannot be interpolated
    of_truth = (true.positions[:last], true.quats_xyzw[:last])
    expected = np.mean(disagreements(of_truth, (late.positions[:last], late.quats_xyzw[:last])))
    assert hypothesis.disagreement == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_poses_of_the_pair_before_are_named(noise: float) -> None:
    truth, (stamps, *poses) = rover(5, 100, noise)
    late = (stamps, *(np.concatenate((each[:1], each[:-1])) for each in poses))
    got, sentence = found(late, truth)
    assert got == "time offset"
    assert "add -0.200 s (-1 periods)" in sentence
    assert found((stamps, *poses), truth)[0] is None


@pytest.mark.parametrize("seed", range(4))
def test_quaternions_of_the_truth_that_are_scalar_first_are_not_blamed_on_the_estimate(seed: int) -> None:
    (stamps, positions, quats), estimate = rover(seed)
    name, sentence = found(estimate, (stamps, positions, quats[:, [3, 0, 1, 2]]), RIG if seed % 2 else None)
    assert (name, sentence.partition(":")[0]) == ("truth scalar first", "the truth looks wrong")


WRONG_TRUTHS: dict[str, tuple[Callable[..., Poses], str]] = {
    "optical": (CASES["optical"][0], "truth with optical axes"),
    "camera": (CASES["camera"][0], "truth of a camera, tilted optical axes"),
    "conjugated": (CASES["conjugated"][0], "truth with conjugated quaternions"),
    "inverted": (CASES["inverted"][0], "inverted truth"),
    "feet": (lambda s, p, q: (s, p / 0.3048, q), "truth in feet"),
}


@pytest.mark.parametrize("case", WRONG_TRUTHS)
def test_a_wrong_truth_is_not_blamed_on_the_estimate(case: str) -> None:
    mistake, name = WRONG_TRUTHS[case]
    for seed in range(3):
        truth, estimate = rover(seed, 150)
        assert found(estimate, mistake(*truth))[0] == name


@pytest.mark.parametrize("side", ["estimate", "truth"])
def test_gps_time_is_found_although_estimate_and_truth_overlap(side: str) -> None:
    """The stamps of GPS time are 18 s ahead of UTC; the drive is longer."""
    truth, (stamps, *poses) = rover(2, 600)
    ahead_ns = 18 * NS_PER_S * (1 if side == "estimate" else -1)
    assert found((stamps + ahead_ns, *poses), truth)[1].count(f"add {-ahead_ns / NS_PER_S:+.3f} s") == 1


OF_POSITIONS: dict[str, tuple[Callable[[Any, Any], Any], str]] = {
    "as it is": (lambda s, p: (s, p), ""),
    "millimetres": (lambda s, p: (s, 1e3 * p), "truth in millimetres"),
    "kilometres": (lambda s, p: (s, 1e-3 * p), "truth in kilometres"),
    "feet": (lambda s, p: (s, p / 0.3048), "truth in feet"),
    "x and y exchanged": (lambda s, p: (s, p[:, [1, 0, 2]]), "left-handed truth"),
    "depths": (lambda s, p: (s, p * [1, 1, -1]), "left-handed truth"),
    "axes in another order": (lambda s, p: (s, p[:, [1, 2, 0]]), ""),
    "late": (lambda s, p: (s + 1_500_000_000, p), "time offset"),
    "GPS time": (lambda s, p: (s + 18 * NS_PER_S, p), "time offset"),
}


@pytest.mark.parametrize("has_tilt", [True, False])
@pytest.mark.parametrize("case", OF_POSITIONS)
def test_positions_alone_show_units_left_handed_axes_and_late_stamps(case: str, has_tilt: bool) -> None:
    mistake, name = OF_POSITIONS[case]
    for seed in range(3):
        (stamps, positions, quats), estimate = rover(seed, 600)
        positions = positions + np.column_stack((np.zeros((600, 2)), 0.3 * np.sin(0.02 * np.arange(600))))
        made = (estimate[0], estimate[1] * 0 + Rotation.from_euler("z", 1.0).apply(positions), estimate[2])
        true = Truth(*mistake(stamps, positions), 0 * quats if has_tilt else quats, has_tilt=has_tilt)
        noise = np.random.default_rng(seed).normal(0.0, 1e-3, positions.shape)
        diagnosis = diagnose(Trajectory(made[0], made[1] + noise, made[2]), true, AssociationConfig())
        assert (diagnosis.found.mismatch if diagnosis.found else "") == name


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["rolling", "straight", "turning on the spot", "standing", "stop and go"])
def test_a_correct_pair_is_never_accused(kind: str) -> None:
    for seed, noise in enumerate((0.0, 0.3, 1.0, 5.0)):
        truth, estimate = rover(seed, 20 + 100 * seed, noise, kind)
        assert found(estimate, truth, RIG if seed % 3 else None)[0] is None, seed


@pytest.mark.parametrize("true_noise_m", [0.0, 1e-6, 1e-4, 1e-3])
def test_noise_at_standstill_is_not_a_unit(true_noise_m: float) -> None:
    """A truth that is less noisy than the estimate made millimetres explain the noise, because they remove it."""
    (stamps, _, quats), (_, _, turned) = rover(5, kind="standing")
    rng = np.random.default_rng(9)
    truth = Trajectory(stamps, rng.normal(0, 1, (len(stamps), 3)) * true_noise_m, quats)
    estimate = Trajectory(stamps, rng.normal(0, 1e-3, (len(stamps), 3)), turned)
    assert diagnose(estimate, truth, AssociationConfig(), RIG).found is None


def test_no_honest_drive_is_accused() -> None:
    """Two drives of each kind of `honest_drive`; the campaign `honest-drives` has 1000 drives."""
    for seed in range(16):
        kind, estimate, truth = honest_drive(seed)
        for known in (truth, positions_of(truth)):
            diagnosis = diagnose(estimate, known, AssociationConfig(), RIG if seed % 3 else None, every=False)
            assert diagnosis.found is None, (kind, seed)


# ---- converted estimates


WORLD = Transform(Rotation.from_euler("xyz", [0.7, -0.2, 2.0]).as_matrix(), np.array([3.0, 9.0, -1.0]))
COUNT = 12
TRUTH = Trajectory(
    np.arange(COUNT) * 100,
    np.cumsum(np.random.default_rng(1).normal(0, 1, (COUNT, 3)), axis=0),
    Rotation.random(COUNT, random_state=2).as_quat(),
)
CAMERA_POSES = Trajectory.from_poses((k * 100, WORLD @ TRUTH.pose(k) @ CAMERA) for k in range(COUNT))
"""The same drive, written by a node of the camera in a world frame of its own."""


def test_the_covariance_is_that_of_sampled_poses() -> None:
    """Law: perturb the camera's pose by its covariance, convert, and the scatter of RB is the converted covariance."""
    rng = np.random.default_rng(5)
    root, camera, count = rng.normal(0, 1e-4, (6, 6)), CAMERA_POSES.pose(3), 4000
    noise = rng.normal(0, 1, (count, 6)) @ root.T
    quats = (Rotation.from_rotvec(noise[:, 3:]) * Rotation.from_matrix(camera.rotation)).as_quat()
    sampled = Trajectory(np.arange(count), camera.translation + noise[:, :3], quats)
    covariance = np.tile((root @ root.T)[UPPER], (count, 1))
    convention = PoseConvention(extrinsics=OF_CAMERA)
    found = converted_estimates(Estimates.of(sampled, covariance=covariance), convention, CAMERA, None)
    mean = Rotation.from_quat(found.trajectory.quats_xyzw).mean()
    turns = (Rotation.from_quat(found.trajectory.quats_xyzw) * mean.inv()).as_rotvec()
    scatter = np.cov(np.hstack((found.trajectory.positions, turns)).T)
    assert found.covariance is not None
    full = np.zeros((6, 6))
    full[UPPER] = found.covariance[0]
    full = full + np.triu(full, 1).T
    np.testing.assert_allclose(scatter, full, atol=0.1 * np.abs(full).max())
    assert np.abs(full - root @ root.T).max() > 0.3 * np.abs(full).max()  # the lever arm matters here


@pytest.mark.parametrize(("metres", "unit"), [(1e-3, "kilometres"), (1e3, "millimetres")])
def test_a_unit_of_the_truth_is_not_corrected_in_the_estimate(metres: float, unit: str) -> None:
    """In the unit of the truth, an estimate that misses a limit in metres would meet it."""
    (stamps, positions, quats), estimate = rover(1)
    truth = Trajectory(stamps, metres * positions, quats)
    found = diagnose(Trajectory(*estimate), truth, AssociationConfig()).found
    assert found is not None
    assert (found.mismatch, found.setting) == (f"truth in {unit}", "")


def test_a_long_estimate_is_decimated_to_the_maximum_number_of_poses() -> None:
    count = 2 * MAX_POSES - 1
    poses = Trajectory(np.arange(count), np.zeros((count, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)))
    compared = compared_poses(poses, poses, AssociationConfig(), None)
    assert (len(compared.estimate), len(compared.truth)) == (MAX_POSES, count)


def test_a_diagnosis_requires_attitudes_of_the_estimate() -> None:
    truth, _ = (Trajectory(*poses) for poses in rover(1))
    bare = replace(truth, quats_xyzw=np.zeros_like(truth.quats_xyzw))
    for true in (bare, truth):
        with pytest.raises(MetricsError, match="only positions"):
            diagnose(bare, true, AssociationConfig())
