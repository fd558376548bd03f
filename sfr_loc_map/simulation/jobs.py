"""The files of a simulated data set: one job for each image and each ground truth, and the lists of each task."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from sfr_loc_map.atomic import atomic_path
from sfr_loc_map.io.calibration.rig_file import rig_json
from sfr_loc_map.io.image_codec import encode_png
from sfr_loc_map.io.layouts.folder import pair_row, pairs_lines
from sfr_loc_map.io.tables.trajectory_writer import trajectory_text
from sfr_loc_map.simulation.plan import Plan
from sfr_loc_map.simulation.world import World
from sfr_loc_map.suite_names import SIDES, Side, Task

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


def write_job(world: World, out: Path, job: RenderJob) -> None:
    """Write the files of a job into the folder of its task."""
    folder = task_folders(world.plan, out)[job.task]
    for file, content in zip(job.files(folder), rendered(world, job), strict=True):
        write_file(file, content)


def rendered(world: World, job: RenderJob) -> list[bytes]:
    """Return the contents of a job's files."""
    if job.product != "truth":
        return [encode_png(world.image(job.task, job.frame, job.product))]
    points, mask = world.truth(job.frame)
    stream = io.BytesIO()
    np.save(stream, points)
    return [encode_png(mask), stream.getvalue()]


def is_written(path: Path) -> bool:
    """Return whether a file of a job is complete. The content of an empty file was lost when the computer stopped."""
    return path.is_file() and path.stat().st_size > 0


def write_file(path: Path, content: bytes) -> None:
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
