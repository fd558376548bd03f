"""Check of a recording without ground truth: of its drive (`check`) and of its maps (`overlap`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sfr_loc_map.configuration.sections import Configuration
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.evidence.calibration import Advice
from sfr_loc_map.evidence.check import MIN_PAIRS, check_drive, short_drive
from sfr_loc_map.evidence.check_result import OF_SUBJECTS, SCHEMA, Check, CheckResult, combined, results_of
from sfr_loc_map.evidence.localiser_runs import NAMES_OF_OWN_RUNS, ComparedRun, calls_of
from sfr_loc_map.evidence.overlap import check_maps
from sfr_loc_map.io.sequence import Source, drive_of
from sfr_loc_map.io.tables.trajectory_file import read_trajectory_file
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.metrics.conditions import Condition
from sfr_loc_map.metrics.figures.records import Provenance
from sfr_loc_map.metrics.figures.rows import Figure
from sfr_loc_map.metrics.frames.association import Estimates
from sfr_loc_map.metrics.stored.score_json import HASH, hash_of_values, to_plain


@dataclass(frozen=True, slots=True)
class RecordingCheck:
    """The checks of a recording."""

    drive: Check | None = None  #: None without a drive.
    maps: Check | None = None  #: None without several mapping pairs.
    provenance: Provenance | None = None  #: Inputs, command, settings, version and time; None if unknown.

    @property
    def checks(self) -> dict[str, Check]:
        """The checks by subject."""
        return {check.subject: check for check in (self.drive, self.maps) if check is not None}

    @property
    def calibration(self) -> tuple[str, ...]:
        """Offsets of the right camera for which the calibration should be repeated, one phrase each."""
        return () if self.drive is None else tuple(offset.text for offset in self.drive.wrong_offsets)

    @property
    def advice(self) -> dict[str, Advice]:
        """The recommended action for the calibration file, by angle."""
        return {} if self.drive is None else self.drive.advice

    @property
    def results(self) -> dict[str, CheckResult]:
        """The result of each subject; the calibration has a result only if it should be repeated."""
        return results_of(self.checks, self.figures, self.advice)

    @property
    def result(self) -> CheckResult:
        """The result of the recording: not enough data if a subject was not checked and no other subject disagrees."""
        return combined(self.results.values(), OF_SUBJECTS)

    @property
    def checked(self) -> dict[str, str]:
        """For each subject, the number of comparisons with enough data, and the number of all comparisons."""
        return {subject: f"{check.checked} of {len(check.results)}" for subject, check in self.checks.items()}

    @property
    def figures(self) -> tuple[Figure, ...]:
        """The figures of all subjects."""
        return tuple(row for check in self.checks.values() for row in check.figures)

    @property
    def disagreements(self) -> list[str]:
        """Differences that exceed the prediction, one phrase each."""
        return [text for check in self.checks.values() for text in check.disagreements]

    @property
    def not_checked(self) -> list[str]:
        """Why subjects could not be checked, one phrase each."""
        return [check.shortage for check in self.checks.values() if check.shortage]

    def to_dict(self) -> dict[str, Any]:
        """Return the check for JSON, with the hash of its values."""
        content = {
            "schema": SCHEMA,
            "result": self.result.value,
            "results": {subject: result.value for subject, result in self.results.items()},
            "checked": self.checked,
            "pairs": {subject: check.pairs for subject, check in self.checks.items()},
            "pairs_of_source": {subject: check.pairs_of_source for subject, check in self.checks.items()},
            "calibration": list(self.calibration),
            "advice": self.advice,
            "disagreements": self.disagreements,
            "not_checked": self.not_checked,
            "figures": to_plain(self.figures),
            "provenance": to_plain(self.provenance),
        }
        return {**content, HASH: hash_of_values(content)}


def check_recording(
    source: Source,
    config: Configuration,
    conditions: Sequence[Condition],
    most_pairs: int,
    others: Sequence[ComparedRun] = (),
    progress: Callable[[], None] = lambda: None,
) -> RecordingCheck:
    """Check the drive of a source, if it has one, and its maps, if it has several mapping pairs.

    A drive of fewer than `MIN_PAIRS` pairs has not enough data, and its maps are checked.
    `progress` is called after each of the `calls_of_check` calls of the localiser.
    """
    drive: Check | None = None
    maps: Check | None = None
    if has_drive_to_check(source):
        sequence = drive_of(source)
        count = min(len(sequence), most_pairs)
        localiser = config.build(LocalisationConfig, "localisation")
        if count < MIN_PAIRS:
            drive = short_drive(count, len(sequence))
        else:
            drive = check_drive(sequence, localiser, conditions, most_pairs, others, progress)
    if source.nav is not None and has_maps(source):
        maps = check_maps(source.nav, config.build(MappingConfig, "mapping"))
    return RecordingCheck(drive, maps)


def has_maps(source: Source) -> bool:
    """Return whether a source has several mapping pairs."""
    return source.nav is not None and len(source.nav) > 1


def has_drive_to_check(source: Source) -> bool:
    """Return whether the drive of a source is checked; a source without a drive is an error unless it has maps."""
    return source.loc is not None or not has_maps(source)


def calls_of_check(source: Source, most_pairs: int) -> int:
    """Return the number of calls of the localiser in a check."""
    return 0 if source.loc is None else calls_of(min(len(source.loc), most_pairs))


def read_estimates(paths: Sequence[Path]) -> list[ComparedRun]:
    """Read estimates of other methods; the names of the runs are those of `names_of_estimates`."""
    names = names_of_estimates(paths)
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
