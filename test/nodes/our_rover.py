"""Localisation and mapping of one rover in one process."""

from sfr_loc_map.nodes.localisation_node import LocalisationNode
from sfr_loc_map.nodes.mapping_node import MappingNode
from sfr_loc_map.nodes.process.runner import run


def main() -> int:
    """Run both until Ctrl-C or SIGTERM."""
    return run(lambda: LocalisationNode(namespace="rover1"), lambda: MappingNode(namespace="rover1"))


if __name__ == "__main__":
    raise SystemExit(main())
