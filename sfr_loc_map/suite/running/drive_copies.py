"""Detection of sources that are copies of one drive although their files differ. Their errors are correlated."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sfr_loc_map.errors import SfrError
from sfr_loc_map.geometry.trajectory import Trajectory, Truth
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.scoring.inputs import ScoreInputs
from sfr_loc_map.scoring.load import load_run
from sfr_loc_map.suite.running.job import JobSource

PLACES = 100  #: Number of compared poses of the ground truth, evenly distributed over the drive.
PIXELS = 8  #: Number of compared rows and columns of the first left image.
SAME_M = 0.01
"""Largest distance, m, between two copies of a path at each pose. A rover that repeats its path deviates by more,
because its start and its speed differ."""
SAME_GREY = 8
"""Largest difference, grey levels, between two copies of an image. Images of other terrain differ by more."""


@dataclass(frozen=True, slots=True)
class DriveTrace:
    """Features by which copies of one drive are detected."""

    poses: int = 0  #: Number of poses of the ground truth; 0 if there is none.
    path_m: tuple[float, ...] = ()  #: x, y, z of poses of the ground truth, in the frame of the first pose.
    grey: tuple[int, ...] = ()  #: Pixels of the first left image; empty without images.

    def is_copy_of(self, other: DriveTrace) -> bool:
        """Return whether both traces are of one drive; False without ground truth."""
        if not self.poses or (self.poses, len(self.grey)) != (other.poses, len(other.grey)):
            return False
        apart_m = np.subtract(self.path_m, other.path_m).reshape(-1, 3)
        if not (np.linalg.norm(apart_m, axis=1) <= SAME_M).all():
            return False
        return bool((np.abs(np.subtract(self.grey, other.grey)) <= SAME_GREY).all())


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


def _trace(truth: Trajectory, grey: tuple[int, ...] = ()) -> DriveTrace:
    if not len(truth):
        return DriveTrace()
    chosen = np.linspace(0, len(truth) - 1, PLACES, dtype=int)
    path_m = truth.positions[chosen] - truth.positions[0]
    if not isinstance(truth, Truth) or truth.has_attitude:
        path_m = path_m @ truth.pose(0).rotation  # in the frame of the first pose
    return DriveTrace(len(truth), tuple(np.round(path_m, 6).ravel().tolist()), grey)


def with_drives(sources: Sequence[JobSource], traces: Sequence[DriveTrace]) -> list[JobSource]:
    """Return the sources with the hashes of their drives. Copies have the hash of the source with the smallest hash.

    The hash of an estimate's drive is that of its ground truth. Simulated drives have no trace, because their settings
    identify them.
    """
    found: dict[int, JobSource] = {}
    originals: list[tuple[DriveTrace, str]] = []
    for index in sorted(range(len(sources)), key=lambda number: sources[number].sha256):
        source = sources[index]
        own = source.truth_sha256 or source.sha256
        drive = next((drive for trace, drive in originals if trace.is_copy_of(traces[index])), own)
        if drive == own:
            originals.append((traces[index], own))
        found[index] = replace(source, drive=drive)
    return [found[index] for index in range(len(sources))]
