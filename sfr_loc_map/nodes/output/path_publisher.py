"""The path travelled so far on the topic localisation/path."""

from __future__ import annotations

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry, Path

from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.io.image_codec import stamp_of
from sfr_loc_map.localisation.estimate import PoseEstimate
from sfr_loc_map.nodes.lifecycle.endpoints import Endpoints
from sfr_loc_map.pipeline.reception import ThinnedPath

PERIOD_NS = NS_PER_S
"""A path is published at most once in that time, by the stamps of the pairs: it may have 2000 poses."""


class PathPublisher:
    """Collects poses and publishes them as a path; used in the worker's thread."""

    def __init__(self, endpoints: Endpoints) -> None:
        """Create the publisher; who comes late gets the last path."""
        self._publisher = endpoints.add_publisher(Path, "localisation/path", 1, latched=True)
        self._path: ThinnedPath[PoseStamped] = ThinnedPath()
        self._published_ns: int | None = None

    def clear(self) -> None:
        """Start a new path."""
        self._path.clear()
        self._published_ns = None

    def add(self, estimate: PoseEstimate, message: Odometry) -> None:
        """Add the pose of an estimate, and publish the path if it is time to."""
        stamp_ns = stamp_of(message)
        pose = PoseStamped(header=message.header, pose=message.pose.pose)
        self._path.add(stamp_ns, estimate.T_ds_rb, pose)
        published = self._published_ns
        if published is None or not published <= stamp_ns < published + PERIOD_NS:
            self._publisher.publish(Path(header=message.header, poses=list(self._path.poses)))
            self._published_ns = stamp_ns
