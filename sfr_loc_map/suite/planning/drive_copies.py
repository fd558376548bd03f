"""Detection of sources that are copies or parts of one drive although their files differ.

The errors of such sources are correlated. If they counted as independent drives, a proof over many drives could pass
because of one drive.

Copies: Two sources are candidates if their paths agree, or if a large fraction of the steps is common. Steps depend
neither on the frame nor on the first pose nor on the stamps. The paths are also compared because rounding changes the
steps, but hardly the path, and because a short drive has too few steps. If the paths of two candidates agree, or if
their first windows of steps agree, their first left images must agree as well. Steps at constant speed and curvature
are equal in different drives and are therefore no evidence of a copy. The same applies to the paths of two stationary
rovers, which are copies only if their images or their simulated terrains agree.

Parts of one recording: the ground truth of the later part begins when and where that of the earlier part ends.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace as struct_replace
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from sfr_loc_map.configuration.parameters import build
from sfr_loc_map.errors import SfrError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.trajectory import Trajectory, Truth
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.metrics.frames.motion import MOVING_SHARE
from sfr_loc_map.scoring.inputs import ScoreInputs
from sfr_loc_map.scoring.load import load_run
from sfr_loc_map.simulation.config import SimulationConfig
from sfr_loc_map.suite.jobs.sources import PlannedSource, Simulation

PLACES = 100  #: Largest number of compared poses, and of compared windows of steps, evenly distributed over a drive.
PIXELS = 8  #: Number of compared rows and columns of the first left image.
SAME_M = 0.01
"""Largest distance, m, between two copies of a path at each pose. A rover that repeats its path deviates by more,
because its start and its speed differ."""
SAME_GREY = 8
"""Largest difference, grey levels, between two copies of an image. Images of other terrain differ by more."""
WINDOW = 4  #: Number of successive steps that are compared together.
SAME_STEP = 0.001
"""Largest difference between two copies of a step, as a fraction of a long step. Steps of two drives at equal speed
differ by more, because slip and the noise of the ground truth differ."""
COMMON_SHARE = 0.5
"""Minimum fraction of the windows of the shorter drive that must agree for two sources to count as one drive."""
LONG_STEP = 0.9  #: Quantile of the step lengths that is the length of a long step.
MAX_STEPS = 20_000  #: Largest number of compared steps, which bounds memory and time.
MAX_BREAK_S = 10.0
"""Longest gap or overlap between two parts of one recording, s. Independent drives need a longer preparation."""
SPEED_MARGIN = 2.0  #: Largest speed at a gap, as a multiple of the speed of a long step.


class PartEnds(NamedTuple):
    """Where and when the ground truth of a source begins and ends."""

    start_ns: int
    end_ns: int
    start_m: tuple[float, ...]  #: x, y, z in the frame of the ground truth.
    end_m: tuple[float, ...]  #: x, y, z in the frame of the ground truth.
    period_s: float  #: Median time between two poses.
    long_step_m: float  #: Length of a long step.

    @classmethod
    def of(cls, truth: Trajectory, steps_m: FloatArray) -> PartEnds | None:
        """Return the ends of a ground truth; None with fewer than two poses or without a period."""
        if len(truth) < 2:
            return None
        period_s = float(np.median(np.diff(truth.stamps_ns))) / NS_PER_S
        if period_s <= 0.0:
            return None
        return cls(
            int(truth.stamps_ns[0]),
            int(truth.stamps_ns[-1]),
            _rounded(truth.positions[0], 6),
            _rounded(truth.positions[-1], 6),
            period_s,
            float(np.quantile(steps_m, LONG_STEP)),
        )

    def is_continued_by(self, later: PartEnds) -> bool:
        """Return whether a later part begins when this one ends, at most as far away as the rover can drive meanwhile.

        A part that begins in the first half of this one does not continue it, because recordings whose stamps begin at
        0, and simulated drives, begin at the same time and place.
        """
        break_s = abs(later.start_ns - self.end_ns) / NS_PER_S
        begins_late = 2 * later.start_ns > self.start_ns + self.end_ns and later.end_ns > self.end_ns
        if not begins_late or break_s > MAX_BREAK_S + self.period_s:
            return False
        speed_m_s = max(self.long_step_m / self.period_s, later.long_step_m / later.period_s)
        reach_m = SPEED_MARGIN * speed_m_s * break_s + SAME_M
        return float(np.linalg.norm(np.subtract(later.start_m, self.end_m))) <= reach_m


@dataclass(frozen=True, slots=True)
class DriveTrace:
    """Features by which copies of one drive are detected."""

    poses: int = 0  #: Number of poses of the ground truth; 0 if there is none.
    path_m: tuple[float, ...] = ()  #: x, y, z of poses of the truth, in axes of the first pose if it has an attitude.
    grey: tuple[int, ...] = ()  #: Pixels of the first left image; empty without images.
    steps_m: tuple[float, ...] = ()  #: Distances between successive poses of the ground truth.
    bends_m: tuple[float, ...] = ()  #: Norms of the differences between successive steps.
    terrain: int | None = None  #: Seed of a simulated terrain; None for other sources.
    ends: PartEnds | None = None  #: Where and when the ground truth begins and ends; None with fewer than two poses.

    @property
    def has_evidence(self) -> bool:
        """Whether few drives share the features: an image, a terrain, or a path along which the rover moves."""
        has_place = bool(self.grey) or self.terrain is not None
        return has_place or bool((np.linalg.norm(np.reshape(self.path_m, (-1, 3)), axis=1) > SAME_M).any())


class StepWindows(NamedTuple):
    """The windows of `WINDOW` successive steps of a drive in which the rover moves in each step."""

    features: FloatArray  #: Lengths and bends of the steps `(W, 2 * WINDOW - 1)`, m.
    has_evidence: NDArray[np.bool_]  #: Whether the lengths or the bends of a window vary, so that few drives share it.
    tolerance_m: float  #: Largest difference between two copies of a feature.

    @classmethod
    def of(cls, trace: DriveTrace) -> StepWindows:
        """Return the windows of a trace."""
        if len(trace.steps_m) < WINDOW:
            return cls(np.zeros((0, 2 * WINDOW - 1)), np.zeros(0, np.bool_), 0.0)
        lengths = sliding_window_view(np.array(trace.steps_m), WINDOW)
        bends = sliding_window_view(np.array(trace.bends_m), WINDOW - 1)
        long_step_m = float(np.quantile(trace.steps_m, LONG_STEP))
        is_moving = (lengths > MOVING_SHARE * long_step_m).all(axis=1)
        tolerance_m = SAME_STEP * long_step_m
        varies = (np.ptp(lengths, axis=1) > tolerance_m) | (np.ptp(bends, axis=1) > tolerance_m)
        return cls(np.hstack((lengths, bends))[is_moving], varies[is_moving], tolerance_m)

    @property
    def compared(self) -> NDArray[np.intp]:
        """Indices of the windows that are searched in other drives."""
        return np.linspace(0, len(self.features) - 1, min(len(self.features), PLACES), dtype=np.intp)

    @property
    def distinct(self) -> FloatArray:
        """The windows with evidence. Of several windows that agree within half of the tolerance, one is kept."""
        windows = self.features[self.has_evidence]
        if not len(windows):
            return windows
        _, kept = np.unique(np.floor(windows / (0.5 * self.tolerance_m)), axis=0, return_index=True)
        return np.asarray(windows[kept])

    def starts_like(self, other: StepWindows) -> bool:
        """Return whether both drives start to move with the same steps."""
        if not len(self.features) or not len(other.features):
            return False
        return bool((np.abs(self.features[0] - other.features[0]) <= self.tolerance_m).all())


def drives_of(traces: Sequence[DriveTrace]) -> NDArray[np.intp]:
    """Return the number of the drive of each trace.

    Copies, copies of copies, and parts of one recording have the same number.
    """
    drives = np.arange(len(traces))
    for first, second in chain(_copies(traces), _continuations(traces)):
        drives[drives == drives[second]] = drives[first]
    return drives


def _copies(traces: Sequence[DriveTrace]) -> Iterator[tuple[int, int]]:
    """Yield the pairs of traces that are of one drive; traces without ground truth are in no pair."""
    windows = [StepWindows.of(trace) for trace in traces]

    def are_comparable(first: int, second: int) -> bool:
        one, other = traces[first], traces[second]
        return len(one.grey) == len(other.grey) and one.terrain == other.terrain

    def have_same_image(first: int, second: int) -> bool:
        return bool((np.abs(np.subtract(traces[first].grey, traces[second].grey)) <= SAME_GREY).all())

    for pair in _pairs_with_same_path(traces):
        if are_comparable(*pair) and have_same_image(*pair):
            yield pair
    for first, second in _pairs_with_common_steps(windows):
        if not are_comparable(first, second):
            continue
        if not windows[first].starts_like(windows[second]) or have_same_image(first, second):
            yield first, second


def _continuations(traces: Sequence[DriveTrace]) -> Iterator[tuple[int, int]]:
    """Yield the pairs of traces of which the second one continues the first one."""
    parts = [(number, trace.ends) for number, trace in enumerate(traces) if trace.ends is not None]
    parts.sort(key=lambda part: part[1].start_ns)
    starts_ns = [ends.start_ns for _, ends in parts]
    for number, ends in parts:
        longest_ns = int((MAX_BREAK_S + ends.period_s) * NS_PER_S)
        begin = bisect_left(starts_ns, ends.end_ns - longest_ns)
        end = bisect_right(starts_ns, ends.end_ns + longest_ns)
        for later, later_ends in parts[begin:end]:
            if later != number and ends.is_continued_by(later_ends):
                yield number, later


def _pairs_with_same_path(traces: Sequence[DriveTrace]) -> Iterator[tuple[int, int]]:
    by_count: dict[int, list[int]] = {}
    for number, trace in enumerate(traces):
        if trace.poses and trace.has_evidence:
            by_count.setdefault(trace.poses, []).append(number)
    for numbers in by_count.values():
        paths = np.array([traces[number].path_m for number in numbers]).reshape(len(numbers), PLACES, 3)
        for row, first in enumerate(numbers):
            apart_m = np.linalg.norm(paths[row + 1 :] - paths[row], axis=2).max(axis=1)
            for later in np.flatnonzero(apart_m <= SAME_M).tolist():
                yield first, numbers[row + 1 + later]


def _pairs_with_common_steps(windows: Sequence[StepWindows]) -> Iterator[tuple[int, int]]:
    """Yield the pairs of drives in which a large fraction of the shorter drive's windows occurs in the other drive.

    All windows are in one search tree, so that the time grows with the number of drives, not with the number of pairs.
    """
    distinct = [item.distinct for item in windows]
    owners = np.repeat(np.arange(len(windows)), [len(item) for item in distinct])
    if not len(owners):
        return
    from scipy.spatial import KDTree  # slow import

    tree = KDTree(np.vstack(distinct))
    for number, item in enumerate(windows):
        compared = item.compared
        searched = compared[item.has_evidence[compared]]
        counts = np.zeros(len(windows), int)
        for found in tree.query_ball_point(item.features[searched], item.tolerance_m, p=np.inf):
            counts[np.unique(owners[found])] += 1
        for other in np.flatnonzero(counts >= COMMON_SHARE * max(len(compared), 1)).tolist():
            if other != number and len(item.features) <= len(windows[other].features):
                yield number, other


def trace_of_source(source: Source) -> DriveTrace:
    """Return the trace of the drive of a source."""
    if source.loc is None or source.loc.ground_truth is None:
        return DriveTrace()
    grey: tuple[int, ...] = ()
    for pair in source.loc.pairs():
        rows, columns = (np.linspace(0, size - 1, PIXELS, dtype=int) for size in pair.left.shape)
        grey = tuple(pair.left[np.ix_(rows, columns)].ravel().tolist())
        break
    return trace_of_truth(source.loc.ground_truth, grey)


def trace_of_estimate(estimate: Path, truth: Path) -> DriveTrace:
    """Return the trace of the ground truth of an estimate; empty if the truth cannot be read or is that of a map."""
    with suppress(SfrError):
        drive = load_run(ScoreInputs.of(estimate, truth)).drive
        if drive is not None:
            return trace_of_truth(drive.truth)
    return DriveTrace()


def trace_of_simulation(source: Simulation) -> DriveTrace:
    """Return the trace of the ground truth of a simulated drive; empty if there is no drive or its path is invalid."""
    from sfr_loc_map.simulation.plan import Plan  # slow import

    config = build(SimulationConfig, source.settings)
    if not config.drive.enabled:
        return DriveTrace()
    with suppress(SfrError):
        return replace(trace_of_truth(Plan.make(config).trajectory()), terrain=config.seed)
    return DriveTrace()


def trace_of_truth(truth: Trajectory, grey: tuple[int, ...] = ()) -> DriveTrace:
    """Return the trace of a ground truth; `grey` are the pixels of the first left image."""
    if not len(truth):
        return DriveTrace()
    chosen = np.linspace(0, len(truth) - 1, PLACES, dtype=int)
    path_m = truth.positions[chosen] - truth.positions[0]
    if not isinstance(truth, Truth) or truth.has_attitude:
        path_m = path_m @ truth.pose(0).rotation  # in the frame of the first pose
    steps = np.diff(truth.positions[: MAX_STEPS + 1], axis=0)
    steps_m = np.linalg.norm(steps, axis=1)
    bends_m = np.linalg.norm(np.diff(steps, axis=0), axis=1)
    ends = PartEnds.of(truth, steps_m)
    return DriveTrace(len(truth), _rounded(path_m, 6), grey, _rounded(steps_m, 9), _rounded(bends_m, 9), ends=ends)


def _rounded(values: FloatArray, digits: int) -> tuple[float, ...]:
    return tuple(np.round(values, digits).ravel().tolist())


def with_drives(sources: Sequence[PlannedSource], traces: Sequence[DriveTrace]) -> list[PlannedSource]:
    """Return the sources with the drives of their copies.

    Copies, copies of copies, and parts of one recording have the drive of the source among them with the smallest hash.
    A simulated drive whose seed occurs only once has no copy, and its ground truth is therefore not computed.
    """
    seeds = Counter(source.seed for source in sources if isinstance(source, Simulation))
    traces = [
        trace_of_simulation(source) if isinstance(source, Simulation) and seeds[source.seed] > 1 else trace
        for source, trace in zip(sources, traces, strict=True)
    ]
    smallest: dict[int, PlannedSource] = {}  # by number of the drive: the source with the smallest hash
    numbers = drives_of(traces).tolist()
    for number, source in zip(numbers, sources, strict=True):
        if number not in smallest or source.sha256 < smallest[number].sha256:
            smallest[number] = source
    return [
        struct_replace(source, drive=smallest[number].drive) for number, source in zip(numbers, sources, strict=True)
    ]
