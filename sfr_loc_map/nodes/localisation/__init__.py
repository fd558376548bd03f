"""The parts of the localisation node: its localiser and start pose (`localisation_session`), and its other inputs."""
