"""Options of a replay, and the parameters of the nodes that follow from them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from sfr_loc_map.config import flatten, load_yaml
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.start_pose import StartPose
from sfr_loc_map.mapping.config import MAX_PAIRS, MappingConfig
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.nodes.process.live_process import LivePage
from sfr_loc_map.nodes.replay.external_options import RESULT_TOPICS, ExternalOptions

REPLAY_PARAMETERS = {"autostart": True, "output_reliability": "reliable"}
"""Parameters that a replay sets for each node, whatever a parameter file says."""
RELIABLE_INPUT = {
    "localisation_node": "input.reliability",
    "mapping_node": "input.reliability",
    "monitor_node": "input_reliability",
}
"""Parameter of each node that a replay sets to reliable: in lock step each message is awaited."""


@dataclass(frozen=True, slots=True)
class ReplayOptions:
    """How a source is replayed.

    Attributes:
        localisation: Parameters of the localiser.
        mapping: Parameters of the mapper.
        score: Settings of the monitor's score.
        limits: Limits file of the monitor's verdicts, None for none.
        start: Returns the pose of RB in DS after an offset in seconds, with its stamp; None for the identity.
        rate: 0: lock step, the result of each pair is awaited; otherwise a multiple of the recorded speed.
        offset_s: Where it starts, seconds after the first message.
        paused: Whether it waits for the operator before the first pair.
        loop: Whether it starts again at its end, until the operator or a signal ends it.
        remap: New names of topics by the names in the bag.
        parameter_file: ROS parameter file for all nodes; the parameters above override it.
        page: Page that shows the run, None for none.
        external: Node under test in place of one of ours, None for ours.
    """

    localisation: LocalisationConfig
    mapping: MappingConfig
    score: ScoreConfig
    limits: Path | None
    start: Callable[[float], StartPose | None]
    rate: float
    offset_s: float
    paused: bool
    loop: bool
    remap: Mapping[str, str]
    parameter_file: Path | None
    page: LivePage | None = None
    external: ExternalOptions | None = None


def pairs_per_map(source: Source) -> int:
    """Return how many pairs the map of a source is made of, 0 without mapping."""
    return len(source.nav) if source.nav is not None else 0


def node_arguments(source: Source, options: ReplayOptions, folder: Path) -> dict[str, list[str]]:
    """Write the parameter files of the nodes; return the command line of each node by its name.

    Args:
        source: An opened source.
        options: Options of the replay.
        folder: Folder for the parameter files.
    """
    localisation = _changed("localisation", options.localisation)
    mapping = _changed("mapping", options.mapping) | {"pairs_per_map": pairs_per_map(source) or MAX_PAIRS}
    monitor = _changed("score", options.score)
    if options.limits is not None:
        monitor["limits_file"] = str(options.limits.resolve())
    if source.loc is not None and source.loc.rig.T_rb_sb is not None:
        extrinsics = source.loc.rig.T_rb_sb
        localisation["T_rb_locsb.translation_m"] = extrinsics.translation.tolist()
        localisation["T_rb_locsb.quat_xyzw"] = extrinsics.file_quat_xyzw.tolist()
    nodes = {"localisation_node": localisation, "mapping_node": mapping, "monitor_node": monitor}
    external = options.external
    if external is not None:
        del nodes[f"{external.task}_node"]
    found = {name: _arguments(folder, name, parameters, options.parameter_file) for name, parameters in nodes.items()}
    if external is not None and external.converted_topic != RESULT_TOPICS[external.task]:
        found["monitor_node"] += ["-r", f"{RESULT_TOPICS[external.task]}:={external.converted_topic}"]
    return found


def is_ros_parameter_file(path: Path) -> bool:
    """Tell whether a YAML file has the layout of ROS parameter files.

    Raises:
        ConfigError: If it is not YAML.
    """
    return any(isinstance(block, dict) and "ros__parameters" in block for block in load_yaml(path).values())


def _changed(prefix: str, config: Any) -> dict[str, Any]:  # noqa: ANN401 - any configuration dataclass
    """Return the values that are not the defaults by name, so that a parameter file decides on the others."""
    defaults = flatten(type(config)())
    values = {name: value for name, value in flatten(config).items() if value != defaults[name]}
    return {f"{prefix}.{name}": list(v) if isinstance(v, tuple) else v for name, v in values.items()}


def _arguments(folder: Path, node: str, parameters: dict[str, Any], user_file: Path | None) -> list[str]:
    path = folder / f"{node}.yaml"
    content = {f"/**/{node}": {"ros__parameters": parameters | REPLAY_PARAMETERS | {RELIABLE_INPUT[node]: "reliable"}}}
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    arguments = ["--ros-args"]
    for file in (user_file, path):
        arguments += ["--params-file", str(file)] if file is not None else []
    return arguments
