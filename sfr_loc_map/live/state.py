"""The state of a run in progress, which the feeds and the server change and all views read.

Its memory is bounded, except for the stamps of all poses (8 bytes each), which `CommonRuns` requires to detect a new
run, as in the monitor.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from threading import RLock
from typing import assert_never

from sfr_loc_map.errors import InputError, SfrError
from sfr_loc_map.latest import Latest
from sfr_loc_map.live import updates
from sfr_loc_map.live.call_log import CallLog
from sfr_loc_map.live.freshness import MAX_TOPICS, ReceivedTopics
from sfr_loc_map.live.node_reports import MAX_LETTERS, NodeReports
from sfr_loc_map.live.path import LivePath
from sfr_loc_map.live.run_end import RunEnd, ShownEnd
from sfr_loc_map.live.shown_score import ShownScore
from sfr_loc_map.live.timeline import EventKind, Timeline
from sfr_loc_map.message_text import one_line
from sfr_loc_map.metrics.stored.score_json import from_json
from sfr_loc_map.run_order import CommonRuns
from sfr_loc_map.topics import ESTIMATE, REPORT, TRUE_POSES

MAX_NODES = 32
MAX_STAMPS = 2000  #: Number of images whose time of publication is kept.
MAX_PROBLEMS = 20
MAX_REPORT_CHARACTERS = 8_000_000


class LiveState:
    """The state of a run. Methods may be called in any thread; a reader of several attributes must hold `lock`."""

    def __init__(self) -> None:
        self.lock = RLock()
        self.path = LivePath()
        self.score: ShownScore | None = None
        self.nodes: dict[str, NodeReports] = {}
        self.calls = CallLog()
        self.topics = ReceivedTopics()
        self.media: dict[str, updates.Media] = {}  # newest image or map of each topic
        self.image_problems: dict[str, str] = {}  # why images cannot be shown, by topic
        self.problems: deque[str] = deque(maxlen=MAX_PROBLEMS)  # unreadable inputs, newest last
        self.timeline = Timeline()
        self.shown_end = ShownEnd()
        self._runs: CommonRuns[updates.PoseSample] = CommonRuns(updates.Track)
        self._published = Latest[int, float](MAX_STAMPS)  # publication time of images by stamp, s
        self._watchers = set[object]()
        self._on_change: Callable[[], None] = lambda: None

    # ---- views

    def call_on_change(self, callback: Callable[[], None]) -> None:
        """Set a function that is called after each record, in the thread that adds the record."""
        self._on_change = callback

    def watch(self, viewer: object, *, is_watching: bool) -> None:
        """Note whether a viewer displays images and maps."""
        with self.lock:
            if is_watching:
                self._watchers.add(viewer)
            else:
                self._watchers.discard(viewer)

    @property
    def is_watched(self) -> bool:
        """Whether a viewer displays images and maps, which are costly to prepare; otherwise a feed omits them."""
        return bool(self._watchers)

    def silent_nodes(self, now_s: float) -> dict[str, float]:
        """Return the stale nodes, each with the time of its last report, s."""
        return {name: node.heard_s for name, node in self.nodes.items() if node.heard_s and node.is_stale(now_s)}

    # ---- records

    def put(self, update: updates.Update) -> None:
        """Add a record; an invalid record is reported as a problem."""
        with self.lock:
            try:
                self._take_in(update)
            except (SfrError, ValueError, OverflowError) as error:
                self.problems.append(one_line(str(error)))
        self._on_change()

    def tick(self, now_s: float) -> None:
        """Add events for poses and reports of nodes that were not received in time."""
        with self.lock:
            if not self.shown_end.is_over:
                self.timeline.tick(now_s, self.silent_nodes(now_s))

    def end(self, run_end: RunEnd, now_s: float) -> None:
        """Record that the run is over or was aborted, with its report and its score if there are any.

        Later silence is then not reported as stale data.
        """
        page = run_end.report_page()
        with self.lock:
            shown = self.shown_end
            if not shown.is_over:
                self.timeline.end_all(now_s)
                shown.at_s = now_s
            shown.report_page = page or shown.report_page
            if run_end.aborted and not shown.aborted_by:
                shown.aborted_by = run_end.aborted
                shown.aborted_s = now_s
                self.timeline.mark(now_s, EventKind.ABORTED, f"aborted: {run_end.aborted}")
            if run_end.score and not shown.has_score:
                self.score = ShownScore(from_json(run_end.score, "the score of the run"), now_s)
                shown.has_score = True

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
        self.topics.add(REPORT, None, update.received_s)
        if (length := len(update.text)) > MAX_REPORT_CHARACTERS:
            raise InputError(f"{REPORT} has {length} characters: at most {MAX_REPORT_CHARACTERS} are allowed")
        if self.shown_end.has_score:
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
        self.topics.add(topic, update.stamp_ns, update.received_s)
        accepted, begins_run = self._runs.add(update.track, update.stamp_ns, update)
        if begins_run:
            self.path.restart()
            self.calls.forget_before(accepted[0].received_s)
            if not self.shown_end.is_over:
                self.timeline.begin_run(accepted[0].stamp_ns, update.received_s)
        for pose in accepted:
            if self.path.is_late(pose):
                continue
            if pose.track is updates.Track.ESTIMATE and not self.shown_end.is_over:
                self.timeline.take_estimate(pose)
            self.path.add(pose, self._published.get(pose.stamp_ns))

    def _take_status(self, update: updates.Status) -> None:
        """Add a node's health, unusable input or internal fault."""
        if not self.shown_end.is_over:
            self.timeline.take_status(update)
        if (node := self._ensure_node(update.node)) is not None:
            node.add_status(update)

    def _take_call(self, update: updates.NodeCall) -> None:
        """Add a call of a node."""
        if not self.shown_end.is_over:
            self.timeline.take_call(update)
        if (node := self._ensure_node(update.node)) is not None:
            node.add_call(update)
            self.calls.add(update)

    def _ensure_node(self, name: str) -> NodeReports | None:
        """Return the reports of a node, which are created at the first call; None if there are too many nodes."""
        if name not in self.nodes and len(self.nodes) < MAX_NODES:
            self.nodes[name] = NodeReports(name)
        return self.nodes.get(name)

    def _take_stamp(self, update: updates.ImageStamp) -> None:
        """Note when the images of a stamp were published."""
        self.topics.add(update.topic, update.stamp_ns, update.published_s)
        self._published[update.stamp_ns] = update.published_s

    def _take_image_problem(self, update: updates.ImageProblem) -> None:
        """Note why an image is not displayed."""
        if update.topic in self.image_problems or len(self.image_problems) < MAX_TOPICS:
            self.image_problems[update.topic] = one_line(update.text)[:MAX_LETTERS]

    def _take_graph(self, update: updates.GraphNodes) -> None:
        """Note which nodes are in the graph, and the lost messages by topic."""
        self.topics.lost = update.lost
        for name in update.nodes:
            self._ensure_node(name)
        for name, node in self.nodes.items():
            node.in_graph = name in update.nodes

    def _take_media(self, update: updates.Media) -> None:
        """Replace the image or the map of a topic by the newest one."""
        before = self.media.get(update.topic)
        if before is None and len(self.media) >= MAX_TOPICS:
            return
        is_new = before is None or before.stamp_ns != update.stamp_ns
        if is_new and isinstance(update, updates.ElevationSample):
            self.topics.add(update.topic, update.stamp_ns, update.published_s)
        self.media[update.topic] = update
