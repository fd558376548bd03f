"""Programs beside the nodes: recorder, graph observation, parameter files."""
