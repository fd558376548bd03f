"""What the name of a topic, frame or file says of a truth: a tracker's, another one's, or the rover's own estimate."""

from __future__ import annotations

import re

from sfr_loc_map.topics import COMPRESSED_END


def words(*alternatives: str) -> re.Pattern[str]:
    """Return a pattern of whole words of a name in the form of `plain_name`."""
    return re.compile(rf"(?<![a-z0-9])(?:{'|'.join(alternatives)})(?![a-z0-9])")


def plain_name(name: str) -> str:
    """Return a name in small letters with underscores between its words, without the end of compressed images."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower().removesuffix(COMPRESSED_END)


TRACKERS = words(
    *("mocap", "motion_?capture", "opti_?track", "vicon", "vrpn", "qualisys", "leica", "prism", "total_?station")
)
TRUTH_WORDS = (
    re.compile("ground_truth/odometry "),
    words("ground_?truth", "gt", "truth"),
    TRACKERS,
    words("rtk"),
    re.compile("fix .*/NavSatFix"),
)
"""Patterns of the name and the type of a topic with a truth, the surest one first."""
NO_TRUTH = words("estimated?", "fused", "filtered", "origin", "set_?point", "slam", "vi?o")
OWN = words("wheels?", "encoders?", "odom(?:etry)?", "visual", "zed_node", "goal", "initial_?pose")
"""Of topics with estimates or goals of the rover itself, unless one of TRUTH_WORDS is in the name."""


def is_tracker(name: str) -> bool:
    """Return whether a topic, frame or file is named after a system that tracks a body of its own."""
    return TRACKERS.search(plain_name(name)) is not None


def is_own(name: str) -> bool:
    """Return whether a topic is named after an estimate of the rover itself, as wheel odometry: no truth."""
    text = plain_name(name)
    is_truth = any(pattern.search(text) for pattern in TRUTH_WORDS)
    return NO_TRUTH.search(text) is not None or (OWN.search(text) is not None and not is_truth)
