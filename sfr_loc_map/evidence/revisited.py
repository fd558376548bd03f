"""Misclosure at revisited places: comparison of the accumulated motion with a direct measurement.

Between two visits of a place, the localiser accumulates its errors over the path between them. A second run omits this
path. This run uses the pairs up to the first visit and the pair of the second visit, and measures the motion between
the visits directly from landmarks of the first visit. The difference of the two motions is the misclosure. The
covariances of both runs predict its size. The systematic errors are included, because they accumulate along the path
but not in the direct run. A scale error is nearly unobservable in a closed loop, because it cancels where the path
returns.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist

from sfr_loc_map.evidence.agreement import Agreement
from sfr_loc_map.evidence.localiser_runs import DIRECT, ComparedRun, PairsInMemory, RunVariant, run_pairs
from sfr_loc_map.evidence.paired_runs import in_axes_of, poses_at, rows_at
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.metrics import formulas
from sfr_loc_map.metrics.figures.rows import Figure, figure_row
from sfr_loc_map.metrics.trajectory.consistency import (
    normalised_square,
    relative_covariance,
    relative_errors,
    sums_of_steps,
)

MIN_PATH_M = 1.0
"""Minimum path between two visits, m. Chosen by hand: a stationary rover does not revisit its place."""
NEAR_M = 0.5  #: Maximum distance between two visits, m. Chosen by hand: images of ground at 2 to 5 m overlap.
MAX_TURN_DEG = 30.0  #: Maximum rotation between two visits, deg. Chosen by hand: half of a field of view overlaps.
PAIRS_BEFORE = 10
"""Pairs up to the first visit in the direct run. Chosen by hand: enough for several keyframes."""
MOST_TRIES = 10  #: Maximum number of direct runs.


@dataclass(frozen=True, slots=True, eq=False)
class Closure:
    """Misclosure at a place that was visited twice."""

    first: int  #: Number of the pair of the first visit, from 0.
    again: int  #: Number of the pair of the second visit.
    path_m: float  #: Path between both visits.
    error: FloatArray  #: `(6,)` accumulated minus directly measured motion, m and rad, in the axes of the first run.
    square: float | None  #: Normalised square of the difference; None if a covariance is unknown or not usable.

    @property
    def misclosure_m(self) -> float:
        """Difference of the positions."""
        return float(np.linalg.norm(self.error[:3]))

    @property
    def name(self) -> str:
        """Name of the pairs of both visits."""
        return f"pairs {self.first} and {self.again}"


def find_closures(drive: PairsInMemory, forward: ComparedRun, config: LocalisationConfig) -> list[Closure]:
    """Return the misclosures of places that a drive revisits. The paths of two misclosures share at most one end."""
    worth = worth_of_visits(forward)
    found = []
    for _ in range(MOST_TRIES):
        first, again = map(int, np.unravel_index(np.argmax(worth), worth.shape))
        if worth[first, again] == 0.0:
            break
        kept = [*drive.kept[max(first - PAIRS_BEFORE, 0) : first + 1], drive.kept[again]]
        closure = closure_between(forward, run_pairs(drive, config, DIRECT, kept), first, again)
        if closure is None:  # a direct run between pairs near these visits would fail, too
            rows, columns = (slice(max(at - PAIRS_BEFORE, 0), at + PAIRS_BEFORE + 1) for at in (first, again))
            worth[rows, columns] = 0.0
        else:
            found.append(closure)
            worth[:again, first + 1 :] = 0.0  # the paths of other closures do not overlap this path
    return sorted(found, key=lambda item: item.first)


def worth_of_visits(forward: ComparedRun) -> FloatArray:
    """Return the score `(N, N)` of two pairs as visits of one place: path times closeness; 0 if the places differ.

    The row is the first visit, the column the second.
    """
    poses = forward.estimates.trajectory
    length_m = formulas.path_length_m(poses.positions).astype(np.float64)
    path_m = length_m[None] - length_m[:, None]
    closeness = 1.0 - cdist(poses.positions, poses.positions) / NEAR_M
    cosine = np.abs(poses.quats_xyzw @ poses.quats_xyzw.T)
    turn_deg = np.degrees(2.0 * np.arccos(np.clip(cosine, 0.0, 1.0)))
    is_known = ~forward.estimates.lost
    is_place = (path_m >= MIN_PATH_M) & (closeness > 0.0) & (turn_deg <= MAX_TURN_DEG)
    return np.where(is_place & is_known[:, None] & is_known[None], path_m * closeness, 0.0)


def closure_between(forward: ComparedRun, direct: ComparedRun, first: int, again: int) -> Closure | None:
    """Return the misclosure between two visits, which are pairs of the forward run.

    `direct` is the run that omits the path between the visits. None if this run is degraded or lost at a visit.
    """
    poses = forward.estimates.trajectory
    visits = np.array([first, again])
    rows = rows_at(direct, poses.stamps_ns[visits])
    if direct.estimates.unreliable[rows].any():
        return None
    along_path, measured = poses_at(forward, visits), poses_at(direct, rows)
    (error,) = relative_errors(along_path, measured, np.array([0]), np.array([1]))
    path_m = float(np.linalg.norm(np.diff(poses.positions[first : again + 1], axis=0), axis=1).sum())
    of_path, of_direct = growth_between(forward, first, again), growth_between(direct, int(rows[0]), int(rows[1]))
    if of_path is None or of_direct is None:
        return Closure(first, again, path_m, error, None)
    of_difference = of_path + in_axes_of(along_path, measured, 0, of_direct)
    return Closure(first, again, path_m, error, normalised_square(error, of_difference))


def growth_between(run: ComparedRun, start: int, end: int) -> FloatArray | None:
    """Return the covariance of one estimate given another, with all errors that the run models.

    None if the covariance is unknown, or if a pose between them is lost or degraded.
    """
    if run.estimates.steps is None or run.estimates.unreliable[start : end + 1].any():
        return None
    sums = sums_of_steps(run.estimates, run.estimates.steps, np.array([start, end]))
    return relative_covariance(sums[start], sums[end], run.estimates.trajectory.positions[end])


# ---- figures


def agreement_at(closures: Sequence[Closure]) -> Agreement:
    """Return the misclosures as a comparison of two runs."""
    errors = np.array([item.error for item in closures])
    return Agreement(
        runs=(RunVariant.FORWARD.value, DIRECT),
        condition=None,
        position_m=errors[:, :3],
        attitude_deg=np.degrees(np.linalg.norm(errors[:, 3:], axis=1)),
        squares=np.array([item.square for item in closures if item.square is not None]),
        independent=len(closures),
    )


def closure_rows(closure: Closure) -> Iterator[Figure]:
    """Yield the rows of a revisited place."""
    yield figure_row("revisited_path", part=closure.name, value=closure.path_m)
    yield figure_row("misclosure", part=closure.name, value=closure.misclosure_m)
    yield figure_row("misclosure_of_path", part=closure.name, value=closure.misclosure_m / closure.path_m)
    yield figure_row("misclosure_nees", part=closure.name, value=closure.square)
