"""The mapping node: up to three stereo pairs with their poses in, one cloud out."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger
from stereo_msgs.msg import DisparityImage

from sfr_loc_map.config import param
from sfr_loc_map.errors import InputError, SfrError
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.image_codec import stamp_of
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.mapper import MAX_PAIRS, Mapper, PairMap
from sfr_loc_map.nodes.calls import CallReporter
from sfr_loc_map.nodes.conversions import NS, cloud_msg, disparity_msg, header_msg, transform_from_pose
from sfr_loc_map.nodes.diagnostics import Level
from sfr_loc_map.nodes.parameters import declare
from sfr_loc_map.nodes.runner import run
from sfr_loc_map.nodes.stereo_input import WARN_EVERY_S, StereoInput, StereoInputConfig

NAME = "mapping_node"
MAX_POSES = 1000
"""Poses that are kept for pairs still to come."""
MAX_WAITING = 2 * MAX_PAIRS
"""Pairs that are kept for poses still to come."""


@dataclass(frozen=True, slots=True)
class MappingNodeConfig:
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


class MappingNode(Node):
    """Publishes the disparity of each stereo pair and the cloud of a set of pairs."""

    def __init__(self) -> None:
        """Declare the parameters, warm up, subscribe.

        Raises:
            ConfigError: If a parameter is unknown or not valid.
        """
        super().__init__(NAME)
        (self._config,) = declare(self, MappingNodeConfig)
        self._mapper: Mapper | None = None
        self._maps: list[PairMap] = []
        self._poses: dict[int, Transform] = {}
        self._waiting: dict[int, tuple[float, StereoPair]] = {}
        self._without_pose = 0
        self._warm_up()
        self._calls = CallReporter(self, "mapping")
        qos = QoSProfile(depth=self._config.output_depth)
        self._cloud = self.create_publisher(PointCloud2, "mapping/points", qos)
        self._disparity = self.create_publisher(DisparityImage, "mapping/disparity", qos)
        self._listen()

    def _listen(self) -> None:
        poses = self.create_subscription(PoseStamped, "nav/pose", self._on_pose, QoSProfile(depth=100))
        self._input = StereoInput(
            self,
            "nav",
            self._config.input,
            on_pair=self._on_pair,
            on_rig=self._on_rig,
            on_jump_back=self._on_jump_back,
            on_problem=self._report,
        )
        services = [
            self.create_service(Trigger, "~/finish", self._on_finish),
            self.create_service(Trigger, "~/reset", self._on_reset),
        ]
        self._timer = self.create_timer(0.2, self._drop_overdue)
        names = [self.resolve_service_name(service.srv_name) for service in services]
        self.get_logger().info(
            f"listens to {', '.join([poses.topic_name, *self._input.topics])}; publishes {self._cloud.topic_name}, "
            f"{self._disparity.topic_name}, {self._calls.topic}; offers {', '.join(names)}"
        )

    def _warm_up(self) -> None:
        rig = StereoRig(320, 240, 300.0, 300.0, 159.5, 119.5, 0.1)
        Mapper(rig, self._config.mapping).warm_up()

    def _on_rig(self, rig: StereoRig) -> None:
        if self._mapper is not None:
            self.get_logger().warning("camera_info has changed: a new map begins")
        self._restart()
        try:
            self._mapper = Mapper(rig, self._config.mapping)
        except SfrError as error:
            self._mapper = None
            self._report(str(error))

    def _on_jump_back(self) -> None:
        self.get_logger().warning("stamps have gone back: a new map begins")
        self._restart()

    def _on_pose(self, message: PoseStamped) -> None:
        stamp_ns = stamp_of(message)
        try:
            pose = transform_from_pose(message.pose, f"nav/pose of stamp {stamp_ns}")
        except InputError as error:
            self.get_logger().warning(str(error), throttle_duration_sec=WARN_EVERY_S)
            return
        if message.header.frame_id not in ("", self._config.lm_frame):
            found, wanted = message.header.frame_id, self._config.lm_frame
            self.get_logger().warning(f"nav/pose is in '{found}', '{wanted}' is needed (parameter lm_frame): ignored")
            return
        self._poses[stamp_ns] = pose
        if len(self._poses) > MAX_POSES:
            self._poses.pop(next(iter(self._poses)))
        self._map_ready()

    def _on_pair(self, pair: StereoPair) -> None:
        self._waiting[pair.stamp_ns] = (time.monotonic(), pair)
        if len(self._waiting) > MAX_WAITING:
            self._drop(next(iter(self._waiting)))
        self._map_ready()

    def _map_ready(self) -> None:
        """Map the waiting pairs whose poses are there, in the order of their coming."""
        for stamp_ns in [stamp for stamp in self._waiting if self._pose_of(stamp) is not None]:
            pose = self._pose_of(stamp_ns)
            _, pair = self._waiting.pop(stamp_ns)
            if pose is not None:
                self._map(pair, pose)

    def _pose_of(self, stamp_ns: int) -> Transform | None:
        tolerance_ns = self._config.input.stamp_tolerance_s * NS
        nearest = min(self._poses, key=lambda stamp: abs(stamp - stamp_ns), default=None)
        if nearest is None or abs(nearest - stamp_ns) > tolerance_ns:
            return None
        return self._poses[nearest]

    def _map(self, pair: StereoPair, pose: Transform) -> None:
        if self._mapper is None or self._input.rig is None:
            self._report("the parameters of the mapper do not fit the rig: pair dropped")
            return
        try:
            with self._calls.measure() as usage:
                result = self._mapper.process(pair, pose, len(self._maps))
        except SfrError as error:
            self._report(str(error))
            return
        self._maps.append(result)
        rig, mapping = self._input.rig, self._config.mapping
        searched = tuple(rig.fx * rig.baseline_m / depth for depth in (mapping.max_range_m, mapping.min_range_m))
        frame = self._input.frame_id
        disparity = disparity_msg(result.disparity_px, rig, searched, header_msg(pair.stamp_ns, frame))
        self._disparity.publish(disparity)
        self._calls.publish(pair.stamp_ns, usage, "mapped", result.statistics, self._counts(), Level.OK)
        if len(self._maps) == self._config.pairs_per_map:
            self._finish()

    def _finish(self) -> int:
        """Fuse and publish what there is and begin anew; return the number of points."""
        maps, self._maps = self._maps, []
        if self._mapper is None:
            raise InputError("there is no camera_info yet: publish that of both navigation cameras")
        with self._calls.measure() as usage:
            fused = self._mapper.fuse(maps)
        stamp_ns = maps[-1].stamp_ns
        self._cloud.publish(cloud_msg(fused.cloud, stamp_ns, self._config.lm_frame))
        self._calls.publish(stamp_ns, usage, "fused", fused.statistics, self._counts(), Level.OK)
        return len(fused.cloud)

    def _on_finish(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        pairs = len(self._maps)
        try:
            points = self._finish()
            response.success, response.message = True, f"{points} points of {pairs} pairs published"
        except SfrError as error:
            response.success, response.message = False, str(error)
        return response

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._restart()
        self._poses.clear()
        self._input.restart()
        response.success, response.message = True, "a new map begins"
        return response

    def _restart(self) -> None:
        """Forget the set begun; poses stay, since those of the next pairs may be among them."""
        self._maps.clear()
        self._waiting.clear()

    def _drop_overdue(self) -> None:
        limit = time.monotonic() - self._config.pose_wait_s
        for stamp_ns in [stamp for stamp, (since, _) in self._waiting.items() if since < limit]:
            self._drop(stamp_ns)

    def _drop(self, stamp_ns: int) -> None:
        self._waiting.pop(stamp_ns)
        self._without_pose += 1
        self._report(
            f"pair of stamp {stamp_ns} dropped: no nav/pose of its stamp came within {self._config.pose_wait_s} s; "
            f"publish the pose of NAVSB in LM with the stamp of the pair"
        )

    def _counts(self) -> dict[str, int]:
        return self._input.statistics() | {"dropped_without_pose": self._without_pose}

    def _report(self, text: str) -> None:
        self.get_logger().error(text, throttle_duration_sec=WARN_EVERY_S)
        self._calls.publish_problem(text, self._counts())


def main() -> int:
    """Run the node."""
    return run(MappingNode)


if __name__ == "__main__":
    raise SystemExit(main())
