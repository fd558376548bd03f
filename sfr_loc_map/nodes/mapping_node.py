"""The mapping node: up to three stereo pairs with their poses in, one cloud out.

Messages are received in the executor's thread, where pairs wait for their poses; the worker's thread alone touches the
mapper and the set of pairs begun.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.qos import QoSProfile
from sensor_msgs.msg import PointCloud2
from stereo_msgs.msg import DisparityImage

from sfr_loc_map.config import param
from sfr_loc_map.constants import NS_PER_S
from sfr_loc_map.errors import InputError, SfrError
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.image_codec import stamp_of
from sfr_loc_map.mapping.config import MAX_PAIRS, MappingConfig
from sfr_loc_map.mapping.mapper import FusedMap, Mapper, PairMap
from sfr_loc_map.metrics.resources import CallUsage
from sfr_loc_map.nodes.diagnostics.call_reporter import CallReporter
from sfr_loc_map.nodes.diagnostics.key_values import Level
from sfr_loc_map.nodes.input.stereo_subscriber import ReceivedPair, StereoInput, StereoInputConfig
from sfr_loc_map.nodes.lifecycle.managed_node import ManagedNode, PairNodeConfig
from sfr_loc_map.nodes.messages.fields import header_msg
from sfr_loc_map.nodes.messages.image import disparity_msg
from sfr_loc_map.nodes.messages.point_cloud import cloud_msg
from sfr_loc_map.nodes.messages.pose import transform_from_pose
from sfr_loc_map.nodes.process.runner import run
from sfr_loc_map.pipeline.online.latency import latencies

NAME = "mapping_node"
ANY_RIG = StereoRig(320, 240, 300.0, 300.0, 159.5, 119.5, 0.1)
"""To warm up and to check parameters with, before the rig is known."""
MAX_POSES = 1000
"""Poses that are kept for pairs still to come."""
MAX_WAITING = 2 * MAX_PAIRS
"""Pairs that are kept for poses still to come."""


@dataclass(frozen=True, slots=True)
class MappingNodeConfig(PairNodeConfig):
    """Parameters of the mapping node."""

    lm_frame: str = param("lm", doc="Name of the local map frame LM: frame of the cloud.")
    pairs_per_map: int = param(
        3, unit="pairs", doc="Stereo pairs after which a cloud is made; a map has 3 at most.", low=1, high=MAX_PAIRS
    )
    pose_wait_s: float = param(
        5.0, unit="s", doc="How long a pair waits for the nav/pose of its stamp.", low=0.0, high=600.0
    )
    output_depth: int = param(10, unit="messages", doc="Depth of the queues of cloud and disparity.", low=1, high=1000)
    input: StereoInputConfig = field(default_factory=StereoInputConfig)
    mapping: MappingConfig = field(default_factory=MappingConfig)


class MappingNode(ManagedNode):
    """Publishes the disparity of each stereo pair and the cloud of a set of pairs."""

    _input: StereoInput | None = None

    def __init__(self, name: str = NAME, **options: Any) -> None:  # noqa: ANN401
        """Declare the parameters.

        Args:
            name: Name of the node.
            options: Of `rclpy.node.Node`.

        Raises:
            ConfigError: If a parameter is unknown or not valid.
        """
        super().__init__(name, "mapping", MappingNodeConfig, live=("mapping.",), **options)
        self.free()

    def check(self, config: MappingNodeConfig) -> None:
        """Try whether a mapper can be made with the parameters and the rig, or any where that is not known."""
        rig = self._input.rig if self._input is not None else None
        Mapper(rig or ANY_RIG, config.mapping)

    def make(self) -> None:
        """Warm up, advertise."""
        config: MappingNodeConfig = self.config
        self._settings_in_force = config.mapping
        Mapper(ANY_RIG, config.mapping).warm_up()
        self._calls = CallReporter(self, self.task, self.diagnostics)
        self._cloud = self.publish_on(PointCloud2, "mapping/points", config.output_depth)
        self._disparity = self.publish_on(DisparityImage, "mapping/disparity", config.output_depth)

    def listen(self) -> None:
        """Subscribe and offer services."""
        self.listen_to(PoseStamped, "nav/pose", self._on_pose, QoSProfile(depth=100))
        self._input = StereoInput(
            self,
            "nav",
            self.config.input,
            on_pair=self._on_pair,
            on_rig=self._on_rig,
            on_jump_back=lambda: self._restart("stamps have gone back"),
        )
        self.offer("~/finish", self._finish)
        self.offer("~/reset", self._reset, first=self._forget_waiting)
        self.every(0.2, self._drop_overdue)

    def free(self) -> None:
        """Forget everything."""
        self._input = None
        self._rig: StereoRig | None = None
        self._mapper: Mapper | None = None
        self._maps: list[PairMap] = []
        self._poses: dict[int, Transform] = {}
        self._waiting: dict[int, tuple[float, ReceivedPair]] = {}
        self._without_pose = 0

    def clock_back(self) -> None:
        """Begin a new map, unless its pairs have come already."""
        if self._input is not None and self._input.is_ahead():
            self._restart("the clock has gone back")

    def adopt(self, config: MappingNodeConfig) -> None:
        """Map the next pairs with other parameters; those of the set begun stay as they are."""

        def change() -> None:
            self._settings_in_force = config.mapping
            if self._rig is not None:
                self._mapper = Mapper(self._rig, config.mapping)

        self.worker.put(change)

    def expects_more(self) -> bool:
        """Tell whether a set of pairs is begun: between maps silence is no sign."""
        return bool(self._maps)

    def counts(self) -> dict[str, int]:
        """Return what was dropped since the start, by name."""
        own = {"dropped_without_pose": self._without_pose} if self._input is not None else {}
        return (self._input.statistics() if self._input is not None else {}) | own | super().counts()

    def restart_after_fault(self) -> None:
        """Begin a new map."""
        self._maps.clear()
        if self._input is not None:
            self._input.counts.broken += 1

    # ---- in the executor's thread

    def _on_rig(self, rig: StereoRig) -> None:
        self._waiting.clear()
        self.worker.put(lambda: self._set_rig(rig))

    def _restart(self, reason: str) -> None:
        """Begin a new map after the pairs that came before; poses stay: the next pairs' may be among them."""
        self.get_logger().warning(f"{reason}: a new map begins")
        if self._input is not None:
            self._input.restart()
        self._waiting.clear()
        self.worker.put(self._begin_map)

    def _on_pose(self, message: PoseStamped) -> None:
        stamp_ns = stamp_of(message)
        try:
            pose = transform_from_pose(message.pose, f"nav/pose of stamp {stamp_ns}")
        except InputError as error:
            self.warn(f"{error}; ignored")
            return
        if message.header.frame_id not in ("", self.config.lm_frame):
            found, wanted = message.header.frame_id, self.config.lm_frame
            self.warn(f"nav/pose is in '{found}', '{wanted}' is needed (parameter lm_frame): ignored")
            return
        self._poses[stamp_ns] = pose
        if len(self._poses) > MAX_POSES:
            self._poses.pop(next(iter(self._poses)))
        self._map_ready()

    def _on_pair(self, pair: ReceivedPair) -> None:
        self._waiting[pair.stamp_ns] = (time.monotonic(), pair)
        if len(self._waiting) > MAX_WAITING:
            self._drop(next(iter(self._waiting)))
        self._map_ready()

    def _map_ready(self) -> None:
        """Hand over the waiting pairs whose poses are there, in the order of their coming."""
        for stamp_ns in list(self._waiting):
            pose = self._pose_of(stamp_ns)
            if pose is not None:
                _, pair = self._waiting.pop(stamp_ns)
                self.worker.offer(partial(self._map, pair, pose))

    def _pose_of(self, stamp_ns: int) -> Transform | None:
        tolerance_ns = self.config.input.stamp_tolerance_s * NS_PER_S
        nearest = min(self._poses, key=lambda stamp: abs(stamp - stamp_ns), default=None)
        if nearest is None or abs(nearest - stamp_ns) > tolerance_ns:
            return None
        return self._poses[nearest]

    def _drop_overdue(self) -> None:
        limit = time.monotonic() - self.config.pose_wait_s
        for stamp_ns in [stamp for stamp, (since, _) in self._waiting.items() if since < limit]:
            self._drop(stamp_ns)

    def _drop(self, stamp_ns: int) -> None:
        self._waiting.pop(stamp_ns)
        self._without_pose += 1
        self.report_problem(
            f"pair of stamp {stamp_ns} dropped: no nav/pose of its stamp came within {self.config.pose_wait_s} s; "
            f"publish the pose of NAVSB in LM with the stamp of the pair"
        )

    def _forget_waiting(self) -> None:
        self.worker.clear()
        self._waiting.clear()
        self._poses.clear()
        if self._input is not None:
            self._input.restart()

    # ---- in the worker's thread

    def _set_rig(self, rig: StereoRig) -> None:
        if self._rig is not None and self._rig.same_cameras(rig):
            return  # the node was inactive meanwhile
        if self._rig is not None:
            self.get_logger().warning("camera_info has changed: a new map begins")
        self._begin_map()
        self._rig, self._mapper = rig, None
        try:
            self._mapper = Mapper(rig, self._settings_in_force)
        except SfrError as error:
            self.report_problem(str(error))

    def _begin_map(self) -> None:
        self._maps.clear()

    def _reset(self) -> str:
        self._begin_map()
        return "a new map begins"

    def _map(self, received: ReceivedPair, pose: Transform) -> None:
        if self._mapper is None:
            self.report_problem("the parameters of the mapper do not fit the rig: pair dropped")
            return
        begin = time.perf_counter()
        try:
            pair = received.decode()
            conversion_s = time.perf_counter() - begin
            with self._calls.measure() as usage:
                result = self._mapper.process(pair, pose, len(self._maps))
        except SfrError as error:
            if self._input is not None:
                self._input.counts.broken += 1
            self.report_problem(str(error))
            return
        self._maps.append(result)
        rig, mapping = received.rig, self._settings_in_force
        product = rig.fx * rig.baseline_m
        searched = (product / mapping.max_range_m, product / mapping.min_range_m)
        header = header_msg(pair.stamp_ns, received.frame_id)
        self._disparity.publish(disparity_msg(result.disparity_px, rig, searched, header))
        now_ns = self.get_clock().now().nanoseconds
        times = latencies(received.receipts, pair.stamp_ns, time.time_ns(), now_ns) | {"conversion_s": conversion_s}
        self._told(pair.stamp_ns, usage, "mapped", result, times)
        if len(self._maps) == self.config.pairs_per_map:
            self._fuse()

    def _fuse(self) -> int:
        """Fuse and publish what there is and begin anew; return the number of points."""
        maps, self._maps = self._maps, []
        if self._mapper is None:
            raise InputError("there is no camera_info yet: publish that of both navigation cameras")
        with self._calls.measure() as usage:
            fused = self._mapper.fuse(maps)
        stamp_ns = maps[-1].stamp_ns
        self._cloud.publish(cloud_msg(fused.cloud, stamp_ns, self.config.lm_frame))
        self._told(stamp_ns, usage, "fused", fused, {})
        return len(fused.cloud)

    def _finish(self) -> str:
        pairs = len(self._maps)
        return f"{self._fuse()} points of {pairs} pairs published"

    def _told(
        self, stamp_ns: int, usage: CallUsage, state: str, result: PairMap | FusedMap, times: Mapping[str, float]
    ) -> None:
        """Publish what a call took and what is suspicious in its result."""
        level = Level.WARN if result.warnings else Level.OK
        for warning in result.warnings:
            self.warn(warning)
        took = self._calls.publish(stamp_ns, usage, state, result.statistics, self.counts(), level, times)
        self.health.called(level, state, took, result.statistics)
        self.report_health(only_changes=True)


def main() -> int:
    """Run the node."""
    return run(MappingNode)


if __name__ == "__main__":
    raise SystemExit(main())
