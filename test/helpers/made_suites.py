"""Small suites of estimates with their ground truth, and a job as a template."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.suite.jobs.job import Job, JobTask
from sfr_loc_map.suite.jobs.sources import Recording
from sfr_loc_map.suite.planning.plan import Plan, PlanFile, SuiteRun
from sfr_loc_map.suite.planning.specification import Refusal
from sfr_loc_map.suite.statistics.scored_job import ScoredJob
from sfr_loc_map.suite.store import Store

SFR = (sys.executable, "-m", "sfr_loc_map")
MEASURED = ("timing", "memory")
SMALL_DRIVE = {
    "terrain.coarseness": 16, "rocks.cover": 0.01, "rocks.smallest_m": 0.3, "panorama.enabled": False,
    "drive.pairs": 8, "drive.segments": ["straight 1.4"], "sensor.samples": 1,
    "loc.width": 160, "loc.height": 160, "loc.focal_px": 130,
}  # fmt: skip
"""Settings of a simulated drive of 8 pairs that is rendered in less than a second."""


def recording(name: str = "a", sha256: str = "0", path: str = "a.mcap", state: str = "") -> Recording:
    """Return a recording with its own drive."""
    return Recording(name=name, path=path, sha256=sha256, drive=sha256, state=state)


JOB = Job(
    task=JobTask.LOCALISE,
    source=recording(),
    fault_seed=0,
    configuration="default",
    start="truth",
    scoring=TrajectoryScoreConfig(),
    repeat=0,
    threads=1,
    code="c",
)


def scored_job(drive: str, score: Score, sha256: str = "") -> ScoredJob:
    """Return a result of a drive; copies of a drive differ in the hash of their source."""
    source = Recording(name=drive, path=f"{drive}.mcap", sha256=sha256 or drive, drive=drive, state="")
    return ScoredJob(replace(JOB, source=source), score)


def save_jobs(
    store: Store,
    jobs: Sequence[Job],
    refusals: Sequence[Refusal] = (),
    limits: Mapping[str, object] = {},
    files: Sequence[Path] = (),
) -> None:
    """Save a plan with these jobs in the folder of a suite."""
    plan = Plan(
        jobs=tuple(jobs),
        refusals=tuple(refusals),
        stated_limits=limits,
        files=tuple(PlanFile.of(path) for path in files),
        run=SuiteRun.now(),
    )
    store.save_plan(plan)


def results(folder: Path) -> dict[str, object]:
    """Return the scores of a suite without times, memory and other values that differ from run to run."""
    scores = {}
    for path in sorted((folder / "results").glob("*.json")):
        score = json.loads(path.read_text())
        score["figures"] = [item for item in score["figures"] if item["subject"] not in MEASURED]
        del score["content_sha256"]
        score["provenance"].pop("time")
        score["provenance"]["host"].pop("load", None)
        scores[path.stem] = score
    return scores


def stamps_of(folder: Path) -> dict[Path, int]:
    """Return the time of the last change of each result of a suite, ns."""
    return {path: path.stat().st_mtime_ns for path in (folder / "results").iterdir()}


def straight(count: int, sigma_m: float, seed: int, step_m: float = 0.1) -> Trajectory:
    """Return a straight drive with noise on each step and on the heading, rad of the same number."""
    rng = np.random.default_rng(seed)
    noise = np.cumsum(rng.normal(0.0, sigma_m, (count, 3)), axis=0)
    places = np.column_stack((step_m * np.arange(count), np.zeros((count, 2)))) + noise
    headings = np.cumsum(rng.normal(0.0, sigma_m, count))
    return Trajectory.from_poses(
        (100_000_000 * (number + 1), Transform.from_quat(place, [0.0, 0.0, np.sin(0.5 * turn), np.cos(0.5 * turn)]))
        for number, (place, turn) in enumerate(zip(places, headings, strict=True))
    )


def made_suite(folder: Path, drives: int, sigma_m: float = 0.0001, *, poses: int = 60, **more: object) -> Path:
    """Write estimates, the truth of each, and the file of a suite that scores them.

    The truths differ in speed and place: estimates of one truth, or of copies of it, are one drive.
    """
    folder.mkdir(parents=True, exist_ok=True)
    sources = []
    for number in range(drives):
        place = np.array([0.0, 10.0 * number, 0.0])
        step_m = 0.1 + 0.001 * number
        for name, sigma, seed in ((f"truth{number}.csv", 0.0, 0), (f"drive{number}.csv", sigma_m, number + 1)):
            drive = straight(poses, sigma, seed, step_m)
            save_trajectory(folder / name, Trajectory(drive.stamps_ns, drive.positions + place, drive.quats_xyzw))
        sources.append({"estimate": f"drive{number}.csv", "truth": f"truth{number}.csv"})
    suite = folder / "suite.yaml"
    suite.write_text(yaml.safe_dump({"sources": sources, "conditions": ["distance=1"], "spacing": 5, **more}))
    return suite
