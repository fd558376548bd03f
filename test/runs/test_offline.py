"""Where a drive starts, the film of its tracks, and what a user is told of it."""

from __future__ import annotations

import itertools
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import cv2
import numpy as np
import pytest

from helpers.made_scene import HEIGHT, LOC_RIG, WIDTH, loc_pair, write_folder
from sfr_loc_map import signals
from sfr_loc_map.errors import ConfigError, InputError
from sfr_loc_map.evidence.localiser_runs import PairsInMemory
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import StartPose
from sfr_loc_map.localisation.localiser import Localiser
from sfr_loc_map.localisation.visualisation import STRIP
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.mapper import Mapper
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.methods.registry import find_method
from sfr_loc_map.runs import localiser_run, mapper_run
from sfr_loc_map.runs.drive_start import start_pose, true_start, unstamped_start_warning
from sfr_loc_map.runs.localiser_run import DEFAULT_STEP_S, localise, localise_with, run_localiser
from sfr_loc_map.runs.mapper_run import run_mapper
from sfr_loc_map.runs.track_video import track_video
from sfr_loc_map.runs.under_test import UnderTest
from sfr_loc_map.signals import handle_signals
from sfr_loc_map.suite_names import Task

FIRST_NS = 1_000_000_000_000
IMAGE = np.zeros((2, 2), np.uint8)


@dataclass(frozen=True)
class OnePair:
    """A drive of a pair, whose truth goes 1 m in each second: its x is the time since the pair, seconds."""

    seconds: tuple[float, ...]
    rig: StereoRig = LOC_RIG
    has_attitude: bool = True

    @property
    def ground_truth(self) -> Trajectory | None:
        poses = (Transform(np.eye(3), np.array([s, 0.0, 0.0])) for s in self.seconds)
        stamps = (FIRST_NS + round(s * NS_PER_S) for s in self.seconds)
        truth = Trajectory.from_poses(zip(stamps, poses, strict=True))
        return truth if self.has_attitude else replace(truth, quats_xyzw=np.zeros((len(truth), 4)))

    @property
    def stamps_ns(self) -> tuple[int, ...]:
        return (FIRST_NS,)

    def __len__(self) -> int:
        return 1

    def pairs(self) -> Iterator[StereoPair]:
        yield StereoPair(FIRST_NS, IMAGE, IMAGE)


@pytest.mark.parametrize(
    ("truth_s", "offset_s", "expected_s"),
    [
        ((0.0, 0.5, 1.0), 0.0, 0.0),  # a pose of the truth at the pair
        ((-2.0, 0.0, 1.0), 0.0, 0.0),  # the truth begins before it
        ((-0.3, 0.1, 1.0), 0.0, 0.0),  # between two poses of the truth
        ((-3.0, 3.0), 0.0, 3.0),  # too far apart: the next one
        ((2.0, 3.0), 0.0, 2.0),  # the truth begins after it
        ((-3.0, -2.0), 0.0, -2.0),  # it ends before it
        ((0.0, 0.5, 1.0), 0.4, 0.5),  # the first one after a part that is left out
        ((-3.0, -1.0, 0.0, 1.0), -1.5, 0.0),  # what is left out is before the pair
    ],
)
def test_the_true_start_pose_is_that_of_its_stamp(
    truth_s: tuple[float, ...], offset_s: float, expected_s: float
) -> None:
    start = start_pose(OnePair(truth_s), "truth", FIRST_NS + round(offset_s * NS_PER_S))
    assert start.stamp_ns == FIRST_NS + round(expected_s * NS_PER_S)
    np.testing.assert_allclose(start.T_ds_rb.translation, [expected_s, 0.0, 0.0], atol=1e-12)
    assert not start.covariance.any()
    assert start_pose(OnePair(truth_s), "identity").stamp_ns is None  # it holds at the first pair
    with pytest.raises(InputError, match="requires ground truth"):
        start_pose(OnePair(()), "truth")
    with pytest.raises(ConfigError, match="start is 'turth'"):
        start_pose(OnePair(truth_s), "turth")


@pytest.mark.parametrize(
    ("truth_s", "words"), [((0.0,), None), ((0.9,), "0.9 s after"), ((2.0,), "2 s after"), ((-3.0,), "3 s before")]
)
def test_a_method_is_not_silently_started_at_the_pose_of_another_time(
    truth_s: tuple[float, ...], words: str | None
) -> None:
    text = unstamped_start_warning(start_pose(OnePair(truth_s), "truth"), OnePair(truth_s))
    assert text is None if words is None else words in str(text)
    assert unstamped_start_warning(start_pose(OnePair(truth_s), "identity"), OnePair(truth_s)) is None


def test_the_time_of_a_mapping_call_is_that_of_its_stages(tmp_path: Path) -> None:
    """The progress between two stages takes 3 s, which no stage and no call contains."""
    source = open_source(write_folder(tmp_path / "source", 0, 2))
    *stages, whole = run_mapper(source.nav, MappingConfig(), lambda done: time.sleep(1.5)).records
    assert [record.state for record in (*stages, whole)] == ["mapped", "mapped", "fused", "mapped_set"]
    assert whole.processing_time_s == sum(record.processing_time_s for record in stages)
    assert whole.peak_rss_bytes == max(record.peak_rss_bytes or 0 for record in stages)


def test_a_start_at_the_truth_requires_true_attitudes() -> None:
    pair = OnePair((0.0, 1.0), has_attitude=False)
    with pytest.raises(InputError, match="requires true attitudes"):
        start_pose(pair, "truth")
    assert true_start(pair).stamp_ns is None
    assert true_start(OnePair((2.0, 3.0))).T_ds_rb.translation[0] == 2.0


@pytest.mark.parametrize("ending", [".avi", ".mp4"])
def test_a_film_has_one_image_for_each_pair_and_estimates_stay_the_same(tmp_path: Path, ending: str) -> None:
    sequence = open_source(write_folder(tmp_path / "drive", 4, 0)).loc
    path, config, start = tmp_path / f"tracks{ending}", LocalisationConfig(), Transform.identity()
    with track_video(path, sequence.rig) as watch:
        watched = [estimate for estimate, _ in localise(sequence, config, start, watch)]
    for a, (b, _) in zip(watched, localise(sequence, config, start), strict=True):
        np.testing.assert_array_equal(a.T_ds_rb.matrix, b.T_ds_rb.matrix)
    film = cv2.VideoCapture(str(path))
    images = []
    while (read := film.read())[0]:
        images.append(read[1])
    assert [image.shape for image in images] == 4 * [(HEIGHT + STRIP, WIDTH, 3)]
    grey = images[0][4 : HEIGHT - 4, 4 : WIDTH - 4].mean(axis=2)
    assert np.median(np.abs(grey - 0.75 * loc_pair(0).left[4:-4, 4:-4])) < 12


def test_a_drive_without_pairs_is_refused() -> None:
    with pytest.raises(InputError, match="no complete pair"):
        run_localiser(PairsInMemory(LOC_RIG, []), LocalisationConfig(), StartPose(Transform.identity()))


@pytest.mark.parametrize(("steps", "rate_hz"), [((2, 1, 1, 1), 10.0), ((), 1.0 / DEFAULT_STEP_S)])
def test_a_missing_pair_at_the_start_does_not_change_the_rate_that_a_method_is_given(
    monkeypatch: pytest.MonkeyPatch, steps: tuple[int, ...], rate_hz: float
) -> None:
    given: list[float] = []

    @contextmanager
    def started(*_: object, rate_hz: float, hidden: object) -> Iterator[None]:
        given.append(rate_hz)
        yield

    monkeypatch.setattr(localiser_run, "IsolatedLocaliser", started)
    stamps_ns = np.cumsum([0, *steps]) * (NS_PER_S // 10)
    sequence = SimpleNamespace(rig=LOC_RIG, stamps_ns=stamps_ns.tolist(), ground_truth=None, pairs=list)
    how = SimpleNamespace(method=SimpleNamespace(config=None), limits=None, hidden=())
    assert not list(localise_with(cast("Any", how), cast("Any", sequence), Transform.identity()))
    assert given == [pytest.approx(rate_hz)]


@pytest.mark.parametrize("after", [1, 3])
def test_a_pair_that_is_processed_when_a_signal_arrives_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after: int
) -> None:
    source, begin = open_source(write_folder(tmp_path / "source", 3, 3)), StartPose(Transform.identity())
    for module in (localiser_run, mapper_run):
        monkeypatch.setattr(module, "load_kernels", lambda part: None)  # it calls `process`
    for run, kind in (
        (lambda: run_localiser(source.loc, LocalisationConfig(), begin, keeps_finished=True).steps, Localiser),
        (lambda: run_mapper(source.nav, MappingConfig(), keeps_finished=True).maps, Mapper),
    ):
        process, count = kind.process, itertools.count(1)

        def interrupted(*args: object, process: Any = process, count: Iterator[int] = count) -> object:
            if next(count) == after:
                signal.raise_signal(signal.SIGINT)
            return process(*args)

        before = signal.getsignal(signal.SIGINT)
        monkeypatch.setattr(kind, "process", interrupted)
        handle_signals()
        try:
            assert len(run()) == after
        finally:
            signal.signal(signal.SIGINT, before)


SLOW = """
import time
from sfr_loc_map.geometry.cloud import PointCloud

class Slow:
    def __init__(self, rig, config):
        self.count = 0
    def process(self, pair, T_lm_navsb, index):
        self.count += 1
        time.sleep(0.6 * (self.count == 2))
        return PointCloud.empty()
    def fuse(self, results):
        return PointCloud.empty()
"""


@pytest.mark.parametrize(("signals_s", "mapped", "is_fused"), [((0.2,), 2, True), ((0.2, 0.4), 1, False)])
def test_a_signal_during_a_call_of_a_mapper_under_test_is_no_fault_of_the_method(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, signals_s: tuple[float, ...], mapped: int, is_fused: bool
) -> None:
    """The first signal lets the method finish its pair. The second ends the call, whose answer is not read later."""
    (tmp_path / "slow.py").write_text(SLOW)
    monkeypatch.setattr(signals, "SAME_REQUEST_S", 0.1)
    source = open_source(write_folder(tmp_path / "source", 0, 3))
    how = UnderTest(find_method(f"{tmp_path}/slow.py:Slow", Task.MAPPING), hidden=())
    timers: list[threading.Timer] = []

    def interrupt(done: int) -> None:
        if done == 1:
            timers.extend(threading.Timer(s, signal.raise_signal, (signal.SIGINT,)) for s in signals_s)
            for timer in timers:
                timer.start()

    before = signal.getsignal(signal.SIGINT)
    handle_signals()
    try:
        run = run_mapper(source.nav, how, interrupt, keeps_finished=True)
    finally:
        signal.signal(signal.SIGINT, before)
        for timer in timers:
            timer.join()
    assert len(run.maps) == mapped
    assert not any(record.finding for record in run.records)
    assert ("fused" in [record.state for record in run.records]) == is_fused
