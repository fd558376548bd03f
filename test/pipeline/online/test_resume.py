"""The pose kept for a restart."""

import json
from pathlib import Path

import numpy as np
import pytest

from sfr_loc_map.errors import InputError, OutputError
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.pipeline.online.resume import KnownPose, PoseFile

POSE = Transform(matrix_from_rotvec([0.1, -0.2, 0.3]), np.array([1.0, 2.0, 3.0]))
KNOWN = KnownPose(1_000_000_000, POSE, np.diag([0.1, 0.2, 0.3, 0.01, 0.02, 0.03]))


def test_a_pose_comes_back_to_the_last_digit_and_nothing_else_is_left(tmp_path: Path) -> None:
    file = PoseFile(tmp_path / "pose.json", 10.0)
    assert file.load(KNOWN.stamp_ns + 1) is None
    file.save(KNOWN)
    found = file.load(KNOWN.stamp_ns + 1)
    assert found is not None
    assert found.stamp_ns == KNOWN.stamp_ns
    assert np.allclose(found.T_ds_rb.translation, POSE.translation, rtol=0, atol=0)
    assert np.allclose(found.T_ds_rb.rotation, POSE.rotation, rtol=0, atol=1e-15)
    assert np.array_equal(found.covariance, KNOWN.covariance)
    assert [path.name for path in tmp_path.iterdir()] == ["pose.json"]


@pytest.mark.parametrize(
    ("age_ns", "taken"), [(-1, False), (0, False), (1, True), (10_000_000_000, True), (10_000_000_001, False)]
)
def test_only_a_young_pose_of_the_same_run_is_resumed_from(tmp_path: Path, age_ns: int, taken: bool) -> None:
    file = PoseFile(tmp_path / "pose.json", 10.0)
    file.save(KNOWN)
    assert (file.load(KNOWN.stamp_ns + age_ns) is not None) == taken


def test_a_step_that_was_not_seen_is_as_long_as_the_one_before() -> None:
    step = Transform(matrix_from_rotvec([0.0, 0.0, 0.05]), np.array([0.3, 0.0, 0.4]))
    known = KnownPose(2_000_000_000, POSE @ step, KNOWN.covariance).after_step(KNOWN)
    added = np.diag(known.covariance - KNOWN.covariance)
    assert np.allclose(added, [0.25, 0.25, 0.25, 0.0025, 0.0025, 0.0025])
    assert known.T_ds_rb is not POSE
    assert known.stamp_ns == 2_000_000_000


def broken() -> list[str]:
    good = {"stamp_ns": 1, "translation_m": [0, 0, 0], "quat_xyzw": [0, 0, 0, 1], "covariance": [0.0] * 36}
    changes = [
        {"stamp_ns": None},
        {"translation_m": [0, 0]},
        {"translation_m": [float("nan"), 0, 0]},
        {"quat_xyzw": [0, 0, 0, 0]},
        {"covariance": [0.0] * 35},
        {"covariance": [float("inf")] * 36},
    ]
    return ["", "{", "[]", "7", "[" * 100_000, *(json.dumps(good | change) for change in changes)]


@pytest.mark.parametrize("text", broken(), ids=range(len(broken())))
def test_a_broken_file_is_reported(tmp_path: Path, text: str) -> None:
    path = tmp_path / "pose.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match="cannot be read"):
        PoseFile(path, 10.0).load(2)


def test_a_file_that_cannot_be_written_is_reported_and_the_one_before_stays(tmp_path: Path) -> None:
    path = tmp_path / "pose.json"
    PoseFile(path, 10.0).save(KNOWN)
    (tmp_path / ".pose.json.part").mkdir()
    with pytest.raises(OutputError, match="an older pose"):
        PoseFile(path, 10.0).save(KnownPose(2_000_000_000, POSE, KNOWN.covariance))
    found = PoseFile(path, 10.0).load(KNOWN.stamp_ns + 1)
    assert found is not None
    assert found.stamp_ns == KNOWN.stamp_ns


def test_the_start_s_covariance_moves_later_poses_as_samples_of_it_do() -> None:
    """A start that is off by a small motion about fixed axes moves what is driven from it; sampled, not derived."""
    random = np.random.default_rng(3)
    root = 0.01 * random.normal(size=(6, 6))
    later = Transform(np.eye(3), POSE.translation + np.array([4.0, -2.0, 1.0]))
    known = KnownPose(0, POSE, root @ root.T)
    samples = random.normal(size=(200_000, 6)) @ root.T
    step = later.translation - POSE.translation
    moved = samples[:, :3] + np.cross(samples[:, 3:], step)
    expected = np.cov(np.column_stack((moved, samples[:, 3:])), rowvar=False)
    found = known.added_covariance(later)
    assert np.allclose(
        found, expected, rtol=0.02, atol=0.02 * np.sqrt(np.outer(np.diag(expected), np.diag(expected))).max()
    )
    assert np.array_equal(known.added_covariance(POSE), known.covariance)


def test_after_a_gap_the_pose_is_less_well_known() -> None:
    gap = KNOWN.after_gap()
    assert np.allclose(np.diag(gap.covariance - KNOWN.covariance), [1.0, 1.0, 0.09, 0.01, 0.01, 0.25])
