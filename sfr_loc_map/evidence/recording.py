"""Check of a recording without ground truth: of its drive (`check`) and of its maps (`overlap`)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from sfr_loc_map.configuration.sections import Configuration
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.evidence.check import check_drive
from sfr_loc_map.evidence.check_result import Check, joined
from sfr_loc_map.evidence.localiser_runs import NAMES_OF_OWN_RUNS, ComparedRun, calls_of
from sfr_loc_map.evidence.overlap import check_maps
from sfr_loc_map.io.sequence import Source, drive_of
from sfr_loc_map.io.tables.trajectory_file import read_trajectory_file
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.metrics.conditions import Condition
from sfr_loc_map.metrics.frames.association import Estimates


def check_recording(
    source: Source,
    config: Configuration,
    conditions: Sequence[Condition],
    most_pairs: int,
    others: Sequence[ComparedRun] = (),
    progress: Callable[[], None] = lambda: None,
) -> Check:
    """Check the drive of a source, if it has one, and its maps, if it has several mapping pairs.

    `progress` is called after each of the `calls_of_check` calls of the localiser.
    """
    checks = []
    if has_drive_to_check(source):
        localiser = config.build(LocalisationConfig, "localisation")
        checks.append(check_drive(drive_of(source), localiser, conditions, most_pairs, others, progress))
    if source.nav is not None and has_maps(source):
        checks.append(check_maps(source.nav, config.build(MappingConfig, "mapping")))
    return joined(checks)


def has_maps(source: Source) -> bool:
    """Return whether a source has several mapping pairs."""
    return source.nav is not None and len(source.nav) > 1


def has_drive_to_check(source: Source) -> bool:
    """Return whether the drive of a source is checked; a source without a drive is an error unless it has maps."""
    return source.loc is not None or not has_maps(source)


def calls_of_check(source: Source, most_pairs: int) -> int:
    """Return the number of calls of the localiser in a check."""
    return 0 if source.loc is None else calls_of(min(len(source.loc), most_pairs))


def read_estimates(names: Mapping[Path, str]) -> list[ComparedRun]:
    """Read the estimates of other methods, given the names of their runs by the paths of their files."""
    return [ComparedRun(name, Estimates.of(read_trajectory_file(path).stamped)) for path, name in names.items()]


def names_of_estimates(paths: Sequence[Path]) -> dict[Path, str]:
    """Return the names of the runs of estimates: the names of their files, or the paths if files have the same name."""
    for path in paths:
        if paths.count(path) > 1:
            raise ConfigError(f"'--estimate {path}' is given {paths.count(path)} times: give different estimates")
    has_equal_names = len({path.name for path in paths}) < len(paths)
    names = {path: str(path) if has_equal_names else path.name for path in paths}
    if reserved := [name for name in names.values() if name in NAMES_OF_OWN_RUNS]:
        raise ConfigError(f"'--estimate {reserved[0]}' is the name of a run that the check makes: rename the file")
    return names
