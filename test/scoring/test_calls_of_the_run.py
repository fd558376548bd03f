"""Calls belong to the run that made the scored estimate or cloud: its poses, its images, its cloud and its rate."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from helpers.made_scene import PERIOD_NS, true_cloud, write_folder
from sfr_loc_map.calls.call_files import load_call_stats, save_stats, stats_beside
from sfr_loc_map.calls.call_record import CallRecord
from sfr_loc_map.calls.run_identity import hash_of_pair, hash_of_set
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.clouds.cloud_file import SUFFIXES, save_cloud
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory
from sfr_loc_map.metrics.figures.records import REPLAY_RATE
from sfr_loc_map.scoring import load_drive
from sfr_loc_map.scoring.inputs import Run, ScoreInputs
from sfr_loc_map.scoring.load import load_run

PAIRS = 5
IDENTITY = ("position_", "attitude_", "images_sha256", "cloud_sha256", "replay_rate")


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_folder(tmp_path_factory.mktemp("run") / "drive", PAIRS, 0)


@pytest.fixture(scope="module")
def panorama(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_folder(tmp_path_factory.mktemp("run") / "panorama", 0, 2)


def poses_of(drive: Path) -> Trajectory:
    sequence = open_source(drive).loc
    assert sequence is not None
    assert sequence.ground_truth is not None
    truth = sequence.ground_truth
    return Trajectory(truth.stamps_ns, truth.positions, truth.quats_xyzw)


def save_run(folder: Path, drive: Path, estimate: Trajectory | None = None, rate: float | None = None) -> Path:
    """Write the true poses of a drive as an estimate, with its calls beside it; return the file of the estimate."""
    sequence, made = open_source(drive).loc, poses_of(drive)
    assert sequence is not None
    records = [
        CallRecord(pair.stamp_ns, 0.1, "tracking", images_sha256=hash_of_pair(pair)) for pair in sequence.pairs()
    ]
    path = folder / "e.csv"
    save_trajectory(path, made if estimate is None else estimate)
    save_stats(stats_beside(path), records, estimate=made, replay_rate=rate)
    return path


def loaded(estimate: Path, truth: Path) -> Run:
    return load_run(ScoreInputs.of(estimate, truth))


def caveats(run: Run) -> str:
    return "; ".join((*run.caveats, *(() if run.drive is None else run.drive.caveats)))


def without_columns(stats: Path, names: Sequence[str]) -> None:
    """Remove the columns whose names begin with one of the names."""
    header, *rows = list(csv.reader(stats.read_text().splitlines()))
    kept = [place for place, name in enumerate(header) if not name.startswith(tuple(names))]
    stats.write_text("".join(",".join(row[place] for place in kept) + "\n" for row in (header, *rows)))


def moved(poses: Trajectory) -> Trajectory:
    return replace(poses, positions=poses.positions + 0.003 * (np.arange(len(poses)) == 1)[:, None])


def turned(poses: Trajectory) -> Trajectory:
    """Turn one pose by 0.5 deg about z."""
    quats = poses.quats_xyzw.copy()
    quats[1, 2] += 0.5 * np.radians(0.5)
    return replace(poses, quats_xyzw=quats / np.linalg.norm(quats, axis=1)[:, None])


def with_a_further_pose(poses: Trajectory) -> Trajectory:
    stamps_ns = np.append(poses.stamps_ns, poses.stamps_ns[-1] + PERIOD_NS)
    return Trajectory(stamps_ns, poses.positions[[*range(len(poses)), -1]], poses.quats_xyzw[[*range(len(poses)), -1]])


def without_a_pose(poses: Trajectory) -> Trajectory:
    kept = np.arange(len(poses)) != 2
    return Trajectory(poses.stamps_ns[kept], poses.positions[kept], poses.quats_xyzw[kept])


def rounded(poses: Trajectory) -> Trajectory:
    return replace(poses, positions=np.round(poses.positions, 3), quats_xyzw=np.round(poses.quats_xyzw, 3))


def opposite(poses: Trajectory) -> Trajectory:
    """Return the same attitudes, as the negative quaternions."""
    return replace(poses, quats_xyzw=-poses.quats_xyzw)


@pytest.mark.parametrize(
    ("edited", "problem"),
    [
        (moved, "belong to another estimate: at 1 of 5 stamps the two positions differ, by up to 0.003 m"),
        (turned, "belong to another estimate: at 1 of 5 stamps the two attitudes differ"),
        (with_a_further_pose, "1 of 6 poses of the estimate have no call"),
    ],
)
def test_an_estimate_that_was_edited_after_its_run_is_refused(
    tmp_path: Path, drive: Path, edited: Callable[[Trajectory], Trajectory], problem: str
) -> None:
    estimate = save_run(tmp_path, drive, edited(poses_of(drive)))
    with pytest.raises(InputError, match=problem):
        loaded(estimate, drive)


@pytest.mark.parametrize(
    ("edited", "words"),
    [
        (lambda poses: poses, ""),
        (opposite, ""),
        (rounded, "as in a rounded file"),
        (without_a_pose, "produced 1 more pose than the estimate has"),
    ],
)
def test_an_estimate_that_differs_little_from_its_calls_has_a_caveat(
    tmp_path: Path, drive: Path, edited: Callable[[Trajectory], Trajectory], words: str
) -> None:
    found = caveats(loaded(save_run(tmp_path, drive, edited(poses_of(drive))), drive))
    assert words in found
    assert bool(words) == bool(found)


@pytest.mark.parametrize("name", ["e.tum", "e.euroc.csv"])
def test_the_format_of_the_estimate_makes_no_difference(tmp_path: Path, drive: Path, name: str) -> None:
    save_run(tmp_path, drive)
    other = tmp_path / name
    save_trajectory(other, poses_of(drive))
    assert not caveats(load_run(ScoreInputs.of(other, drive, [tmp_path / "e.stats.csv"])))


def test_the_last_of_two_poses_with_one_stamp_is_that_of_the_call(tmp_path: Path, drive: Path) -> None:
    made = poses_of(drive)
    rows = [0, *range(PAIRS)]
    twice = Trajectory(made.stamps_ns[rows], made.positions[rows], made.quats_xyzw[rows])
    twice.positions[0] += 0.003
    assert not caveats(loaded(save_run(tmp_path, drive, twice), drive))


def test_calls_on_other_images_with_the_same_stamps_are_a_caveat(tmp_path: Path, drive: Path) -> None:
    """The other drive is darker in one image of one pair."""
    other = write_folder(tmp_path / "other", PAIRS, 0)
    estimate = save_run(tmp_path, drive)
    assert not caveats(loaded(estimate, other))
    image = sorted((other / "right").iterdir())[2]
    cv2.imwrite(str(image), cv2.imread(str(image), cv2.IMREAD_GRAYSCALE) // 2)
    assert "1 of 5 compared pairs differ" in caveats(loaded(estimate, other))
    assert not caveats(load_run(ScoreInputs.of(estimate, other / "groundtruth.csv")))
    inputs = replace(ScoreInputs.of(estimate, other), has_images_of_run=False)
    assert not caveats(load_run(inputs))


def test_the_images_of_a_run_over_the_end_of_a_drive_are_compared(
    tmp_path: Path, drive: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The calls of the first pairs have no hash, and the number of compared pairs is smaller than theirs."""
    monkeypatch.setattr(load_drive, "CHECKED_PAIRS", 2)
    other = write_folder(tmp_path / "other", PAIRS, 0)
    estimate = save_run(tmp_path, drive)
    stats = stats_beside(estimate)
    header, *rows = list(csv.reader(stats.read_text().splitlines()))
    for row in rows[:3]:
        row[header.index("images_sha256")] = ""
    stats.write_text("".join(",".join(row) + "\n" for row in (header, *rows)))
    assert not caveats(loaded(estimate, other))
    image = sorted((other / "right").iterdir())[3]
    cv2.imwrite(str(image), cv2.imread(str(image), cv2.IMREAD_GRAYSCALE) // 2)
    assert "1 of 2 compared pairs differ" in caveats(loaded(estimate, other))


def test_images_that_cannot_be_read_are_not_compared(tmp_path: Path, drive: Path) -> None:
    other = write_folder(tmp_path / "other", PAIRS, 0)
    sorted((other / "left").iterdir())[1].write_bytes(b"no image")
    assert "images of the calls (--stats) were not compared" in caveats(loaded(save_run(tmp_path, drive), other))


@pytest.mark.parametrize(
    ("missing", "words"),
    [
        (IDENTITY, "have no positions, attitudes or hashes of images: it is not verified"),
        (("attitude_", "images_"), "have no attitudes or hashes of images: it is not verified"),
        (("attitude_",), "have no attitudes: it is not verified"),
        (("images_",), "have no hashes of images: it is not verified"),
    ],
)
def test_calls_of_an_earlier_version_are_read_and_the_check_is_reported_as_impossible(
    tmp_path: Path, drive: Path, missing: Sequence[str], words: str
) -> None:
    estimate = save_run(tmp_path, drive)
    without_columns(stats_beside(estimate), missing)
    assert words in caveats(loaded(estimate, drive))


def test_a_score_of_the_files_of_a_replay_states_its_rate(tmp_path: Path, drive: Path) -> None:
    for rate in (None, 2.5):
        run = loaded(save_run(tmp_path, drive, rate=rate), drive)
        assert run.origin.settings.get(REPLAY_RATE) == rate


@pytest.mark.parametrize(
    ("name", "text", "problem"),
    [
        ("images_sha256", "abc", "line 2: images_sha256 is 'abc': 64 digits"),
        ("cloud_sha256", "1" * 64, "cloud_sha256 has 2 different values"),
        ("replay_rate", "3", "replay_rate has 2 different values"),
        ("images_sha256", "A" * 64, "64 digits from 0 to 9 and a to f"),
        ("replay_rate", "-1", "replay_rate is -1: 0 to"),
        ("replay_rate", "fast", "line 2: replay_rate is 'fast', which is not a number"),
    ],
)
def test_an_invalid_identity_of_a_run_is_refused(tmp_path: Path, name: str, text: str, problem: str) -> None:
    path = tmp_path / "s.csv"
    records = [CallRecord(stamp_ns, 0.1, "mapped", images_sha256="a" * 64) for stamp_ns in (1, 2)]
    save_stats(path, records, cloud=true_cloud(0), replay_rate=2.0)
    header, *rows = list(csv.reader(path.read_text().splitlines()))
    rows[0][header.index(name)] = text
    path.write_text("".join(",".join(row) + "\n" for row in (header, *rows)))
    with pytest.raises(InputError, match=problem):
        load_call_stats(path)


def save_map(folder: Path, panorama: Path, suffix: str = ".ply", *, is_set: bool = False) -> Path:
    """Write the true cloud of the first pair, with the calls of a mapper beside it; return the file of the cloud."""
    nav = open_source(panorama).nav
    assert nav is not None
    hashes = {item.pair.stamp_ns: hash_of_pair(item.pair) for item in nav.pairs()}
    records = [CallRecord(stamp_ns, 0.1, "mapped", images_sha256=sha256) for stamp_ns, sha256 in hashes.items()]
    whole = CallRecord(max(hashes), 0.2, "mapped_set", images_sha256=hash_of_set([*hashes.values()]))
    cloud = true_cloud(0)
    xyz = cloud.xyz.copy()
    xyz[3] = np.nan  # omitted when the file is read
    cloud = replace(cloud, xyz=xyz, fused=True, pair_stamps_ns=tuple(hashes))
    path = folder / f"c{suffix}"
    save_cloud(path, cloud)
    save_stats(stats_beside(path), [whole] if is_set else records, cloud=cloud)
    return path


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_cloud_file_of_each_format_is_that_of_its_calls(tmp_path: Path, panorama: Path, suffix: str) -> None:
    assert not caveats(loaded(save_map(tmp_path, panorama, suffix), panorama))


def test_calls_of_another_cloud_are_refused(tmp_path: Path, panorama: Path) -> None:
    path = save_map(tmp_path, panorama)
    cloud = true_cloud(0)
    nav = open_source(panorama).nav
    assert nav is not None
    stamps_ns = tuple(nav.stamps_ns)
    sigma = cloud.sigma.copy()
    sigma[0] *= 2.0
    save_cloud(path, replace(cloud, sigma=sigma, fused=True, pair_stamps_ns=stamps_ns))
    with pytest.raises(InputError, match="made another cloud"):
        loaded(path, panorama)


@pytest.mark.parametrize("is_set", [False, True])
def test_calls_of_a_mapper_on_other_images_are_a_caveat(tmp_path: Path, panorama: Path, is_set: bool) -> None:
    other = write_folder(tmp_path / "other", 0, 2)
    path = save_map(tmp_path, panorama, is_set=is_set)
    assert not caveats(loaded(path, other))
    image = sorted((other / "left").iterdir())[1]
    cv2.imwrite(str(image), cv2.imread(str(image), cv2.IMREAD_GRAYSCALE) // 2)
    assert "made on other images" in caveats(loaded(path, other))
