"""Comparison of several methods on the same pairs: accuracy, time and memory, as JSON.

In each pass, the methods process all pairs one after the other, so that their times can be compared. The jobs of a
suite run concurrently. A method that works in the background between calls receives the pairs at the rate of their
stamps. Figures are medians over the passes.
"""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeAlias, TypeVar

import numpy as np

from sfr_loc_map import __version__
from sfr_loc_map.errors import MethodError
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.host_clock import checked_clock
from sfr_loc_map.inputs import NS_PER_S, Task
from sfr_loc_map.io.sequence import LocSequence, NavSequence
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import TrackingState
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.search_range import search_range_of
from sfr_loc_map.methods.isolated_localiser import IsolatedLocaliser
from sfr_loc_map.methods.isolated_mapper import IsolatedMapper
from sfr_loc_map.methods.method_process import MethodCall
from sfr_loc_map.methods.registry import BUILT_IN, OURS_IN_TABLES, PEERS, Method, MethodLimits, find_method, find_peer
from sfr_loc_map.metrics.association import Estimates
from sfr_loc_map.metrics.call_meter import METHOD
from sfr_loc_map.metrics.cloud_error import PairTruth, score_map
from sfr_loc_map.metrics.config import MapScoreConfig, TrajectoryScoreConfig
from sfr_loc_map.metrics.score import Score
from sfr_loc_map.metrics.trajectory_score import score_trajectory
from sfr_loc_map.signals import hold

SCHEMA = "sfr-bench/1"
CLOCK = "host monotonic"
MEMORY = f"{METHOD}; largest of all calls"
LIMITS = MethodLimits(call_timeout_s=900.0, memory_mb=16_000, restarts=0)
"""Limits of a method in a comparison; some dense matchers take minutes per pair."""
COMPARED = ("accuracy", "time_s", "memory_bytes")
"""Parts of an entry for which ratios of our method to the others are reported."""
Opened = TypeVar("Opened", IsolatedLocaliser, IsolatedMapper)
Figures: TypeAlias = "dict[str, float | Figures | None]"
"""Figures of a pass, or their medians or ratios: numbers by name, or nested groups of numbers; None if unknown."""


@dataclass(slots=True, eq=False)
class PassResult:
    """Calls and results of one method in one pass."""

    version: str
    idle_bytes: int | None
    calls: list[MethodCall] = field(default_factory=list)
    results: list[Any] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Entry:
    """Figures of one method: the medians over the passes, and the figures of each pass."""

    version: str
    medians: Figures
    passes: tuple[Figures, ...]


@dataclass(frozen=True, slots=True)
class Comparison:
    """Figures of several methods on the same pairs."""

    entries: dict[str, Entry]  #: Figures by method name, ours first.
    failed: dict[str, str]  #: Reasons of methods without an entry, by method name.
    findings: dict[str, list[str]]  #: Findings during the calls, by method name.
    interrupted: str = ""  #: Number of finished passes, if the user interrupted the comparison.

    @property
    def ratios(self) -> dict[str, Figures]:
        """Ratios of our method to each other method."""
        ours = self.entries[OURS_IN_TABLES].medians
        others = {name: entry.medians for name, entry in self.entries.items() if name != OURS_IN_TABLES}
        return {name: ratios({part: ours.get(part) for part in COMPARED}, figures) for name, figures in others.items()}

    def content(self) -> dict[str, Any]:
        """Return the content for the JSON file."""
        entries = {
            name: {"version": entry.version, **entry.medians, "runs": list(entry.passes)}
            for name, entry in self.entries.items()
        }
        parts = {"entries": entries, "ratios": self.ratios, "failed": self.failed, "findings": self.findings}
        return parts | ({"interrupted": self.interrupted} if self.interrupted else {})


@dataclass(frozen=True, slots=True, eq=False)
class PassInput(Generic[Opened]):
    """The pairs of a pass, and the functions that start and call a method."""

    items: Callable[[], Iterable[Any]]  #: Yields the pairs from the start; with poses for mappers.
    open: Callable[[Method], Opened]  #: Starts a method.
    #: Passes a pair, its index and its time since the first pair, s, to a method; returns the result and the call.
    call: Callable[[Opened, Any, int, float], tuple[Any, MethodCall]]
    rate_scale: float = 1.0  #: Factor on the rate of the recording, for methods that work in the background.


def methods_to_compare(
    task: Task, peer_python: Path | None = None, vocabulary: Path | None = None, added: Sequence[str] = ()
) -> tuple[list[Method], dict[str, str]]:
    """Return the methods of a comparison, ours first and `added` last, and the reasons of missing peers, by name."""
    ours, *others = BUILT_IN[task].values()
    present, missing = [replace(ours, name=OURS_IN_TABLES), *others], {}
    for name, peer in PEERS[task].items():
        found, reason = find_peer(peer, peer_python, vocabulary)
        if found is None:
            missing[name] = reason
        else:
            present.append(found)
    named = [method.name for method in present]
    others = [find_method(spec, task) for spec in dict.fromkeys(added)]
    return [*present, *(method for method in others if method.name not in named)], missing


def compare_localisers(
    sequence: LocSequence,
    T_ds_rb: Transform,
    methods: Sequence[Method],
    config: LocalisationConfig,
    scoring: TrajectoryScoreConfig,
    *,
    repeat: int = 3,
    rate_hz: float | None = None,
    hidden: Sequence[Path],
    progress: Callable[[], None] = lambda: None,
) -> dict[str, Any]:
    """Compare localisers on a drive; return the JSON content, with our localiser and its parameters first.

    The accuracy is reported if the drive has a ground truth. Methods that work in the background receive the pairs at
    `rate_hz`, or at the recorded rate if None.
    """
    head = _head("localise", len(sequence), repeat) | {"conditions": list(scoring.conditions)}
    stamps_ns = sequence.stamps_ns
    steps_ns = np.diff(stamps_ns)
    usual_ns = float(np.median(steps_ns)) if len(steps_ns) else 0.0
    recorded_hz = NS_PER_S / usual_ns if usual_ns > 0.0 else 10.0
    rate_hz = rate_hz or recorded_hz
    # the rover's frame is the left camera, so that all methods estimate the same pose
    rig = replace(sequence.rig, T_rb_sb=sequence.rig.T_sb_left.inverse())

    def call(
        localiser: IsolatedLocaliser, pair: StereoPair, _: int, since_start_s: float
    ) -> tuple[Transform | None, MethodCall]:
        estimate, done = localiser.localise(pair, since_start_s)
        return None if estimate.state is TrackingState.LOST else estimate.T_ds_rb, done

    given = PassInput(
        sequence.pairs,
        lambda method: IsolatedLocaliser(method, rig, Transform.identity(), LIMITS, rate_hz=rate_hz, hidden=hidden),
        call,
        rate_hz / recorded_hz,
    )
    figures = partial(localiser_figures, sequence=sequence, T_ds_rb=T_ds_rb, scoring=scoring)
    return head | _compared(methods, config, given, figures, repeat, progress).content()


def localiser_figures(
    passed: PassResult, sequence: LocSequence, T_ds_rb: Transform, scoring: TrajectoryScoreConfig
) -> Figures:
    """Return the number of lost frames, and mean + 3 sigma of each error, m and deg, by condition.

    The results are the poses of the left camera relative to its first pose, None for a lost frame. `T_ds_rb` is the
    first pose of the rover.
    """
    lost = np.array([pose is None for pose in passed.results], np.bool_)
    figures: Figures = {"lost": int(lost.sum())}
    if sequence.ground_truth is None:
        return figures
    estimates = Estimates.of(rover_trajectory(passed.results, sequence, T_ds_rb), lost)
    score = Score(figures=score_trajectory(estimates, sequence.ground_truth, scoring).figures)
    figures["accuracy"] = {text: accuracy(score, text, scoring.rebase) for text in scoring.conditions}
    return figures


def rover_trajectory(poses: Sequence[Transform | None], sequence: LocSequence, T_ds_rb: Transform) -> Trajectory:
    """Return the poses of the rover; `poses` are those of the left camera relative to its first pose.

    A lost frame (None) has the last known pose. If the extrinsics are unknown, SB is used as the rover's frame.
    """
    rig = sequence.rig
    T_rb_left = rig.T_sb_left if rig.T_rb_sb is None else rig.T_rb_left
    T_ds_first, T_left_rb = T_ds_rb @ T_rb_left, T_rb_left.inverse()
    stamped, T_first_left = [], Transform.identity()
    for stamp_ns, pose in zip(sequence.stamps_ns, poses, strict=True):
        T_first_left = T_first_left if pose is None else pose
        stamped.append((stamp_ns, T_ds_first @ T_first_left @ T_left_rb))
    return Trajectory.from_poses(stamped)


def accuracy(score: Score, condition: str, reading: str) -> Figures:
    """Return the number of sub-trajectories of a condition, and mean + 3 sigma of each error, m and deg."""
    position = score.figure("position", condition=condition, part=reading)
    return {
        "count": 0 if position is None else position.n,
        "position_m": score.number("position", "mean_plus_3sigma", condition=condition, part=reading),
        "attitude_deg": score.number("attitude", "mean_plus_3sigma", condition=condition, part=reading),
        "heading_deg": score.number("heading", "mean_plus_3sigma", condition=condition, part=reading),
    }


def compare_mappers(
    sequence: NavSequence,
    methods: Sequence[Method],
    config: MappingConfig,
    *,
    repeat: int = 3,
    hidden: Sequence[Path],
    progress: Callable[[], None] = lambda: None,
) -> dict[str, Any]:
    """Compare mappers on the pairs of a source; return the JSON content, with our mapper and its parameters first.

    Each pair is mapped separately. All methods search the same disparity range.
    """
    rig, items = sequence.rig, list(sequence.pairs())
    count = search_range_of(rig, config).count
    head = _head("map", len(items), repeat) | {"disparities": count}
    truths = [PairTruth.of(item, rig) for item in items]

    def call(mapper: IsolatedMapper, item: PosedStereoPair, number: int, _: float) -> tuple[PointCloud, MethodCall]:
        done, costs = mapper.map_pair(item.pair, item.T_lm_navsb, number)
        return done.cloud, costs

    opening = partial(IsolatedMapper, rig=rig, limits=LIMITS, disparities=count, hidden=hidden)
    given = PassInput(sequence.pairs, opening, call)
    figures = partial(mapper_figures, truths=truths)
    return head | _compared(methods, config, given, figures, repeat, progress).content()


def mapper_figures(passed: PassResult, truths: Sequence[PairTruth | None]) -> Figures:
    """Return the mean number of points per pair; with a ground truth for every pair, also coverage and point errors."""
    figures: Figures = {"points": float(np.mean([len(cloud) for cloud in passed.results]))}
    known = [truth for truth in truths if truth is not None]
    if len(known) == len(truths):
        cloud = replace(PointCloud.concatenate(passed.results), fused=False)
        score = Score(figures=score_map(cloud, known, MapScoreConfig()).figures)
        figures["accuracy"] = {
            "coverage": score.number("coverage"),
            "mean": score.number("point_error", "mean"),
            "mean_plus_3sigma": score.number("point_error", "mean_plus_3sigma"),
        }
    return figures


def run_pass(method: Method, given: PassInput[Opened], progress: Callable[[], None] = lambda: None) -> PassResult:
    """Process all pairs with a method; MethodError if the process does not start or has ended."""
    with checked_clock(), given.open(method) as opened:
        passed = PassResult(opened.record.version or "", opened.idle_bytes)
        scale = given.rate_scale if method.background else 1.0
        begin_s, first_ns = time.monotonic(), None
        for number, item in enumerate(given.items()):
            stamp_ns = item.stamp_ns if isinstance(item, StereoPair) else item.pair.stamp_ns
            first_ns = stamp_ns if first_ns is None else first_ns
            since_start_s = (stamp_ns - first_ns) / NS_PER_S / scale
            if method.background:
                time.sleep(max(0.0, begin_s + since_start_s - time.monotonic()))
            result, call = given.call(opened, item, number, since_start_s)
            if not opened.is_alive:
                raise MethodError(f"method {method.name}: {call.finding}")
            passed.calls.append(call)
            passed.results.append(result)
            progress()
    return passed


def _compared(
    methods: Sequence[Method],
    config: LocalisationConfig | MappingConfig,
    given: PassInput[Opened],
    figures: Callable[[PassResult], Figures],
    repeat: int,
    progress: Callable[[], None],
) -> Comparison:
    """Repeat the passes. A failed method is skipped, unless it is ours. An interrupt keeps the finished passes."""
    methods = [replace(methods[0], config=json.dumps(asdict(config))), *methods[1:]]
    passes: dict[str, list[PassResult]] = {}
    failed: dict[str, str] = {}
    interrupted = ""
    for number, method in enumerate(methods * repeat):
        if method.name in failed:
            continue
        try:
            passed = run_pass(method, given, progress)
        except MethodError as error:
            if method.name == OURS_IN_TABLES:
                raise
            failed[method.name] = str(error)
        except KeyboardInterrupt:
            if OURS_IN_TABLES not in passes:
                raise
            interrupted = f"{number} of {len(methods) * repeat} runs"
            break
        else:
            passes.setdefault(method.name, []).append(passed)
    hold()
    entries: dict[str, Entry] = {}
    findings: dict[str, list[str]] = {}
    for name, of_method in passes.items():
        if name in failed:
            continue
        by_pass = tuple(figures(passed) | _costs(passed) for passed in of_method)
        entries[name] = Entry(of_method[0].version, medians(by_pass), by_pass)
        if texts := list(dict.fromkeys(call.finding for passed in of_method for call in passed.calls if call.finding)):
            findings[name] = texts
    return Comparison(entries, failed, findings, interrupted)


def _head(kind: str, pairs: int, repeat: int) -> dict[str, Any]:
    return {"schema": SCHEMA, "kind": kind, "pairs": pairs, "repeat": repeat, "provenance": provenance()}


def provenance() -> dict[str, Any]:
    """Return version, clock, memory method, host and time of a benchmark that begins, as JSON values."""
    host = {
        "machine": platform.machine(),
        "system": platform.system(),
        "python": platform.python_version(),
        "cores": os.cpu_count(),
        "load_at_start": os.getloadavg()[0],
    }
    time_text = datetime.now(UTC).isoformat(timespec="seconds")
    return {"version": __version__, "clock": CLOCK, "memory_method": MEMORY, "host": host, "time": time_text}


def _costs(passed: PassResult) -> Figures:
    seconds = [call.usage.processing_time_s for call in passed.calls]
    peaks = [call.usage.peak_rss_bytes for call in passed.calls if call.usage.peak_rss_bytes is not None]
    times: Figures = dict.fromkeys(("p50", "p95", "max", "first"))
    if seconds:
        p50, p95 = np.percentile(seconds, (50.0, 95.0)).tolist()
        times = {"p50": p50, "p95": p95, "max": max(seconds), "first": seconds[0]}
    memory: Figures = {"peak": max(peaks, default=None), "idle": passed.idle_bytes}
    return {"time_s": times, "memory_bytes": memory, "calls": len(seconds)}


def medians(passes: Sequence[Figures]) -> Figures:
    """Return the median of each number over the passes that have this number."""
    found: Figures = {}
    for name in dict.fromkeys(name for figures in passes for name in figures):
        values = [figures.get(name) for figures in passes]
        groups = [value for value in values if isinstance(value, dict)]
        numbers = [value for value in values if isinstance(value, (int, float))]
        if groups:
            found[name] = medians(groups)
        else:
            found[name] = float(np.median(numbers)) if numbers else None
    return found


def ratios(ours: Figures, other: Figures) -> Figures:
    """Return `abs(ours / other)` for each number that both have; None if the other's number is 0."""
    found: Figures = {}
    for name, a in ours.items():
        b = other.get(name)
        if isinstance(a, dict) and isinstance(b, dict):
            found[name] = ratios(a, b)
        elif isinstance(a, (int, float)) and isinstance(b, (int, float)):
            found[name] = abs(a / b) if b else None
    return found
