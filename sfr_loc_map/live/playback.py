"""Plays a recorded run on a time line: at its speed or another, paused, from any place.

A recording is the folder of a replay, a bag of a run, or any source with images. It is read as the updates that a feed
would give while the run goes on; drive and map have a clock each, which begins with their first stamps. The player
stands in for the nodes and scores as the monitor does, so that the figures at the end are those of `sfr score`. After a
jump back the figures of that place are made again from the begin.
"""

from __future__ import annotations

import csv
import heapq
import io
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from operator import itemgetter
from pathlib import Path, PurePosixPath
from threading import Event, Lock, Thread

import numpy as np

from sfr_loc_map.config import parameters
from sfr_loc_map.errors import InputError, SfrError
from sfr_loc_map.geometry.arrays import GreyImage
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import NS_PER_S, SIDES, hash_path, read_table_text, read_text, refusing
from sfr_loc_map.io.bag import GROUND_TRUTH, ODOMETRY, Bag, read_trajectory
from sfr_loc_map.io.bag_files import is_bag
from sfr_loc_map.io.cloud_file import load_cloud
from sfr_loc_map.io.registry import open_source, read_truth
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.live import updates
from sfr_loc_map.live.media import CloudTruth, cloud_samples, image_sample
from sfr_loc_map.live.state import MAX_REPORT_CHARACTERS, LiveState
from sfr_loc_map.live.updates import Action, Command
from sfr_loc_map.localisation.estimate import TrackingState, lost_covariance
from sfr_loc_map.metrics.association import UPPER, Estimates
from sfr_loc_map.metrics.calls import stage_of
from sfr_loc_map.metrics.cloud_error import PairTruth, ScoredMap, score_map
from sfr_loc_map.metrics.config import MappingState, ScoreConfig
from sfr_loc_map.metrics.limits import Limits, limits_of, load_limits
from sfr_loc_map.metrics.score import InputFile, Score
from sfr_loc_map.metrics.score_json import from_json, to_json
from sfr_loc_map.replay.result import ReplayFiles
from sfr_loc_map.runs.calls import STATISTIC, STEP_NAMES, call_of, load_call_stats, values_of
from sfr_loc_map.scoring.bag_estimates import statuses_of
from sfr_loc_map.scoring.monitor_score import MonitorScore
from sfr_loc_map.scoring.score_run import load_estimates

LOCALISATION_NODE, MAPPING_NODE = "localisation_node", "mapping_node"
LEVELS = {TrackingState.DEGRADED.value: 1, TrackingState.LOST.value: 2}
TICK_S, REPORT_PERIOD_S, TIME_LINE_PERIOD_S = 0.05, 1.0, 0.25
MAX_HASHED = 2**28  #: Bytes of a file that is compared by its hash, which takes a tenth of a second for so many.
IMAGES_BUDGET_S = 0.03  #: Of each tick, for reading images: figures do not wait for them.
Moment = tuple[float, updates.Update]
"""Place, seconds since the begin of its task; the time of receipt is filled in when it is played."""
Frame = tuple[float, str, int, GreyImage]
"""Place, topic such as `loc/left`, stamp and pixels of one image of a pair."""


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A recorded run; what is absent is None or empty."""

    title: str
    moments: Sequence[Moment]  # all but images, in their order; the truth of a stamp comes first
    source: Source | None  # of the images
    cloud: PointCloud | None
    truths: Sequence[PairTruth]  # of the pairs of a cloud that can be scored: of all of them
    begin_ns: tuple[int, int]  # first stamps of the drive and of the mapping pairs
    end_s: float
    score: Score | None = None  # of the report beside it
    limits: Limits | None = None  # that it was judged by
    page: bytes = b""  # of the report, HTML
    note: str = ""  # what was not found

    @property
    def settings(self) -> dict[str, object]:
        """The settings that its report was scored with, as far as they are known here."""
        made = None if self.score is None else self.score.provenance
        known = {info.name for info in parameters(ScoreConfig)}
        return {name: value for name, value in (made.configuration if made else {}).items() if name in known}

    def frames(self) -> Iterator[Frame]:
        """Yield the images in their order, read from the disk as they are asked for."""
        loc, nav = (None, None) if self.source is None else (self.source.loc, self.source.nav)

        def images(rig: str, pairs: Iterable[StereoPair], begin_ns: int) -> Iterator[Frame]:
            for pair in pairs:
                for side, image in zip(SIDES, (pair.left, pair.right), strict=True):
                    yield _place(pair.stamp_ns, begin_ns), f"{rig}/{side}", pair.stamp_ns, image

        drive = images("loc", loc.pairs() if loc else (), self.begin_ns[0])
        panorama = images("nav", (item.pair for item in (nav.pairs() if nav else ())), self.begin_ns[1])
        return heapq.merge(drive, panorama, key=itemgetter(0))


def open_recording(path: Path, truth: Path | None = None) -> Recording:
    """Return what is recorded in a folder of `sfr replay --out`, a bag or a data set.

    Truth and images of a replay are those of the source `truth`; None: of the one that its report names, as seen from
    here or from the run. InputError if there is nothing to play, or it is broken.
    """
    files = ReplayFiles(path)
    if path.is_dir() and any(file.is_file() for file in (files.estimate, files.cloud)):
        return _replayed(files, truth)
    bag = Bag(path) if is_bag(path) else None
    is_run = bag is not None and bag.find("localisation/odometry", ODOMETRY) is not None
    try:
        source = open_source(truth if is_run and truth is not None else path)
    except InputError:
        if not is_run:
            raise
        source = None  # a recording without images
    if truth is not None:
        true_poses: Trajectory | None = read_truth(truth)
    else:
        true_poses = _truth_of(source) if source is not None or bag is None else read_trajectory(bag, GROUND_TRUTH)
    said = [] if bag is None else list(_diagnostics(bag))
    return _recording(path, load_estimates(path) if is_run else None, true_poses, said, source)


def _replayed(files: ReplayFiles, truth: Path | None) -> Recording:
    """Return a finished replay, with the truth and the images of its source where that is known."""
    score, limits, note = None, None, ""
    if files.report.is_file():
        with refusing(f"cannot read the report '{files.report}'", "replay again"):
            score = from_json(read_text(files.report, MAX_REPORT_CHARACTERS), str(files.report))
        inputs = {} if score.provenance is None else score.provenance.inputs
        truth, note = (truth, "") if truth is not None else _source_of(inputs, files.folder)
        same = _found(inputs.get("limits"), files.folder)
        limits = limits_of(score.verdicts) if same is None else load_limits(same)
    source = None if truth is None else open_source(truth)
    stats = [load_call_stats(files.stats)] if files.stats.is_file() else []
    estimates = load_estimates(files.estimate, stats) if files.estimate.is_file() else None
    cloud = load_cloud(files.cloud).cloud if files.cloud.is_file() else None
    said = list(_calls(files.stats)) if stats else []
    made = _recording(files.folder, estimates, _truth_of(source), said, source, cloud)
    return replace(
        made, score=score, limits=limits, page=files.page.read_bytes() if files.page.is_file() else b"", note=note
    )


def _found(item: InputFile | None, folder: Path) -> Path | None:
    """Return a file that a score names, as seen from here or from the run; None where it is gone or another one."""
    if item is None:
        return None
    for path in (base / item.path for base in (Path(), folder.resolve(), *folder.resolve().parents)):
        if not path.exists():
            continue
        files = (file for file in path.rglob("*") if file.is_file()) if path.is_dir() else (path,)
        if sum(file.stat().st_size for file in files) > MAX_HASHED or hash_path(path) == item.sha256:
            return path
    return None


def _source_of(inputs: Mapping[str, InputFile], folder: Path) -> tuple[Path | None, str]:
    """Return the source that a replay was made of, None where it is not named or gone; and what is gone."""
    named = list(filter(None, (inputs.get("map_truth"), inputs.get("truth"))))
    for item in named:
        if (path := _found(item, folder)) is not None:
            if path.name == "groundtruth.csv":
                path = path.parent.parent if path.parent.name == "loc" else path.parent
            return path, ""
    gone = f"the truth of the run, '{named[0].path}', is not there or has changed: give --truth SRC" if named else ""
    return None, gone


def _truth_of(source: Source | None) -> Trajectory | None:
    truth = None if source is None or source.loc is None else source.loc.ground_truth
    return truth if truth is not None and len(truth) else None


def _recording(
    path: Path,
    estimates: Estimates | None,
    truth: Trajectory | None,
    said: Sequence[updates.Status],
    source: Source | None,
    cloud: PointCloud | None = None,
) -> Recording:
    """Return the recording with its time line; InputError if nothing is in it, or a figure of a call is none."""
    drive = [int(stamp) for track in (estimates and estimates.trajectory, truth) if track for stamp in track.stamps_ns]
    cloud_ns = () if cloud is None else cloud.pair_stamps_ns or (0,)
    panorama = list(cloud_ns)
    calls = [call_of(status.values) if status.kind is updates.StatusKind.CALL else None for status in said]
    for status, call in zip(said, calls, strict=True):
        if call is not None:
            (panorama if status.node == MAPPING_NODE else drive).append(call.stamp_ns)
    nav = None if source is None else source.nav
    if source is not None:
        drive += getattr(source.loc, "stamps_ns", ())  # files and bags know their stamps without their images
        panorama += getattr(nav, "stamps_ns", ())
    if not drive and not panorama:
        raise InputError(f"'{path}' holds nothing to play: give a bag, the folder of sfr replay --out, or a data set")
    begin_ns = min(drive, default=0), min(panorama, default=0)
    end_s = max(_place(max(drive, default=0), begin_ns[0]), _place(max(panorama, default=0), begin_ns[1]))
    moments = [] if truth is None else [*_poses(updates.Track.TRUTH, Estimates.of(truth), begin_ns[0])]
    latest = [0.0, 0.0]
    for status, call in zip(said, calls, strict=True):
        is_map = status.node == MAPPING_NODE
        if call is not None:
            latest[is_map] = _place(call.stamp_ns, begin_ns[is_map])
        # health has no stamp of the drive and stands where it was recorded
        moments.append((latest[is_map] if call is not None else max(latest), status))
    if estimates is not None:
        moments += _poses(updates.Track.ESTIMATE, estimates, begin_ns[0])
    truths: list[PairTruth] = []
    if cloud is not None:
        true_points = CloudTruth()
        if nav is not None:
            for item in nav.pairs():  # in the order of their stamps, as those of the cloud
                if item.pair.stamp_ns in cloud_ns and (known := PairTruth.of(item, nav.rig)) is not None:
                    truths.append(known)
                    true_points.add(item.pair.stamp_ns, known.points)
        if cloud.fused is None or len(truths) != len(cloud_ns):
            truths.clear()
        media = cloud_samples(cloud_ns[-1], cloud.xyz, cloud.sigma, 0.0, true_points.errors(cloud))
        moments += ((_place(cloud_ns[-1], begin_ns[1]), sample) for sample in media if sample is not None)
    moments.sort(key=itemgetter(0))
    return Recording(path.name or str(path), moments, source, cloud, truths, begin_ns, end_s)


def _place(stamp_ns: int, begin_ns: int) -> float:
    return max(stamp_ns - begin_ns, 0) / NS_PER_S


def _poses(track: updates.Track, poses: Estimates, begin_ns: int) -> Iterator[Moment]:
    """Yield poses in the order in which they were given; the covariance of a lost one says so."""
    trajectory, latest_ns = poses.trajectory, 0
    for row, stamp_ns in enumerate(trajectory.stamps_ns.tolist()):
        (x, y, z), (a, b, c, d) = trajectory.positions[row].tolist(), trajectory.quats_xyzw[row].tolist()
        covariance = lost_covariance() if poses.lost[row] else None
        if covariance is None and poses.covariance is not None and np.isfinite(poses.covariance[row]).all():
            covariance = np.zeros((6, 6))
            covariance[UPPER] = covariance[UPPER[::-1]] = poses.covariance[row]
        latest_ns = max(latest_ns, stamp_ns)
        yield _place(latest_ns, begin_ns), updates.PoseSample(track, stamp_ns, (x, y, z), (a, b, c, d), 0.0, covariance)


def _calls(stats: Path) -> Iterator[updates.Status]:
    """Yield the calls of statistics as the nodes tell them on /diagnostics."""
    for read in csv.DictReader(io.StringIO(read_table_text(stats), newline="")):
        row = {name: value for name, value in read.items() if isinstance(name, str) and value}
        state, reason = row.get("state", ""), row.get("reason", "")
        is_map, steps = state in set(MappingState), [row.get(name, "") for name in STEP_NAMES]
        values = row | {STATISTIC + name: value for name, value in row.items() if stage_of(name)}
        values |= {"task": "mapping" if is_map else "localisation", "step": " ".join(steps) if all(steps) else ""}
        values.setdefault("processing_time_s", "0")
        node, message = MAPPING_NODE if is_map else LOCALISATION_NODE, f"{state}: {reason}" if reason else state
        yield updates.Status(node, updates.StatusKind.CALL, LEVELS.get(state, 0), message, values, 0.0)


def _diagnostics(bag: Bag) -> Iterator[updates.Status]:
    for _, item in statuses_of(bag):
        name, _, kind = item.name.partition(": ")
        if kind in set(updates.StatusKind):
            node, level = PurePosixPath("/" + name).name, int(item.level)
            yield updates.Status(node, updates.StatusKind(kind), level, item.message, values_of(item), 0.0)


class Player:
    """Plays in a thread of its own, from the begin of the `with` block to its end. The operator of the views."""

    actions = frozenset({Action.PLAY, Action.PAUSE, Action.SEEK})

    def __init__(
        self, state: LiveState, recording: Recording, config: ScoreConfig, limits: Limits | None, rate: float = 1.0
    ) -> None:
        """Stand before the begin; the rate is a multiple of the recorded speed."""
        self._state, self._recording, self._settings, self._rate = state, recording, (config, limits), rate
        state.place_s = 0.0
        for place_s, update in recording.moments:
            state.timeline.take(update, place_s)
        state.timeline.end(recording.end_s)
        state.report_page = recording.page
        if recording.note:
            state.problems.append(recording.note)
        said = [update for _, update in recording.moments if isinstance(update, updates.Status)]
        self._silent = {status.node for status in said} - {s.node for s in said if s.kind is updates.StatusKind.HEALTH}
        self._map_score: ScoredMap | None = None
        self._lock, self._stopped = Lock(), Event()
        self._playing = True
        self._jump_to: float | None = 0.0
        self._report_due_s = self._told_s = 0.0
        self._thread = Thread(target=self._play, name="sfr-live-player", daemon=True)
        self._rewind()

    def __enter__(self) -> Player:
        self._state.operator = self
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
        self._thread.join(5.0)

    def close(self) -> None:
        """Play no more."""
        self._stopped.set()

    def run(self, command: Command) -> str:
        """Pause, play on (at the end: from the begin) or jump; InputError for other commands."""
        with self._lock:
            if command.action is Action.PAUSE:
                self._playing = False
                return "paused"
            if command.action is Action.PLAY:
                if self._jump_to is None and self._at_s >= self._recording.end_s:
                    self._jump_to = 0.0
                self._playing = True
                return "plays"
            if command.action is Action.SEEK:
                self._jump_to = min(command.at_s, self._recording.end_s)
                return f"goes to {self._jump_to:.1f} s"
        raise InputError(f"'{command.action}' is not possible here: a recording is played, there are no nodes")

    def advance(self, at_s: float) -> None:
        """Tell all up to a place."""
        moments, now_s = self._recording.moments, time.time()
        self._state.place_s = at_s
        while self._next < len(moments) and moments[self._next][0] <= at_s:
            place_s, update = moments[self._next]
            self._next += 1
            self._take_in(update)
            name = "received_s" if hasattr(update, "received_s") else "published_s"
            when_s = now_s - (at_s - place_s) / self._rate  # as if it had been played up to here
            self._state.put(replace(update, **{name: when_s}))  # type: ignore[arg-type]
        self._at_s = at_s

    def report(self) -> None:
        """Tell the figures up to here."""
        begin_s, now_s = time.monotonic(), time.time()
        for node in self._silent:
            message = "as recorded; its health was not"
            self._state.put(
                updates.Status(node, updates.StatusKind.HEALTH, 0, message, {"lifecycle": "recorded"}, now_s)
            )
        if self._next:
            source, ended, images = self._recording.source, self._at_s >= self._recording.end_s, None
            if ended and source is not None and source.loc is not None:
                with suppress(InputError):  # it has no whole pair
                    images = np.asarray(source.loc.stamps_ns, np.int64)
            score = self._score.result(details=False, ended=ended, image_stamps_ns=images)
            self._state.put(updates.Report(to_json(score), now_s))
        end_s = time.monotonic()
        self._report_due_s = end_s + max(REPORT_PERIOD_S, 10.0 * (end_s - begin_s))

    def _rewind(self) -> None:
        self._at_s = -1.0
        self._next: int = 0
        self._score = MonitorScore(*self._settings)
        self._frames: Iterator[Frame] | None = None
        self._frame: Frame | None = None

    def _take_in(self, update: updates.Update) -> None:
        """Score what the monitor of a running graph would have received."""
        score = self._score
        match update:
            case updates.PoseSample(track=updates.Track.TRUTH):
                score.add_truth(update.stamp_ns, update.position, update.quat_xyzw)
            case updates.PoseSample():
                score.add_estimate(update.stamp_ns, update.position, update.quat_xyzw, update.covariance)
            case updates.Status(kind=updates.StatusKind.CALL):
                call = call_of(update.values)
                if call is not None:
                    score.add_call(call)
            case updates.CloudSample():
                cloud, truths = self._recording.cloud, self._recording.truths
                if cloud is not None and truths and self._map_score is None:  # it takes seconds: once is enough
                    self._map_score = score_map(cloud, truths, self._settings[0].map)
                score.map_score = self._map_score

    def _play(self) -> None:
        last_s = time.monotonic()
        try:
            while not self._stopped.is_set():
                last_s = self._tick(last_s)
                self._stopped.wait(TICK_S)
        except SfrError as error:
            self._state.put(updates.Status("recording", updates.StatusKind.HEALTH, 2, str(error), {}, time.time()))

    def _tick(self, last_s: float) -> float:
        """Go on by the time since the last tick, or jump; return when this was."""
        now_s, end_s = time.monotonic(), self._recording.end_s
        with self._lock:
            jump_to, self._jump_to = self._jump_to, None
            playing = self._playing
        if jump_to is not None:
            if jump_to < self._at_s:
                self._rewind()
                self._state.put(updates.TimeLine(jump_to, end_s, playing, restarted=True))
            self.advance(jump_to)
        elif playing:
            self.advance(min(self._at_s + (now_s - last_s) * self._rate, end_s))
        has_ended = playing and self._at_s >= end_s
        if jump_to is not None or has_ended or (playing and now_s >= self._report_due_s):
            self.report()
        with self._lock:
            self._playing = self._playing and not has_ended
        self._show_images()
        if jump_to is not None or has_ended or now_s - self._told_s >= TIME_LINE_PERIOD_S:
            self._told_s = now_s
            self._state.put(updates.TimeLine(round(self._at_s, 3), end_s, self._playing))
        return now_s if jump_to is None else time.monotonic()

    def _show_images(self) -> None:
        """Tell the newest images up to the place, as far as they can be read in the time that a tick has for them."""
        if updates.View.IMAGES not in self._state.wanted:
            return
        until_s, newest = time.monotonic() + IMAGES_BUDGET_S, dict[str, Frame]()
        if self._frames is None:
            self._frames = self._recording.frames()
            self._frame = next(self._frames, None)
        while self._frame is not None and self._frame[0] <= self._at_s and time.monotonic() < until_s:
            newest[self._frame[1]] = self._frame
            self._frame = next(self._frames, None)
        for _, topic, stamp_ns, image in newest.values():
            self._state.put(image_sample(topic, stamp_ns, image, time.time()))
