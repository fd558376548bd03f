"""Localisers side by side."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sfr_loc_map.bench.figures import SCHEMA, Figures, compared, cost_figures, growths, median, provenance
from sfr_loc_map.bench.peers import OURS, Peers
from sfr_loc_map.bench.rounds import Pass, Progress, Run, one_pass
from sfr_loc_map.bench.scaling import half_pair, half_rig
from sfr_loc_map.constants import NS_PER_S
from sfr_loc_map.errors import BenchError
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.sequence import LocSequence
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.metrics.association import Estimates
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.trajectory_score import score_trajectory
from sfr_loc_map.pipeline.offline import start_pose

ERRORS = ("position_m", "attitude_deg", "heading_deg")


@dataclass(frozen=True, slots=True)
class LocaliseBenchSettings:
    """What is measured.

    Attributes:
        score: Sub-trajectories.
        repeat: Passes; medians are shown.
        sizes: Number of sizes of the pictures, each half of the one before.
        rate_hz: Pairs a second for peers that work in the background; None: as recorded.
    """

    score: TrajectoryScoreConfig
    repeat: int = 3
    sizes: int = 1
    rate_hz: float | None = None


def bench_localise(
    sequence: LocSequence,
    config: LocalisationConfig,
    peers: Peers,
    settings: LocaliseBenchSettings,
    progress: Progress = lambda name: None,
) -> Figures:
    """Return the figures of all localisers on one drive.

    Args:
        sequence: The drive, with the truth if accuracy is wanted.
        config: Parameters of ours.
        peers: Contestants.
        settings: What is measured.
        progress: Told the name of a peer after each of its calls.

    Raises:
        BenchError: If ours does not run.
    """
    facts = provenance()
    sizes = [_one_size(sequence, halvings, config, peers, settings, progress) for halvings in range(settings.sizes)]
    return {
        "schema": SCHEMA,
        "kind": "localise",
        "pairs": len(sequence),
        "conditions": list(settings.score.conditions),
        "repeat": settings.repeat,
        "sizes": sizes,
        "growth": growths(sizes),
        "missing": dict(peers.missing),
        "provenance": facts,
    }


def _one_size(
    sequence: LocSequence,
    halvings: int,
    config: LocalisationConfig,
    peers: Peers,
    settings: LocaliseBenchSettings,
    progress: Progress,
) -> Figures:
    rig = sequence.rig
    for _ in range(halvings):
        rig = half_rig(rig)
    recorded_hz = _rate_hz(sequence)
    rate_hz = settings.rate_hz or recorded_hz
    setup = {"config": asdict(config), "rate_hz": rate_hz}
    runs: dict[str, list[Run]] = {}
    failed: dict[str, str] = {}
    for _ in range(settings.repeat):
        going = [peer for peer in peers.present if peer.name not in failed]
        done = one_pass(
            going,
            rig,
            lambda: _pairs(sequence, halvings),
            setup,
            _keep,
            rate_scale=rate_hz / recorded_hz,
            progress=progress,
        )
        _collect(done, runs, failed)
    entries = {name: _entry(mine, sequence, settings.score) for name, mine in runs.items()}
    return {
        "width": rig.width,
        "height": rig.height,
        "entries": entries,
        "ratios": compared(entries, OURS, ("accuracy", "time_s", "memory_bytes")),
        "failed": failed,
    }


def _collect(done: Pass, runs: dict[str, list[Run]], failed: dict[str, str]) -> None:
    failed |= done.failed
    if OURS in failed:
        raise BenchError(failed[OURS])
    for name, run in done.runs.items():
        runs.setdefault(name, []).append(run)


def _keep(run: Run, report: Mapping[str, Any], output: Path) -> list[float] | None:
    pose: list[float] | None = report["pose"]
    return pose


def _pairs(sequence: LocSequence, halvings: int) -> Iterator[StereoPair]:
    for pair in sequence.pairs():
        for _ in range(halvings):
            pair = half_pair(pair)
        yield pair


def _stamps(sequence: LocSequence) -> list[int]:
    return [pair.stamp_ns for pair in sequence.pairs()]


def _rate_hz(sequence: LocSequence) -> float:
    steps = np.diff(_stamps(sequence))
    return NS_PER_S / float(np.median(steps)) if len(steps) and np.median(steps) > 0 else 10.0


def _entry(runs: Sequence[Run], sequence: LocSequence, config: TrajectoryScoreConfig) -> Figures:
    stamps = _stamps(sequence)
    each = []
    for run in runs:
        lost = np.array([pose is None for pose in run.results], np.bool_)
        figures: Figures = {"lost": int(lost.sum())}
        if sequence.ground_truth is not None:
            figures["accuracy"] = accuracy(run.results, stamps, sequence, config)
        each.append(figures | cost_figures(run.seconds, run.peaks, run.idle_bytes))
    return {"version": runs[0].version, **median(each), "runs": each}


def accuracy(
    poses: Sequence[list[float] | None], stamps_ns: Sequence[int], sequence: LocSequence, config: TrajectoryScoreConfig
) -> Figures:
    """Return mean + 3 sigma of each kind of error by condition.

    A pair without a pose has the last one known, as the suite's own localiser says it.

    Args:
        poses: Pose of the left camera in its first one, 16 numbers row by row, or None, for each pair.
        stamps_ns: Stamps of the pairs.
        sequence: The drive with its truth.
        config: Sub-trajectories.
    """
    truth = sequence.ground_truth
    assert truth is not None
    T_rb_left = _rig_with_place(sequence.rig).T_rb_left
    T_ds_first, T_left_rb = start_pose(sequence, "truth") @ T_rb_left, T_rb_left.inverse()
    last = T_ds_first @ T_left_rb
    stamped = []
    for stamp_ns, pose in zip(stamps_ns, poses, strict=True):
        if pose is not None:
            matrix = np.reshape(pose, (4, 4))
            last = T_ds_first @ Transform(matrix[:3, :3], matrix[:3, 3]) @ T_left_rb
        stamped.append((stamp_ns, last))
    lost = np.array([pose is None for pose in poses], np.bool_)
    score = score_trajectory(Estimates.of(Trajectory.from_poses(stamped), lost), truth, config)["trajectory"]
    parts = score.get("conditions", [score])
    return {
        text: {"count": part["count"], **{name: part[name]["mean_plus_3sigma"] for name in ERRORS}}
        for text, part in zip(config.conditions, parts, strict=True)
    }


def _rig_with_place(rig: StereoRig) -> StereoRig:
    """Return the rig; where its place on the rover is not known, that of the stereo bench stands for the rover."""
    return rig if rig.T_rb_sb is not None else replace(rig, T_rb_sb=Transform.identity())
