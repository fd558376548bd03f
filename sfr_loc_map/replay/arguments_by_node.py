"""Command lines and parameter files of the nodes of a replay."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sfr_loc_map.configuration.nodes import node_parameters
from sfr_loc_map.configuration.parameters import changed
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.io.truth.config import TrackedBodyConfig
from sfr_loc_map.mapping.config import MAX_PAIRS
from sfr_loc_map.nodes.launch.ros_arguments import write_parameters
from sfr_loc_map.replay.options import ReplayOptions
from sfr_loc_map.stamp_pairing import STAMP_TOLERANCE_S
from sfr_loc_map.suite_names import MONITOR_NODE, Task
from sfr_loc_map.topics import RESULTS


def arguments_by_node(source: Source, options: ReplayOptions, folder: Path) -> dict[str, list[str]]:
    """Write the parameter files of the nodes into a folder; return the command line of each node by its name.

    The monitor runs in each replay, with or without a page, because a replay tests the three nodes together. The score
    of the replay is computed from the collected results. The report of the monitor is shown only on the page.
    """
    given = node_parameters(
        {
            "localisation": changed(options.localisation),
            "mapping": changed(options.mapping),
            "monitor": {**options.configuration.section("monitor"), **changed(options.request.config, "score.")},
            "truth": _tracked_body(source),
            "extrinsics": _extrinsics(source),
            # The nodes must form the same pairs as the reader of the bag.
            "sync": {"stamp_tolerance_s": STAMP_TOLERANCE_S},
        }
    )
    given[Task.MAPPING.node]["pairs_per_map"] = pairs_per_map(source)
    limits_file = options.limits_file
    if limits_file is not None:
        given[MONITOR_NODE]["limits_file"] = str(limits_file.resolve())
    external = options.external
    parameter_file = options.parameter_file
    of_all = [] if parameter_file is None else ["--params-file", str(parameter_file)]
    found = {}
    for node, parameters in given.items():
        if external is not None and node == external.task.node:
            continue
        # in lock step no message may be lost
        parameters |= {"autostart": True, "output_reliability": "reliable", "input.reliability": "reliable"}
        own = write_parameters({node: parameters}, folder / f"{node}.yaml")
        found[node] = ["--ros-args", *of_all, *own]
    if external is not None and external.converted_topic != RESULTS[external.task]:
        found[MONITOR_NODE] += ["-r", f"{RESULTS[external.task]}:={external.converted_topic}"]
    return found


def pairs_per_map(source: Source) -> int:
    """Return the number of pairs of a map, which contains all pairs of the source."""
    return MAX_PAIRS if source.nav is None else len(source.nav)


def _tracked_body(source: Source) -> dict[str, Any]:
    """Return the settings of the ground truth, which has poses of RB or positions of a point on RB."""
    truth = None if source.loc is None else source.loc.ground_truth
    if truth is None:
        return {}
    unknown = {(True, True): "none", (False, True): "height", (True, False): "tilt", (False, False): "planar"}
    x, y, z = truth.lever_arm_m
    body = TrackedBodyConfig(
        (x, y, z),
        sigma_m=truth.sigma_m,
        sigma_deg=truth.sigma_deg,
        attitude="auto" if truth.has_attitude else "no",
        unknown=unknown[truth.has_height, truth.has_tilt],
    )
    return changed(body)


def _extrinsics(source: Source) -> dict[str, Any]:
    """Return the extrinsics of the localisation rig; empty if unknown."""
    if source.loc is None or source.loc.rig.T_rb_sb is None:
        return {}
    T_rb_sb = source.loc.rig.T_rb_sb
    return {"translation_m": T_rb_sb.translation.tolist(), "quat_xyzw": T_rb_sb.file_quat_xyzw.tolist()}
