"""Hands what a run publishes to a `LiveState`, in a thread of its own, and carries out what is asked of the nodes.

Small messages are subscribed to always; images, feature tracks and clouds only while a page looks at them. Image
messages are dropped as bytes, undecoded, beyond the rate that is shown.
"""

from __future__ import annotations

import math
import os
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from threading import Event, Thread
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from sensor_msgs.msg import CompressedImage, Image, PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger

from sfr_loc_map.errors import InputError, NodeError, SfrError
from sfr_loc_map.geometry.arrays import FloatArray32
from sfr_loc_map.geometry.plausibility import check_image_size
from sfr_loc_map.inputs import NS_PER_S, SIDES, Task, serialised_stamp, stamp_of
from sfr_loc_map.io.image_codec import decode_grey, image_from_message, points_image
from sfr_loc_map.live import media, updates
from sfr_loc_map.live.state import LiveState
from sfr_loc_map.nodes import messages
from sfr_loc_map.nodes.diagnostics import TOPIC, level_of
from sfr_loc_map.nodes.lifecycle.worker import Overload, Worker
from sfr_loc_map.nodes.peer import Peer
from sfr_loc_map.nodes.processes import page_node_name
from sfr_loc_map.nodes.reception import TransportGaps
from sfr_loc_map.runs.calls import decode_call, values_of

SUITE_NODES = ("localisation_node", "mapping_node", "monitor_node")
DEPTH = 200
GRAPH_PERIOD_S = 0.5
SPIN_S = 0.1
IMAGE_PERIOD_S = 0.15  #: Shortest time between two pairs of images that are shown.
TRACKED = "loc/left"  #: The image that tracks are drawn on; of its stamps that are not shown they are left out.
MAX_SHOWN = 64  #: Images of which tracks are waited for: ten seconds.
MAX_MAPS = 8  #: Clouds, elevation and hazard grids that wait; of more the oldest are left out.
IMAGE_KINDS = ((Image, "image_rect"), (CompressedImage, "image_rect/compressed"), (Image, "image_raw"))
LAYERS = ("height", *messages.ELEVATION_FIELDS[3:])  #: Layers of an elevation message, after x and y.
FOUND_S, ANSWER_S, POLL_S = 2.0, 10.0, 0.02
CALL_LEVELS = {"lost": 2, "degraded": 1, "initialising": 1}  #: Levels of diagnostics by the state after a call.
TRANSITIONS = {
    updates.Action.ACTIVATE: Transition.TRANSITION_ACTIVATE,
    updates.Action.DEACTIVATE: Transition.TRANSITION_DEACTIVATE,
}
SERVICES = {
    updates.Action.RESET: SUITE_NODES,
    updates.Action.FINISH: ("mapping_node",),
    updates.Action.SAVE: ("monitor_node",),
}
"""Nodes that offer each service."""


class RosFeed(Peer):
    """A ROS node that receives for a page, and the operator of it; a context manager that runs its thread.

    True points are always received: they are published once, and are what clouds are compared with.
    """

    actions = frozenset({*TRANSITIONS, *SERVICES, updates.Action.BOOKMARK})

    def __init__(self, state: LiveState, namespace: str = "") -> None:
        super().__init__(page_node_name(os.getpid()), f"/{namespace.strip('/')}")
        self._state, self._space = state, namespace.strip("/")
        self._gaps: dict[str, TransportGaps] = {}
        self._subscriptions: dict[updates.View, list[Any]] = {}
        self._due: dict[str, tuple[float, int]] = {}
        self._shown: deque[int] = deque(maxlen=MAX_SHOWN)
        self._map = MapFeed(state, lambda: bool(self.node.count_publishers(updates.ELEVATION)))
        self._worker = Worker("sfr-live-maps", Overload.EVERY_PAIR, MAX_MAPS, lambda error, was_message: None)
        self._best_effort = QoSProfile(depth=2, reliability=ReliabilityPolicy.BEST_EFFORT)
        truth = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._receive_map(updates.TRUE_POINTS, PointCloud2, self._map.add_true_points, truth)
        state.operator = self
        # here, so that a recording under way finds them
        events = PublisherEventCallbacks(use_default_callbacks=False)
        self._bookmarks = self.node.create_publisher(String, "bookmark", QoSProfile(depth=100), event_callbacks=events)
        best_effort = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        for track, topic in ((updates.Track.ESTIMATE, updates.LOCALISATION), (updates.Track.TRUTH, updates.TRUTH)):
            self._receive(Odometry, topic, partial(self._on_odometry, track), best_effort)
        for task in Task:
            self.subscribe(String, f"{task}_node/call", partial(self._on_call, task), best_effort)
        # the diagnostics have many publishers; of reports only the latest is kept for who is late
        self.subscribe(DiagnosticArray, TOPIC, self._on_diagnostics, best_effort)
        self.subscribe(String, updates.REPORT, self._on_report, latched)
        self.node.create_timer(GRAPH_PERIOD_S, self._look_around)
        self._ended = Event()
        self._thread = Thread(target=self._spin, name="sfr-live-ros", daemon=True)

    def __enter__(self) -> RosFeed:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join(5.0)
        self._worker.stop()
        super().__exit__()

    def _spin(self) -> None:
        while not self._ended.is_set():
            try:
                self.executor.spin_once(timeout_sec=SPIN_S)
            except Exception as error:  # of one message; the page must not stop for it
                if not self._ended.is_set():
                    self.node.get_logger().error(f"live: {error!r}", throttle_duration_sec=5.0)

    def _on_report(self, message: String, _: dict[str, Any]) -> None:
        self._state.put(updates.Report(message.data, time.time()))

    def _on_odometry(self, track: updates.Track, raw: bytes, _: float) -> None:
        message = deserialize_message(raw, Odometry)
        stamp_ns, position, quat = messages.odometry_row(message, positions_alone=track is updates.Track.TRUTH)
        covariance = messages.covariance_of(message) if track is updates.Track.ESTIMATE else None
        self._state.put(updates.PoseSample(track, stamp_ns, position, quat, time.time(), covariance))

    def _on_diagnostics(self, message: DiagnosticArray, _: dict[str, Any]) -> None:
        for status in message.status:
            full_name, _, kind = status.name.partition(": ")
            space, _, name = full_name.strip("/").rpartition("/")
            if space != self._space or name not in SUITE_NODES or kind not in ("health", "input"):
                continue
            what, level = updates.StatusKind(kind), int(level_of(status))
            self._state.put(updates.Status(name, what, level, status.message, values_of(status), time.time()))

    def _on_call(self, task: Task, message: String, _: dict[str, Any]) -> None:
        call, received_s = decode_call(message.data, task), time.time()
        figures = {"stamp_ns": call.stamp_ns, "processing_time_s": call.processing_time_s, **call.times}
        values = {name: repr(value) for name, value in figures.items()} | {"state": call.state, "reason": call.reason}
        if call.peak_rss_bytes is not None:
            values["peak_rss_bytes"] = repr(call.peak_rss_bytes)
        result = f"{call.state}: {call.reason}" if call.reason else call.state
        level = CALL_LEVELS.get(call.state, 0)
        self._state.put(updates.Status(f"{task}_node", updates.StatusKind.CALL, level, result, values, received_s))

    def _look_around(self) -> None:
        """Find out which nodes are there, and receive images and clouds as the pages want."""
        self._follow(self._state.wanted)
        names = self.node.get_node_names_and_namespaces()
        nodes = frozenset(name for name, space in names if space.strip("/") == self._space) & frozenset(SUITE_NODES)
        lost = {topic: gaps.lost for topic, gaps in self._gaps.items()}
        self._state.put(updates.GraphView(nodes, time.time(), lost))

    def _follow(self, wanted: frozenset[updates.View]) -> None:
        """Subscribe to the media that are wanted and to no others; of images to those that somebody publishes."""
        for view in updates.View:
            if view in wanted and view not in self._subscriptions:
                self._subscriptions[view] = self._subscribe_to(view)
            elif view not in wanted:
                for subscription in self._subscriptions.pop(view, ()):
                    self.node.destroy_subscription(subscription)
        if updates.View.IMAGES not in wanted:
            return
        subscriptions = self._subscriptions[updates.View.IMAGES]
        known = {subscription.topic_name for subscription in subscriptions}
        for name in (f"{rig}/{side}" for rig in ("loc", "nav") for side in SIDES):
            for kind, end in IMAGE_KINDS:
                topic = f"{name}/{end}"
                if self.node.resolve_topic_name(topic) not in known and self.node.count_publishers(topic):
                    received = partial(self._on_image, name, kind)
                    subscriptions.append(self._receive(kind, topic, received, self._best_effort))

    def _subscribe_to(self, view: updates.View) -> list[Any]:
        if view is updates.View.TRACKS:
            return [self._receive(PointCloud2, updates.TRACKS, self._on_tracks, self._best_effort)]
        if view is not updates.View.CLOUDS:
            return []
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        return [
            self._receive_map(updates.POINTS, PointCloud2, self._map.add_cloud, latched),
            self._receive_map(updates.ELEVATION, PointCloud2, self._map.add_elevation, latched),
            self._receive_map(updates.HAZARD, OccupancyGrid, self._map.add_hazard, latched),
        ]

    def _receive(
        self, kind: type[Any], topic: str, callback: Callable[[bytes, float], None], qos: QoSProfile
    ) -> Subscription:
        """Subscribe with a callback for serialised messages and the time when they were published, seconds."""
        gaps = self._gaps.setdefault(topic, TransportGaps())

        def received(raw: bytes, info: dict[str, Any]) -> None:
            gaps.add(info)
            with suppress(SfrError, ValueError):  # the node that is given it reports it; what can be shown is shown
                callback(raw, (info.get("source_timestamp") or time.time_ns()) / NS_PER_S)

        return self.subscribe(kind, topic, received, qos, raw=True)

    def _receive_map(
        self, topic: str, kind: type[Any], add: Callable[[Any, float], None], qos: QoSProfile
    ) -> Subscription:
        """Take maps in, beside the thread that receives: figures do not wait for it; a broken one is left out."""

        def received(raw: bytes, published_s: float) -> None:
            self._worker.enqueue_droppable(lambda: add(deserialize_message(raw, kind), published_s))

        return self._receive(kind, topic, received, qos)

    def _on_image(self, name: str, kind: type[Any], raw: bytes, published_s: float) -> None:
        stamp_ns, rig = serialised_stamp(raw), name.partition("/")[0]
        self._state.put(updates.Sampled(name, stamp_ns, published_s))
        due_s, chosen_ns = self._due.get(rig, (0.0, -1))
        now = time.monotonic()
        if now >= due_s:
            self._due[rig] = now + IMAGE_PERIOD_S, stamp_ns
        elif stamp_ns != chosen_ns:  # both images of a stamp are shown, and not more than a screen needs
            return
        if name == TRACKED:
            self._shown.append(stamp_ns)
        message = deserialize_message(raw, kind)
        image = image_from_message(message) if kind is Image else decode_grey(bytes(message.data))
        self._state.put(media.image_sample(name, stamp_ns, image, published_s))

    def _on_tracks(self, raw: bytes, published_s: float) -> None:
        stamp_ns = serialised_stamp(raw)
        if stamp_ns not in self._shown:
            return
        found = messages.tracks_from_msg(deserialize_message(raw, PointCloud2))
        self._state.put(updates.TrackSample(updates.TRACKS, stamp_ns, found, {}, published_s))

    # ---- the operator

    def run(self, command: updates.Command) -> str:
        """Carry out what an operator asks of the nodes; in any thread but that of the executor."""
        node, action = command.node, command.action
        if action is updates.Action.BOOKMARK:
            self._bookmarks.publish(String(data=command.text or "bookmark"))
            return "bookmark published"
        if action in TRANSITIONS and node in SUITE_NODES:
            request = ChangeState.Request(transition=Transition(id=TRANSITIONS[action]))
            if not self._call(ChangeState, f"{node}/change_state", request).success:
                raise NodeError(f"{node} refuses to {action}: see its log")
            return f"{node}: {action} done"
        if node in SERVICES.get(action, ()):
            answer = self._call(Trigger, f"{node}/{action}", Trigger.Request())
            if not answer.success:
                raise NodeError(f"{node}: {answer.message}")
            return f"{node}: {answer.message}"
        raise InputError(f"'{node}' has no '{action}'")

    def close(self) -> None:
        """Give up what is under way; its threads end before the node is destroyed."""
        self._ended.set()

    def _call(self, kind: type[Any], name: str, request: Any) -> Any:  # noqa: ANN401 - any service
        client = self.node.create_client(kind, name)
        try:
            if not self._wait(client.service_is_ready, FOUND_S):
                raise NodeError(f"no node offers {name}: is it running?")
            future = client.call_async(request)
            if not self._wait(future.done, ANSWER_S):
                raise NodeError(f"{name} gave no answer within {ANSWER_S:g} s")
            return future.result()
        finally:
            self.node.destroy_client(client)

    def _wait(self, condition: Callable[[], bool], seconds: float) -> bool:
        deadline = time.monotonic() + seconds
        while not (found := condition()) and time.monotonic() < deadline:
            if self._ended.wait(POLL_S):
                raise NodeError("the page has ended")
        return found


class MapFeed:
    """Gives maps to a state: the mapper's own grid where it publishes one, else one that is made of its cloud.

    Messages that are none raise an `SfrError`.
    """

    def __init__(self, state: LiveState, has_grid: Callable[[], bool]) -> None:
        """Start without a map; `has_grid` tells whether the mapper publishes a grid of its own."""
        self._has_grid = has_grid
        self._state, self._truth = state, media.CloudTruth()
        self._points: tuple[int, FloatArray32, FloatArray32] | None = None
        self._hazard: tuple[int, FloatArray32] | None = None
        self._grid: updates.ElevationSample | None = None

    def add_true_points(self, message: PointCloud2, published_s: float) -> None:
        """Take the true points of a pair in."""
        size = int(message.width), int(message.height)
        check_image_size(*size, updates.TRUE_POINTS)
        self._truth.add(stamp_of(message), points_image(message, size))

    def add_cloud(self, message: PointCloud2, published_s: float) -> None:
        """Take a cloud in."""
        stamp_ns, cloud = stamp_of(message), messages.cloud_from_msg(message)
        error = self._truth.errors(cloud)
        shown = cloud.xyz, cloud.sigma, published_s, error
        sample, grid = media.cloud_samples(stamp_ns, *shown, with_grid=not self._has_grid())
        self._state.put(sample)
        self._points = None if error is None else (stamp_ns, np.asarray(cloud.xyz[:, :2], np.float32), error)
        if grid is not None:
            self._state.put(grid)

    def add_elevation(self, message: PointCloud2, published_s: float) -> None:
        """Take an elevation grid in."""
        cells, stamp_ns = messages.elevation_from_msg(message), stamp_of(message)
        rows, columns = cells.shape[:2]
        axis, steps = (0, columns - 1) if columns > 1 else (1, rows - 1)
        with np.errstate(over="ignore", invalid="ignore"):  # infinite ones are refused
            # one cell alone has the side that is usual
            cell_m = float(cells[-1, -1, axis] - cells[0, 0, axis]) / steps if steps else media.CELL_M
            corner = cells[0, 0, :2] - 0.5 * cell_m
        origin = float(corner[0]), float(corner[1])
        if not (0.0 < cell_m < math.inf and all(map(math.isfinite, origin))):
            raise InputError(f"elevation with cells of {cell_m:g} m: x must grow along the columns, y along the rows")
        grid = updates.ElevationSample(updates.ELEVATION, stamp_ns, origin, cell_m, LAYERS, cells[..., 2:], published_s)
        if self._points is not None and self._points[0] == stamp_ns:
            _, xy, error = self._points
            means = media.means_of(media.cells_of(xy, origin, cell_m, (rows, columns)), error, rows * columns)
            known = np.where(np.isfinite(cells[..., 2]), means.reshape(rows, columns), np.nan)
            grid = media.with_layer(grid, "error", known)
        self._points, self._grid = None, grid
        self._put()

    def add_hazard(self, message: OccupancyGrid, published_s: float) -> None:
        """Take a hazard grid in; it is shown with the elevation of its stamp."""
        self._hazard = stamp_of(message), messages.hazard_from_msg(message)
        self._put()

    def _put(self) -> None:
        """Show the grid with its hazard, whichever comes first."""
        grid, hazard = self._grid, self._hazard
        if grid is None:
            return
        if hazard is not None and hazard[0] == grid.stamp_ns and hazard[1].shape == grid.layers.shape[:2]:
            grid = media.with_layer(grid, "hazard", hazard[1])
        self._state.put(media.thinned(grid))
