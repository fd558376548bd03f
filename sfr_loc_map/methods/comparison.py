"""Methods beside each other on the same pairs, in the same run: accuracy, time and memory of each, as JSON.

Methods that are idle between calls are interleaved: each pair is processed by one after the other, and the first one
changes from pair to pair, so that other load on the machine affects all alike. Methods that work in the background
follow, each alone, at the rate of the stamps.
"""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from sfr_loc_map import __version__
from sfr_loc_map.errors import BenchError, MethodError
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import NS_PER_S, Task
from sfr_loc_map.io.sequence import LocSequence, NavSequence
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import TrackingState
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.disparity.semi_global_matching import search_range
from sfr_loc_map.methods.isolated_method import IsolatedMethod
from sfr_loc_map.methods.method_process import MethodCall
from sfr_loc_map.methods.registry import BUILT_IN, PEERS, Method, MethodLimits, find_method, find_peer
from sfr_loc_map.metrics.association import Estimates
from sfr_loc_map.metrics.cloud_error import PairTruth, score_map
from sfr_loc_map.metrics.config import MapScoreConfig, TrajectoryScoreConfig
from sfr_loc_map.metrics.trajectory_score import score_trajectory

SCHEMA = "sfr-bench/1"
OURS = "ours"  #: Name of our method in tables.
CLOCK = "host monotonic"
MEMORY = (
    "kernel high-water mark of the process' resident memory (VmHWM), set back before each call; largest of all calls"
)
LIMITS = MethodLimits(call_timeout_s=900.0, memory_mb=16_000, restarts=0)
"""Of a method in a comparison; some dense matchers take minutes."""
COMPARED = ("accuracy", "time_s", "memory_bytes")
"""Parts of an entry of which the ratios of ours to the others are told."""
Figures = dict[str, Any]  #: Figures of a pass, or their medians, as they are written to a file.
P = TypeVar("P", StereoPair, PosedStereoPair)
R = TypeVar("R")


@dataclass(slots=True, eq=False)
class MethodRun(Generic[R]):
    """Calls of one method in one pass: time, peak memory and result of each, and what it did wrong and went on."""

    version: str
    idle_bytes: int | None
    seconds: list[float] = field(default_factory=list)
    peaks: list[int | None] = field(default_factory=list)
    results: list[R] = field(default_factory=list)
    findings: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True, eq=False)
class PassInput(Generic[P, R]):
    """Input of all methods, and how they are called."""

    items: Callable[[], Iterable[P]]  #: Yields the pairs from the start at each call.
    open: Callable[[Method], IsolatedMethod]  #: Starts a method.
    #: Gives it a pair, with its number and the seconds since the first; returns its result and what it did.
    call: Callable[[IsolatedMethod, P, int, float], tuple[R, MethodCall]]
    rate_scale: float = 1.0  #: Factor on the rate of the recording, for methods that work in the background.


def methods_to_compare(
    task: Task, peer_python: Path | None = None, vocabulary: Path | None = None, added: Sequence[str] = ()
) -> tuple[list[Method], dict[str, str]]:
    """Return the methods of a comparison, ours first, and why others cannot be run, by name.

    Args:
        task: Localisers or mappers.
        peer_python: Interpreter that may have the peers.
        vocabulary: Text file with ORB-SLAM3's vocabulary.
        added: More methods, as `--method` names them.

    Raises:
        MethodError: If an interpreter or an added method is none.
    """
    ours, *others = BUILT_IN[task].values()
    present, missing = [replace(ours, name=OURS), *others], {}
    for name, peer in PEERS[task].items():
        found, reason = find_peer(peer, peer_python, {} if vocabulary is None else {"vocabulary": vocabulary})
        if found is None:
            missing[name] = reason
        else:
            present.append(found)
    return [*present, *(find_method(spec, task) for spec in added)], missing


def compare_localisers(
    sequence: LocSequence,
    T_ds_rb: Transform,
    methods: Sequence[Method],
    config: LocalisationConfig,
    scoring: TrajectoryScoreConfig,
    *,
    repeat: int = 3,
    rate_hz: float | None = None,
    progress: Callable[[], None] = lambda: None,
) -> Figures:
    """Return the figures of localisers on one drive.

    Args:
        sequence: The drive, with ground truth if accuracy is wanted.
        T_ds_rb: Pose of RB in DS at the first pair.
        methods: The localisers, ours first.
        config: Parameters of ours.
        scoring: Sub-trajectories.
        repeat: Passes; medians are shown.
        rate_hz: Pairs per second for methods that work in the background; None: as recorded.
        progress: Called after each call.

    Raises:
        BenchError: If ours does not run.
    """
    head = _head("localise", len(sequence), repeat) | {"conditions": list(scoring.conditions)}
    stamps_ns = [pair.stamp_ns for pair in sequence.pairs()]
    steps_ns = np.diff(stamps_ns)
    usual_ns = float(np.median(steps_ns)) if len(steps_ns) else 0.0
    recorded_hz = NS_PER_S / usual_ns if usual_ns > 0.0 else 10.0
    rate_hz = rate_hz or recorded_hz
    # the rover frame in the left camera: all methods estimate the same pose
    rig = replace(sequence.rig, T_rb_sb=sequence.rig.T_sb_left.inverse())

    def call(
        localiser: IsolatedMethod, pair: StereoPair, _: int, since_start_s: float
    ) -> tuple[Transform | None, MethodCall]:
        estimate, done = localiser.localise(pair, {"since_start_s": since_start_s})
        return None if estimate.state is TrackingState.LOST else estimate.T_ds_rb, done

    def figures(run: MethodRun[Transform | None]) -> Figures:
        found: Figures = {"lost": sum(pose is None for pose in run.results)}
        if sequence.ground_truth is not None:
            found["accuracy"] = trajectory_errors(run.results, stamps_ns, sequence, T_ds_rb, scoring)
        return found | _costs(run)

    given = PassInput(
        sequence.pairs,
        lambda method: IsolatedMethod(method, rig, Transform.identity(), LIMITS, {"rate_hz": rate_hz}),
        call,
        rate_hz / recorded_hz,
    )
    ours, *others = methods
    mine = replace(ours, config=json.dumps(asdict(config)))
    return head | _compared([mine, *others], given, figures, repeat, progress)


def trajectory_errors(
    poses: Sequence[Transform | None],
    stamps_ns: Sequence[int],
    sequence: LocSequence,
    T_ds_rb: Transform,
    scoring: TrajectoryScoreConfig,
) -> dict[str, Figures]:
    """Return number of sub-trajectories and mean + 3 sigma of each error (m, deg), by condition.

    Args:
        poses: Pose of the left camera in its first one for each pair; where None, the last known one counts.
        stamps_ns: Stamps of the pairs.
        sequence: The drive with its ground truth.
        T_ds_rb: Pose of RB in DS at the first pair.
        scoring: Sub-trajectories.
    """
    truth, rig = sequence.ground_truth, sequence.rig
    assert truth is not None
    if rig.T_rb_sb is None:  # the stereo rig's own frame stands for the rover's
        rig = replace(rig, T_rb_sb=Transform.identity())
    T_ds_first, T_left_rb = T_ds_rb @ rig.T_rb_left, rig.T_rb_left.inverse()
    last = T_ds_first @ T_left_rb
    stamped = []
    for stamp_ns, pose in zip(stamps_ns, poses, strict=True):
        if pose is not None:
            last = T_ds_first @ pose @ T_left_rb
        stamped.append((stamp_ns, last))
    lost = np.array([pose is None for pose in poses], np.bool_)
    score = score_trajectory(Estimates.of(Trajectory.from_poses(stamped), lost), truth, scoring).score
    return {
        text: {
            "count": part.count,
            "position_m": part.position_m.mean_plus_3sigma,
            "attitude_deg": part.attitude_deg.mean_plus_3sigma,
            "heading_deg": part.heading_deg.mean_plus_3sigma,
        }
        for text, part in zip(scoring.conditions, score.conditions, strict=True)
    }


def compare_mappers(
    sequence: NavSequence,
    methods: Sequence[Method],
    config: MappingConfig,
    *,
    repeat: int = 3,
    progress: Callable[[], None] = lambda: None,
) -> Figures:
    """Return the figures of mappers on the pairs of a source, as maps of single pairs.

    Args:
        sequence: Pairs, with ground truth if accuracy is wanted.
        methods: The mappers, ours first.
        config: Parameters of ours; all search the same disparities.
        repeat: Passes; medians are shown.
        progress: Called after each call.

    Raises:
        BenchError: If ours does not run.
    """
    rig, items = sequence.rig, list(sequence.pairs())
    count = search_range(rig, config).count
    head = _head("map", len(items), repeat) | {"disparities": count}
    truths = [truth for item in items if (truth := PairTruth.of(item, rig)) is not None]

    def call(mapper: IsolatedMethod, item: PosedStereoPair, number: int, _: float) -> tuple[PointCloud, MethodCall]:
        done, costs = mapper.map_pair(item.pair, item.T_lm_navsb, number)
        return done.cloud, costs

    def figures(run: MethodRun[PointCloud]) -> Figures:
        found: Figures = {"points": float(np.mean([len(cloud) for cloud in run.results]))}
        if len(truths) == len(items):
            cloud = replace(PointCloud.concatenate(run.results), fused=False)
            score = score_map(cloud, truths, MapScoreConfig()).score
            found["accuracy"] = {"coverage": score.coverage}
            if score.errors is not None:
                error = score.errors.point_error_m
                found["accuracy"] |= {"mean": error.mean, "mean_plus_3sigma": error.mean_plus_3sigma}
                found["accuracy"]["by_range_m"] = {
                    f"{row.from_m:g}-{row.to_m:g} m": {
                        "count": row.point_error_m.count,
                        "mean": row.point_error_m.mean,
                        "mean_plus_3sigma": row.point_error_m.mean_plus_3sigma,
                    }
                    for row in score.errors.by_range
                }
        return found | _costs(run)

    given = PassInput(
        sequence.pairs, lambda method: IsolatedMethod(method, rig, limits=LIMITS, setup={"disparities": count}), call
    )
    ours, *others = methods
    return head | _compared(
        [replace(ours, config=json.dumps(asdict(config))), *others], given, figures, repeat, progress
    )


def run_pass(
    methods: Sequence[Method], given: PassInput[P, R], progress: Callable[[], None] = lambda: None
) -> tuple[dict[str, MethodRun[R]], dict[str, str]]:
    """Process all pairs with all methods; return the runs of those that completed it, and why others did not."""
    runs, failed = _run_group([method for method in methods if not method.background], given, None, progress)
    for method in methods:
        if method.background:
            alone, reasons = _run_group([method], given, given.rate_scale, progress)
            runs |= alone
            failed |= reasons
    return runs, failed


def _run_group(
    methods: Sequence[Method], given: PassInput[P, R], rate_scale: float | None, progress: Callable[[], None]
) -> tuple[dict[str, MethodRun[R]], dict[str, str]]:
    """Process all pairs, at the scaled rate of their stamps if there is one."""
    runs: dict[str, MethodRun[R]] = {}
    failed: dict[str, str] = {}
    with ExitStack() as stack:
        active: list[tuple[str, IsolatedMethod]] = []
        for method in methods:
            try:
                opened = given.open(method)
            except MethodError as error:
                failed[method.name] = str(error)
                continue
            stack.callback(opened.close)
            active.append((method.name, opened))
            runs[method.name] = MethodRun(opened.record.version or "", opened.idle_bytes)
        begin_s, first_ns = time.monotonic(), None
        for number, item in enumerate(given.items()):
            stamp_ns = item.stamp_ns if isinstance(item, StereoPair) else item.pair.stamp_ns
            first_ns = stamp_ns if first_ns is None else first_ns
            since_start_s = (stamp_ns - first_ns) / NS_PER_S / (rate_scale or 1.0)
            if rate_scale is not None:
                time.sleep(max(0.0, begin_s + since_start_s - time.monotonic()))
            turn: int = number % max(1, len(active))
            for name, opened in [*active[turn:], *active[:turn]]:
                result, call = given.call(opened, item, number, since_start_s)
                if not opened.alive:
                    failed[name] = f"method {name}: {call.finding}"
                    del runs[name]
                    active.remove((name, opened))
                    continue
                run = runs[name]
                run.seconds.append(call.usage.processing_time_s)
                run.peaks.append(call.usage.peak_rss_bytes)
                run.results.append(result)
                if call.finding:
                    run.findings.append(call.finding)
                progress()
    return runs, failed


def _compared(
    methods: Sequence[Method],
    given: PassInput[P, R],
    figures: Callable[[MethodRun[R]], Figures],
    repeat: int,
    progress: Callable[[], None],
) -> Figures:
    """Repeat a pass; a method that has failed is left out of the later ones."""
    runs: dict[str, list[MethodRun[R]]] = {}
    failed: dict[str, str] = {}
    for _ in range(repeat):
        done, reasons = run_pass([method for method in methods if method.name not in failed], given, progress)
        failed |= reasons
        if OURS in failed:
            raise BenchError(failed[OURS])
        for name, run in done.items():
            runs.setdefault(name, []).append(run)
    complete = {name: mine for name, mine in runs.items() if name not in failed}
    entries = {}
    for name, mine in complete.items():
        each = [figures(run) for run in mine]
        entries[name] = {"version": mine[0].version, **medians(each), "runs": each}
    ours = {part: entries[OURS].get(part, {}) for part in COMPARED}
    found = {
        name: list(dict.fromkeys(text for run in mine for text in run.findings)) for name, mine in complete.items()
    }
    return {
        "entries": entries,
        "ratios": {name: ratios(ours, entry) for name, entry in entries.items() if name != OURS},
        "failed": failed,
        "findings": {name: texts for name, texts in found.items() if texts},
    }


def _head(kind: str, pairs: int, repeat: int) -> Figures:
    host = {
        "machine": platform.machine(),
        "system": platform.system(),
        "python": platform.python_version(),
        "cores": os.cpu_count(),
        "load_at_start": os.getloadavg()[0],
    }
    provenance = {"version": __version__, "clock": CLOCK, "memory_method": MEMORY, "host": host}
    provenance["time"] = datetime.now(UTC).isoformat(timespec="seconds")
    return {"schema": SCHEMA, "kind": kind, "pairs": pairs, "repeat": repeat, "provenance": provenance}


def _costs(run: MethodRun[Any]) -> Figures:
    """Return time (s) and memory of the calls of a run; None where there are none, or memory cannot be measured."""
    known = [peak for peak in run.peaks if peak is not None]
    times: Figures = dict.fromkeys(("p50", "p95", "max", "first"))
    if run.seconds:
        p50, p95 = np.percentile(run.seconds, (50.0, 95.0)).tolist()
        times = {"p50": p50, "p95": p95, "max": max(run.seconds), "first": run.seconds[0]}
    memory = {"peak": max(known, default=None), "idle": run.idle_bytes}
    return {"time_s": times, "memory_bytes": memory, "calls": len(run.seconds)}


def medians(runs: Sequence[Mapping[str, Any]]) -> Figures:
    """Return the median of each number of nested figures over the runs that have it."""
    found: Figures = {}
    for name in dict.fromkeys(name for run in runs for name in run):
        known = [value for run in runs if (value := run.get(name)) is not None]
        if known and isinstance(known[0], Mapping):
            found[name] = medians(known)
        else:
            found[name] = float(np.median(known)) if known else None
    return found


def ratios(ours: Mapping[str, Any], other: Mapping[str, Any]) -> Figures:
    """Return the magnitude of ours over the other's for each number that both have; None where the other's is 0."""
    found: Figures = {}
    for name in ours:
        a, b = ours[name], other.get(name)
        if isinstance(a, Mapping) and isinstance(b, Mapping):
            found[name] = ratios(a, b)
        elif isinstance(a, (int, float)) and isinstance(b, (int, float)):
            found[name] = abs(a / b) if b else None
    return found
