"""Known answers of every layout of files; MADMAX, Katwijk and LuSNAR by their descriptions, without their files."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import cv2
import made_layouts as made
import numpy as np
import pytest
from made_worlds import World, assert_same_pairs, blob, centre_of, write_folder
from scipy.io import savemat

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.rover_data_sets import _load_struct, load_cameras
from sfr_loc_map.io.sequence import LocSequence


def opened(path: Path, name: str) -> LocSequence:
    source = open_source(path)
    assert (source.format, source.nav, source.left_out) == (name, None, 0)
    return source.loc


def first_pixels(loc: LocSequence) -> list[tuple[int, int, int]]:
    return [(pair.stamp_ns, int(pair.left[0, 0]), int(pair.right[0, 0])) for pair in loc.pairs()]


def test_one_task_lies_in_the_folder_itself(tmp_path: Path, world: World) -> None:
    loc = open_source(write_folder(tmp_path / "loc_only", world, nav=False))
    nav = open_source(write_folder(tmp_path / "nav_only", world, loc=False))
    assert (loc.format, loc.nav, nav.loc) == ("sfr", None, None)
    assert (tmp_path / "loc_only" / "groundtruth.csv").exists()
    assert_same_pairs(loc.loc.pairs(), world.pairs)
    assert_same_pairs((item.pair for item in nav.nav.pairs()), (item.pair for item in world.navs))


def test_colour_and_16_bit_images_become_grey(tmp_path: Path, world: World) -> None:
    folder = write_folder(tmp_path / "a", world, nav=False)
    grey16 = np.full((16, 24), 65535, np.uint16)
    grey16[:, :12] = 257 * 7 + 128  # 7.498 -> 7
    cv2.imwrite(str(folder / "left/000000.png"), grey16)
    cv2.imwrite(str(folder / "right/000000.png"), np.full((16, 24, 3), (0, 200, 0), np.uint8))  # 0.587 * 200 = 117.4
    pair = next(open_source(folder).loc.pairs())
    assert (np.unique(pair.left).tolist(), np.unique(pair.right).tolist()) == ([7, 255], [117])


def test_kitti_has_the_known_answer(tmp_path: Path) -> None:
    loc = opened(made.write_kitti(tmp_path / "00"), "kitti")
    assert loc.rig.same_cameras(StereoRig(20, 16, 700.0, 700.0, 10.0, 8.0, 0.54))
    assert first_pixels(loc) == [(0, 0, 1), (103_622_400, 10, 11), (207_291_100, 20, 21)]
    truth = loc.ground_truth
    np.testing.assert_allclose(truth.positions[:2], [[0, 0, 0], [2, 0, 0]], atol=1e-15)  # z of the camera is x of RB
    # The left camera is at (0, b/2, 0) in SB. Turned by +0.5 about z, the SB origin is at c - R (0, b/2, 0).
    wanted = np.array([4.0, 1.0 + 0.27, 0.25]) - matrix_from_rotvec([0, 0, 0.5]) @ [0, 0.27, 0]
    np.testing.assert_allclose(truth.positions[2], wanted, atol=1e-14)
    np.testing.assert_allclose(truth.pose(2).rotation, matrix_from_rotvec([0, 0, 0.5]), atol=1e-14)


def test_kitti_colour_cameras_and_poses_folder(tmp_path: Path) -> None:
    folder = made.write_kitti(tmp_path / "sequences" / "07", (2, 3))
    (tmp_path / "poses").mkdir()
    (folder / "poses.txt").rename(tmp_path / "poses" / "07.txt")
    loc = open_source(folder).loc
    assert loc.rig.baseline_m == 0.54
    # Camera 2 is 0.06 m left of camera 0 (P2[3] = 42 = -700 * -0.06): the bench turns about another point.
    turn, to_left, half = matrix_from_rotvec([0, 0, 0.5]), np.array([0, 0.06, 0]), np.array([0, 0.27, 0])
    wanted = np.array([4.0, 1.0, 0.25]) + turn @ to_left - to_left + half - turn @ half
    np.testing.assert_allclose(loc.ground_truth.positions[2], wanted, atol=1e-14)


def test_euroc_has_the_known_answer(tmp_path: Path) -> None:
    """A point of the world, put where the distorted cameras see it, must come out where the rectified ones do."""
    folder = made.write_euroc(tmp_path / "V1")
    point = np.array([0.3, 0.25, 2.0])
    for camera, place in made.EUROC_CAMERAS_M.items():
        at = cv2.projectPoints(point - place, np.zeros(3), np.zeros(3), made.EUROC_K, made.EUROC_D)[0].reshape(2)
        for path in (folder / "mav0" / camera / "data").iterdir():
            cv2.imwrite(str(path), blob(at, (48, 64)))
    loc = opened(folder, "euroc")
    rig, truth = loc.rig, loc.ground_truth
    assert len(loc) == 2  # the middle stamps differ by a nanosecond
    assert rig.baseline_m == pytest.approx(0.11, abs=1e-12)
    # The bench is midway between the cameras; its x is along their view (z of B), its y to the left (-x of B).
    for on_bench, in_body in (([0, 0, 0], [0.105, -0.02, 0.5]), ([1, 0.055, 0], [0.05, -0.02, 1.5])):
        np.testing.assert_allclose(rig.T_rb_sb.apply(on_bench), in_body, atol=1e-9)
    assert truth.stamps_ns.tolist() == [1403636579763555585, 1403636579768555585]
    np.testing.assert_allclose(truth.pose(0).rotation, matrix_from_rotvec(made.EUROC_ROTVEC), atol=1e-14)
    seen = rig.T_rb_left.inverse().apply(point)
    u, v, _ = rig.camera_matrix @ seen / seen[2]
    pair = next(loc.pairs())
    for image, column in ((pair.left, u), (pair.right, u - rig.fx * rig.baseline_m / seen[2])):
        np.testing.assert_allclose(centre_of(image), [column, v], atol=0.15)


@pytest.mark.parametrize("inverse", [False, True])
def test_madmax_has_the_known_answer_whichever_way_its_transforms_are_written(tmp_path: Path, inverse: bool) -> None:
    loc = opened(made.write_madmax(tmp_path / "A-0", inverse=inverse), "madmax")
    assert first_pixels(loc) == [(made.MADMAX_STAMPS[0], 0, 1), (made.MADMAX_STAMPS[1], 10, 11)]
    assert (loc.rig.width, loc.rig.height, loc.rig.fx, loc.rig.cx, loc.rig.cy) == (64, 48, 868.246, 31, 23)
    assert loc.rig.baseline_m == pytest.approx(made.MADMAX_BASELINE_M, abs=1e-12)
    T_b_left = made.MADMAX_T_IMU_B.inverse() @ made.MADMAX_T_IMU_LEFT
    np.testing.assert_allclose(loc.rig.T_rb_left.matrix, T_b_left.matrix, atol=1e-12)
    truth = loc.ground_truth
    assert truth.stamps_ns.tolist() == [1544000000120000000, 1544000000220000000]
    assert truth.positions.tolist() == [[1, 2, 3], [1.5, 2, 3]]
    np.testing.assert_allclose(truth.pose(1).rotation, np.diag([-1.0, -1.0, 1.0]), atol=1e-15)


def test_madmax_as_other_archives_unpack_it(tmp_path: Path) -> None:
    run = made.write_madmax(tmp_path / "A-0")
    for old, new in (
        ("img_rect_left", "rect_left"),
        ("img_rect_right", "rect_right"),
        ("ground_truth", "A_ground_truth"),
    ):
        (run / old).rename(run / new)
    (tmp_path / "calibration").rename(run / "calibration")
    (run / "calibration" / "tf__imu_to_B.csv").unlink()
    (run / "rect_left" / f"img_rect_left_{made.MADMAX_STAMPS[0]}.png").unlink()
    source = open_source(run)
    assert (len(source.loc.ground_truth), source.loc.rig.T_rb_sb) == (2, None)
    assert (len(source.loc), source.left_out) == (1, 1)
    (run / "rect_left" / "img_rect_left_1.5.png").write_bytes(b"")
    with pytest.raises(InputError, match=r"is not whole nanoseconds.*; rename or remove it"):
        open_source(run)
    (run / "rect_left" / "img_rect_left_1.5.png").unlink()
    (run / "calibration" / "camera_rect_left_info.txt").unlink()
    with pytest.raises(InputError, match=r"has no calibration/camera_rect_left_info\.txt"):
        open_source(run)


@pytest.mark.parametrize("compressed", [True, False])
def test_katwijk_has_the_known_answer(tmp_path: Path, compressed: bool) -> None:
    """A point put where the distorted cameras see it must have one row in both images, and its distance."""
    rotation = matrix_from_rotvec([0.01, -0.02, 0.015])
    part = made.write_katwijk(tmp_path / "Traverse1" / "Part1", compressed=compressed, rotation=rotation)
    first = np.array([0.3, 0.2, 2.0])
    second = first @ rotation + [-0.12, 0.0005, -0.0003]  # as MATLAB writes it, for rows
    for side, point in enumerate((first, second)):
        at = cv2.projectPoints(point, np.zeros(3), np.zeros(3), made.KATWIJK_K, made.KATWIJK_DISTORTION)[0].reshape(2)
        for path in (part / "LocCam").glob(f"*_{side}.png"):
            cv2.imwrite(str(path), cv2.merge([blob(at, (48, 64))] * 3))
    loc = opened(part, "katwijk")
    assert loc.rig.baseline_m == pytest.approx(np.linalg.norm([0.12, 0.0005, 0.0003]), abs=1e-9)
    assert loc.ground_truth is None
    (pair, other) = loc.pairs()
    moment = int(datetime(2015, 11, 26, 12, 53, 35, tzinfo=UTC).timestamp()) * 1000
    assert [pair.stamp_ns, other.stamp_ns] == [(moment + ms) * 10**6 for ms in (149, 349)]
    (u, v), (u_right, v_right) = centre_of(pair.left), centre_of(pair.right)
    assert v == pytest.approx(v_right, abs=0.1)
    depth = loc.rig.fx * loc.rig.baseline_m / (u - u_right)
    ray = np.array([(u - loc.rig.cx) / loc.rig.fx, (v - loc.rig.cy) / loc.rig.fy, 1.0])
    assert depth * np.linalg.norm(ray) == pytest.approx(np.linalg.norm(first), rel=0.05)


def test_matlab_counts_pixels_from_one_and_may_write_matrices_for_rows(tmp_path: Path) -> None:
    made.write_katwijk(tmp_path / "Part1")
    file = tmp_path / "LocCam_calibstruct.mat"
    np.testing.assert_array_equal(load_cameras(file, (64, 48))[0].k, made.KATWIJK_K)
    parameters = _load_struct(file)
    for camera in (parameters["CameraParameters1"], parameters["CameraParameters2"]):
        camera["IntrinsicMatrix"] = camera.pop("IntrinsicMatrixInternal").T
    savemat(file, {"stereoParams": parameters})
    np.testing.assert_array_equal(load_cameras(file, (64, 48))[1].k, made.KATWIJK_K)


def test_broken_katwijk(tmp_path: Path) -> None:
    part = made.write_katwijk(tmp_path / "Traverse1" / "Part1")
    calibration = tmp_path / "Traverse1" / "LocCam_calibstruct.mat"
    whole = calibration.read_bytes()
    cuts = ((b"MATLAB 5.0", "no header of a little-endian file"), (whole[: len(whole) // 2], "cut off"))
    for data, words in (*cuts, (whole[:130], "no struct 'stereoParams'")):
        calibration.write_bytes(data)
        with pytest.raises(InputError, match=words):
            open_source(part)
    wrong = ({"RotationOfCamera2": np.eye(2)}, "'RotationOfCamera2' has the shape")
    for content, words in (wrong, ({"x": np.zeros(5_000_000)}, "holds more than")):
        savemat(calibration, {"stereoParams": content}, do_compression=True)
        with pytest.raises(InputError, match=words):
            open_source(part)
    calibration.rename(calibration.with_name("LocCam_calibration.mat"))
    with pytest.raises(InputError, match=r"LocCam_calibration\.mat holds an object of MATLAB, save it again"):
        open_source(part)
    (part / "LocCam" / "LocCam_2015_11_26_12_53_35_5_0.png").write_bytes(b"")
    with pytest.raises(InputError, match="its name has another form"):
        open_source(part)


@pytest.mark.parametrize("described", [False, True])
def test_lusnar_has_the_known_answer(tmp_path: Path, described: bool) -> None:
    scene = made.write_lusnar(tmp_path / "Moon_1", described=described)
    loc = opened(scene, "lusnar")
    assert first_pixels(loc) == [(made.LUSNAR_STAMPS[0], 0, 1), (made.LUSNAR_STAMPS[1], 10, 11)]
    assert (loc.rig.width, loc.rig.fx, loc.rig.cx, loc.rig.baseline_m) == (1024, 610.17784, 511.5, 0.31)
    np.testing.assert_allclose(loc.rig.T_rb_left.translation, [1.0, 0.155, 1.5], atol=1e-12)
    down = np.radians(20)  # the cameras look down
    np.testing.assert_allclose(loc.rig.T_rb_left.rotation @ [0, 0, 1], [np.cos(down), 0, -np.sin(down)], atol=1e-12)
    np.testing.assert_allclose(loc.rig.T_rb_left.rotation @ [1, 0, 0], [0, -1, 0], atol=1e-12)
    truth = loc.ground_truth
    np.testing.assert_allclose(truth.pose(0).matrix, np.eye(4), atol=1e-15)
    np.testing.assert_allclose(truth.positions[1], [1, -2, 3])  # three metres up, two to the right
    np.testing.assert_allclose(truth.pose(1).rotation @ [1, 0, 0], [0, -1, 0], atol=1e-15)  # turned to the right
    cv2.imwrite(str(min(scene.rglob("*.png"))), np.zeros((16, 16), np.uint8))
    with pytest.raises(InputError, match="is 16 x 16: the published cameras of LuSNAR have 1024 x 1024"):
        open_source(scene)


@pytest.mark.shared
def test_development_data_opens(shared_data: Path) -> None:
    drive = open_source(shared_data / "dev-loc").loc
    assert (len(drive), drive.rig.fx, drive.rig.baseline_m) == (200, 402.0, 0.12)
    assert drive.ground_truth.positions[1].tolist() == [-5.699764609, -3.198718668, 0.443842408]
    assert drive.ground_truth.quats_xyzw[0].tolist() == [-0.070230739, 0.075815548, 0.303943373, 0.947068145]
    assert next(drive.pairs()).left.shape == (512, 512)
    nav = open_source(shared_data / "dev-nav").nav
    assert len(nav) == 3
    first = next(nav.pairs())
    # The truth of a pixel, seen from the left camera, must come out at that pixel.
    points = (first.T_lm_navsb @ nav.rig.T_sb_left).inverse().apply(first.truth[700, 300].astype(float))
    np.testing.assert_allclose(nav.rig.camera_matrix @ points / points[2], [300, 700, 1], atol=0.01)
    car = open_source(shared_data / "kitti-1").loc
    assert (car.rig.baseline_m, len(car)) == (0.5371506532679237, 51)
