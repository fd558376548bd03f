"""Reads the data of the sources of a suite, for its plan: hashes, possible tasks, and features of the drives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from sfr_loc_map.atomic import make_folder, write_text
from sfr_loc_map.configuration.parameters import build
from sfr_loc_map.configuration.sections import Configuration
from sfr_loc_map.errors import InputError, SfrError
from sfr_loc_map.hashes import hash_path
from sfr_loc_map.inputs import MAX_JSON_BYTES, read_text, refusing
from sfr_loc_map.io.source_config import SourceConfig, config_beside
from sfr_loc_map.json_yaml import parse_json
from sfr_loc_map.metrics.stored.score_json import from_plain, json_line, to_plain
from sfr_loc_map.scoring.input_files import read_files
from sfr_loc_map.scoring.inputs import ScoreInputs
from sfr_loc_map.simulation.config import SimulationConfig
from sfr_loc_map.suite.jobs.digests import cached, code_fingerprint, digest, file_state, hash_of
from sfr_loc_map.suite.jobs.job import JobTask, tasks_for
from sfr_loc_map.suite.jobs.source_cache import fetch
from sfr_loc_map.suite.jobs.sources import Estimate, PlannedSource, Recording, Simulation, StatedFile, StatedSource
from sfr_loc_map.suite.planning.drive_copies import DriveTrace, trace_of_estimate, trace_of_source

FACTS = "facts"  #: Folder in the cache of a suite, with one file for each recording.
UNREADABLE = "unreadable"  #: State of files of which one cannot be read.


class InspectedSource(NamedTuple):
    """A source on this host, its tasks and its features. Its drive is that of the source alone."""

    source: PlannedSource
    possible: tuple[JobTask, ...]  #: Tasks for which the source has data.
    trace: DriveTrace = DriveTrace()  #: Features that copies of the drive share.


def inspected(stated: StatedSource, cache: Path) -> InspectedSource:
    """Return a source with the hashes of its data. A remote recording is fetched to `cache`.

    InputError if the data cannot be read.
    """
    if isinstance(stated, Simulation):
        config = build(SimulationConfig, stated.settings)
        possible = tasks_for(has_drive=config.drive.enabled, has_panorama=config.panorama.enabled)
        return InspectedSource(stated, possible)
    return _inspected_estimate(stated) if stated.truth else _inspected_recording(stated, cache)


def _inspected_estimate(stated: StatedFile) -> InspectedSource:
    path, truth = Path(stated.location), Path(stated.truth)
    state = state_of(files_of_estimate, path, truth)  # before the files are hashed, so that a later change is detected
    truth_sha256 = hash_of(files_of_source(truth))
    estimate = Estimate(
        name=stated.name,
        path=stated.location,
        sha256=hash_of(files_of_estimate(path, truth)),
        drive=truth_sha256,
        truth=stated.truth,
        truth_sha256=truth_sha256,
        input_sha256=input_hashes(path, truth),
        state=state,
    )
    return InspectedSource(estimate, (JobTask.SCORE,), trace_of_estimate(path, truth))


def _inspected_recording(stated: StatedFile, cache: Path) -> InspectedSource:
    is_remote = "://" in stated.location
    path = fetch(stated.location, cache).absolute() if is_remote else Path(stated.location)
    state = state_of(files_of_source, path)  # before the files are hashed, as for an estimate
    facts = facts_of(path, cache)
    recording = Recording(
        name=stated.name,
        path=str(path),
        sha256=facts.sha256,
        drive=facts.sha256,
        state=state,
        url=stated.location if is_remote else "",
    )
    possible = tasks_for(has_drive=facts.pairs > 0, has_panorama=facts.nav_pairs > 0)
    return InspectedSource(recording, possible, facts.trace)


def has_changed(source: PlannedSource) -> bool:
    """Return whether the files of a source are not those that the plan hashed; a simulation has no files."""
    match source:
        case Recording():
            return state_of(files_of_source, Path(source.path)) != source.state
        case Estimate():
            return state_of(files_of_estimate, Path(source.path), Path(source.truth)) != source.state
        case Simulation():
            return False


def state_of(files_of: Callable[..., Sequence[Path]], *paths: Path) -> str:
    """Return the state of the files that `files_of` returns for paths; `UNREADABLE` if one of them cannot be read."""
    try:
        return digest([file_state(file) for file in files_of(*paths)])
    except SfrError:
        return UNREADABLE


# ---- facts of recordings, which are cached because the hash of a large recording takes minutes


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingFacts:
    """Facts of a recording: hash of the content, numbers of localisation and mapping pairs."""

    sha256: str
    pairs: int
    nav_pairs: int
    trace: DriveTrace = field(default_factory=DriveTrace)  #: Features that copies of the drive share.


def facts_of(path: Path, cache: Path) -> RecordingFacts:
    """Return the facts of a recording from the cache, or read them; InputError if the recording cannot be read.

    The facts in the cache are valid until the code or the `file_state` of a file of the recording changes. An
    unreadable file of the cache is written again.
    """
    state = digest([code_fingerprint(), *(file_state(file) for file in files_of_source(path))])
    file = cache / FACTS / f"{digest(str(path.absolute()))}.json"
    with suppress(InputError):
        return _cached_facts(file, state)
    facts = read_facts(path)
    make_folder(file.parent, "choose another folder")
    write_text(json_line({"source": str(path.absolute()), "state": state, "facts": to_plain(facts)}), file)
    return facts


def _cached_facts(file: Path, state: str) -> RecordingFacts:
    """Return the facts in a file of the cache; InputError if there are none for this state of the recording."""
    with refusing(f"cannot read '{file}'"):
        content = parse_json(read_text(file, MAX_JSON_BYTES))
        if content["state"] != state:
            raise ValueError("it has facts of another state of the source")
        return from_plain(RecordingFacts, content["facts"])


def read_facts(path: Path) -> RecordingFacts:
    """Read the facts of a recording; raise InputError if the recording cannot be read."""
    from sfr_loc_map.io.registry import open_source  # slow import, not needed by a resumed suite

    source = open_source(path)
    pairs, nav_pairs = (0 if part is None else len(part) for part in (source.loc, source.nav))
    return RecordingFacts(
        sha256=hash_of(files_of_source(path)), pairs=pairs, nav_pairs=nav_pairs, trace=trace_of_source(source)
    )


# ---- files of sources


def input_hashes(estimate: Path, truth: Path) -> dict[str, str]:
    """Return the hashes of an estimate, its truth and its calls, by their role in the provenance of a score."""
    inputs = ScoreInputs.of(estimate, truth)
    stats = {f"stats_{number}": path for number, path in enumerate(inputs.stats)}
    named = {"estimate": inputs.estimate, "truth": inputs.truth, "cloud": inputs.cloud, "map_truth": inputs.map_truth}
    return {role: cached(file.path, hash_path) for role, file in read_files({**named, **stats}).items()}


def files_of_estimate(estimate: Path, truth: Path) -> tuple[Path, ...]:
    """Return an estimate, its truth and its calls, each with the files of `files_of_source`.

    The calls are inputs of the score, because they contain findings and lost poses.
    """
    paths = (estimate, truth, *ScoreInputs.of(estimate, truth).stats)
    return tuple(file for path in paths for file in files_of_source(path))


def files_of_source(path: Path) -> tuple[Path, ...]:
    """Return a file or folder, its configuration, and the truth and the calibration that the configuration names."""
    beside = config_beside(path)
    if beside is None:
        return (path,)
    config = SourceConfig.of(Configuration.read(beside))
    calibration = Path(config.calibration.file) if config.calibration.file else None
    named = [file for file in (config.truth.file, calibration) if file is not None]
    return (path, beside, *(file for file in named if file.exists()))
