"""The sources of a suite in their two phases: as the suite's file states them, and as the plan gives them to its jobs.

    StatedRecording   a path                          ┐
    StatedRemote      a URL, which the plan fetches   ┴─► Recording
    StatedEstimate    an estimate with its truth        ─► Estimate
    StatedSimulation  a scenario with a seed            ─► Simulation

`source_readers.py` reads stated sources from the suite's file, and inspects their data for the plan. To add a kind, add
its two classes here, and a case in `read_entry`, `inspected`, `local_path` and `has_changed` there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

from msgspec import Struct


@dataclass(frozen=True, slots=True, kw_only=True)
class _Stated:
    """Fields of the stated sources of all kinds. They are known before the data of the sources are read."""

    name: str  #: Short name, unique in the suite; the variants of an error budget share the name of their simulation.
    entry: int = 0  #: Number of the entry of `sources` in the suite's file, from 1; 0 for a source of a search.
    location: str  #: Path or URL of a recording, path of a scenario or of an estimate.


@dataclass(frozen=True, slots=True, kw_only=True)
class StatedRecording(_Stated):
    """A recording on this host."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StatedRemote(_Stated):
    """A recording that fsspec reads from a URL."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StatedEstimate(_Stated):
    """An estimate with its ground truth, for a score."""

    truth: str  #: Path of the ground truth.


@dataclass(frozen=True, slots=True, kw_only=True)
class StatedSimulation(_Stated):
    """A drive or a panorama that is rendered from the settings of a scenario."""

    settings: Mapping[str, object]  #: All settings of the scenario.
    sha256: str  #: Hash of the settings.
    seed: int  #: Seed of the settings.
    variant: str = ""  #: Variant of an error budget (`variants.py`); empty without a budget.
    faults: str = ""  #: Faults that belong to the variant, joined by `+`.


StatedSource: TypeAlias = StatedRecording | StatedRemote | StatedEstimate | StatedSimulation


class _Planned(Struct, frozen=True, kw_only=True, tag_field="kind"):
    """Fields of the planned sources of all kinds."""

    name: str  #: Name of the stated source.
    entry: int = 0  #: Number of the entry of the stated source.
    path: str  #: Path of the recording, of the scenario or of the estimate.
    sha256: str  #: Hash of the data, or of the settings of a simulation: part of the key of a job.
    drive: str  #: Hash that identifies the drive; copies and parts of one drive share the hash.
    identical: tuple[str, ...] = ()  #: Names of further sources with the same data, which have the same jobs.

    @property
    def kind(self) -> str:
        """Kind of the source: `file`, `estimate` or `simulated`."""
        return str(self.__struct_config__.tag)

    @property
    def location(self) -> str:
        """Location of the stated source."""
        return self.path

    @property
    def data_identity(self) -> tuple[str, ...]:
        """What two suites must have in common for a comparison of their jobs: by default, the data."""
        return (self.sha256,)

    @property
    def drive_identity(self) -> tuple[str, str]:
        """Identity of the drive among all sources of a suite."""
        return self.kind, self.drive


class Recording(_Planned, frozen=True, kw_only=True, tag="file"):
    """A recording on this host; a remote recording was fetched."""

    state: str  #: State of the files before they were hashed (`state_of`).
    url: str = ""  #: URL from which the recording was fetched; empty if it was not fetched.

    @property
    def location(self) -> str:
        """URL or path of the recording. The path of a fetched recording differs for each version of its data."""
        return self.url or self.path


class Estimate(_Planned, frozen=True, kw_only=True, tag="estimate"):
    """An estimate with its ground truth."""

    truth: str  #: Path of the ground truth.
    truth_sha256: str
    input_sha256: Mapping[str, str]  #: Hashes of estimate, truth and calls by their role in the provenance of a score.
    state: str  #: State of the files before they were hashed (`state_of`).

    @property
    def data_identity(self) -> tuple[str, ...]:
        """Name and truth, because estimates of one name and one truth are the results of two methods."""
        return self.name, self.truth_sha256


class Simulation(_Planned, frozen=True, kw_only=True, tag="simulated"):
    """A simulated source, which the first of its jobs renders."""

    settings: Mapping[str, object]  #: Those of `StatedSimulation`, like the following fields.
    seed: int
    variant: str = ""
    faults: str = ""

    @classmethod
    def of(cls, stated: StatedSimulation) -> Simulation:
        """Return the source of a plan, whose drive is not a copy of another drive."""
        return cls(
            name=stated.name,
            entry=stated.entry,
            path=stated.location,
            sha256=stated.sha256,
            drive=stated.sha256,
            settings=stated.settings,
            seed=stated.seed,
            variant=stated.variant,
            faults=stated.faults,
        )


PlannedSource: TypeAlias = Recording | Estimate | Simulation
