"""When a message of a replay is due, and which pairs have been published."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping

from sfr_loc_map.geometry.stamp_pairing import WAITING, StampPairing
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import Task
from sfr_loc_map.io.message_stream import Message
from sfr_loc_map.nodes.input.pose_matching import PoseMatching
from sfr_loc_map.topics import COMPRESSED_END, NAV_POSE


class Pacer:
    """Says when a message is due, by its stamp and a multiple of the recorded speed; each rig has its own clock."""

    def __init__(self, rate: float) -> None:
        """Start with the first message of each rig; a rate of 0: every message is due at once."""
        self._rate = rate
        self._origins: dict[str, tuple[float, int]] = {}

    def restart(self) -> None:
        """Start again with the next message, as after a pause."""
        self._origins.clear()

    def wait_s(self, message: Message) -> float:
        """Return for how long a message has to wait, 0 if it is due."""
        if self._rate <= 0.0:
            return 0.0
        begin_s, first_ns = self._origins.setdefault(message.rig, (time.monotonic(), message.stamp_ns))
        return max(begin_s + (message.stamp_ns - first_ns) * 1e-9 / self._rate - time.monotonic(), 0.0)


class PairTracker:
    """Tells when a stereo pair, with its pose where it needs one, has been published; pairs as the nodes pair them."""

    def __init__(self, tolerance_ns: Mapping[Task, int]) -> None:
        """Start before the first message; the tolerances are those by which the nodes of the tasks pair stamps."""
        self._images = {task.rig: StampPairing[int](tolerance_ns[task], WAITING) for task in Task}
        self._poses = PoseMatching[int](tolerance_ns[Task.MAPPING], math.inf, lambda stamp_ns: None)

    def add(self, message: Message) -> list[tuple[str, int]]:
        """Add a published message; return rig and stamp, that of the left image, of the pairs that it completes."""
        part = message.topic.removesuffix(COMPRESSED_END)
        rig = message.rig
        stamp_ns = message.stamp_ns
        if part == NAV_POSE:
            return [(rig, pair) for pair, _ in self._poses.add_pose(stamp_ns, Transform.identity())]
        if not part.endswith("image_rect"):
            return []
        images = self._images[rig]
        found = (images.add_left if "/left/" in part else images.add_right)(stamp_ns, stamp_ns)
        if found is None or rig == Task.LOCALISATION.rig:
            return [] if found is None else [(rig, found[0])]
        return [(rig, pair) for pair, _ in self._poses.add_pair(found[0], found[0])]
