"""The errors of the suite: one root, one subclass per layer.

A message is one line that says what was sought, what was found and what to do. The library raises; only
`sfr_loc_map.cli` prints and sets exit codes.
"""


class SfrError(Exception):
    """Root of every error that the suite raises deliberately."""


class ConfigError(SfrError):
    """A configuration value or file is not valid."""


class GeometryError(SfrError):
    """A transform, rotation, rig or trajectory is not valid."""


class InputError(SfrError):
    """A source (folder, bag, trajectory, cloud) is missing, broken or incomplete."""


class OutputError(SfrError):
    """An output cannot be written."""


class MetricsError(SfrError):
    """Figures cannot be computed from what was given."""


class MappingError(SfrError):
    """A set of stereo pairs cannot be mapped."""


class LocalisationError(SfrError):
    """A stereo pair cannot be handed to the localiser (wrong size or type)."""


class NodeError(SfrError):
    """A node, or the graph it lives in, cannot do its work."""


class BenchError(SfrError):
    """A reference method of a benchmark does not run."""


class MissingExtraError(SfrError):
    """An optional part is not installed."""


class FailedVerdictError(SfrError):
    """A figure missed its limit: not an error of input, exit code 1."""
