"""Plays a recording to a hub on a time line: at its speed or another, paused, from any place.

It stands in for the nodes: the score is that of the monitor, so the figures at the end are those of `sfr score`. After
a jump back the figures of that place are made again from the begin.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import chain
from threading import Event, Lock, Thread

from sfr_loc_map.errors import InputError, SfrError
from sfr_loc_map.live.hub import Action, Command, Hub
from sfr_loc_map.live.media import image_sample
from sfr_loc_map.live.recording import Frame, Recording
from sfr_loc_map.live.updates import (
    CloudSample,
    ElevationSample,
    PoseSample,
    Report,
    Status,
    StatusKind,
    TimeLine,
    Track,
    Update,
    View,
)
from sfr_loc_map.metrics.cloud_error import ScoredMap
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.limits import Limits
from sfr_loc_map.metrics.score_json import to_json
from sfr_loc_map.pipeline.call_stats import call_of
from sfr_loc_map.pipeline.monitor_score import MonitorScore

TICK_S = 0.05
REPORT_PERIOD_S, TIME_LINE_PERIOD_S = 1.0, 0.25
IMAGES_BUDGET_S = 0.03
"""Of each tick, for images that are behind: figures do not wait for them."""
SHOWN_WITHIN_S = 0.3
"""Images farther behind than this are passed over, but for the last of each camera."""
MOST_WAITING = 2000
"""Records that may wait in the hub while the player is ahead."""
NO_HEALTH = "as recorded; its health was not"


class Player:
    """Plays in a thread of its own, from the begin of the `with` block to its end. The operator of the views."""

    actions = frozenset({Action.PLAY, Action.PAUSE, Action.SEEK})

    def __init__(
        self, hub: Hub, recording: Recording, config: ScoreConfig, limits: Limits | None, rate: float = 1.0
    ) -> None:
        """Stand before the begin; the rate is a multiple of the recorded speed."""
        self.problem = ""  # why it plays no more
        self._hub, self._recording, self._settings, self._rate = hub, recording, (config, limits), rate
        self._silent = recording.silent_nodes
        self._map_score: ScoredMap | None = None
        self._lock, self._stopped = Lock(), Event()
        self._playing = True
        self._jump_to: float | None = 0.0
        self._report_due_s = self._told_s = 0.0
        self._thread = Thread(target=self._play, name="sfr-live-player", daemon=True)
        self.at_s, self._next = -1.0, 0
        self._rewind()

    def __enter__(self) -> Player:
        """Begin to play."""
        self._hub.operator = self
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """End."""
        self.close()
        self._thread.join(5.0)

    def close(self) -> None:
        """Play no more."""
        self._stopped.set()

    def run(self, command: Command) -> str:
        """Pause, play on (at the end: from the begin) or jump.

        Raises:
            InputError: If the command is another one.
        """
        with self._lock:
            if command.action is Action.PAUSE:
                self._playing = False
                return "paused"
            if command.action is Action.PLAY:
                if self._jump_to is None and self.at_s >= self._recording.end_s:
                    self._jump_to = 0.0
                self._playing = True
                return "plays"
            if command.action is Action.SEEK:
                self._jump_to = min(command.at_s, self._recording.end_s)
                return f"goes to {self._jump_to:.1f} s"
        raise InputError(f"'{command.action}' is not possible here: a recording is played, there are no nodes")

    def advance(self, at_s: float) -> None:
        """Tell all up to a place.

        Raises:
            SfrError: If the recording is broken there.
        """
        moments = self._recording.moments
        while self._next < len(moments) and moments[self._next][0] <= at_s:
            update = moments[self._next][1]
            self._next += 1
            self._take_in(update)
            self._hub.put(_received_now(update))
            if self._next % MOST_WAITING == 0:  # a hub drops what it has no room for: let the views catch up
                patience = time.monotonic() + 5.0
                while self._hub.waiting > MOST_WAITING and time.monotonic() < patience:
                    time.sleep(0.01)
        self.at_s = at_s

    def report(self) -> None:
        """Tell the figures up to here, again after a second or ten times the time that they took."""
        begin_s, now_s = time.monotonic(), time.time()
        for node in self._silent:
            self._hub.put(Status(node, StatusKind.HEALTH, 0, NO_HEALTH, {"lifecycle": "recorded"}, now_s))
        if self._recording.report:
            self._hub.put(Report(self._recording.report, now_s))
        elif self._next:
            self._hub.put(Report(to_json(self._score.result(details=False)), now_s))
        end_s = time.monotonic()
        self._report_due_s = end_s + max(REPORT_PERIOD_S, 10.0 * (end_s - begin_s))

    def _rewind(self) -> None:
        self.at_s = -1.0
        self._score = MonitorScore(*self._settings)
        self._next = 0
        self._frames: Iterator[Frame] | None = None
        self._passed: dict[str, Frame] = {}

    def _take_in(self, update: Update) -> None:
        """Score what the monitor of a running graph would have received."""
        score = self._score
        match update:
            case PoseSample(track=Track.TRUTH):
                score.add_truth(update.stamp_ns, update.position, update.quat_xyzw)
            case PoseSample():
                score.add_estimate(update.stamp_ns, update.position, update.quat_xyzw, update.covariance)
            case Status(kind=StatusKind.CALL):
                call = call_of(update.values)
                if call is not None:
                    score.add_call(call.record)
            case CloudSample():
                self._score_map(update.stamp_ns)

    def _score_map(self, stamp_ns: int) -> None:
        """Score the map once: it takes seconds, and whoever jumps back does not wait for it again."""
        found, inputs = self._recording, self._score.map_inputs
        if found.cloud is not None and self._map_score is None:
            inputs.rig = found.source.nav.rig if found.source is not None and found.source.nav is not None else None
            for item in found.pairs:
                inputs.add_pose(item.pair.stamp_ns, item.T_lm_navsb)
                if item.truth is not None:
                    inputs.add_true_points(item.pair.stamp_ns, item.truth)
            inputs.add_cloud(stamp_ns, found.cloud)
            self._score.score_maps()
            self._map_score = self._score.map_score
        self._score.map_score = self._map_score

    def _play(self) -> None:
        try:
            self._loop()
        except SfrError as error:
            self.problem = str(error)
            self._hub.put(Status("recording", StatusKind.HEALTH, 2, self.problem, {}, time.time()))

    def _loop(self) -> None:
        last_s, end_s = time.monotonic(), self._recording.end_s
        while not self._stopped.is_set():
            now_s = time.monotonic()
            with self._lock:
                jump_to, self._jump_to = self._jump_to, None
                playing = self._playing
            if jump_to is not None:
                if jump_to < self.at_s:
                    self._rewind()
                    self._hub.put(TimeLine(jump_to, end_s, playing, restarted=True))
                self._step(jump_to, told=True)
                now_s = time.monotonic()
            elif playing:
                self._step(min(self.at_s + (now_s - last_s) * self._rate, end_s))
            last_s = now_s
            self._show_images()
            if now_s - self._told_s >= TIME_LINE_PERIOD_S:
                self._tell_place()
            self._stopped.wait(TICK_S)

    def _step(self, at_s: float, *, told: bool = False) -> None:
        self.advance(at_s)
        at_end = at_s >= self._recording.end_s
        if at_end or told or time.monotonic() >= self._report_due_s:
            self.report()
        if at_end:
            with self._lock:
                self._playing = False
        if at_end or told:
            self._tell_place()

    def _tell_place(self) -> None:
        self._told_s = time.monotonic()
        self._hub.put(TimeLine(round(self.at_s, 3), self._recording.end_s, self._playing))

    def _show_images(self) -> None:
        """Tell the images of the place, as far as the time of a tick allows and somebody looks.

        Raises:
            SfrError: If an image is broken.
        """
        if View.IMAGES not in self._hub.wanted:
            return
        frames = self._recording.frames() if self._frames is None else self._frames
        until_s = time.monotonic() + IMAGES_BUDGET_S
        while time.monotonic() < until_s:
            frame = next(frames, None)
            if frame is None or frame[0] > self.at_s:
                frames = iter(()) if frame is None else chain((frame,), frames)
                for passed in self._passed.values():
                    self._show(passed)
                self._passed.clear()
                break
            self._passed[frame[1]] = frame
            if self.at_s - frame[0] <= SHOWN_WITHIN_S:
                self._show(self._passed.pop(frame[1]))
        self._frames = frames

    def _show(self, frame: Frame) -> None:
        _, topic, stamp_ns, image = frame
        self._hub.put(image_sample(topic, stamp_ns, image, time.time()))


def _received_now(update: Update) -> Update:
    if isinstance(update, CloudSample | ElevationSample):
        return replace(update, published_s=time.time())
    return replace(update, received_s=time.time()) if isinstance(update, PoseSample | Status) else update
