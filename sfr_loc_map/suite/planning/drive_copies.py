"""Detection of sources that show one drive although their files differ: copies, and parts of one recording.

The errors of such sources are correlated. If they counted as independent drives, a proof over many drives could pass
because of one drive.

Two sources are copies if their ground truths have the same number of poses and the same path, and if their first left
images agree. The path is compared in the frame of the first pose, so that it depends neither on the frame of the ground
truth nor on the stamps. The paths of two stationary rovers always agree. Stationary rovers are therefore copies only if
their images or their simulated terrains agree.

Two sources are parts of one recording if the ground truth of one begins shortly after the end of the other, as in a bag
that is split into several files.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import numpy as np
from msgspec.structs import replace as struct_replace
from numpy.typing import NDArray

from sfr_loc_map.configuration.parameters import build
from sfr_loc_map.errors import SfrError
from sfr_loc_map.geometry.trajectory import Trajectory, Truth
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.scoring.inputs import ScoreInputs
from sfr_loc_map.scoring.load import load_run
from sfr_loc_map.simulation.config import SimulationConfig
from sfr_loc_map.suite.jobs.sources import PlannedSource, Simulation

PLACES = 100  #: Number of compared poses, evenly distributed over a drive.
PIXELS = 8  #: Number of compared rows and columns of the first left image.
SAME_M = 0.01
"""Largest distance, m, between two copies of a path at each pose. A rover that repeats its path deviates by more,
because its start and its speed differ."""
SAME_GREY = 8
"""Largest difference, grey levels, between two copies of an image. Images of other terrain differ by more."""
MAX_BREAK_NS = 10 * NS_PER_S
"""Longest time, ns, between two parts of one recording. The preparation of an independent drive takes longer."""


@dataclass(frozen=True, slots=True)
class DriveTrace:
    """Features by which copies of one drive are detected."""

    poses: int = 0  #: Number of poses of the ground truth; 0 if there is none.
    path_m: tuple[float, ...] = ()  #: x, y, z of poses of the truth, in axes of the first pose if it has an attitude.
    grey: tuple[int, ...] = ()  #: Pixels of the first left image; empty without images.
    terrain: int | None = None  #: Seed of a simulated terrain; None for other sources.
    start_ns: int = 0  #: Stamp of the first pose.
    end_ns: int = 0  #: Stamp of the last pose.

    @property
    def has_evidence(self) -> bool:
        """Whether few drives share the features: an image, a terrain, or a path along which the rover moves."""
        has_place = bool(self.grey) or self.terrain is not None
        return has_place or bool((np.linalg.norm(np.reshape(self.path_m, (-1, 3)), axis=1) > SAME_M).any())

    def has_image_of(self, other: DriveTrace) -> bool:
        """Return whether the first left images of both drives agree; drives without images agree."""
        if len(self.grey) != len(other.grey):
            return False
        return bool((np.abs(np.subtract(self.grey, other.grey)) <= SAME_GREY).all())


def drives_of(traces: Sequence[DriveTrace]) -> NDArray[np.intp]:
    """Return the number of the drive of each trace.

    Copies, copies of copies, and parts of one recording have the same number.
    """
    drives = np.arange(len(traces))
    for first, second in chain(_copies(traces), _successive_parts(traces)):
        drives[drives == drives[second]] = drives[first]
    return drives


def _copies(traces: Sequence[DriveTrace]) -> Iterator[tuple[int, int]]:
    """Yield the pairs of traces that are copies; traces without ground truth are in no pair."""
    for first, second in _pairs_with_same_path(traces):
        if traces[first].terrain == traces[second].terrain and traces[first].has_image_of(traces[second]):
            yield first, second


def _successive_parts(traces: Sequence[DriveTrace]) -> Iterator[tuple[int, int]]:
    """Yield the pairs of traces of which the second begins at most `MAX_BREAK_NS` after the end of the first."""
    timed = sorted((trace.start_ns, number) for number, trace in enumerate(traces) if trace.poses)
    for first, trace in enumerate(traces):
        if trace.end_ns == trace.start_ns:
            continue
        begin = bisect_left(timed, (trace.end_ns, 0))
        end = bisect_right(timed, (trace.end_ns + MAX_BREAK_NS, len(traces)))
        for _, second in timed[begin:end]:
            yield first, second


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
    return DriveTrace(
        poses=len(truth),
        path_m=tuple(np.round(path_m, 6).ravel().tolist()),
        grey=grey,
        start_ns=int(truth.stamps_ns[0]),
        end_ns=int(truth.stamps_ns[-1]),
    )


def with_drives(sources: Sequence[PlannedSource], traces: Sequence[DriveTrace]) -> list[PlannedSource]:
    """Return the sources, of which copies and parts of one drive have the same `drive`.

    This is the hash of the source among them with the smallest hash. A simulated drive whose seed occurs only once has
    no copy, and its ground truth is therefore not computed.
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
