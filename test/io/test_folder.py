"""Data set folders: round trip, and one error for each broken one."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from made_worlds import World, assert_is_world, assert_same_pairs, write_folder

from sfr_loc_map.errors import InputError
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.sequence import Source


def read_all(source: Source) -> None:
    for part in (source.loc, source.nav):
        for _ in part.pairs() if part is not None else ():
            pass


def test_round_trip_is_exact(folder: Path, world: World) -> None:
    source = open_source(folder)
    assert source.format == "sfr"
    assert_is_world(source, world)


def test_one_task_lies_in_the_folder_itself(tmp_path: Path, world: World) -> None:
    loc = open_source(write_folder(tmp_path / "loc_only", world, nav=False))
    nav = open_source(write_folder(tmp_path / "nav_only", world, loc=False))
    assert loc.nav is None
    assert nav.loc is None
    assert (tmp_path / "loc_only" / "groundtruth.csv").exists()
    assert_same_pairs(loc.loc.pairs(), world.pairs)
    assert "truth" in (tmp_path / "nav_only" / "pairs.csv").read_text().splitlines()[0]


def test_colour_and_16_bit_images_become_grey(folder: Path) -> None:
    grey16 = np.full((16, 24), 65535, np.uint16)
    grey16[:, :12] = 257 * 7 + 128  # 7.498 -> 7
    colour = np.zeros((16, 24, 3), np.uint8)
    colour[..., 1] = 200  # green: 0.587 * 200 = 117.4
    cv2.imwrite(str(folder / "loc/left/000000.png"), grey16)
    cv2.imwrite(str(folder / "loc/right/000000.png"), colour)
    loc = open_source(folder).loc
    pair = next(loc.pairs())
    assert np.unique(pair.left).tolist() == [7, 255]
    assert np.unique(pair.right).tolist() == [117]


def edit_rig(change: Callable[[dict[str, Any]], Any]) -> Callable[[Path], None]:
    def edit(folder: Path) -> None:
        path = folder / "loc" / "rig.json"
        content = json.loads(path.read_text())
        change(content)
        path.write_text(json.dumps(content))

    return edit


def edit_text(name: str, change: Callable[[str], str]) -> Callable[[Path], None]:
    return lambda folder: (folder / name).write_text(change((folder / name).read_text())) and None


def resize(folder: Path) -> None:
    cv2.imwrite(str(folder / "loc/right/000002.png"), np.zeros((16, 23), np.uint8))


def flip(folder: Path) -> None:
    path = folder / "loc/left/000001.png"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)


def swap_lines(text: str) -> str:
    head, first, second, *rest = text.splitlines()
    return "\n".join([head, second, first, *rest])


def edit_last_pose(x: str) -> Callable[[Path], None]:
    def edit(folder: Path) -> None:
        path = folder / "nav/pairs.csv"
        *rest, last = path.read_text().splitlines()
        words = last.split(",")
        words[3] = x
        path.write_text("\n".join([*rest, ",".join(words)]))

    return edit


BROKEN: dict[str, tuple[Callable[[Path], None], str]] = {
    "rig a list": (edit_text("loc/rig.json", lambda t: "[]"), "Expected `object`"),
    "key unknown": (edit_rig(lambda c: c.update(baseline=1)), "unknown field `baseline`"),
    "text for number": (
        edit_rig(lambda c: c.update(baseline_m="0.1")),
        r"Expected `float`, got `str` - at `\$.baseline_m`",
    ),
    "short k": (edit_rig(lambda c: c.update(k=[1, 2])), r"length 9, got 2 - at `\$.k`"),
    "skew": (edit_rig(lambda c: c["k"].__setitem__(1, 0.5)), "k is"),
    "baseline 0": (edit_rig(lambda c: c.update(baseline_m=0)), "baseline"),
    "pose without rotation": (edit_rig(lambda c: c["T_rb_locsb"].pop("quat_xyzw")), "quat_xyzw"),
    "quaternion 0": (edit_rig(lambda c: c["T_rb_locsb"].update(quat_xyzw=[0, 0, 0, 0])), "is not a rotation"),
    "strange header": (edit_text("loc/pairs.csv", lambda t: t.replace("left,", "Left,", 1)), "line 1"),
    "short line": (edit_text("loc/pairs.csv", lambda t: t + "5,a\n"), "line 6: 2 columns"),
    "backwards": (edit_text("loc/pairs.csv", swap_lines), "must be in order"),
    "truth missing": (lambda f: (f / "nav/truth/000000.npy").unlink(), r"a truth that is not there: .*000000.npy"),
    "size": (resize, r"000002.png' .*is 23 x 16.*24 x 16"),
    "flipped bytes": (flip, r"000001.png.*broken"),
    "stamp with underscore": (edit_text("loc/pairs.csv", lambda t: t.replace("\n17", "\n1_7", 1)), "line 2: stamp"),
    "position of 1e308": (edit_last_pose("1e308"), "line 3: a position is"),
    "principal point of 1e300": (edit_rig(lambda c: c["k"].__setitem__(5, 1e300)), "principal point"),
    "truth beyond the sky": (
        lambda f: np.save(f / "nav/truth/000000.npy", np.full((16, 26, 3), 1e30, np.float32)),
        r"truth .*000000.npy.*beyond 1e.09 m",
    ),
    "truth with a zero byte in its name": (
        edit_text("nav/pairs.csv", lambda text: text.replace("truth/000000.npy", "truth/\0.npy")),
        "names a truth that is not there",
    ),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_folder_is_one_error(folder: Path, name: str) -> None:
    edit, words = BROKEN[name]
    edit(folder)
    with pytest.raises(InputError, match=words) as caught:
        read_all(open_source(folder))
    assert "\n" not in str(caught.value)
    assert str(folder) in str(caught.value)


def test_unknown_things_say_what_is_sought(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"there is no '.*nope'"):
        open_source(tmp_path / "nope")
    (tmp_path / "photo.jpg").write_bytes(b"")
    with pytest.raises(InputError, match=r"no format.*pairs.csv.*KITTI.*found photo.jpg"):
        open_source(tmp_path)
    with pytest.raises(InputError, match="found a file"):
        open_source(tmp_path / "photo.jpg")


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
    assert car.rig.baseline_m == 0.5371506532679237
    assert len(car) == 51
