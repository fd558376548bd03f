"""Render a simulation in several processes into a data set folder; an interrupted run can be continued.

Each image and each ground truth is one job, which writes its files atomically. The lists (`pairs.csv`,
`groundtruth.csv`) are written last, so a folder without the lists is unfinished. The same command then renders only the
missing files. If the settings or the code have changed, the command fails. Jobs depend only on the configuration, so
the result does not depend on the number of workers.
"""

from __future__ import annotations

import io
import multiprocessing
import os
import shutil
import signal
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import yaml

from sfr_loc_map import __version__, geometry, jit
from sfr_loc_map.atomic import atomic_path, make_folder
from sfr_loc_map.child_process import end_with_parent
from sfr_loc_map.configuration.parameters import build, flatten
from sfr_loc_map.configuration.yaml_file import load_yaml
from sfr_loc_map.errors import ConfigError, OutputError, SfrError
from sfr_loc_map.hashes import hash_path
from sfr_loc_map.inputs import read_text
from sfr_loc_map.io import image_codec
from sfr_loc_map.io.bag.writer import STORAGE_BY_SUFFIX
from sfr_loc_map.io.calibration.rig_file import rig_json
from sfr_loc_map.io.image_codec import encode_png
from sfr_loc_map.io.layouts.folder import pair_row, pairs_lines
from sfr_loc_map.io.tables.trajectory_writer import trajectory_text
from sfr_loc_map.signals import deferred_signals
from sfr_loc_map.simulation.config import SimulationConfig
from sfr_loc_map.simulation.plan import Plan
from sfr_loc_map.simulation.tracer import require_tracer
from sfr_loc_map.simulation.world import World
from sfr_loc_map.suffixes import suffix_of
from sfr_loc_map.suite_names import SIDES, Side, Task

SETTINGS = "simulation.yaml"  #: Name of the file with the settings in the folder of a simulation.
CODE = tuple(
    Path(path) for path in (Path(__file__).parent, Path(geometry.__file__).parent, jit.__file__, image_codec.__file__)
)
"""Folders and files of the code that determines the images."""


Product = Side | Literal["truth"]


class RenderJob(NamedTuple):
    """One image, or one ground truth with mask, of a task."""

    task: Task
    frame: int  #: Number of the pair.
    product: Product  #: The image of a camera, or the ground truth of the left image.

    def files(self, folder: Path) -> list[Path]:
        """Return the output files."""
        number = f"{self.frame:06d}"
        if self.product == "truth":
            return [folder / "masks" / f"{number}.png", folder / "truth" / f"{number}.npy"]
        return [folder / self.product / f"{number}.png"]


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
    todo = [job for job in jobs if not all(map(_is_written, job.files(folders[job.task])))]
    progress(len(jobs) - len(todo), len(jobs))
    if todo:
        _render(plan, out, todo, workers, lambda done: progress(len(jobs) - len(todo) + done, len(jobs)))
    for task, folder in folders.items():
        for name, content in lists_of(plan, task).items():
            _write(folder / name, content)
    return sum(plan.count(task) for task in folders)


def can_continue(config: SimulationConfig, out: Path) -> bool:
    """Return whether a folder holds an unfinished run with these settings by this version of the code.

    Raises ConfigError as `Plan.make`.
    """
    plan = Plan.make(config)
    folders = task_folders(plan, out).values()
    return not _difference(plan.config, out) and not all((folder / "pairs.csv").exists() for folder in folders)


def render_jobs(plan: Plan) -> list[RenderJob]:
    """Return the jobs of a plan."""
    products: dict[Task, tuple[Product, ...]] = {Task.LOCALISATION: SIDES, Task.MAPPING: (*SIDES, "truth")}
    return [
        RenderJob(task, frame, product)
        for task in Task
        for frame in range(plan.count(task))
        for product in products[task]
    ]


def task_folders(plan: Plan, out: Path) -> dict[Task, Path]:
    """Return the output folder of each task of a plan."""
    tasks = [task for task in Task if plan.count(task)]
    return {tasks[0]: out} if len(tasks) == 1 else {task: out / task.rig for task in tasks}


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
    _write(out / SETTINGS, settings_text(config).encode())


def _render(plan: Plan, out: Path, jobs: list[RenderJob], workers: int, progress: Callable[[int], None]) -> None:
    """Write the files of jobs, in this process or in `workers` processes; OutputError if a process is killed.

    `progress` is called with the number of finished jobs.
    """
    if workers <= 1:
        world = World(plan)
        folders = task_folders(plan, out)
        for done, job in enumerate(jobs, start=1):
            _write_job(world, folders[job.task], job)
            progress(done)
        return
    context = multiprocessing.get_context("spawn")
    others = set(multiprocessing.active_children())
    with deferred_signals():  # a signal may go to the whole process group; this process ends the others
        pool = ProcessPoolExecutor(min(workers, len(jobs)), context, _start_worker, (plan.config, out))
    try:
        with deferred_signals():
            futures = [pool.submit(_run_on_worker, job) for job in jobs]
        for done, future in enumerate(as_completed(futures), start=1):
            future.result()
            progress(done)
    except KeyboardInterrupt:  # an unfinished job may take 30 s, and is rendered again anyway
        for worker in set(multiprocessing.active_children()) - others:
            worker.kill()
        raise
    except BrokenProcessPool as error:
        raise OutputError(
            "a worker process was killed (out of memory?): run the command again with fewer --workers to continue"
        ) from error
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


_worker: tuple[World, dict[Task, Path]] | None = None  # set only in worker processes, which end with the pool


def _start_worker(config: SimulationConfig, out: Path) -> None:
    """Build the world of a worker process once, for all its jobs."""
    global _worker
    end_with_parent(signal.SIGKILL)
    if (parent := multiprocessing.parent_process()) is None or not parent.is_alive():  # parent killed before the call
        os._exit(1)
    plan = Plan.make(config)
    _worker = World(plan), task_folders(plan, out)


def _run_on_worker(job: RenderJob) -> None:
    """Write the files of a job in a worker process."""
    assert _worker is not None
    world, folders = _worker
    _write_job(world, folders[job.task], job)


def _write_job(world: World, folder: Path, job: RenderJob) -> None:
    """Write the files of a job into the folder of its task."""
    for file, content in zip(job.files(folder), rendered(world, job), strict=True):
        _write(file, content)


def rendered(world: World, job: RenderJob) -> list[bytes]:
    """Return the contents of a job's files."""
    if job.product != "truth":
        return [encode_png(world.image(job.task, job.frame, job.product))]
    points, mask = world.truth(job.frame)
    stream = io.BytesIO()
    np.save(stream, points)
    return [encode_png(mask), stream.getvalue()]


def _is_written(path: Path) -> bool:
    """Return whether a file of a job is complete. The content of an empty file was lost when the computer stopped."""
    return path.is_file() and path.stat().st_size > 0


def _write(path: Path, content: bytes) -> None:
    """Write a file atomically: an interrupted process leaves no incomplete file under this name."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def lists_of(plan: Plan, task: Task) -> dict[str, bytes]:
    """Return rig, true trajectory and list of pairs of a task by file name; the list of pairs is last."""
    files = {"rig.json": rig_json(plan.rig(task))}
    rows: list[list[str]] = []
    for frame in range(plan.count(task)):
        stamp_ns = plan.stamp_ns(task, frame)
        if task is Task.LOCALISATION:
            rows.append(pair_row(stamp_ns, frame))
        else:
            rows.append(pair_row(stamp_ns, frame, plan.lm_pose(frame), f"truth/{frame:06d}.npy"))
    if task is Task.LOCALISATION:
        files["groundtruth.csv"] = trajectory_text(plan.trajectory())
    files["pairs.csv"] = "\n".join(pairs_lines(rows)) + "\n"
    return {name: text.encode() for name, text in files.items()}
