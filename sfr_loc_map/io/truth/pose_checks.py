"""Checks of true paths: which poses are possible given the others, and which components are known.

The checks apply to every file and topic. An impossible pose has a stray stamp or an unreachable position; it is ignored
and counted. If more than `MAX_INVALID` of the positions are unreachable, all of them are kept, and this is reported.
`geometry.plausibility` has already decided whether each single pose is valid. An attitude that never changes along a
path that turns is the placeholder of a position tracker (GNSS, prism); only the positions are then kept. A height that
never changes, or zero roll and pitch, along such a path are placeholders of a planar source.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.geometry.plausibility import LOST_VARIANCE
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import MAX_INVALID
from sfr_loc_map.io.stamps.stamp_checks import stray_stamps
from sfr_loc_map.io.truth.recorded import RecordedTruth
from sfr_loc_map.message_stamps import NS_PER_S

_log = logging.getLogger(__name__)

MAX_SPEED_M_PER_S = 100.0  #: Largest speed of a vehicle with cameras; cars, trains and racing drones are slower.
MIN_JUMP_M = 1.0  #: Smallest jump, m. Smaller jumps may be position noise at two nearly equal stamps.
JUMPS_PER_STEP = 20.0
"""Smallest ratio of a jump to the median step, and of its speed to the 90 % quantile of the speeds. The ratio is large
because rovers pause and accelerate."""
JUMP_SPEED_M_PER_S = 5.0  #: Smallest speed of a jump, m/s. A rover that mostly rests has slower honest steps.
MOVED_M = 1e-6  #: Smallest step that is not a held pose, m; files round to this.
SHORTEST_STEP_S = 1e-3  #: Smallest time between two poses for the speed of a step, s.
STEPS_FROM_ZERO = 5.0  #: Smallest ratio of the distance of a path from 0, 0, 0, where it never is, to its median step.
MIN_POSITIONS = 4  #: Smallest number of positions for the detection of jumps.
SAME_ATTITUDE = 1e-6  #: Largest quaternion component x or y if roll and pitch are zero; files round to 1e-6.
HELD_ATTITUDE = 5e-4  #: Largest change of a component of a constant quaternion: 0.06 deg, less than any vehicle.
PLACES = 50  #: Number of cells along the extent of a path; a stationary rover with position noise occupies few cells.
TURN_DEG = 20.0  #: A path turns if the lines along two of its parts differ by more than this, deg.
PARTS = 12  #: Number of parts of equal length of a path; position noise hardly rotates such long parts.
SAME_HEIGHT_M = 1e-6  #: Largest range of a constant height, m; the measured height of a flat floor varies more.
SHORTEST_PART = 0.5
"""Smallest straight length of a part, as a fraction of its length along the path; the line of others is noise."""
SMALLEST_CELL_M = 1e-6  #: Smallest side of the cells along a path, m; files round to this.
SHORTEST_M = 0.5  #: Shortest path, m. A shorter path may consist of noise.
MOST = 0.5  #: Fraction of poses without a component above which the component is unknown.


def jumping_positions(stamps_ns: IntArray, positions: FloatArray) -> Mask:
    """Return which positions `(N, 3)`, m, at stamps `(N,)`, ns, are unreachable, `(N,)`.

    A position is reachable if a vehicle with `MAX_SPEED_M_PER_S` can travel there from the last reachable position. The
    search runs forwards and backwards in time from the position nearest to the median position.
    """
    count = len(positions)
    none = np.zeros(count, np.bool_)
    if count < MIN_POSITIONS:
        return none
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    shortest = max(MIN_JUMP_M, JUMPS_PER_STEP * float(np.median(steps)))
    times_s = (stamps_ns - stamps_ns[0]) / NS_PER_S
    if not (steps > np.maximum(shortest, MAX_SPEED_M_PER_S * np.abs(np.diff(times_s)))).any():
        return none
    centre = np.median(positions, axis=0)
    first = int(np.argmin(np.linalg.norm(positions - centre, axis=1)))
    reachable = none.copy()
    reachable[first] = True
    for order in (range(first + 1, count), range(first - 1, -1, -1)):
        last = first
        for row in order:
            distance = float(np.linalg.norm(positions[row] - positions[last]))
            reach = max(shortest, MAX_SPEED_M_PER_S * abs(times_s[row] - times_s[last]))
            if distance <= reach:
                reachable[row] = True
                last = row
    return ~reachable


def zero_positions(positions: FloatArray) -> Mask:
    """Return which positions `(N, 3)` are 0, 0, 0 as placeholders, `(N,)`: all other positions are away from there."""
    is_zero = np.asarray((positions == 0.0).all(axis=1))
    others = positions[~is_zero]
    none = np.zeros(len(positions), np.bool_)
    if not is_zero.any() or is_zero.mean() > MOST or len(others) < MIN_POSITIONS:
        return none
    step_m = float(np.median(np.linalg.norm(np.diff(others, axis=0), axis=1)))
    is_away = float(np.linalg.norm(others, axis=1).min()) > max(MIN_JUMP_M, STEPS_FROM_ZERO * step_m)
    return is_zero if is_away else none


def largest_jump(stamps_ns: IntArray, positions: FloatArray) -> str:
    """Return a finding about the largest jump between positions `(N, 3)`, m; empty if there is none.

    A jump exceeds `MIN_JUMP_M`. Its speed exceeds `JUMP_SPEED_M_PER_S` and `JUMPS_PER_STEP` times the speed of nearly
    all other steps. Rows that repeat the position of the previous row are ignored, because a table may hold each
    position until the next measurement.
    """
    has_moved = np.append(True, np.linalg.norm(np.diff(positions, axis=0), axis=1) > MOVED_M)[: len(positions)]
    stamps_ns, positions = stamps_ns[has_moved], positions[has_moved]
    if len(positions) < MIN_POSITIONS:
        return ""
    steps_m = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    steps_s = np.maximum(np.abs(np.diff(stamps_ns)) / NS_PER_S, SHORTEST_STEP_S)
    speeds = steps_m / steps_s
    fastest = max(JUMP_SPEED_M_PER_S, JUMPS_PER_STEP * float(np.quantile(speeds, 1.0 - MAX_INVALID)))
    is_jump = (steps_m > MIN_JUMP_M) & (speeds > fastest)
    if not is_jump.any():
        return ""
    row = int(np.argmax(np.where(is_jump, steps_m, 0.0)))
    return (
        f"the positions jump {int(is_jump.sum())} times, by up to {steps_m[row]:.3g} m in {steps_s[row]:.3g} s: verify "
        "that all poses are of one body in one frame"
    )


def are_too_fast(stamps_ns: IntArray, positions: FloatArray) -> bool:
    """Return whether more than `MAX_INVALID` of the steps between positions `(N, 3)`, m, exceed `MAX_SPEED_M_PER_S`.

    The positions are then in another unit, or those of several bodies. Steps below `MIN_JUMP_M` may be noise.
    """
    if len(positions) < MIN_POSITIONS:
        return False
    steps_m = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    reach_m = MAX_SPEED_M_PER_S * np.abs(np.diff(stamps_ns)) / NS_PER_S
    return bool((steps_m > np.maximum(MIN_JUMP_M, reach_m)).mean() > MAX_INVALID)


def has_constant_attitude(poses: Trajectory) -> bool:
    """Return whether the attitude is the same at nearly all positions although the path turns.

    Each cell of the path counts once, because a stationary rover keeps its attitude.
    """
    if len(poses) < 3 or not poses.has_attitude:
        return False
    quats = poses.quats_xyzw[first_at_each_place(poses.positions)]
    largest = int(np.argmax(np.abs(quats[len(quats) // 2])))
    upright = quats * np.where(quats[:, largest] < 0.0, -1.0, 1.0)[:, None]  # q and -q are the same attitude
    is_held: Mask = np.all(np.abs(upright - np.median(upright, axis=0)) <= HELD_ATTITUDE, axis=1)
    return bool(is_held.mean() >= 1.0 - MAX_INVALID) and path_turns(poses.positions)


def first_at_each_place(positions: FloatArray) -> IntArray:
    """Return the first row of positions `(N, 3)` in each cell of a grid of `PLACES` cells along their extent."""
    side_m = max(float(np.ptp(positions, axis=0).max()) / PLACES, SMALLEST_CELL_M)
    cells = np.floor((positions - positions[0]) / side_m + 0.5).astype(np.int64)
    return np.unique(cells, axis=0, return_index=True)[1]


def has_constant_height(poses: Trajectory) -> bool:
    """Return whether every height is the same although the path turns."""
    heights = poses.positions[:, 2]
    return len(heights) > 2 and float(np.ptp(heights)) <= SAME_HEIGHT_M and path_turns(poses.positions)


def has_no_tilt(poses: Trajectory) -> bool:
    """Return whether roll and pitch of every attitude are zero although the path turns."""
    if len(poses) < 3 or not poses.has_attitude:
        return False
    return float(np.abs(poses.quats_xyzw[:, :2]).max()) <= SAME_ATTITUDE and path_turns(poses.positions)


def path_turns(positions: FloatArray) -> bool:
    """Return whether a path `(N, 3)` turns; driving backwards along the same line is not a turn.

    The path is divided into `PARTS` of equal length. It turns if the lines along two parts differ, even if any one part
    is omitted. A single part may contain position noise, a jump or a change of lanes.
    """
    along_m = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1)))
    if not along_m[-1] >= SHORTEST_M:
        return False
    ends_m = np.linspace(0.0, along_m[-1], PARTS + 1)
    points = np.stack([np.interp(ends_m, along_m, positions[:, axis]) for axis in range(3)], axis=1)
    parts = np.diff(points, axis=0)
    lengths = np.linalg.norm(parts, axis=1)
    long_enough = lengths >= SHORTEST_PART * along_m[-1] / PARTS
    lines = parts[long_enough] / lengths[long_enough, None]
    if len(lines) < 3:
        return False
    cosines = np.abs(lines @ lines.T)
    turned_deg = np.degrees(np.arccos(np.clip(cosines, 0.0, 1.0)))
    others = ~np.eye(len(lines), dtype=np.bool_)
    return all(turned_deg[kept][:, kept].max() > TURN_DEG for kept in others)


def possible_poses(poses: Trajectory) -> tuple[Mask, tuple[str, ...]]:
    """Return which poses are possible, `(N,)`, and the findings about stray stamps, zeros and excessive speeds."""
    kept = ~stray_stamps(poses.stamps_ns)
    findings = []
    if not kept.all():
        findings.append(f"{_of(~kept)} poses have stamps that are 0 or days away from the others: ignored")
    at_zero = kept & zero_positions(poses.positions)
    if at_zero.any():
        findings.append(f"{_of(at_zero)} poses are at 0, 0, 0, away from all others: ignored")
        kept &= ~at_zero
    rows = np.flatnonzero(kept)
    jumping = jumping_positions(poses.stamps_ns[rows], poses.positions[rows])
    is_ambiguous = bool(len(rows)) and float(jumping.mean()) > MAX_INVALID
    if jumping.any() and not is_ambiguous:
        text = f"poses require speeds of more than {MAX_SPEED_M_PER_S:g} m/s: ignored"
        findings.append(f"{_of(jumping)} {text}")
        kept[rows[jumping]] = False
    if not is_ambiguous and (jump := largest_jump(poses.stamps_ns[kept], poses.positions[kept])):
        findings.append(jump)
    if is_ambiguous or are_too_fast(poses.stamps_ns[kept], poses.positions[kept]):
        findings.append(
            f"more than {100.0 * MAX_INVALID:g} % of the poses require speeds of more than {MAX_SPEED_M_PER_S:g} m/s "
            "and are kept: verify the units of the positions and stamps, and that all poses are of one body"
        )
    return kept, tuple(findings)


def _of(wrong: Mask) -> str:
    return f"{int(wrong.sum())} of {len(wrong)}"


@dataclass(frozen=True, slots=True, eq=False)
class CheckedTruth:
    """The possible poses of a truth, and their known components."""

    recorded: RecordedTruth  #: The possible poses, without attitudes that are placeholders, unknown or not to be used.
    has_height: bool = True  #: Whether z is known.
    has_tilt: bool = True  #: Whether roll and pitch are known.
    findings: tuple[str, ...] = ()  #: Findings about impossible poses and jumps.


def check_poses(
    recorded: RecordedTruth, attitude: str = "auto", unknown: str = "auto", warn: Callable[[str], object] = _log.warning
) -> CheckedTruth:
    """Return the possible poses of a truth; warnings report the others.

    If `attitude` is no, only the positions are kept. If `attitude` is auto, attitudes are removed that never change
    along a path that turns, or that the variances mark as unknown. `unknown` names the unknown components
    (`TrackedBodyConfig.unknown`); auto infers them. InputError if `attitude` is yes but the truth has no attitudes.
    """
    if not len(recorded.poses):
        return CheckedTruth(recorded)
    kept, findings = possible_poses(recorded.poses)
    variances = recorded.variances
    if variances is not None:
        has_no_height = variances[:, 2] >= LOST_VARIANCE
        if 0.0 < has_no_height.mean() <= MOST:
            kept &= ~has_no_height
            findings = (*findings, f"{_of(has_no_height)} positions have no height: ignored")
    about_poses = findings
    if not kept.all():
        recorded = recorded.where(kept)
    if attitude == "auto" and has_constant_attitude(recorded.poses):
        recorded = recorded.without_attitudes()
        same = "all poses have the same attitude although the path turns: only positions are used"
        findings = (*findings, f"{same} (truth.attitude=yes keeps the attitudes)")
    has_height, has_tilt = unknown in ("none", "tilt"), unknown in ("none", "height")
    if unknown == "auto":
        has_height, has_tilt = known_components(recorded)
        names = [name for name, is_known in (("height", has_height), ("roll and pitch", has_tilt)) if not is_known]
        if names:
            text = f"unknown components: {', '.join(names)} (constant along a path that turns, or marked by variances)"
            findings = (*findings, f"{text}: they are not judged; set truth.unknown=none to judge them")
    name = f"truth {recorded.read_from}".rstrip()
    for text in findings:
        warn(f"{name}: {text}")
    if attitude == "yes" and not recorded.poses.has_attitude:
        raise InputError(f"{name} has no attitudes:", "set truth.attitude to auto or no")
    if attitude == "no" or (attitude == "auto" and not has_known_attitude(recorded)):
        recorded = recorded.without_attitudes()
    return CheckedTruth(recorded, has_height, has_tilt, about_poses)


def known_components(recorded: RecordedTruth) -> tuple[bool, bool]:
    """Return whether the height, and roll and pitch, of true poses are known."""
    poses, variances = recorded.poses, recorded.variances
    no_height, no_tilt = (False, False) if variances is None else marked_as_unknown(variances)
    has_height = not no_height and not has_constant_height(poses)
    has_tilt = not poses.has_attitude or not (no_tilt or has_no_tilt(poses))
    return has_height, has_tilt


def has_known_attitude(recorded: RecordedTruth) -> bool:
    """Return whether the variances state at least one attitude as known, or state nothing about one."""
    if recorded.variances is None:
        return True
    variances = recorded.variances[:, 3:]
    is_known = (variances < LOST_VARIANCE).any(axis=1) & (variances >= 0.0).all(axis=1)
    return bool(is_known.any() or np.isnan(variances).any())


def marked_as_unknown(variances: FloatArray) -> tuple[bool, bool]:
    """Return whether variances `(N, 6)` mark the height, and roll and pitch, as unknown.

    Unknown components have the variance of a lost pose or a negative variance. Tools that estimate planar
    poses send zero variances of z, roll and pitch, and positive variances of x, y and yaw.
    """
    if not len(variances):
        return False, False
    is_lost = (variances >= LOST_VARIANCE) | (variances < 0.0)
    is_planar = bool((variances[:, 2:5] == 0.0).all() and (variances[:, [0, 1, 5]] > 0.0).all())
    return is_planar or bool(is_lost[:, 2].mean() > MOST), is_planar or bool(is_lost[:, 3:5].all())
