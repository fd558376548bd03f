"""Known answers of every layout of files."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from helpers import made_layouts as made
from helpers.made_scene import write_bag, write_folder
from helpers.made_worlds import blob, centre_of
from sfr_loc_map.faults.kinds import parse_fault
from sfr_loc_map.faults.source import faulty
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.sequence import LocSequence
from sfr_loc_map.io.source_config import SourceConfig, SyncConfig


class EmptySequence:
    """A drive without pairs."""

    def __len__(self) -> int:
        return 0

    def pairs(self) -> Iterator[Any]:
        return iter(())


def opened(path: Path, name: str) -> LocSequence:
    source = open_source(path)
    assert (source.format, source.nav, source.skipped_pairs) == (name, None, 0)
    return source.loc


def first_pixels(loc: LocSequence) -> list[tuple[int, int, int]]:
    return [(pair.stamp_ns, int(pair.left[0, 0]), int(pair.right[0, 0])) for pair in loc.pairs()]


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
    assert len(loc) == 3  # the middle stamps differ by a nanosecond
    assert len(open_source(folder, SourceConfig(sync=SyncConfig(stamp_tolerance_s=0.0))).loc) == 2
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


def test_the_paths_of_the_truth_are_the_source_its_links_and_the_file_that_is_named(tmp_path: Path) -> None:
    source = write_folder(tmp_path / "source", 2, 0)
    outside = (source / "groundtruth.csv").rename(tmp_path / "linked.csv")
    (source / "groundtruth.csv").symlink_to(outside)
    image = (source / "left/000000.png").rename(tmp_path / "image.png")
    (source / "left/000000.png").symlink_to(image)
    assert set(open_source(source).truth_paths()) == {source, outside}
    named = tmp_path / "station.csv"
    named.write_text(outside.read_text())
    (source / "sfr.yaml").write_text("truth: {source: ../station.csv}\n")
    assert set(open_source(source).truth_paths()) == {source, outside, named}
    changed = faulty(open_source(source), [parse_fault("late:share=1,amount=0.1")])
    assert set(changed.truth_paths()) == {source, outside, named}


def test_a_source_with_an_empty_drive_has_no_pairs(tmp_path: Path) -> None:
    source = open_source(write_folder(tmp_path / "source", 2, 3))
    empty: Any = EmptySequence()
    source = replace(source, loc=empty)
    assert len(source) == len(list(source)) == 0
    source = replace(source, loc=None)
    assert len(source) == len(list(source)) == 3


def test_the_poses_beside_a_kitti_sequence_are_paths_of_its_truth(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sequence = made.write_kitti(tmp_path / "sequences" / "00")
    (tmp_path / "poses").mkdir()
    poses = (sequence / "poses.txt").rename(tmp_path / "poses" / "00.txt")
    source = open_source(sequence)
    assert source.truth is not None
    assert set(source.truth_paths()) == {sequence, poses}
    monkeypatch.chdir(sequence)
    assert open_source(Path()).truth is not None


@pytest.mark.parametrize("write", [write_folder, write_bag])
def test_the_stamps_of_a_source_are_those_of_its_pairs_and_need_no_image(
    write: Callable[[Path, int, int], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = open_source(write(tmp_path / "source", 4, 2))
    faults = [parse_fault("late:share=1,amount=0.02"), parse_fault("clock:amount=0.5")]
    for changed in (source, faulty(source, faults)):
        loc_ns = [pair.stamp_ns for pair in changed.loc.pairs()]
        nav_ns = [item.pair.stamp_ns for item in changed.nav.pairs()]
        with monkeypatch.context() as patch:
            patch.setattr(type(source.loc), "pairs", None)
            patch.setattr(type(source.nav), "pairs", None)
            assert changed.expected_loc_ns().tolist() == loc_ns
            assert changed.expected_nav_ns().tolist() == nav_ns
    assert loc_ns != list(source.loc.stamps_ns)
    assert nav_ns != list(source.nav.stamps_ns)
