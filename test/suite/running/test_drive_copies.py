"""Copies of a drive are detected by their ground truth and images, so that they are not independent drives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from helpers.made_suites import JOB, straight
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.suite.running.drive_copies import DriveTrace, _trace, with_drives
from sfr_loc_map.suite.running.job import JobSource, SourceKind

RNG = np.random.default_rng(5)
TRUTH = straight(200, 0.01, 1)
GREY = tuple(RNG.integers(0, 255, 64).tolist())
ORIGINAL = _trace(TRUTH, GREY)


def moved(offset_m: object) -> Trajectory:
    return Trajectory(TRUTH.stamps_ns, TRUTH.positions + offset_m, TRUTH.quats_xyzw)


@pytest.mark.parametrize(
    ("trace", "is_copy"),
    [
        (_trace(moved(1e-9), GREY), True),
        (_trace(moved([3.0, -2.0, 1.0]), GREY), True),
        (_trace(moved(np.linspace(0.0, 0.009, 200)[:, None] * [1.0, 0.0, 0.0]), GREY), True),
        (_trace(TRUTH, tuple(level + 3 for level in GREY)), True),
        (_trace(moved(np.linspace(0.0, 0.012, 200)[:, None] * [1.0, 0.0, 0.0]), GREY), False),
        (_trace(TRUTH, tuple(RNG.integers(0, 255, 64).tolist())), False),
        (_trace(TRUTH), False),
        (_trace(straight(200, 0.01, 2), GREY), False),
        (_trace(straight(199, 0.01, 1), GREY), False),
    ],
)
def test_a_copy_is_known_by_its_path_and_its_images(trace: DriveTrace, is_copy: bool) -> None:
    assert trace.is_copy_of(ORIGINAL) is is_copy
    assert not DriveTrace().is_copy_of(DriveTrace()), "without ground truth nothing is known"


def test_a_turned_copy_is_a_copy() -> None:
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    poses = [TRUTH.pose(index) for index in range(len(TRUTH))]
    turned = Trajectory.from_poses(
        (int(stamp), replace(pose, rotation=turn @ pose.rotation, translation=turn @ pose.translation))
        for stamp, pose in zip(TRUTH.stamps_ns, poses, strict=True)
    )
    assert _trace(turned, GREY).is_copy_of(ORIGINAL)


def test_copies_name_one_drive_whatever_their_order() -> None:
    def source(kind: SourceKind, sha256: str) -> JobSource:
        return replace(JOB.source, kind=kind, sha256=sha256)

    traces = [_trace(moved(1e-6), GREY), ORIGINAL, _trace(straight(200, 0.01, 2), GREY)]
    files = [source(SourceKind.FILE, sha256) for sha256 in "cab"]
    drives = [item.drive for item in with_drives(files, traces)]
    assert drives == ["a", "a", "b"]
    assert [item.drive for item in with_drives(files[::-1], traces[::-1])] == drives[::-1]
    first, second, other = (replace(JOB, source=item) for item in with_drives(files, traces))
    assert first.drive_key == second.drive_key != other.drive_key
    assert first.key != second.key, "each is run"
    simulated = [source(SourceKind.SIMULATED, sha256) for sha256 in "cab"]
    assert [item.drive for item in with_drives(simulated, [DriveTrace()] * 3)] == ["c", "a", "b"]
