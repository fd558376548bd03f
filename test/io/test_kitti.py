"""The KITTI layout with known answers."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.io.registry import open_source

# Columns of P: fx = fy = 700, cx = 10, cy = 8, and -fx b with b = 0.54 m.
KITTI_CALIB = """P0: 7.0e+02 0 1.0e+01 0 0 7.0e+02 8 0 0 0 1 0
P1: 7.0e+02 0 1.0e+01 -3.78e+02 0 7.0e+02 8 0 0 0 1 0
P2: 7.0e+02 0 1.0e+01 4.2e+01 0 7.0e+02 8 0 0 0 1 0
P3: 7.0e+02 0 1.0e+01 -3.36e+02 0 7.0e+02 8 0 0 0 1 0
"""


def write_kitti(folder: Path, cameras: tuple[int, int] = (0, 1)) -> Path:
    for i, camera in enumerate(cameras):
        (folder / f"image_{camera}").mkdir(parents=True)
        for frame in range(3):
            image = np.full((16, 20), 10 * frame + i, np.uint8)
            cv2.imwrite(str(folder / f"image_{camera}" / f"{frame:06d}.png"), image)
    (folder / "calib.txt").write_text(KITTI_CALIB)
    (folder / "times.txt").write_text("0.000000e+00\n1.036224e-01\n2.072911e-01\n")
    turn = matrix_from_rotvec([0, -0.5, 0])  # about y of the camera (down) by -0.5: a turn to the left
    poses = [
        np.eye(3, 4),
        np.hstack((np.eye(3), [[0.0], [0.0], [2.0]])),
        np.hstack((turn, [[-1.0], [-0.25], [4.0]])),
    ]
    (folder / "poses.txt").write_text("\n".join(" ".join(map(repr, p.reshape(-1).tolist())) for p in poses) + "\n")
    return folder


def test_kitti_has_the_known_answer(tmp_path: Path) -> None:
    source = open_source(write_kitti(tmp_path / "00"))
    loc = source.loc
    assert (source.format, source.nav) == ("kitti", None)
    assert (loc.rig.width, loc.rig.height, loc.rig.fx, loc.rig.cx, loc.rig.cy) == (20, 16, 700, 10, 8)
    assert loc.rig.baseline_m == 0.54
    assert [(p.stamp_ns, p.left[0, 0], p.right[0, 0]) for p in loc.pairs()] == [
        (0, 0, 1),
        (103_622_400, 10, 11),
        (207_291_100, 20, 21),
    ]
    truth = loc.ground_truth
    np.testing.assert_allclose(truth.positions[0], 0, atol=1e-15)
    np.testing.assert_allclose(truth.positions[1], [2, 0, 0], atol=1e-15)  # z of the camera is x of RB
    # The left camera is at (0, b/2, 0) in SB. Turned by +0.5 about z, the SB origin is at c - R (0, b/2, 0).
    centre = np.array([4.0, 1.0 + 0.27, 0.25])
    wanted = centre - matrix_from_rotvec([0, 0, 0.5]) @ [0, 0.27, 0]
    np.testing.assert_allclose(truth.positions[2], wanted, atol=1e-14)
    np.testing.assert_allclose(truth.pose(2).rotation, matrix_from_rotvec([0, 0, 0.5]), atol=1e-14)


def test_kitti_colour_cameras_and_poses_folder(tmp_path: Path) -> None:
    folder = write_kitti(tmp_path / "sequences" / "07", (2, 3))
    (tmp_path / "poses").mkdir()
    (folder / "poses.txt").rename(tmp_path / "poses" / "07.txt")
    loc = open_source(folder).loc
    assert loc.rig.baseline_m == 0.54
    # Camera 2 is 0.06 m left of camera 0 (P2[3] = 42 = -700 * -0.06): the bench turns about another point.
    turn, to_left, half = matrix_from_rotvec([0, 0, 0.5]), np.array([0, 0.06, 0]), np.array([0, 0.27, 0])
    left = np.array([4.0, 1.0, 0.25]) + turn @ to_left - to_left
    wanted = left + half - turn @ half
    np.testing.assert_allclose(loc.ground_truth.positions[2], wanted, atol=1e-14)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("times.txt", "0\nx\n", "line 2: stamp 'x' is not a number of seconds"),
        ("times.txt", "", "no time"),
        ("times.txt", "0\n2\n1\n", "in order"),
        ("poses.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n", "1 poses for 3 times"),
        ("poses.txt", "1 0 0\n" * 3, "line 1: 3 columns found where 12"),
        ("poses.txt", "1 0 0 nan 0 1 0 0 0 0 1 0\n" * 3, "finite"),
        ("calib.txt", "P0: 1 2 3\n", "12 finite numbers"),
        ("calib.txt", KITTI_CALIB.splitlines()[0], r"P0 and P1 are needed"),
        ("calib.txt", KITTI_CALIB.replace("-3.78", "3.78"), "swapped"),
        ("calib.txt", KITTI_CALIB.replace("P1: 7.0e+02", "P1: 7.1e+02"), "differ"),
    ],
)
def test_broken_kitti(tmp_path: Path, name: str, text: str, words: str) -> None:
    folder = write_kitti(tmp_path / "00")
    (folder / name).write_text(text)
    with pytest.raises(InputError, match=words) as caught:
        open_source(folder)
    assert str(folder) in str(caught.value)
