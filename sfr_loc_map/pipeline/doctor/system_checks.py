"""Checks of extrinsics, nodes and host."""

from __future__ import annotations

from collections.abc import Iterator

from sfr_loc_map.pipeline.doctor.finding import Cause, Finding, Severity, blocking
from sfr_loc_map.pipeline.doctor.observation import Observation

QUEUES_BYTES = 1_000_000
"""What a process has in /dev/shm beside its segment."""


def check_extrinsics(seen: Observation) -> Iterator[Finding]:
    """Yield whether the extrinsics of the localisation rig are unknown."""
    node = seen.node("loc")
    given = seen.extrinsics_given or seen.extrinsics_in_tf or (node is not None and node.extrinsics_given)
    if "loc" not in seen.tasks or given:
        return
    if seen.files:
        text = "rig.json does not have it, and no parameter"
    elif seen.extrinsics_in_tf is None:
        text = "/tf_static cannot be read without tf2_msgs, and no parameter has it"
    elif any(name.strip("/").endswith("tf_static") for name in seen.others):
        text = "/tf_static does not connect rb and locsb, and no parameter has it"
    else:
        text = "neither a parameter nor /tf_static has it"
    place = "it to rig.json" if seen.files else "rb to locsb to /tf_static"
    fix = "set T_rb_locsb.translation_m and quat_xyzw of localisation_node"
    yield blocking(
        Cause.FRAMES,
        "extrinsics of the localisation rig (T_rb_locsb)",
        text,
        fix if seen.live else f"{fix} (--config), or add {place}",
    )


def check_nodes(seen: Observation) -> Iterator[Finding]:
    """Yield nodes without a clock, and nodes that are not active."""
    for node in seen.nodes:
        if node.use_sim_time and not seen.has_clock:
            yield blocking(
                Cause.CLOCK,
                node.name,
                "use_sim_time is on but /clock has no publisher: its time stops",
                "set use_sim_time to false, or publish /clock (ros2 bag play --clock)",
            )
        if node.state not in ("active", ""):
            transition = "activate" if node.state == "inactive" else "configure"
            yield blocking(
                Cause.INACTIVE, node.name, f"the node is {node.state}", f"ros2 lifecycle set {node.name} {transition}"
            )


def check_shared_memory(seen: Observation) -> Iterator[Finding]:
    """Yield whether /dev/shm is too small."""
    processes = max(len(seen.nodes), 1) + 1  # and the image publisher
    memory = seen.memory
    needed = processes * (memory.segment_bytes + QUEUES_BYTES) if memory.segment_bytes else 0
    if memory.size_bytes is not None and memory.size_bytes < needed:
        yield Finding(
            Cause.SHARED_MEMORY,
            Severity.BLOCKING if seen.live else Severity.WARNING,
            "/dev/shm",
            f"it has {memory.size_bytes / 1e6:.0f} MB, {processes} processes reserve {needed / 1e6:.0f} MB: "
            f"images go by UDP and are dropped",
            f"docker run --shm-size={-(-needed * 2 // 2**20)}m, or --ipc=host; mount -o remount,size=...",
        )
