"""The pose kept for a restart."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from sfr_loc_map.errors import InputError, OutputError
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.estimate import StartPose
from sfr_loc_map.pipeline.localisation_session import PoseFile

POSE = Transform(matrix_from_rotvec([0.1, -0.2, 0.3]), np.array([1.0, 2.0, 3.0]))
RIG = StereoRig(160, 120, 150.0, 150.0, 79.5, 59.5, 0.12, Transform.identity())
STAMP = 1_000_000_000
KNOWN = StartPose(POSE, np.diag([0.1, 0.2, 0.3, 0.01, 0.02, 0.03]), STAMP)


def test_a_pose_comes_back_to_the_last_digit_and_nothing_else_is_left(tmp_path: Path) -> None:
    file = PoseFile(tmp_path / "pose.json", 10.0)
    assert file.load(STAMP + 1, RIG) is None
    file.save(KNOWN, RIG)
    found = file.load(STAMP + 1, RIG)
    assert found is not None
    assert found.stamp_ns == STAMP
    assert np.allclose(found.T_ds_rb.translation, POSE.translation, rtol=0, atol=0)
    assert np.allclose(found.T_ds_rb.rotation, POSE.rotation, rtol=0, atol=1e-15)
    assert np.array_equal(found.covariance, KNOWN.covariance)
    assert [path.name for path in tmp_path.iterdir()] == ["pose.json"]


@pytest.mark.parametrize(
    ("age_ns", "taken"), [(-1, False), (0, False), (1, True), (10_000_000_000, True), (10_000_000_001, False)]
)
def test_only_a_young_pose_of_the_same_run_is_resumed_from(tmp_path: Path, age_ns: int, taken: bool) -> None:
    file = PoseFile(tmp_path / "pose.json", 10.0)
    file.save(KNOWN, RIG)
    assert (file.load(STAMP + age_ns, RIG) is not None) == taken


def broken() -> list[str]:
    good: dict[str, object] = {
        "schema": "sfr-resume/1",
        "rig": RIG.fingerprint,
        "stamp_ns": 1,
        "translation_m": [0, 0, 0],
        "quat_xyzw": [0, 0, 0, 1],
        "covariance": np.eye(6).reshape(-1).tolist(),
    }
    changes: list[dict[str, object]] = [
        {"stamp_ns": None},
        {"stamp_ns": 1.5},
        {"stamp_ns": True},
        {"stamp_ns": -1},
        {"stamp_ns": 2**63},
        {"schema": "sfr-resume/2"},
        {"translation_m": [0, 0]},
        {"translation_m": ["0", 0, 0]},
        {"translation_m": [float("nan"), 0, 0]},
        {"translation_m": [1e300, 0, 0]},
        {"translation_m": {"0": 0}},
        {"quat_xyzw": [0, 0, 0, 0]},
        {"quat_xyzw": [0, 0, 0, 7]},
        {"covariance": [0.0] * 35},
        {"covariance": [float("inf")] * 36},
        {"covariance": (-np.eye(6)).reshape(-1).tolist()},
        {"covariance": np.arange(36.0).tolist()},
    ]
    digits = json.dumps(good).replace('"stamp_ns": 1', f'"stamp_ns": {"9" * 400}')
    version_0_1 = json.dumps({key: value for key, value in good.items() if key not in ("schema", "rig")})
    wrong = [json.dumps(good | change) for change in changes]
    return ["", "{", "[]", "7", "[" * 100_000, "\0" * 100, digits, version_0_1, json.dumps(good)[:-9], *wrong]


@pytest.mark.parametrize("text", broken(), ids=range(len(broken())))
def test_a_broken_file_is_reported(tmp_path: Path, text: str) -> None:
    path = tmp_path / "pose.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"cannot be read.*the file is replaced"):
        PoseFile(path, 10.0).load(2, RIG)


def test_damaged_poses_are_replaced_and_other_files_never(tmp_path: Path) -> None:
    path = tmp_path / "pose.json"
    PoseFile(path, 10.0).check()
    PoseFile(path, 10.0).save(KNOWN, RIG)
    whole = path.read_bytes()
    for ours in (whole, whole[:100], whole[:5], b"", bytes(4096), b'{"stamp_ns": 1, "translation_m": [0'):
        path.write_bytes(ours)
        PoseFile(path, 10.0).check()
    for foreign in (b"{}", b'{"width": 512}', b"years of work", b"\x89PNG", b"x" * 200_000):
        path.write_bytes(foreign)
        with pytest.raises(OutputError, match=r"holds no kept pose|larger than"):
            PoseFile(path, 10.0).check()
        assert path.read_bytes() == foreign
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    for name, words in (("folder", "it is a folder"), ("pipe", "a named pipe"), ("none/x", "there is no folder")):
        with pytest.raises(OutputError, match=words):
            PoseFile(tmp_path / name, 10.0).check()


def test_a_link_to_a_kept_pose_stays(tmp_path: Path) -> None:
    (tmp_path / "link.json").symlink_to("pose.json")
    PoseFile(tmp_path / "link.json", 10.0).save(KNOWN, RIG)
    assert (tmp_path / "link.json").is_symlink()
    assert PoseFile(tmp_path / "pose.json", 10.0).load(STAMP + 1, RIG) is not None


def test_a_pipe_in_the_way_does_not_wait(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / ".pose.json.part")
    with pytest.raises(OutputError, match="an older pose"):
        PoseFile(tmp_path / "pose.json", 10.0).save(KNOWN, RIG)


def test_a_file_that_cannot_be_written_is_reported_and_the_one_before_stays(tmp_path: Path) -> None:
    path = tmp_path / "pose.json"
    PoseFile(path, 10.0).save(KNOWN, RIG)
    (tmp_path / ".pose.json.part").mkdir()
    with pytest.raises(OutputError, match="an older pose"):
        PoseFile(path, 10.0).save(StartPose(POSE, KNOWN.covariance, 2 * STAMP), RIG)
    found = PoseFile(path, 10.0).load(STAMP + 1, RIG)
    assert found is not None
    assert found.stamp_ns == STAMP
