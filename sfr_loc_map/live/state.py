"""The state of a run in progress, which one feed writes and all views read.

Its memory is bounded, except for the stamps of all poses (8 bytes each), which `CommonRuns` requires to detect a new
run, as in the monitor.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import asdict
from threading import RLock
from typing import Any, assert_never

from sfr_loc_map.errors import InputError, SfrError
from sfr_loc_map.latest import Latest
from sfr_loc_map.live import updates
from sfr_loc_map.live.commands import NoOperator, Operator
from sfr_loc_map.live.displayed_media import DisplayedMedia
from sfr_loc_map.live.freshness import ReceivedTopic
from sfr_loc_map.live.headline import headline
from sfr_loc_map.live.node_reports import LOCALISATION_NODE, MAX_LETTERS, NodeReports, NumberedCall, state_of_pose
from sfr_loc_map.live.path import ROW_FIELDS, LivePath
from sfr_loc_map.live.run_end import Aborted, RunEnd
from sfr_loc_map.live.shown_score import NO_SCORE_SHOWN, ShownScore
from sfr_loc_map.live.timeline import EventKind, Timeline
from sfr_loc_map.message_text import one_line
from sfr_loc_map.metrics.score.score import SCHEMA
from sfr_loc_map.metrics.stored.score_json import from_json
from sfr_loc_map.run_order import AnyOrder, CommonRuns
from sfr_loc_map.topics import ESTIMATE, REPORT, TRUE_POSES

MAX_NODES = 32
MAX_TOPICS = 32
MAX_STAMPS = 2000  #: Number of images whose time of publication is kept.
MAX_PROBLEMS = 20
MAX_CALLS = 600
MAX_REPORT_CHARACTERS = 8_000_000
NO_SCORE: dict[str, Any] = {"schema": SCHEMA, "figures": [], "verdicts": []}  #: Content before the first score.
STALE_TOPICS = {ESTIMATE: "pose", REPORT: "figures"}  #: Topics whose silence makes the displayed data stale.


class LiveState:
    """The state of a run. Methods may be called in any thread; a reader of several attributes must hold `lock`."""

    def __init__(self) -> None:
        self.lock = RLock()
        self._on_change: Callable[[], None] = lambda: None
        self.displayed = DisplayedMedia()
        self.operator: Operator = NoOperator()  # replaced once the graph is joined
        self._runs: CommonRuns[updates.PoseSample] = CommonRuns({track: AnyOrder() for track in updates.Track})
        self.path = LivePath()
        self.score: ShownScore | None = None
        self.nodes: dict[str, NodeReports] = {}
        self.calls: deque[NumberedCall] = deque(maxlen=MAX_CALLS)
        self.media: dict[str, updates.Media] = {}  # newest image or map of each topic
        self.image_problems: dict[str, str] = {}  # why images cannot be shown, by topic
        self.topics: dict[str, ReceivedTopic] = {}
        self.lost: dict[str, int] = {}  # messages lost in transport to this process, by topic
        self.problems: deque[str] = deque(maxlen=MAX_PROBLEMS)  # unreadable inputs, newest last
        self.timeline = Timeline()
        self.ended_s: float | None = None  # time of the end, s; None during the run
        self.aborted: Aborted | None = None
        self._report_page = b""  # HTML report after the end of the run
        # whether the score is that of the complete run; a score of the monitor must not replace it
        self._has_final_score = False
        self._result_s: float | None = None  # reception of the last pose or call, s; None before the first
        self._published = Latest[int, float](MAX_STAMPS)  # publication time of images by stamp, s
        self._call_count = 0

    @property
    def call_numbers(self) -> tuple[int, int]:
        """Number of the first kept call, and number of the next call."""
        return self._call_count - len(self.calls), self._call_count

    @property
    def ended(self) -> bool:
        """Whether the run is over."""
        return self.ended_s is not None

    # ---- views

    def shown_media(self, viewer: object) -> dict[str, updates.Media]:
        """Return, by topic, the newest images and maps of the kinds that a viewer displays."""
        kinds = self.displayed.kinds_of(viewer)
        with self.lock:
            return {topic: media for topic, media in self.media.items() if media.kind in kinds}

    def call_on_change(self, callback: Callable[[], None]) -> None:
        """Set a function that is called after each record, in the thread of the feed."""
        self._on_change = callback

    @property
    def report_page(self) -> bytes:
        """HTML report after the end of the run; empty before."""
        return self._report_page

    # ---- records

    def put(self, update: updates.Update) -> None:
        """Add a record; an invalid record is reported as a problem."""
        with self.lock:
            try:
                if not math.isfinite(update.time_s):
                    raise ValueError(f"{update.subject} is ignored, because its time is not a finite number")
                self._take_in(update)
            except (SfrError, ValueError, OverflowError) as error:
                self.problems.append(one_line(str(error)))
        self._on_change()

    def tick(self, now_s: float) -> None:
        """Add events for poses and reports of nodes that were not received in time."""
        with self.lock:
            if not self.ended:
                self.timeline.tick(now_s, self._silent_nodes(now_s))

    def end_reception(self, now_s: float) -> None:
        """Record that no more data are received, so that later silence is not reported as stale data."""
        with self.lock:
            if self.ended_s is None:
                self.timeline.end_all(now_s)
                self.ended_s = now_s

    def end(self, run_end: RunEnd, now_s: float) -> None:
        """Record that the run is over or was aborted, with its report and its score if there are any."""
        page, score_text = run_end.report_page(), run_end.score_text()
        with self.lock:
            self.end_reception(now_s)
            self._report_page = page or self._report_page
            if run_end.aborted and self.aborted is None:
                self.aborted = Aborted(run_end.aborted, now_s)
                self.timeline.mark(now_s, EventKind.ABORTED, f"aborted: {run_end.aborted}")
            if score_text and not self._has_final_score:
                self.score = ShownScore(from_json(score_text, "the score of the run"), now_s)
                self._has_final_score = True

    def to_plain(self, now_s: float) -> dict[str, Any]:
        """Return the latest score (`sfr-score/2`) with the state of the run as `live`, as JSON values."""
        with self.lock:
            live, score, events = self.live_to_plain(now_s), self.score, self.events_to_plain()
        content = NO_SCORE if score is None else score.content
        shown = NO_SCORE_SHOWN if score is None else score.to_plain()
        live |= {name: shown[name] for name in NO_SCORE_SHOWN}
        return content | {"live": live | {"events": events}}

    def live_to_plain(self, now_s: float) -> dict[str, Any]:
        """Return the `live` part of `state.json` as JSON values, without events and the content of the score."""
        with self.lock:
            silent = self._silent_nodes(now_s)
            score, newest = self.score, self.path.newest
            age_s = self._age_of_verdict_s(now_s)
            topics = {
                name: topic.to_plain(now_s, self.lost.get(name, 0)) for name, topic in sorted(self.topics.items())
            }
            stale_reasons = self._stale_reasons(silent, now_s)
            shown = headline(
                None if score is None else score.overall,
                () if score is None else score.bars,
                age_s=age_s,
                stale_reasons=stale_reasons,
                ended_s=self.ended_s,
                aborted=self.aborted,
            )
            return {
                "schema": "sfr-live/1",
                "time_s": now_s,
                "stale": ESTIMATE in topics and topics[ESTIMATE]["stale"],
                "headline": asdict(shown),
                "age_s": age_s,
                "stale_reasons": stale_reasons,
                "ended": self.ended,
                "ended_at": self.ended_s,
                "aborted": None if self.aborted is None else self.aborted.to_plain(),
                "has_report": bool(self._report_page),
                "report_age_s": None if score is None else round(now_s - score.received_s, 3),
                "nodes": [self._node_to_plain(name, now_s) for name in sorted(self.nodes)],
                "topics": topics,
                "localisation": self._localisation_to_plain(now_s),
                "last_call": {item.call.node: item.to_plain() for item in self._last_calls()},
                "poses": 0 if newest is None else newest.n + 1,
                "problems": list(self.problems),
                "image_problems": {topic: text for topic, text in self.image_problems.items() if text},
            }

    def _node_to_plain(self, name: str, now_s: float) -> dict[str, Any]:
        """Return a node with its possible actions as JSON values."""
        return self.nodes[name].to_plain(now_s) | {"actions": list(self.operator.node_actions.get(name, ()))}

    def _age_of_verdict_s(self, now_s: float) -> float | None:
        """Return the time since the last score or the last result, whichever is older; None without a score.

        A score is latched, so it may be received without any pose or call.
        """
        if self.score is None:
            return None
        known_s = [self.score.received_s] if self._result_s is None else [self.score.received_s, self._result_s]
        return round(now_s - min(known_s), 3)

    def _localisation_to_plain(self, now_s: float) -> dict[str, Any] | None:
        """Return the last pose with its state and age as JSON values; None before the first pose.

        `stale` states whether a newer pose is overdue, or the node has become silent.
        """
        row, node = self.path.newest, self.nodes.get(LOCALISATION_NODE)
        if row is None:
            return None
        topic = self.topics.get(ESTIMATE)
        plain = dict(zip(ROW_FIELDS, row.to_plain(), strict=True))
        plain |= asdict(state_of_pose(None if node is None else node.call, covariance_is_lost=row.lost))
        is_overdue = topic is not None and topic.is_stale(now_s)
        plain["stale"] = is_overdue or LOCALISATION_NODE in self._silent_nodes(now_s)
        plain["age_s"] = round(max(now_s - (row.received_s if topic is None else topic.received_s), 0.0), 3)
        plain["distance_m"] += self.path.before_m
        return plain

    def _silent_nodes(self, now_s: float) -> dict[str, float]:
        """Return the stale nodes, each with the time of its last report, s."""
        return {name: node.heard_s for name, node in self.nodes.items() if node.heard_s and node.is_stale(now_s)}

    def events_to_plain(self) -> list[dict[str, Any]]:
        """Return the events of the run as JSON values, with times of the clock, s."""
        with self.lock:
            return self.timeline.to_plain()

    def _last_calls(self) -> Iterable[NumberedCall]:
        """Return the last call of each node."""
        return {item.call.node: item for item in self.calls}.values()

    def _stale_reasons(self, silent: dict[str, float], now_s: float) -> list[str]:
        """Return why the displayed data are stale; empty after the end of the run."""
        if self.ended:
            return []
        known = [(text, self.topics[name]) for name, text in STALE_TOPICS.items() if name in self.topics]
        stopped = [(text, topic) for text, topic in known if topic.is_stale(now_s)]
        return [
            *(f"no {text} for {topic.age_s(now_s):.1f} s" for text, topic in stopped),
            *(f"{name} silent for {now_s - since_s:.1f} s" for name, since_s in sorted(silent.items())),
        ]

    def _note_topic(self, name: str, stamp_ns: int | None, received_s: float) -> None:
        if name in self.topics or len(self.topics) < MAX_TOPICS:
            self.topics[name] = ReceivedTopic.after(self.topics.get(name), stamp_ns, received_s)

    def _ensure_node(self, name: str) -> NodeReports | None:
        """Return the reports of a node, which are created at the first call; None if there are too many nodes."""
        if name not in self.nodes and len(self.nodes) < MAX_NODES:
            self.nodes[name] = NodeReports(name)
        return self.nodes.get(name)

    def _take_in(self, update: updates.Update) -> None:
        match update:
            case updates.PublishedScore():
                self._take_score(update)
            case updates.PoseSample():
                self._take_pose(update)
            case updates.NodeCall():
                self._take_call(update)
            case updates.Status():
                self._take_status(update)
            case updates.ImageStamp():
                self._take_stamp(update)
            case updates.ImageProblem():
                self._take_image_problem(update)
            case updates.GraphNodes():
                self._take_graph(update)
            case updates.ImageSample() | updates.ElevationSample():
                self._take_media(update)
            case _:
                assert_never(update)

    def _take_score(self, update: updates.PublishedScore) -> None:
        """Add a score of the monitor."""
        self._note_topic(REPORT, None, update.received_s)
        if (length := len(update.text)) > MAX_REPORT_CHARACTERS:
            raise InputError(f"{REPORT} has {length} characters: at most {MAX_REPORT_CHARACTERS} are allowed")
        if self._has_final_score:
            return
        self.score = ShownScore(from_json(update.text, REPORT), update.received_s)
        bars = sorted(self.score.bars, key=lambda bar: bar.place)
        self.timeline.judge(bars, update.received_s)
        if (drive := self.score.score.association) is not None:
            self.path.note_length(drive.path_length_m)
        self.path.note_conversion(is_converted=self.score.converts_truth)

    def _take_pose(self, update: updates.PoseSample) -> None:
        """Add a pose to the path of its track, once the run of the pose is known; late poses are dropped."""
        topic = ESTIMATE if update.track is updates.Track.ESTIMATE else TRUE_POSES
        self._note_topic(topic, update.stamp_ns, update.received_s)
        if update.track is updates.Track.ESTIMATE:
            self._result_s = update.received_s
        accepted, begins_run = self._runs.add(update.track, update.stamp_ns, update)
        if begins_run:
            self.path.restart()
            self._forget_calls_before(accepted[0].received_s)
            if not self.ended:
                self.timeline.begin_run(accepted[0].stamp_ns, update.received_s)
        for pose in accepted:
            if self.path.is_late(pose):
                continue
            if pose.track is updates.Track.ESTIMATE and not self.ended:
                self.timeline.take_estimate(pose)
            self.path.add(pose, self._published.get(pose.stamp_ns))

    def _forget_calls_before(self, received_s: float) -> None:
        """Forget the calls of the previous run, which were received before the first pose of the new run."""
        while self.calls and self.calls[0].call.received_s < received_s:
            self.calls.popleft()

    def _take_status(self, update: updates.Status) -> None:
        """Add a node's health, unusable input or internal fault."""
        if not self.ended:
            self.timeline.take_status(update)
        if (node := self._ensure_node(update.node)) is not None:
            node.add(update)

    def _take_call(self, update: updates.NodeCall) -> None:
        """Add a call of a node."""
        if not self.ended:
            self.timeline.take_call(update)
        if (node := self._ensure_node(update.node)) is not None:
            node.add(update)
            self._result_s = update.received_s
            self.calls.append(NumberedCall(self._call_count, update))
            self._call_count += 1

    def _take_stamp(self, update: updates.ImageStamp) -> None:
        """Note when the images of a stamp were published."""
        self._note_topic(update.topic, update.stamp_ns, update.published_s)
        self._published[update.stamp_ns] = update.published_s

    def _take_image_problem(self, update: updates.ImageProblem) -> None:
        """Note why an image is not displayed."""
        if update.topic in self.image_problems or len(self.image_problems) < MAX_TOPICS:
            self.image_problems[update.topic] = one_line(update.text)[:MAX_LETTERS]

    def _take_graph(self, update: updates.GraphNodes) -> None:
        """Note which nodes are in the graph, and the lost messages by topic."""
        self.lost = dict(update.lost)
        for name in update.nodes:
            self._ensure_node(name)
        for name, node in self.nodes.items():
            node.in_graph = name in update.nodes

    def _take_media(self, update: updates.Media) -> None:
        """Replace the image, cloud or grid of a topic by the newest one."""
        before = self.media.get(update.topic)
        if before is None and len(self.media) >= MAX_TOPICS:
            return
        is_new = before is None or before.stamp_ns != update.stamp_ns
        if is_new and isinstance(update, updates.ElevationSample):
            self._note_topic(update.topic, update.stamp_ns, update.published_s)
        self.media[update.topic] = update
