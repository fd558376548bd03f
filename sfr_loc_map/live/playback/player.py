"""Plays a recording to a hub on a time line: at its speed or another, paused, from any place.

The score is that of the monitor, so the figures at the end are those of `sfr score`. After a jump back the figures of
that place are made again from the begin.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import chain
from threading import Event, Lock, Thread

from sfr_loc_map.errors import InputError, SfrError
from sfr_loc_map.live.commands import Action, Command
from sfr_loc_map.live.hub import Hub
from sfr_loc_map.live.media import image_sample
from sfr_loc_map.live.playback.recording import Frame, Moment, Recording
from sfr_loc_map.live.updates import (
    CloudSample,
    ElevationSample,
    PoseSample,
    Report,
    Status,
    StatusKind,
    TimeLine,
    Update,
    View,
)
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.limits import Limits
from sfr_loc_map.metrics.score_json import to_json
from sfr_loc_map.pipeline.monitor_score import MonitorScore

TICK_S = 0.05
REPORT_PERIOD_S = 1.0
TIME_LINE_PERIOD_S = 0.25
IMAGES_BUDGET_S = 0.03
"""Of each tick, for images that are behind: figures do not wait for them."""
SHOWN_WITHIN_S = 0.3
"""Images farther behind than this are passed over, but for the last of each camera."""
MOST_WAITING = 2000
"""Records that may wait in the hub while the player is ahead."""
NO_HEALTH = "as recorded; its health was not"


class Playback:
    """What of a recording has been told so far. One thread uses it.

    Attributes:
        at_s: How far it is.
    """

    def __init__(self, hub: Hub, recording: Recording, config: ScoreConfig, limits: Limits | None) -> None:
        """Stand before the begin.

        Args:
            hub: Takes what has happened.
            recording: The run.
            config: Settings of the score.
            limits: Limits to judge by.
        """
        self._hub, self._recording, self._settings = hub, recording, (config, limits)
        self._silent = recording.silent_nodes
        self.rewind()

    def rewind(self) -> None:
        """Go back before the begin."""
        self.at_s = -1.0
        self._score = MonitorScore(*self._settings)
        self._moments = self._recording.moments()
        self._next: Moment | None = None
        self._frames: Iterator[Frame] | None = None
        self._passed: dict[str, Frame] = {}
        self._scored = False

    def advance(self, at_s: float) -> None:
        """Tell all up to a place.

        Raises:
            SfrError: If the recording is broken there.
        """
        for number, moment in enumerate(self._until(at_s)):
            if moment.score is not None:
                moment.score(self._score)
                self._scored = True
            self._hub.put(_now(moment.shown))
            if number % MOST_WAITING == MOST_WAITING - 1:
                self._wait_for_views()
        self.at_s = at_s

    def report(self) -> None:
        """Tell the figures up to here."""
        now_s = time.time()
        for node in self._silent:
            self._hub.put(Status(node, StatusKind.HEALTH, 0, NO_HEALTH, {"lifecycle": "recorded"}, now_s))
        if self._recording.report:
            self._hub.put(Report(self._recording.report, now_s))
        elif self._scored:
            self._hub.put(Report(to_json(self._score.result(details=False)), now_s))

    def show_images(self) -> None:
        """Tell the images of the place, as far as the time of a tick allows and somebody looks.

        Raises:
            SfrError: If an image is broken.
        """
        if View.IMAGES not in self._hub.wanted:
            return
        if self._frames is None:
            self._frames = self._recording.frames()
        until_s = time.monotonic() + IMAGES_BUDGET_S
        while time.monotonic() < until_s:
            frame = next(self._frames, None)
            if frame is None or frame.at_s > self.at_s:
                self._frames = iter(()) if frame is None else chain((frame,), self._frames)
                for passed in self._passed.values():
                    self._show(passed)
                self._passed.clear()
                return
            self._passed[frame.topic] = frame
            if self.at_s - frame.at_s <= SHOWN_WITHIN_S:
                self._show(self._passed.pop(frame.topic))

    def _show(self, frame: Frame) -> None:
        self._hub.put(image_sample(frame.topic, frame.stamp_ns, frame.image, time.time()))

    def _until(self, at_s: float) -> Iterator[Moment]:
        while True:
            moment = self._next or next(self._moments, None)
            self._next = moment
            if moment is None or moment.at_s > at_s:
                return
            self._next = None
            yield moment

    def _wait_for_views(self) -> None:
        """Let the views catch up, for a bounded time: a hub drops what it has no room for."""
        patience = time.monotonic() + 5.0
        while self._hub.waiting > MOST_WAITING and time.monotonic() < patience:
            time.sleep(0.01)


class Player:
    """Plays in a thread of its own, from the begin of the `with` block to its end. The operator of the views.

    Attributes:
        problem: Why it plays no more, empty otherwise.
    """

    actions = frozenset({Action.PLAY, Action.PAUSE, Action.SEEK})

    def __init__(self, playback: Playback, hub: Hub, end_s: float, rate: float = 1.0) -> None:
        """Stand at the begin.

        Args:
            playback: What is played.
            hub: Is told the place on the time line.
            end_s: Length of the recording.
            rate: Multiple of the recorded speed.
        """
        self.problem = ""
        self._playback, self._hub, self._end_s, self._rate = playback, hub, end_s, rate
        self._lock = Lock()
        self._playing = True
        self._jump_to: float | None = 0.0
        self._stopped = Event()
        self._reported_s = self._told_s = 0.0
        self._thread = Thread(target=self._play, name="sfr-live-player", daemon=True)

    def __enter__(self) -> Player:
        """Begin to play."""
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """End."""
        self._stopped.set()
        self._thread.join(5.0)

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
                if self._jump_to is None and self._playback.at_s >= self._end_s:
                    self._jump_to = 0.0
                self._playing = True
                return "plays"
            if command.action is Action.SEEK:
                self._jump_to = min(command.at_s, self._end_s)
                return f"goes to {self._jump_to:.1f} s"
        raise InputError(f"'{command.action}' is not possible here: a recording is played, there are no nodes")

    def close(self) -> None:
        """Do nothing: no command takes long."""

    def _play(self) -> None:
        try:
            self._loop()
        except SfrError as error:
            self.problem = str(error)
            self._hub.put(Status("recording", StatusKind.HEALTH, 2, self.problem, {}, time.time()))

    def _loop(self) -> None:
        last_s = time.monotonic()
        while not self._stopped.is_set():
            now_s = time.monotonic()
            with self._lock:
                jump_to, self._jump_to = self._jump_to, None
                playing = self._playing
            if jump_to is not None:
                self._jump(jump_to)
                last_s = time.monotonic()
            elif playing:
                self._step(min(self._playback.at_s + (now_s - last_s) * self._rate, self._end_s))
                last_s = now_s
            else:
                last_s = now_s
            self._playback.show_images()
            self._tell(force=False)
            self._stopped.wait(TICK_S)

    def _jump(self, at_s: float) -> None:
        if at_s < self._playback.at_s:
            self._playback.rewind()
            self._hub.put(TimeLine(at_s, self._end_s, self._playing, restarted=True))
        self._step(at_s)
        self._report()
        self._tell(force=True)

    def _step(self, at_s: float) -> None:
        self._playback.advance(at_s)
        if at_s < self._end_s:
            if time.monotonic() - self._reported_s >= REPORT_PERIOD_S:
                self._report()
            return
        self._report()
        with self._lock:
            self._playing = False
        self._tell(force=True)

    def _report(self) -> None:
        self._playback.report()
        self._reported_s = time.monotonic()

    def _tell(self, *, force: bool) -> None:
        now_s = time.monotonic()
        if force or now_s - self._told_s >= TIME_LINE_PERIOD_S:
            self._told_s = now_s
            self._hub.put(TimeLine(round(self._playback.at_s, 3), self._end_s, self._playing))


def _now(shown: PoseSample | Status | CloudSample | ElevationSample) -> Update:
    """Return a record as received at this moment."""
    if isinstance(shown, CloudSample | ElevationSample):
        return replace(shown, published_s=time.time())
    return replace(shown, received_s=time.time())
