"""Write the parameter files in `config/` from the declarations.

Run `python -m sfr_loc_map.nodes.parameter_files config` after changing a declaration.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from sfr_loc_map.atomic import write_text
from sfr_loc_map.configuration.yaml_file import to_yaml_lines
from sfr_loc_map.nodes.localisation_node import LocalisationNodeConfig
from sfr_loc_map.nodes.mapping_node import MappingNodeConfig
from sfr_loc_map.nodes.monitor_node import MonitorNodeConfig

FILES: dict[str, tuple[str, type[Any]]] = {
    "localisation.yaml": ("localisation_node", LocalisationNodeConfig),
    "mapping.yaml": ("mapping_node", MappingNodeConfig),
    "monitor.yaml": ("monitor_node", MonitorNodeConfig),
}
"""Node name and parameter dataclass of each file."""


def parameter_file(node_name: str, config_type: type[Any]) -> str:
    """Return a ROS parameter file with all parameters of a node at their defaults, each with its description."""
    lines = [
        f"# Parameters of {node_name} and their defaults. Copy the file, keep the lines you change, and use it with",
        f"# `ros2 run sfr_loc_map {node_name} --ros-args --params-file FILE`, or `sfr replay --config FILE`.",
        f"/**/{node_name}:",
        "  ros__parameters:",
        *to_yaml_lines(config_type, "    "),
    ]
    return "\n".join(lines) + "\n"


def main(folder: Path) -> None:
    """Write the files into a folder."""
    for name, (node_name, config_type) in FILES.items():
        write_text(parameter_file(node_name, config_type), folder / name)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
