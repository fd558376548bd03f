"""The work of one task, in the process that is its own."""

from __future__ import annotations

import fcntl
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import yaml

from sfr_loc_map.config import build
from sfr_loc_map.errors import ConfigError, InputError
from sfr_loc_map.io.cloud_file import load_cloud, save_cloud
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.trajectory_file import save_trajectory
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.methods.method import MethodLimits, MethodTask
from sfr_loc_map.methods.registry import record_of_ours
from sfr_loc_map.metrics.cloud_error import truths_of
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.limits import parse_limits, verdicts
from sfr_loc_map.metrics.score import Provenance, Score
from sfr_loc_map.metrics.score_json import from_json, to_plain
from sfr_loc_map.pipeline.call_stats import load_call_stats, save_stats
from sfr_loc_map.pipeline.convert import faulty, perturb
from sfr_loc_map.pipeline.offline import localise, localise_with, map_pairs, map_pairs_with, start_pose, trajectory_of
from sfr_loc_map.pipeline.scoring import Run, ScoredCloud, ScoreInputs, score_files, score_run
from sfr_loc_map.pipeline.simulate import simulate
from sfr_loc_map.simulation.config import SimulationConfig
from sfr_loc_map.simulation.faults import Fault, parse_fault
from sfr_loc_map.suite.method import METHOD_KEYS, task_method
from sfr_loc_map.suite.reference_work import REFERENCE, reference_seconds
from sfr_loc_map.suite.source_cache import SourceCache
from sfr_loc_map.suite.task import SourceKind, Task, TaskKind

REPLAY = "from sfr_loc_map.cli.main import main; raise SystemExit(main())"
"""The command line is above this layer: it is run as the command that it is."""


def run_task(task: Task, scratch: Path, cache: Path) -> Score:
    """Return the score of a task.

    Args:
        task: The task.
        scratch: An empty folder, the current directory: paths in the score are relative to it.
        cache: Folder in which simulated sources are kept.

    Raises:
        SfrError: If the source cannot be read, or nothing can be scored.
    """
    work = {TaskKind.LOCALISE: _localise, TaskKind.MAP: _map, TaskKind.SCORE: _score, TaskKind.REPLAY: _replay}
    score = work[task.kind](task, scratch, cache)
    judged = verdicts(parse_limits(task.limits, "limits"), score) if task.limits else ()
    return replace(score, verdicts=judged, provenance=_provenance(task, score.provenance))


def _localise(task: Task, scratch: Path, cache: Path) -> Score:
    path = _source(task, cache)
    source = faulty(open_source(path), _faults(task), task.fault_seed)
    if source.loc is None:
        raise InputError(f"no drive in '{task.source.path}': give a source that has one")
    section, start = _section(task, "localisation"), start_pose(source.loc, task.start)
    method = task_method(section, MethodTask.LOCALISE)
    if method is None:
        results = list(localise(source.loc, build(LocalisationConfig, section), start))
        about = record_of_ours(MethodTask.LOCALISE)
    else:
        done = list(localise_with(method, source.loc, start.T_ds_rb, MethodLimits()))
        results, about = [(result, record) for result, record, _ in done], done[-1][2]
    estimate, stats = Path("estimate.csv"), Path("stats.csv")
    save_trajectory(scratch / estimate, trajectory_of([result for result, _ in results]))
    save_stats(scratch / stats, [record for _, record in results], about)
    return score_files(ScoreInputs(estimate=estimate, truth=path, stats=(stats,)), _score_config(task))


def _map(task: Task, scratch: Path, cache: Path) -> Score:
    path = _source(task, cache)
    source = faulty(open_source(path), _faults(task), task.fault_seed)
    if source.nav is None:
        raise InputError(f"no mapping pairs in '{task.source.path}': give a source that has them")
    section = _section(task, "mapping")
    method, about = task_method(section, MethodTask.MAP), record_of_ours(MethodTask.MAP)
    if method is None:
        run = map_pairs(source.nav, build(MappingConfig, section))
    else:
        run, about = map_pairs_with(method, source.nav, MethodLimits())
    cloud, stats = Path("cloud.npz"), Path("stats.csv")
    save_cloud(scratch / cloud, run.fused.cloud)
    save_stats(scratch / stats, run.records, about)
    inputs = ScoreInputs(cloud=cloud, map_truth=path, stats=(stats,))
    truths = truths_of(list(source.nav.pairs()), source.nav.rig)
    scored = ScoredCloud(load_cloud(cloud), truths)
    return score_run(Run(inputs, [load_call_stats(stats)], cloud=scored), _score_config(task))


def _score(task: Task, scratch: Path, cache: Path) -> Score:
    inputs = ScoreInputs.of(Path(task.source.path), Path(task.source.truth))
    return score_files(inputs, _score_config(task))


def _replay(task: Task, scratch: Path, cache: Path) -> Score:
    path = _source(task, cache)
    faults = _faults(task)
    if faults:
        perturb(open_source(path), scratch / "faulty", faults, task.fault_seed)
        path = scratch / "faulty"
    if any(name.rpartition(".")[2] in METHOD_KEYS for name in task.parameters):
        raise ConfigError("'method' of a configuration is for the tasks localise and map: a replay runs our nodes")
    out = scratch / "replay"
    command = [sys.executable, "-c", REPLAY, "replay", str(path), "--out", str(out), "--start", task.start]
    if task.parameters:
        (scratch / "config.yaml").write_text(yaml.safe_dump(_nested(task.parameters)), encoding="utf-8")
        command += ["--config", str(scratch / "config.yaml")]
    for condition in task.scoring.conditions:
        command += ["--condition", condition]
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    report = out / "report.json"
    if not report.exists():
        raise InputError(f"replay of '{task.source.path}' gave no report: {done.stderr.strip()[-300:]}")
    return from_json(report.read_text(encoding="utf-8"), str(report))


def _source(task: Task, cache: Path) -> Path:
    """Return the place of a source; a simulation is rendered once, a remote source fetched once, whoever asks first."""
    if task.source.kind is SourceKind.REMOTE:
        copies = SourceCache(cache, task.cache_mb * 10**6)
        return copies.fetch(task.source.path, task.source.version, task.source.content_sha256)
    if task.source.kind is not SourceKind.SIMULATED:
        return Path(task.source.path)
    out = cache / f"simulated-{task.source.sha256}"
    with _locked(cache / f"simulated-{task.source.sha256}.lock"):
        if not (out / "complete").exists():
            simulate(build(SimulationConfig, task.source.settings), out, workers=1)
            (out / "complete").touch()
    return out


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    with path.open("w") as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        yield


def _faults(task: Task) -> list[Fault]:
    return [parse_fault(text) for text in task.faults.split("+") if text]


def _section(task: Task, section: str) -> dict[str, object]:
    prefix = f"{section}."
    return {name.removeprefix(prefix): value for name, value in task.parameters.items() if name.startswith(prefix)}


def _nested(parameters: Mapping[str, object]) -> dict[str, dict[str, object]]:
    nested: dict[str, dict[str, object]] = {}
    for name, value in parameters.items():
        section, _, rest = name.partition(".")
        nested.setdefault(section, {})[rest] = to_plain(value)
    return nested


def _score_config(task: Task) -> ScoreConfig:
    scoring = task.scoring
    values = {"conditions": scoring.conditions, "spacing": scoring.spacing, "rebase": scoring.rebase}
    return build(ScoreConfig, {f"trajectory.{name}": value for name, value in values.items()})


def _provenance(task: Task, provenance: Provenance | None) -> Provenance:
    """Add what the task was; names and places of its files come from the suite, not from the scratch folder."""
    known = provenance or Provenance(version="")
    about = {
        "suite.key": task.key,
        "suite.task": task.kind.value,
        "suite.source": task.source.name,
        "suite.source_sha256": task.source.sha256,
        "suite.faults": task.faults,
        "suite.fault_seed": task.fault_seed,
        "suite.configuration": task.configuration,
        "suite.repeat": task.repeat,
        "suite.start": task.start,
        "suite.code": task.code,
    }
    timing = "alone on its host" if task.alone else "beside other tasks"
    host = {**known.host, "timing": timing, "threads": str(task.threads)}
    if task.alone:
        host[REFERENCE] = repr(reference_seconds())
    return replace(known, configuration={**known.configuration, **task.parameters, **about}, host=host)
