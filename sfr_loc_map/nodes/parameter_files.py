"""The parameter files in `config/`, made from the declarations, and the arguments of nodes of an `sfr.yaml`.

Run `python -m sfr_loc_map.nodes.parameter_files config` after a change of a declaration.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from sfr_loc_map.atomic import write_text
from sfr_loc_map.config import changed, read_config, read_sections, section, to_yaml_lines
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.inputs import Task
from sfr_loc_map.io.source_config import CalibrationConfig, SourceConfig
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.nodes.localisation_node import LocalisationNodeConfig
from sfr_loc_map.nodes.mapping_node import MappingNodeConfig
from sfr_loc_map.nodes.monitor_node import MonitorNodeConfig
from sfr_loc_map.topics import COMPRESSED_END

FILES: dict[str, tuple[str, type[Any]]] = {
    "localisation.yaml": ("localisation_node", LocalisationNodeConfig),
    "mapping.yaml": ("mapping_node", MappingNodeConfig),
    "monitor.yaml": ("monitor_node", MonitorNodeConfig),
}
"""Node and parameters of each file."""


def parameter_file(node_name: str, config_type: type[Any]) -> str:
    """Return a ROS parameter file with all parameters of a node at their defaults, each with its description."""
    lines = [
        f"# Parameters of {node_name} and their defaults. Copy the file, keep what you change, and give it by",
        f"# `ros2 run sfr_loc_map {node_name} --ros-args --params-file FILE`, or `sfr replay --config FILE`.",
        f"/**/{node_name}:",
        "  ros__parameters:",
        *to_yaml_lines(config_type, "    "),
    ]
    return "\n".join(lines) + "\n"


def run_arguments(config: Path, written: Path) -> list[str]:
    """Return the arguments of the nodes that an `sfr.yaml` comes to; their parameters are written to a file.

    ConfigError for what only a recording can be read with: a node takes topics as their drivers publish them.
    """
    sections = read_sections(config)
    how = SourceConfig.of(sections, config)
    if how.calibration != CalibrationConfig() or how.sync.right_offset_s:
        raise ConfigError(
            f"'{config}': calibration and sync.right_offset_s are for recordings: publish camera_info and images of "
            f"both sides by one clock, or convert the recording (sfr convert)"
        )
    if "record" in (how.sync.stamps, how.truth.stamps):
        raise ConfigError(
            f"'{config}': sync.stamps and truth.stamps of record are for recordings, whose times they take: stamp the "
            "messages when they are published"
        )
    values: dict[str, dict[str, Any]] = {
        "localisation": changed(read_config(LocalisationConfig, config, "localisation"), "localisation."),
        "mapping": changed(read_config(MappingConfig, config, "mapping"), "mapping."),
        "monitor": {**section(config, "monitor"), **changed(replace(how.truth, source="", columns=""), "truth.")},
    }
    values["localisation"] |= changed(how.extrinsics, "T_rb_locsb.")
    if how.frames.base:
        values["localisation"]["rb_frame"] = how.frames.base
    if isinstance(limits := sections.get("limits"), str):
        values["monitor"]["limits_file"] = str((config.parent / limits).resolve())
    if conditions := sections.get("conditions"):
        values["monitor"]["score.trajectory.conditions"] = conditions
    for task in ("localisation", "mapping"):
        values[task]["input.stamp_tolerance_s"] = how.sync.stamp_tolerance_s
        raw = f"{Task(task).rig}/left/image_raw"
        names = (name.removesuffix(COMPRESSED_END) for name in how.remap.values())
        values[task]["input.rectify"] = any(name.endswith(raw) for name in names)
    content = {f"/**/{name}_node": {"ros__parameters": parameters} for name, parameters in values.items()}
    written.write_text(yaml.safe_dump(content), encoding="utf-8")
    return ["--params-file", str(written), *(word for rule in remaps_of(how) for word in ("-r", rule))]


def remaps_of(how: SourceConfig) -> list[str]:
    """Return the topics of a configuration as remapping rules; compressed images have a name of their own."""
    rules = []
    for name, topic in how.topics.items():
        is_compressed = topic.endswith(COMPRESSED_END) and not name.endswith(COMPRESSED_END)
        rules.append(f"{name}{COMPRESSED_END if is_compressed else ''}:={topic}")
    return rules


def main(folder: Path) -> None:
    """Write the files into a folder."""
    for name, (node_name, config_type) in FILES.items():
        write_text(parameter_file(node_name, config_type), folder / name)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
