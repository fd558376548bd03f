"""Wheel odometry on the topic motion_prior."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from nav_msgs.msg import Odometry

from sfr_loc_map.config import param
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.io.image_codec import stamp_of
from sfr_loc_map.nodes.input.odometry_buffer import OdometryBuffer
from sfr_loc_map.nodes.lifecycle.endpoints import Endpoints
from sfr_loc_map.nodes.lifecycle.qos import profile
from sfr_loc_map.nodes.messages.pose import transform_from_pose


@dataclass(frozen=True, slots=True)
class MotionPriorConfig:
    """How wheel odometry on the topic motion_prior is used."""

    max_gap_s: float = param(
        0.5, unit="s", doc="Neighbouring messages further apart are not interpolated.", low=0.001, high=60.0
    )
    wait_s: float = param(
        0.0,
        unit="s",
        doc="How long a pair waits for a message at or after its stamp, once such messages come; 0: not at all.",
        low=0.0,
        high=10.0,
    )


class OdometrySubscriber:
    """Receives wheel odometry of RB and gives the motion between stamps."""

    def __init__(self, config: MotionPriorConfig, rb_frame: str, warn: Callable[[str], None]) -> None:
        """Start without odometry.

        Args:
            config: How it is used.
            rb_frame: Name of RB: child frame of the odometry.
            warn: Called with what is wrong with a message.
        """
        self._rb_frame, self._wait_s, self._warn = rb_frame, config.wait_s, warn
        self._buffer = OdometryBuffer(round(config.max_gap_s * NS_PER_S))

    def subscribe(self, endpoints: Endpoints, queue_depth: int) -> None:
        """Subscribe."""
        endpoints.add_subscription(Odometry, "motion_prior", self._on_odometry, profile("best_effort", queue_depth))

    def motion(self, before_ns: int | None, now_ns: int) -> Transform | None:
        """Return `T_before_now` of RB, None where it is not known; may wait, in the worker's thread."""
        return None if before_ns is None else self._buffer.between(before_ns, now_ns, self._wait_s)

    def _on_odometry(self, message: Odometry) -> None:
        child = message.child_frame_id
        try:
            if child not in ("", self._rb_frame):
                raise InputError(f"motion_prior is of '{child}', of '{self._rb_frame}' (parameter rb_frame) is needed")
            pose = transform_from_pose(message.pose.pose, "motion_prior")
        except InputError as error:
            self._warn(f"{error}; ignored")
            return
        self._buffer.add(stamp_of(message), pose)
