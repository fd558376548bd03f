"""The checks of an observation, in order. Pure functions of what was observed."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from sfr_loc_map.pipeline.doctor.finding import Finding
from sfr_loc_map.pipeline.doctor.observation import Observation
from sfr_loc_map.pipeline.doctor.stamp_checks import (
    check_host_clock,
    check_order,
    check_pairs,
    check_poses,
    check_truth,
)
from sfr_loc_map.pipeline.doctor.stereo_checks import check_stereo
from sfr_loc_map.pipeline.doctor.system_checks import check_extrinsics, check_nodes, check_shared_memory
from sfr_loc_map.pipeline.doctor.topic_checks import check_camera_topics, check_names, check_readable, check_transport

IMAGE_CHECKS: tuple[Callable[[Observation, str], Iterator[Finding]], ...] = (check_transport, check_pairs, check_stereo)
"""Checks of a task with images of both sides."""
CHECKS: tuple[Callable[[Observation], Iterator[Finding]], ...] = (
    check_extrinsics,
    check_order,
    check_poses,
    check_truth,
    check_nodes,
    check_host_clock,
)


def examine(seen: Observation) -> list[Finding]:
    """Return the findings of all checks, blocking ones first."""
    found = [*check_readable(seen)]
    if not (seen.broken and not seen.topics):
        found += check_names(seen)
        for task in seen.tasks:
            found += check_camera_topics(seen, task)
            if seen.has_images(task):
                found += [finding for check in IMAGE_CHECKS for finding in check(seen, task)]
        found += [finding for check in CHECKS for finding in check(seen)]
    found += check_shared_memory(seen)
    return sorted(found, key=lambda finding: not finding.is_blocking)
