"""Options of a replay, and the parameters of the nodes that follow from them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from sfr_loc_map.config import changed, load_yaml
from sfr_loc_map.geometry.trajectory import Truth
from sfr_loc_map.inputs import MONITOR_NODE, SUITE_NODES, Task
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.io.truth import TrackedBody
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import StartPose
from sfr_loc_map.mapping.config import MAX_PAIRS, MappingConfig
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.pose_convention import PoseConvention
from sfr_loc_map.nodes.launch.live_process import LiveProcess
from sfr_loc_map.topics import RESULTS

CONVERTED = "external/converted"
"""Topic of converted results, where an external node itself publishes on the suite's."""


@dataclass(frozen=True, slots=True)
class ExternalOptions:
    """An external node in place of ours."""

    task: Task  #: What it does.
    topic: str  #: What it publishes its results on.
    command: str = ""  #: Command that starts it; empty: it runs already, or is started by the user.
    #: Process whose CPU and memory are measured: number, or part of a command line; empty: that of the command.
    watch: str = ""
    #: What its answers name, `parent -> child` or of a cloud `parent`; empty: what the first of them names.
    frames: str = ""
    timeout_s: float = 5.0  #: How long the answer to a pair is waited for, in lock step; what comes later is late.
    start_timeout_s: float = 60.0  #: How long it may take until it listens.
    #: In what its poses differ from those of RB in DS; for a cloud, its points from those in LM.
    convention: PoseConvention = field(default_factory=PoseConvention)

    @property
    def converted_topic(self) -> str:
        """What the converted results are published on, for the monitor."""
        own = RESULTS[self.task]
        return CONVERTED if self.topic == own else own


@dataclass(frozen=True, slots=True)
class ReplayOptions:
    """How a source is replayed."""

    localisation: LocalisationConfig  #: Parameters of the localiser.
    mapping: MappingConfig  #: Parameters of the mapper.
    score: ScoreConfig  #: Settings of the monitor's score.
    limits: Path | None  #: Limits file of the monitor's verdicts, None for none.
    start: StartPose | None  #: Pose of RB in DS at the start, with its stamp; None for the identity.
    rate: float  #: 0: lock step, the result of each pair is awaited; otherwise a multiple of the recorded speed.
    offset_s: float  #: Where it starts, seconds after the first message.
    duration_s: float  #: How much of the source is played, seconds.
    paused: bool  #: Whether it waits for the service ~/resume before the first pair.
    parameter_file: Path | None  #: ROS parameter file for all nodes; the parameters above override it.
    monitor: Mapping[str, Any] = field(default_factory=dict)  #: More parameters of the monitor.
    page: LiveProcess | None = None  #: Page that shows the run, None for none.
    external: ExternalOptions | None = None  #: Node under test in place of one of ours, None for ours.


def node_arguments(source: Source, options: ReplayOptions, folder: Path) -> dict[str, list[str]]:
    """Write the parameter files of the nodes into a folder; return the command line of each node by its name."""
    pairs = len(source.nav) if source.nav is not None else MAX_PAIRS
    localisation = changed(options.localisation, "localisation.")
    mapping = changed(options.mapping, "mapping.") | {"pairs_per_map": pairs}
    monitor = {**options.monitor, **changed(options.score, "score.")}
    truth = None if source.loc is None else source.loc.ground_truth
    if isinstance(truth, Truth):  # it comes as poses of RB, or positions of a point of it
        attitude = "auto" if truth.has_attitude else "no"
        unknown = {(True, True): "none", (False, True): "height", (True, False): "tilt", (False, False): "planar"}
        body = TrackedBody(
            truth.lever_arm_m,
            sigma_m=truth.sigma_m,
            sigma_deg=truth.sigma_deg,
            attitude=attitude,
            unknown=unknown[truth.has_height, truth.has_tilt],
        )
        monitor |= changed(body, "truth.")
    if options.limits is not None:
        monitor["limits_file"] = str(options.limits.resolve())
    if source.loc is not None and source.loc.rig.T_rb_sb is not None:
        extrinsics = source.loc.rig.T_rb_sb
        localisation["T_rb_locsb.translation_m"] = extrinsics.translation.tolist()
        localisation["T_rb_locsb.quat_xyzw"] = extrinsics.file_quat_xyzw.tolist()
    external = options.external
    found = {}
    for node, parameters in zip(SUITE_NODES, (localisation, mapping, monitor), strict=True):
        if external is not None and node == external.task.node:
            continue
        # in lock step each message is awaited
        parameters |= {"autostart": True, "output_reliability": "reliable", "input.reliability": "reliable"}
        path = folder / f"{node}.yaml"
        path.write_text(yaml.safe_dump({f"/**/{node}": {"ros__parameters": parameters}}), encoding="utf-8")
        files = [file for file in (options.parameter_file, path) if file is not None]
        found[node] = ["--ros-args", *(word for file in files for word in ("--params-file", str(file)))]
    if external is not None and external.converted_topic != RESULTS[external.task]:
        found[MONITOR_NODE] += ["-r", f"{RESULTS[external.task]}:={external.converted_topic}"]
    return found


def is_ros_parameter_file(path: Path) -> bool:
    """Tell whether a YAML file has the layout of ROS parameter files."""
    return any(isinstance(block, dict) and "ros__parameters" in block for block in load_yaml(path).values())
