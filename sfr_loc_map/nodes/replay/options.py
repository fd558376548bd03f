"""Options of a replay, and the parameters of the nodes that follow from them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from sfr_loc_map.config import changed, load_yaml, node_parameters
from sfr_loc_map.errors import ConfigError, naming
from sfr_loc_map.geometry.stamp_pairing import STAMP_TOLERANCE_S
from sfr_loc_map.geometry.trajectory import Truth
from sfr_loc_map.inputs import MONITOR_NODE, NS_PER_S, Task
from sfr_loc_map.io.message_stream import begin_of
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.io.truth.config import TrackedBody
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import StartPose
from sfr_loc_map.mapping.config import MAX_PAIRS, MappingConfig
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.pose_convention import PoseConvention
from sfr_loc_map.nodes.launch.live_process import LiveProcess
from sfr_loc_map.runs.offline import start_pose
from sfr_loc_map.scoring.inputs import Correction
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
    start_timeout_s: float = 60.0  #: Timeout for its subscription to images.
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
    """Write the parameter files of the nodes into a folder; return the command line of each node by its name.

    The monitor runs in each replay, with or without a page, because a replay tests the three nodes together. The score
    of the replay is that of its collected results. The report of the monitor is shown on the page alone.
    """
    given = node_parameters(
        {
            "localisation": changed(options.localisation),
            "mapping": changed(options.mapping),
            "monitor": {**options.monitor, **changed(options.score, "score.")},
            "truth": _tracked_body(source),
            "extrinsics": _extrinsics(source),
            # The pairs of a bag that is played as recorded are those of its reader.
            "sync": {"stamp_tolerance_s": STAMP_TOLERANCE_S},
        }
    )
    given[Task.MAPPING.node]["pairs_per_map"] = len(source.nav) if source.nav is not None else MAX_PAIRS
    if options.limits is not None:
        given[MONITOR_NODE]["limits_file"] = str(options.limits.resolve())
    external = options.external
    found = {}
    for node, parameters in given.items():
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


def _tracked_body(source: Source) -> dict[str, Any]:
    """Return the settings of the truth: poses of RB, or positions of a point on RB."""
    truth = None if source.loc is None else source.loc.ground_truth
    if not isinstance(truth, Truth):
        return {}
    unknown = {(True, True): "none", (False, True): "height", (True, False): "tilt", (False, False): "planar"}
    body = TrackedBody(
        truth.lever_arm_m,
        sigma_m=truth.sigma_m,
        sigma_deg=truth.sigma_deg,
        attitude="auto" if truth.has_attitude else "no",
        unknown=unknown[truth.has_height, truth.has_tilt],
    )
    return changed(body)


def _extrinsics(source: Source) -> dict[str, Any]:
    """Return the pose of the rig on the rover."""
    if source.loc is None or source.loc.rig.T_rb_sb is None:
        return {}
    T_rb_sb = source.loc.rig.T_rb_sb
    return {"translation_m": T_rb_sb.translation.tolist(), "quat_xyzw": T_rb_sb.file_quat_xyzw.tolist()}


def is_ros_parameter_file(path: Path) -> bool:
    """Return whether a YAML file has the layout of ROS parameter files."""
    return any(isinstance(block, dict) and "ros__parameters" in block for block in load_yaml(path).values())


def first_pose(source: Source, start: str, offset_s: float) -> StartPose | None:
    """Return the pose that a drive starts at, played from an offset; None for the identity, and without a drive."""
    if source.loc is None or start == "identity":
        return None
    with naming(source.path):
        begin_ns = begin_of(source, source.loc) if offset_s else 0
        return start_pose(source.loc, start, begin_ns + round(offset_s * NS_PER_S))


def task_under_test(source: Source, external: str | None, method: str) -> Task | None:
    """Return the task of an external node, None if ours run; ConfigError if the source leaves it open."""
    if external is not None:
        return Task(external)
    if method != "external":
        return None
    if source.loc is not None and source.nav is not None:
        raise ConfigError("'--method external': which task? give --external localisation or mapping")
    return Task.LOCALISATION if source.nav is None else Task.MAPPING


def node_under_test(
    task: Task | None, given: Mapping[str, str], timeout_s: float, correction: Correction
) -> ExternalOptions | None:
    """Return the options of an external node, None if ours run; ConfigError if an option does not fit the task."""
    if task is None:
        needless = [f"--{option}" for option, value in given.items() if value]
        needless += ["--convention or --apply-diagnosis"] if correction.is_wanted else []
        if needless:
            raise ConfigError(f"'{needless[0]}' is for external nodes: give --external TASK as well")
        return None
    if task is Task.MAPPING and correction.apply_diagnosis:
        raise ConfigError("'--apply-diagnosis' is for poses: omit it with --external mapping")
    return ExternalOptions(
        task=task,
        topic=given["answers"] or RESULTS[task],
        command=given["command"],
        watch=given["watch"],
        frames=" -> ".join(given["frames"].split(",")),
        timeout_s=timeout_s,
        convention=correction.declared,
    )
