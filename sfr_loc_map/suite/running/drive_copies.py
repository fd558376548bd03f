"""Detection of sources that are copies of one drive although their files differ. Their errors are correlated."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from sfr_loc_map.config import build
from sfr_loc_map.errors import SfrError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.trajectory import Trajectory, Truth
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.scoring.inputs import ScoreInputs
from sfr_loc_map.scoring.load import load_run
from sfr_loc_map.simulation.config import SimulationConfig
from sfr_loc_map.suite.running.job import JobSource, SourceKind

PLACES = 100  #: Number of compared poses of the ground truth, evenly distributed over the drive.
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
MOVING_SHARE = 0.1  #: The rover moves in a step that exceeds this fraction of a long step.
MAX_STEPS = 20_000  #: Largest number of compared steps, which bounds memory and time.


@dataclass(frozen=True, slots=True)
class DriveTrace:
    """Features by which copies of one drive are detected."""

    poses: int = 0  #: Number of poses of the ground truth; 0 if there is none.
    path_m: tuple[float, ...] = ()  #: x, y, z of poses of the ground truth, in the frame of the first pose.
    grey: tuple[int, ...] = ()  #: Pixels of the first left image; empty without images.
    steps_m: tuple[float, ...] = ()  #: Distances between successive poses of the ground truth.
    bends_m: tuple[float, ...] = ()  #: Norms of the differences between successive steps.
    terrain: int | None = None  #: Seed of a simulated terrain; None for other sources.

    def is_copy_of(self, other: DriveTrace) -> bool:
        """Return whether both traces are of one drive; False without ground truth.

        The paths agree, or a large fraction of the steps is common. Steps depend neither on the frame nor on the first
        pose nor on the stamps. The paths are also compared because rounding changes the steps, but hardly the path, and
        because a short drive has too few steps. The first images are compared if the paths agree or the drives start
        with the same steps.
        """
        if not self.poses or not other.poses or len(self.grey) != len(other.grey) or self.terrain != other.terrain:
            return False
        if not self._has_same_path(other):
            if not self._shares_steps(other):
                return False
            if not self._starts_like(other):
                return True
        return bool((np.abs(np.subtract(self.grey, other.grey)) <= SAME_GREY).all())

    def _has_same_path(self, other: DriveTrace) -> bool:
        if self.poses != other.poses:
            return False
        apart_m = np.subtract(self.path_m, other.path_m).reshape(-1, 3)
        return bool((np.linalg.norm(apart_m, axis=1) <= SAME_M).all())

    def _shares_steps(self, other: DriveTrace) -> bool:
        """Return whether the drive with fewer moving windows has a large fraction of them in common with the other."""
        traces = [(trace._moving_windows, trace) for trace in (self, other)]
        (windows, shorter), (longer_windows, _) = sorted(traces, key=lambda item: len(item[0]))
        if not len(windows):
            return False
        from scipy.spatial import KDTree  # slow import

        tolerance_m = SAME_STEP * shorter._long_step_m
        apart_m, _ = KDTree(longer_windows).query(windows, p=np.inf, distance_upper_bound=tolerance_m)
        return bool(np.mean(np.isfinite(apart_m)) >= COMMON_SHARE)

    def _starts_like(self, other: DriveTrace) -> bool:
        windows, others = self._windows[:1], other._windows[:1]
        if not len(windows) or not len(others):
            return False
        return bool((np.abs(windows - others) <= SAME_STEP * self._long_step_m).all())

    @property
    def _long_step_m(self) -> float:
        return float(np.quantile(self.steps_m, LONG_STEP))

    @property
    def _windows(self) -> FloatArray:
        """Features of `WINDOW` successive steps `(W, 2 * WINDOW - 1)`: lengths and bends, m."""
        if len(self.steps_m) < WINDOW:
            return np.zeros((0, 2 * WINDOW - 1))
        lengths = sliding_window_view(np.array(self.steps_m), WINDOW)
        bends = sliding_window_view(np.array(self.bends_m), WINDOW - 1)
        return np.hstack((lengths, bends))

    @property
    def _moving_windows(self) -> FloatArray:
        """Features of the windows in which the rover moves in each step."""
        windows = self._windows
        if not len(windows):
            return windows
        shortest_m = MOVING_SHARE * self._long_step_m
        return np.asarray(windows[(windows[:, :WINDOW] > shortest_m).all(axis=1)])


def trace_of_source(source: Source) -> DriveTrace:
    """Return the trace of the drive of a source."""
    if source.loc is None or source.loc.ground_truth is None:
        return DriveTrace()
    grey: tuple[int, ...] = ()
    for pair in source.loc.pairs():
        rows, columns = (np.linspace(0, size - 1, PIXELS, dtype=int) for size in pair.left.shape)
        grey = tuple(pair.left[np.ix_(rows, columns)].ravel().tolist())
        break
    return _trace(source.loc.ground_truth, grey)


def trace_of_estimate(estimate: Path, truth: Path) -> DriveTrace:
    """Return the trace of the ground truth of an estimate; empty if the files are unreadable or of a map."""
    with suppress(SfrError):
        drive = load_run(ScoreInputs.of(estimate, truth)).drive
        if drive is not None:
            return _trace(drive.truth)
    return DriveTrace()


def trace_of_simulation(source: JobSource) -> DriveTrace:
    """Return the trace of the ground truth of a simulated drive; empty if there is no drive or its path is invalid."""
    from sfr_loc_map.simulation.plan import Plan  # slow import

    config = build(SimulationConfig, source.settings)
    if not config.drive.enabled:
        return DriveTrace()
    with suppress(SfrError):
        return replace(_trace(Plan.make(config).trajectory()), terrain=config.seed)
    return DriveTrace()


def _trace(truth: Trajectory, grey: tuple[int, ...] = ()) -> DriveTrace:
    if not len(truth):
        return DriveTrace()
    chosen = np.linspace(0, len(truth) - 1, PLACES, dtype=int)
    path_m = truth.positions[chosen] - truth.positions[0]
    if not isinstance(truth, Truth) or truth.has_attitude:
        path_m = path_m @ truth.pose(0).rotation  # in the frame of the first pose
    steps = np.diff(truth.positions[: MAX_STEPS + 1], axis=0)
    steps_m = np.linalg.norm(steps, axis=1)
    bends_m = np.linalg.norm(np.diff(steps, axis=0), axis=1)
    return DriveTrace(len(truth), _rounded(path_m, 6), grey, _rounded(steps_m, 9), _rounded(bends_m, 9))


def _rounded(values: FloatArray, digits: int) -> tuple[float, ...]:
    return tuple(np.round(values, digits).ravel().tolist())


def with_drives(sources: Sequence[JobSource], traces: Sequence[DriveTrace]) -> list[JobSource]:
    """Return the sources with the hashes of their drives. Copies have the hash of the source with the smallest hash.

    The hash of an estimate's drive is that of its ground truth. Copies of copies are copies. Simulated drives of a seed
    that occurs once are identified by their settings, so that their ground truth is not computed.
    """
    seeds = Counter(source.seed for source in sources if source.kind is SourceKind.SIMULATED)
    traces = [
        trace_of_simulation(source) if source.kind is SourceKind.SIMULATED and seeds[source.seed] > 1 else trace
        for source, trace in zip(sources, traces, strict=True)
    ]
    order = sorted(range(len(sources)), key=lambda number: sources[number].sha256)
    drives: list[list[int]] = []  # places in the order
    for place, index in enumerate(order):
        copies = [drive for drive in drives if any(traces[index].is_copy_of(traces[order[known]]) for known in drive)]
        merged = sorted(known for drive in copies for known in drive)
        drives = [*(drive for drive in drives if drive not in copies), [*merged, place]]
    found = list(sources)
    for drive in drives:
        first = sources[order[drive[0]]]
        for index in (order[place] for place in drive):
            found[index] = replace(sources[index], drive=first.truth_sha256 or first.sha256)
    return found
