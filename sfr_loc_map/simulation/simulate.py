"""Render a simulation into a data set folder; an interrupted run can be continued.

Each image and each ground truth is one job (`jobs`), which writes its files atomically. The lists (`pairs.csv`,
`groundtruth.csv`) are written last, so a folder without the lists is unfinished. The same command then renders only the
missing files. If the settings or the code have changed, the command fails. Jobs depend only on the configuration, so
the result does not depend on the number of workers.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import yaml

from sfr_loc_map import __version__, geometry, jit
from sfr_loc_map.atomic import make_folder
from sfr_loc_map.configuration.parameters import build, flatten
from sfr_loc_map.configuration.yaml_file import load_yaml
from sfr_loc_map.errors import ConfigError, OutputError, SfrError
from sfr_loc_map.hashes import hash_path
from sfr_loc_map.inputs import read_text
from sfr_loc_map.io import image_codec
from sfr_loc_map.io.bag.writer import STORAGE_BY_SUFFIX
from sfr_loc_map.simulation.config import SimulationConfig
from sfr_loc_map.simulation.jobs import (
    RenderJob,
    is_written,
    lists_of,
    render_jobs,
    task_folders,
    write_file,
    write_job,
)
from sfr_loc_map.simulation.plan import Plan
from sfr_loc_map.simulation.tracer import require_tracer
from sfr_loc_map.simulation.workers import write_jobs
from sfr_loc_map.simulation.world import World
from sfr_loc_map.suffixes import suffix_of

SETTINGS = "simulation.yaml"  #: Name of the file with the settings in the folder of a simulation.
CODE = tuple(
    Path(path) for path in (Path(__file__).parent, Path(geometry.__file__).parent, jit.__file__, image_codec.__file__)
)
"""Folders and files of the code that determines the images."""


def simulate(
    config: SimulationConfig,
    out: Path,
    workers: int = 2,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> int:
    """Write a simulated data set with exact ground truth, and return the number of pairs.

    An unfinished run with the same settings by the same code is continued. `workers` is the number of processes; 0 or 1
    renders in this process. `progress` is called with the number of finished jobs and the total.

    Raises ConfigError as `Plan.make`, and if `out` is a bag. Raises OutputError if the folder contains anything else
    than this run, or if a worker is killed. Raises MissingExtraError if the ray tracer is not installed.
    """
    require_tracer()
    if suffix_of(out) in STORAGE_BY_SUFFIX:
        raise ConfigError(f"'{out}' is a bag: simulate into a folder, then run sfr convert FOLDER {out}")
    plan = Plan.make(config)
    folders = task_folders(plan, out)
    _claim(plan.config, out)
    jobs = render_jobs(plan)
    for job in jobs:
        for file in job.files(folders[job.task]):
            file.parent.mkdir(parents=True, exist_ok=True)
    for rest in out.rglob(".*.part"):  # left by a killed run
        shutil.rmtree(rest, ignore_errors=True)
    todo = [job for job in jobs if not all(map(is_written, job.files(folders[job.task])))]
    progress(len(jobs) - len(todo), len(jobs))
    if todo:
        written = len(jobs) - len(todo)
        _render(plan, out, todo, workers, lambda done: progress(written + done, len(jobs)))
    for task, folder in folders.items():
        for name, content in lists_of(plan, task).items():
            write_file(folder / name, content)
    return sum(plan.count(task) for task in folders)


def can_continue(config: SimulationConfig, out: Path) -> bool:
    """Return whether a folder holds an unfinished run with these settings by this version of the code.

    Raises ConfigError as `Plan.make`.
    """
    plan = Plan.make(config)
    folders = task_folders(plan, out).values()
    return not _difference(plan.config, out) and not all((folder / "pairs.csv").exists() for folder in folders)


def settings_text(config: SimulationConfig) -> str:
    """Return the settings as YAML for `sfr simulate`, with a comment that names the code that renders."""
    flat = {name: list(value) if isinstance(value, tuple) else value for name, value in flatten(config).items()}
    return _code_line() + yaml.safe_dump(flat, sort_keys=False, width=120)


def _code_line() -> str:
    """Return the first line of the file of settings, which names the version and the hash of the code."""
    code = "-".join(hash_path(folder)[:8] for folder in CODE)
    return f"# rendered by sfr_loc_map {__version__}, code {code}\n"


def _difference(config: SimulationConfig, out: Path) -> str:
    """Return how the simulation in a folder differs; empty if settings and code are the same."""
    try:
        found = build(SimulationConfig, load_yaml(out / SETTINGS))
        text = read_text(out / SETTINGS)
    except (SfrError, OSError, ValueError) as error:
        return f"whose settings cannot be read ({error})"
    if found != config:
        return "with other settings"
    return "" if text.startswith(_code_line()) else "by another version of the code"


def _claim(config: SimulationConfig, out: Path) -> None:
    """Write the settings into a new or empty folder; OutputError if the folder contains anything else.

    A folder with a simulation of the same settings by the same code is accepted, and its run is continued.
    """
    if (out / SETTINGS).exists():
        if difference := _difference(config, out):
            raise OutputError(f"'{out}' contains a simulation {difference}: remove it or choose another name")
        return
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise OutputError(f"cannot write '{out}': it exists and is not a simulation; remove it or choose another name")
    make_folder(out, "choose another name")
    write_file(out / SETTINGS, settings_text(config).encode())


def _render(plan: Plan, out: Path, jobs: Sequence[RenderJob], workers: int, progress: Callable[[int], None]) -> None:
    """Write the files of jobs, in this process or in `workers` processes; OutputError if a process is killed.

    `progress` is called with the number of finished jobs.
    """
    if workers > 1:
        write_jobs(plan.config, out, jobs, workers, progress)
        return
    world = World(plan)
    for done, job in enumerate(jobs, start=1):
        write_job(world, out, job)
        progress(done)
