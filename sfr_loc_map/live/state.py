"""The state of a run while it goes on: typed, of bounded memory, fed by the records of `updates`."""

from __future__ import annotations

import math
from collections import OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from sfr_loc_map.errors import SfrError
from sfr_loc_map.inputs import one_line
from sfr_loc_map.live.node_view import MAX_CALLS, CallSample, NodeView
from sfr_loc_map.live.path import LivePath, PathRow
from sfr_loc_map.live.report_view import ReportView
from sfr_loc_map.live.updates import (
    MEDIA,
    CloudSample,
    ElevationSample,
    GraphView,
    Media,
    PoseSample,
    Report,
    Sampled,
    Status,
    StatusKind,
    TimeLine,
    Track,
    Update,
)
from sfr_loc_map.metrics.score_json import SCHEMA

LIVE_SCHEMA = "sfr-live/1"
MAX_NODES = 32
MAX_TOPICS = 32
MAX_STAMPS = 2000
MAX_PROBLEMS = 20
TOPIC_STALE_S = 1.7
MIN_PERIOD_S = 1e-6
"""Shortest period that a rate is told of: messages that are all of one moment have none."""
LOCALISATION, TRUTH, REPORT = "localisation/odometry", "ground_truth/odometry", "metrics/report"


@dataclass(slots=True)
class TopicView:
    """When a topic was last received.

    Attributes:
        stamp_ns: Stamp of the last message, None where it has none.
        received_s: When it was received.
        period_s: Smoothed time between two messages, 0 before the second.
    """

    stamp_ns: int | None
    received_s: float
    period_s: float = 0.0

    def add(self, stamp_ns: int | None, received_s: float) -> None:
        """Note a message."""
        passed = max(received_s - self.received_s, 0.0)
        self.period_s = passed if not self.period_s else 0.8 * self.period_s + 0.2 * passed
        self.stamp_ns, self.received_s = stamp_ns, received_s

    def is_stale(self, now_s: float) -> bool:
        """Tell whether nothing has come for longer than its period explains; what came once has none."""
        return self.period_s > 0.0 and now_s - self.received_s > max(TOPIC_STALE_S, 3.0 * self.period_s)


class LiveState:
    """What is known of a run. One thread alone uses it.

    Attributes:
        path: Estimates, truth and errors.
        report: The monitor's latest report, None before the first.
        nodes: By name.
        calls: The last calls.
        media: Newest image, cloud, map and tracks by topic.
        topics: By name.
        time_line: Of the player of a recorded run, None of a live one.
        problems: What could not be read, the latest last.
    """

    def __init__(self) -> None:
        """Start with nothing known."""
        self.path = LivePath()
        self.report: ReportView | None = None
        self.nodes: dict[str, NodeView] = {}
        self.calls: deque[CallSample] = deque(maxlen=MAX_CALLS)
        self.media: dict[str, Media] = {}
        self.topics: dict[str, TopicView] = {}
        self.lost: dict[str, int] = {}
        self.time_line: TimeLine | None = None
        self.problems: deque[str] = deque(maxlen=MAX_PROBLEMS)
        self._sampled: OrderedDict[int, float] = OrderedDict()
        self._call_count = 0
        self._heard_s = 0.0
        self._appliers: dict[type[Any], Callable[[Any], None]] = {
            Report: self._add_report,
            PoseSample: self._add_pose,
            Status: self._add_status,
            Sampled: self._add_sampled,
            **dict.fromkeys(MEDIA, self._add_media),
            GraphView: self._add_graph,
            TimeLine: self._add_time_line,
        }

    def apply(self, update: Update) -> bool:
        """Take a record in and return True; one that makes no sense is noted as a problem."""
        try:
            self._heard_s = max(self._heard_s, _time_of(update))
            self._appliers[type(update)](update)
        except (SfrError, ValueError, OverflowError) as error:
            self.problems.append(one_line(str(error)))
            return False
        return True

    def published_s(self, stamp_ns: int) -> float | None:
        """Return when the image of a stamp was published, None where that is not known."""
        return self._sampled.get(stamp_ns)

    def row_to_plain(self, row: PathRow) -> list[Any]:
        """Return a row of the path as a list in the order of `ROW_FIELDS`."""
        return [
            row.n,
            str(row.stamp_ns),
            round(row.received_s, 4),
            self.published_s(row.stamp_ns),
            _rounded(row.position),
            None if row.covariance_xy is None else [float(f"{value:.4g}") for value in row.covariance_xy],
            int(row.lost),
            _rounded(row.truth),
            _rounded(row.error, 6),
            round(row.distance_m, 4),
        ]

    def to_plain(self, now_s: float) -> dict[str, Any]:
        """Return the latest report (`sfr-score/1`) with the state of the run as `live`, as JSON values."""
        report = self.report
        content: dict[str, Any] = {"schema": SCHEMA, "verdicts": []} if report is None else dict(report.content)
        return content | {"live": self.live_to_plain(now_s)}

    def live_to_plain(self, now_s: float, *, tables: bool = True) -> dict[str, Any]:
        """Return what `state.json` adds to the score, as JSON values; the tables change with the report only."""
        now_s = self.moment(now_s)
        report, latest = self.report, self.path.rows[-1] if self.path.rows else None
        view = report.to_plain() if report is not None and tables else None
        return {
            "schema": LIVE_SCHEMA,
            "time_s": now_s,
            "stale": self.is_stale(now_s),
            "overall": None if view is None else view["overall"],
            "tables": [] if view is None else view["tables"],
            "report_age_s": None if report is None else round(now_s - report.received_s, 3),
            "nodes": [self.nodes[name].to_plain(now_s) for name in sorted(self.nodes)],
            "topics": {name: self._topic(name, now_s) for name in sorted(self.topics)},
            "localisation": None if latest is None else self._localisation(latest),
            "under_way": self.under_way_to_plain(),
            "last_call": {call.node: call.to_plain() for call in self.calls},
            "poses": 0 if latest is None else latest.n + 1,
            "problems": list(self.problems),
            "time_line": self.time_line_to_plain(),
        }

    def moment(self, now_s: float) -> float:
        """Return the moment by which ages are told: while a player stands still, so does its time."""
        return now_s if self.time_line is None or self.time_line.playing else min(now_s, self._heard_s)

    def is_stale(self, now_s: float) -> bool:
        """Tell whether no pose comes any more although there were some."""
        topic = self.topics.get(LOCALISATION)
        return topic is not None and topic.is_stale(self.moment(now_s))

    def under_way_to_plain(self) -> dict[str, Any] | None:
        """Return the sub-trajectory under way as JSON values."""
        found = self.path.under_way
        if found is None:
            return None
        return {
            "start_n": found.start_n,
            "condition": found.condition,
            "progress": round(found.progress, 4),
            "error": list(found.error),
        }

    def time_line_to_plain(self) -> dict[str, Any] | None:
        """Return the place of a player as JSON values."""
        line = self.time_line
        return None if line is None else {"at_s": line.at_s, "end_s": line.end_s, "playing": line.playing}

    def _localisation(self, row: PathRow) -> dict[str, Any]:
        node = self.nodes.get("localisation_node")
        return dict(zip(ROW_FIELDS, self.row_to_plain(row), strict=True)) | {
            "state": "" if node is None else node.state
        }

    def _topic(self, name: str, now_s: float) -> dict[str, Any]:
        topic = self.topics[name]
        return {
            "stamp_ns": None if topic.stamp_ns is None else str(topic.stamp_ns),
            "age_s": round(max(now_s - topic.received_s, 0.0), 3),
            "rate_hz": round(1.0 / topic.period_s, 2) if topic.period_s > MIN_PERIOD_S else None,
            "stale": topic.is_stale(now_s),
            "lost": self.lost.get(name, 0),
        }

    def _note_topic(self, name: str, stamp_ns: int | None, received_s: float) -> None:
        if name in self.topics:
            self.topics[name].add(stamp_ns, received_s)
        elif len(self.topics) < MAX_TOPICS:
            self.topics[name] = TopicView(stamp_ns, received_s)

    def _add_report(self, update: Report) -> None:
        self._note_topic(REPORT, None, update.received_s)
        self.report = ReportView.read(update.text, update.received_s)
        if self.report.conditions:
            self.path.condition = self.report.conditions[0]
        if self.report.spacing:
            self.path.spacing = self.report.spacing

    def _add_pose(self, update: PoseSample) -> None:
        self._note_topic(LOCALISATION if update.track is Track.ESTIMATE else TRUTH, update.stamp_ns, update.received_s)
        self.path.add(update)

    def _add_status(self, update: Status) -> None:
        node = self._node(update.node)
        if node is None:
            return
        node.add(update)
        if update.kind is StatusKind.CALL:
            call = CallSample.of(self._call_count, update)
            if call is not None:
                self.calls.append(call)
                self._call_count += 1

    def _node(self, name: str) -> NodeView | None:
        if name not in self.nodes and len(self.nodes) < MAX_NODES:
            self.nodes[name] = NodeView(name)
        return self.nodes.get(name)

    def _add_sampled(self, update: Sampled) -> None:
        self._note_topic(update.topic, update.stamp_ns, update.published_s)
        self._sampled[update.stamp_ns] = update.published_s
        if len(self._sampled) > MAX_STAMPS:
            self._sampled.popitem(last=False)

    def _add_media(self, update: Media) -> None:
        before = self.media.get(update.topic)
        if before is None and len(self.media) >= MAX_TOPICS:
            return
        if isinstance(update, (CloudSample, ElevationSample)) and (
            before is None or before.stamp_ns != update.stamp_ns
        ):
            self._note_topic(update.topic, update.stamp_ns, update.published_s)
        self.media[update.topic] = update

    def _add_graph(self, update: GraphView) -> None:
        self.lost = dict(update.lost)
        for name in update.nodes:
            self._node(name)
        for name, node in self.nodes.items():
            node.in_graph = name in update.nodes

    def _add_time_line(self, update: TimeLine) -> None:
        self.time_line = update
        if update.restarted:
            self.path.restart()
            self.calls.clear()
            self.report = None


ROW_FIELDS = (
    "n",
    "stamp_ns",
    "received_s",
    "published_s",
    "position_m",
    "covariance_xy_m2",
    "lost",
    "truth_m",
    "error_m",
    "distance_m",
)
"""What stands in a row of the path, in this order."""


def _time_of(update: Update) -> float:
    """Return when a record was received, 0 where it does not say.

    Raises:
        ValueError: If a time of it is no number.
    """
    received_s, published_s = (float(getattr(update, name, 0.0)) for name in ("received_s", "published_s"))
    if not (math.isfinite(received_s) and math.isfinite(published_s)):
        raise ValueError(f"a {type(update).__name__} whose time is no number is left out")
    return received_s


def _rounded(values: tuple[float, float, float] | None, digits: int = 5) -> list[float] | None:
    return None if values is None else [round(value, digits) for value in values]
