"""The EuRoC layout with known answers."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.rotation import matrix_from_rotvec, quat_from_matrix
from sfr_loc_map.io.registry import open_source


def sensor_yaml(x_m: float, y_m: float, width: int = 64) -> str:
    """Return a camera at (x, y, 0) in B, looking along z of B, pinhole with barrel distortion."""
    return f"""%YAML:1.0
# a comment
sensor_type: camera
T_BS:
  cols: 4
  rows: 4
  data: [1.0, 0.0, 0.0, {x_m}, 0.0, 1.0, 0.0, {y_m}, 0.0, 0.0, 1.0, 0.5, 0.0, 0.0, 0.0, 1.0]
rate_hz: 20
resolution: [{width}, 48]
camera_model: pinhole
intrinsics: [60.0, 61.0, 31.0, 24.5]
distortion_model: radial-tangential
distortion_coefficients: [-0.28, 0.07, 0.0002, 1.8e-05]
"""


def write_euroc(folder: Path) -> Path:
    for camera, x_m in (("cam0", 0.05), ("cam1", 0.16)):
        data = folder / "mav0" / camera / "data"
        data.mkdir(parents=True)
        (data.parent / "sensor.yaml").write_text(sensor_yaml(x_m, -0.02))
        stamps = [1403636579763555584, 1403636579813555456, 1403636579863555584]
        if camera == "cam1":
            stamps[1] += 1
        (data.parent / "data.csv").write_text(
            "#timestamp [ns],filename\r\n" + "".join(f"{stamp},{stamp}.png\r\n" for stamp in stamps)
        )
        for stamp in stamps:
            cv2.imwrite(str(data / f"{stamp}.png"), np.full((48, 64), 90, np.uint8))
    truth = folder / "mav0" / "state_groundtruth_estimate0"
    truth.mkdir()
    quat = quat_from_matrix(matrix_from_rotvec([0.1, 0.2, 0.3])).tolist()
    rest = ",".join(["0.0"] * 9)
    (truth / "data.csv").write_text(
        "#timestamp, p_RS_R_x [m], ...\n"
        f"1403636579763555585,1,2,3,{quat[3]!r},{quat[0]!r},{quat[1]!r},{quat[2]!r},{rest}\n"
        f"1403636579768555585,1,2,4,1,0,0,0,{rest}\n"
    )
    return folder


def test_euroc_has_the_known_answer(tmp_path: Path) -> None:
    source = open_source(write_euroc(tmp_path / "V1"))
    loc = source.loc
    assert source.format == "euroc"
    assert len(loc) == 2  # the middle stamps differ by a nanosecond
    assert loc.rig.baseline_m == pytest.approx(0.11, abs=1e-12)
    assert loc.rig.fx == loc.rig.fy
    # The bench is midway between the cameras; its x is along their view (z of B), its y to the left (-x of B).
    np.testing.assert_allclose(loc.rig.T_rb_sb.apply([0, 0, 0]), [0.105, -0.02, 0.5], atol=1e-12)
    np.testing.assert_allclose(loc.rig.T_rb_sb.apply([1, 0, 0]), [0.105, -0.02, 1.5], atol=1e-9)
    np.testing.assert_allclose(loc.rig.T_rb_sb.apply([0, 0.055, 0]), [0.05, -0.02, 0.5], atol=1e-9)
    truth = loc.ground_truth
    assert truth.stamps_ns.tolist() == [1403636579763555585, 1403636579768555585]
    np.testing.assert_allclose(truth.pose(0).rotation, matrix_from_rotvec([0.1, 0.2, 0.3]), atol=1e-14)
    assert all((pair.left == 90).all() and (pair.right == 90).all() for pair in loc.pairs())  # alpha 0: no black rim


def test_euroc_images_are_rectified(tmp_path: Path) -> None:
    """A point of the world, put where the distorted camera sees it, must come out where the rectified one does."""
    folder = write_euroc(tmp_path / "V1")
    rig = open_source(folder).loc.rig  # type: ignore[union-attr]
    k = np.array([[60.0, 0, 31.0], [0, 61.0, 24.5], [0, 0, 1]])
    for camera, x_m in (("cam0", 0.05), ("cam1", 0.16)):
        point = np.array([0.3, 0.25, 2.0]) - [x_m, -0.02, 0.5]
        distortion = np.array([-0.28, 0.07, 0.0002, 1.8e-05])
        u, v = cv2.projectPoints(point, np.zeros(3), np.zeros(3), k, distortion)[0].reshape(2)
        rows, columns = np.mgrid[:48, :64]
        blob = np.exp(-((columns - u) ** 2 + (rows - v) ** 2) / 8.0)
        for path in (folder / "mav0" / camera / "data").iterdir():
            cv2.imwrite(str(path), np.round(250 * blob).astype(np.uint8))
    pair = next(open_source(folder).loc.pairs())  # type: ignore[union-attr]
    assert rig.T_rb_sb is not None
    seen = rig.T_rb_left.inverse().apply([0.3, 0.25, 2.0])
    u, v, _ = rig.camera_matrix @ seen / seen[2]
    for image, column in ((pair.left, u), (pair.right, u - rig.fx * rig.baseline_m / seen[2])):
        weights = np.where(image > 20, image, 0).astype(float)
        rows, columns = np.mgrid[:48, :64]
        centre = [(weights * columns).sum() / weights.sum(), (weights * rows).sum() / weights.sum()]
        np.testing.assert_allclose(centre, [column, v], atol=0.15)


def test_broken_euroc(tmp_path: Path) -> None:
    folder = write_euroc(tmp_path / "V1")
    yaml, listing = folder / "mav0/cam1/sensor.yaml", folder / "mav0/cam0/data.csv"
    good = yaml.read_text(), listing.read_text()
    cases = [
        (yaml, good[0].replace("radial-tangential", "equidistant"), "equidistant"),
        (yaml, good[0].replace("intrinsics", "other"), "intrinsics"),
        (yaml, sensor_yaml(0.16, -0.02, width=63), "one size"),
        (yaml, sensor_yaml(-0.16, -0.02), "swapped"),
        (yaml, sensor_yaml(0.05, 0.2), "one above the other"),
        (listing, "#x\n12,a.png\n", "equal stamps"),
        (listing, "#x\n1.5,a.png\n", "'1.5'"),
    ]
    for path, text, words in cases:
        path.write_text(text)
        with pytest.raises(InputError, match=words):
            open_source(folder)
        path.write_text(good[0] if path is yaml else good[1])
    yaml.unlink()
    with pytest.raises(InputError, match="cam1"):
        open_source(folder)
