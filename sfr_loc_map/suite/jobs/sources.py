"""The sources of a suite before and after their data are read.

    entry of `sources`                before the data are read     in the plan
    a path, a glob or a URL           StatedFile                   Recording
    an estimate with its truth        StatedFile                   Estimate
    a scenario with its seeds         Simulation                   Simulation

`source_entries.py` reads the entries, and `source_inspection.py` reads the data. To add a kind of source:

- add its class here, and the class to `StatedSource` and `PlannedSource`
- add a case to `sources_of_entry` (source_entries.py), and to `inspected` and `has_changed` (source_inspection.py)
- add a case to `local_path` (source_cache.py), where the jobs find their data

A source has these identities:

    name             displayed name; the variants of an error budget share the name of their simulation
    location         path or URL in the suite's file
    sha256           hash of the data, or of the settings of a simulation
    data_identity    what two suites must have in common for a comparison: `sha256`, or name and truth of an estimate
    drive_identity   the drive that the source shows, which is equal for copies and parts of one drive
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeAlias

from msgspec import Struct


class StatedFile(Struct, frozen=True, kw_only=True):
    """A recording, or an estimate with its ground truth, whose data have not been read yet."""

    name: str
    location: str  #: Path or URL.
    truth: str = ""  #: Path of the ground truth of an estimate; empty for a recording.


class _Source(Struct, frozen=True, kw_only=True, tag_field="kind"):
    """Fields of the planned sources of all kinds."""

    name: str
    path: str  #: Path of the recording, of the scenario or of the estimate.
    sha256: str
    drive: str  #: Hash that identifies the drive among the sources of one kind.
    identical: tuple[str, ...] = ()  #: Names of further sources with the same data, which have the same jobs.

    @property
    def kind(self) -> str:
        """Kind of the source: `file`, `estimate` or `simulated`."""
        return str(self.__struct_config__.tag)

    @property
    def location(self) -> str:
        """Path or URL in the suite's file."""
        return self.path

    @property
    def data_identity(self) -> tuple[str, ...]:
        """What two suites must have in common for a comparison of their jobs: by default, the data."""
        return (self.sha256,)

    @property
    def drive_identity(self) -> tuple[str, str]:
        """Identity of the drive among all sources of a suite."""
        return self.kind, self.drive


class Recording(_Source, frozen=True, kw_only=True, tag="file"):
    """A recording on this host; a remote recording was fetched."""

    state: str  #: State of the files before they were hashed (`state_of`).
    url: str = ""  #: URL from which the recording was fetched; empty if it was not fetched.

    @property
    def location(self) -> str:
        """URL or path of the recording. The path of a fetched recording differs for each version of its data."""
        return self.url or self.path


class Estimate(_Source, frozen=True, kw_only=True, tag="estimate"):
    """An estimate with its ground truth."""

    truth: str  #: Path of the ground truth.
    truth_sha256: str
    input_sha256: Mapping[str, str]  #: Hashes of estimate, truth and calls by their role in the provenance of a score.
    state: str  #: State of the files before they were hashed (`state_of`).

    @property
    def data_identity(self) -> tuple[str, ...]:
        """Name and truth, because estimates of one name and one truth are the results of two methods."""
        return self.name, self.truth_sha256


class Simulation(_Source, frozen=True, kw_only=True, tag="simulated"):
    """A drive or a panorama that the first of its jobs renders from the settings of a scenario."""

    settings: Mapping[str, object]  #: All settings of the scenario.
    seed: int  #: Seed of the settings.
    variant: str = ""  #: Variant of an error budget (`variants.py`); empty without a budget.
    faults: str = ""  #: Faults that belong to the variant, joined by `+`.


StatedSource: TypeAlias = StatedFile | Simulation
PlannedSource: TypeAlias = Recording | Estimate | Simulation
