"""The work of one job."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numba
import yaml
from msgspec.structs import replace as struct_replace

from sfr_loc_map.calls.call_files import load_call_stats, save_stats
from sfr_loc_map.child_process import child_environment, end_with_parent, ending_of
from sfr_loc_map.configuration.parameters import build
from sfr_loc_map.errors import ConfigError, ExitCode, InputError, NodeError, SfrError
from sfr_loc_map.faults.kinds import parse_fault
from sfr_loc_map.faults.source import faulty
from sfr_loc_map.io.clouds.cloud_file import load_cloud, save_cloud
from sfr_loc_map.io.convert import convert
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.methods.registry import Method
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.figures.catalogue import KINDS
from sfr_loc_map.metrics.figures.records import Provenance
from sfr_loc_map.metrics.map.pair_truth import truths_of
from sfr_loc_map.metrics.score.limits import BOUND, Population
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.stored.score_json import from_json, to_plain
from sfr_loc_map.runs.drive_start import start_pose
from sfr_loc_map.runs.localiser_run import run_localiser
from sfr_loc_map.runs.mapper_run import run_mapper
from sfr_loc_map.runs.under_test import UnderTest
from sfr_loc_map.scoring.input_files import read_files
from sfr_loc_map.scoring.inputs import CloudToScore, ExpectedPairs, Origin, Run, ScoreInputs
from sfr_loc_map.scoring.load import load_run
from sfr_loc_map.scoring.load_map import pairs_of_cloud
from sfr_loc_map.scoring.score_run import score_run
from sfr_loc_map.suite.jobs.configurations import (
    METHOD,
    SECTIONS,
    Configuration,
    check_input_files,
    chosen_method,
    values_in_section,
)
from sfr_loc_map.suite.jobs.job import NATIVE_THREADS, Job, JobTask
from sfr_loc_map.suite.jobs.source_cache import local_path
from sfr_loc_map.suite.jobs.sources import Estimate
from sfr_loc_map.suite_names import Task

REPLAY_FOLDER = "replay"  #: Folder of the output of a replay.
SCORED = (ExitCode.OK, ExitCode.FAILED, ExitCode.NOT_JUDGED)
"""Exit codes of a replay whose score covers the complete source. After an interrupt, only the played part is scored."""
THREAD_VARIABLES = (*NATIVE_THREADS, "NUMBA_NUM_THREADS", "OPENCV_FOR_THREADS_NUM")
"""Environment variables that set the number of threads of a replay and of its nodes."""


def run_job(job: Job, scratch: Path, cache: Path) -> Score:
    """Return the score of a job. The score has no verdicts on limits, because the summary judges the score again.

    Paths in the score are relative to `scratch`, an empty folder. Simulated sources are rendered to `cache`. InputError
    if a file that the parameters name is not that of the plan.
    """
    use_threads(job.threads)
    check_input_files(Configuration(job.parameters, job.input_files))
    path = local_path(job.source, cache)
    score = RUN_OF_TASK[job.task](job, path, scratch, cache)
    return struct_replace(score, provenance=_provenance(job, score.provenance, scratch))


def use_threads(count: int) -> None:
    """Set the number of threads of this process, also to more threads than an earlier job had.

    Numba accepts at most the number with which the process was started.
    """
    cv2.setNumThreads(count)
    most: int = numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]  # set when numba is imported
    numba.set_num_threads(min(count, most))


def _localise(job: Job, path: Path, scratch: Path, cache: Path) -> Score:
    source = _source_with_faults(job, path)
    if source.loc is None:
        raise InputError(f"'{job.source.path}' has no drive (localisation pairs): give a source that has one")
    parameters = values_in_section(job.parameters, "localisation")
    method = chosen_method(parameters, Task.LOCALISATION)
    localiser = build(LocalisationConfig, parameters) if method is None else _under_test(method, source, cache)
    drive = run_localiser(source.loc, localiser, start_pose(source.loc, job.start))
    # the run is scored from files, as by `sfr score`, so that the provenance states their hashes
    estimate, stats = scratch / "estimate.csv", scratch / "stats.csv"
    save_trajectory(estimate, drive.trajectory)
    save_stats(stats, drive.records, {Task.LOCALISATION: drive.method}, drive.trajectory)
    has_images = not job.faults  # whether the images in the source at `path` are those that were localised
    run = load_run(ScoreInputs(estimate=estimate, truth=path, stats=(stats,), has_images_of_run=has_images))
    assert run.drive is not None  # estimate and truth are given
    expected_ns = source.expected_loc_ns()  # excludes images that a fault has dropped
    return _scored(job, replace(run, drive=replace(run.drive, image_stamps_ns=expected_ns)))


def _map(job: Job, path: Path, scratch: Path, cache: Path) -> Score:
    source = _source_with_faults(job, path)
    if source.nav is None:
        raise InputError(f"'{job.source.path}' has no mapping pairs: give a source that has them")
    parameters = values_in_section(job.parameters, "mapping")
    method = chosen_method(parameters, Task.MAPPING)
    mapper = build(MappingConfig, parameters) if method is None else _under_test(method, source, cache)
    run = run_mapper(source.nav, mapper)
    cloud, stats = scratch / "cloud.npz", scratch / "stats.csv"
    save_cloud(cloud, run.fused.cloud)
    save_stats(stats, run.records, {Task.MAPPING: run.method}, cloud=run.fused.cloud)
    loaded = load_cloud(cloud)
    pairs = pairs_of_cloud(source.nav, loaded.pair_stamps_ns, source.path)
    scored = CloudToScore(loaded, truths_of(pairs, source.nav.rig))
    files = read_files({"cloud": cloud, "map_truth": path, "stats_0": stats})
    origin = Origin(files, settings=source.changed_reading)
    expected = ExpectedPairs(nav_stamps_ns=source.expected_nav_ns())
    return _scored(job, Run(origin, [load_call_stats(stats)], cloud=scored, expected=expected))


def _score(job: Job, path: Path, scratch: Path, cache: Path) -> Score:
    assert isinstance(job.source, Estimate)
    return _scored(job, load_run(ScoreInputs.of(path, Path(job.source.truth))))


def _replay(job: Job, path: Path, scratch: Path, cache: Path) -> Score:
    if any(METHOD in values_in_section(job.parameters, section) for section in SECTIONS):
        raise ConfigError(
            "the task replay always runs the nodes of sfr_loc_map, not another method: omit 'method' in the "
            "configuration, or omit replay in 'tasks'"
        )
    if job.faults:
        convert(_source_with_faults(job, path), scratch / "faulty")
        path = scratch / "faulty"
    # the command line belongs to a higher layer, so it is run as a process
    done = subprocess.run(
        [sys.executable, "-P", "-m", "sfr_loc_map", "replay", str(path), *replay_options(job, scratch)],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
        env=child_environment() | dict.fromkeys(THREAD_VARIABLES, str(job.threads)),
        preexec_fn=partial(end_with_parent, signal.SIGTERM),
    )
    report = scratch / REPLAY_FOLDER / "report.json"
    if done.returncode not in SCORED or not report.exists():
        raise _error_of_replay(job, done)
    return from_json(report.read_text(encoding="utf-8"), str(report))


def _error_of_replay(job: Job, done: subprocess.CompletedProcess[str]) -> SfrError:
    """Return the error of a replay without a score: InputError for bad input, NodeError if the process has died."""
    lines = done.stderr.splitlines() or ["it printed no error"]
    message = f"the replay of '{job.source.path}' {ending_of(done.returncode)} without a score: {lines[-1]}"
    return InputError(message) if done.returncode == ExitCode.BAD_INPUT else NodeError(message)


def replay_options(job: Job, scratch: Path) -> list[str]:
    """Return the options of `sfr replay` for a job; parameters and limits are written to files.

    Limits with a probability are passed on only because a replay keeps all errors of their figures. Their values have
    no effect, because the summary judges the score again by the limits of the suite.
    """
    options = ["--out", str(scratch / REPLAY_FOLDER), "--start", job.start]
    if job.parameters:
        parameters = {section: to_plain(values_in_section(job.parameters, section)) for section in SECTIONS}
        nested = {section: values for section, values in parameters.items() if values}
        config = scratch / "config.yaml"
        config.write_text(yaml.safe_dump(nested), encoding="utf-8")
        options += ["--config", str(config)]
    if job.kept_errors:
        terms = {"limit": 0.0, "prob": 0.5, "confidence": 0.5, "interpretation": Population.TEMPORAL.value}
        entries = [
            {"condition": condition, f"{figure}_{BOUND}_{KINDS[figure].unit}": terms}
            for figure, condition in job.kept_errors
        ]
        limits = scratch / "limits.yaml"
        limits.write_text(yaml.safe_dump({"trajectory": entries}), encoding="utf-8")
        options += ["--limits", str(limits)]
    options += ["--spacing", str(job.scoring.spacing), "--rebase", job.scoring.rebase]
    if job.scoring.partial:
        options.append("--partial")
    for condition in job.scoring.conditions:
        options += ["--condition", condition]
    return options


RUN_OF_TASK: Mapping[JobTask, Callable[[Job, Path, Path, Path], Score]] = {
    JobTask.LOCALISE: _localise,
    JobTask.MAP: _map,
    JobTask.SCORE: _score,
    JobTask.REPLAY: _replay,
}
"""Function of each task. Its arguments are the job, the local path of the source, the empty folder and the cache."""


def _source_with_faults(job: Job, path: Path) -> Source:
    faults = [parse_fault(text) for text in job.faults.split("+") if text]
    return faulty(open_source(path), faults, job.fault_seed)


def _under_test(method: Method, source: Source, cache: Path) -> UnderTest:
    """Return a method that cannot read the ground truth of a source.

    The cache is hidden, too, because it may contain other variants of an error budget, which have the same true path.
    """
    return UnderTest(method, hidden=(*source.truth_paths(), cache))


def _scored(job: Job, run: Run) -> Score:
    return score_run(run, ScoreConfig(trajectory=job.scoring), kept_errors=job.kept_errors)


def _provenance(job: Job, provenance: Provenance | None, scratch: Path) -> Provenance:
    """Return the provenance with the description of the job. Paths are those of the suite, not of `scratch`."""
    known = provenance or Provenance(version="")
    host = {**known.host, "threads": str(job.threads)}
    inputs = {
        role: struct_replace(item, path=item.path.removeprefix(f"{scratch}/")) for role, item in known.inputs.items()
    }
    hashes = {f"{name}_sha256": sha256 for name, sha256 in job.input_files.items()}
    configuration = {**known.configuration, **job.parameters, **hashes, **job.description.to_provenance()}
    return struct_replace(known, inputs=inputs, configuration=configuration, host=host)
