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


def test_a_localiser_starts_at_the_pose_and_allows_for_the_time_since() -> None:
    start = KNOWN.start
    assert (start.T_ds_rb, start.stamp_ns) == (POSE, KNOWN.stamp_ns)
    np.testing.assert_array_equal(start.covariance, KNOWN.covariance)
