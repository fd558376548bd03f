"""Classification of topics, frames and files by name: truth of a tracker, other truth, or estimate of the rover."""

from __future__ import annotations

import re

from sfr_loc_map.topics import COMPRESSED_END


def words(*alternatives: str) -> re.Pattern[str]:
    """Return a pattern of whole words of a name in `snake_case`."""
    return re.compile(rf"(?<![a-z0-9])(?:{'|'.join(alternatives)})(?![a-z0-9])")


def snake_case(name: str) -> str:
    """Return a name in lower case with underscores between its words, without the ending of compressed images.

    `/Vicon/groundTruth` becomes `/vicon/ground_truth`.
    """
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
"""Patterns of the name and the type of a topic with a truth, the most reliable pattern first."""
NO_TRUTH = words("estimated?", "fused", "filtered", "origin", "set_?point", "slam", "vi?o")
OWN = words("wheels?", "encoders?", "odom(?:etry)?", "visual", "zed_node", "goal", "initial_?pose")
"""Names of topics with estimates or goals of the rover itself, unless a pattern of TRUTH_WORDS matches."""


def is_tracker(name: str) -> bool:
    """Return whether a topic, frame or file is named after a tracking system."""
    return TRACKERS.search(snake_case(name)) is not None


def is_own(name: str) -> bool:
    """Return whether a topic is named after an estimate of the rover itself, such as wheel odometry."""
    text = snake_case(name)
    is_truth = any(pattern.search(text) for pattern in TRUTH_WORDS)
    return NO_TRUTH.search(text) is not None or (OWN.search(text) is not None and not is_truth)
