"""Whether what was read as a trajectory can be one: stray stamps, positions beyond any speed, attitudes of nobody.

The checks hold for every file and topic. A pose that cannot be true is left out and counted; an attitude that never
changes along a path that turns is the placeholder of a tracker of positions (GNSS, prism), so positions alone are kept.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import NS_PER_S

MAX_SPEED_M_PER_S = 100.0  #: Fastest that a carrier of cameras moves; cars, trains and racing drones stay below.
MIN_JUMP_M = 1.0  #: A jump below may be the noise of a position at two stamps that nearly coincide.
JUMPS_PER_STEP = 20.0  #: A jump exceeds the median step of the path by this factor.
MAX_STRAY = 0.1  #: Largest fraction of poses that are left out as stray; more of them are the path itself.
STRAY_S = 86_400.0  #: A stamp is stray if it is farther from the median stamp than a day and than the drive is long.
SAME_ATTITUDE = 1e-6  #: Largest change of a component of a quaternion that never changes; files round to 1e-6.
TURN_DEG = 20.0  #: A path turns if the lines along two of its parts differ by more than this.
PARTS = 12  #: Parts of equal length of which a path is compared; noise of a position hardly turns them.
SHORTEST_M = 0.5  #: A shorter path may be noise alone.


def stray_stamps(stamps_ns: IntArray) -> Mask:
    """Tell of each stamp `(N,)` whether it cannot be of this recording: 0 among those of a clock, or days away."""
    if len(stamps_ns) < 3:
        return np.zeros(len(stamps_ns), np.bool_)
    middle = int(np.partition(stamps_ns, len(stamps_ns) // 2)[len(stamps_ns) // 2])
    low, high = np.quantile(stamps_ns.astype(np.float64) - middle, (MAX_STRAY, 1.0 - MAX_STRAY))
    limit = max(STRAY_S * NS_PER_S, 2.0 * (high - low))
    away = np.abs(stamps_ns.astype(np.float64) - middle) > limit
    return away if away.mean() <= MAX_STRAY else np.zeros(len(stamps_ns), np.bool_)


def jumping_positions(stamps_ns: IntArray, positions: FloatArray) -> Mask:
    """Tell of each position `(N, 3)` whether nothing could have moved there and back: few of them, by `MAX_STRAY`.

    A position counts as reachable if the last reachable one is within `MAX_SPEED_M_PER_S`; the path begins at the
    position that most others can be reached from.
    """
    count = len(positions)
    nowhere = np.zeros(count, np.bool_)
    if count < 4:
        return nowhere
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    shortest = max(MIN_JUMP_M, JUMPS_PER_STEP * float(np.median(steps)))
    times_s = (stamps_ns - stamps_ns[0]) / NS_PER_S
    if not (steps > np.maximum(shortest, MAX_SPEED_M_PER_S * np.abs(np.diff(times_s)))).any():
        return nowhere
    centre = np.median(positions, axis=0)
    first = int(np.argmin(np.linalg.norm(positions - centre, axis=1)))
    good = nowhere.copy()
    good[first] = True
    for order in (range(first + 1, count), range(first - 1, -1, -1)):
        last = first
        for row in order:
            distance = float(np.linalg.norm(positions[row] - positions[last]))
            reach = max(shortest, MAX_SPEED_M_PER_S * abs(times_s[row] - times_s[last]))
            if distance <= reach:
                good[row], last = True, row
    return ~good if (~good).mean() <= MAX_STRAY else nowhere


def has_constant_attitude(poses: Trajectory) -> bool:
    """Tell whether every attitude is the same while the path turns."""
    if len(poses) < 3 or not poses.has_attitude:
        return False
    quats = poses.quats_xyzw
    signs = np.where(quats @ quats[0] < 0.0, -1.0, 1.0)
    return bool(np.abs(quats * signs[:, None] - quats[0]).max() <= SAME_ATTITUDE) and path_turns(poses.positions)


def path_turns(positions: FloatArray) -> bool:
    """Tell whether a path `(N, 3)` turns; driving backwards along the same line is no turn."""
    along_m = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1)))
    if not along_m[-1] >= SHORTEST_M:
        return False
    places = np.linspace(0.0, along_m[-1], PARTS + 1)
    points = np.stack([np.interp(places, along_m, positions[:, axis]) for axis in range(3)], axis=1)
    parts = np.diff(points, axis=0)
    lengths = np.linalg.norm(parts, axis=1)
    long_enough = lengths >= 0.5 * along_m[-1] / PARTS
    lines = parts[long_enough] / lengths[long_enough, None]
    if len(lines) < 3:
        return False
    cosines = np.abs(lines @ lines.T)
    turned = np.degrees(np.arccos(np.clip(cosines, 0.0, 1.0)))
    return bool(np.sort(turned, axis=None)[-4] > TURN_DEG)  # the largest pair, twice, may be of one noisy part


def possible_poses(poses: Trajectory) -> tuple[Mask, tuple[str, ...]]:
    """Return which poses can be true, and what is wrong with the others, a sentence for each kind."""
    kept = ~stray_stamps(poses.stamps_ns)
    findings = []
    if not kept.all():
        findings.append(f"{_of(~kept)} poses have stamps that are 0 or days away from the others: left out")
    rows = np.flatnonzero(kept)
    jumping = jumping_positions(poses.stamps_ns[rows], poses.positions[rows])
    if jumping.any():
        text = f"poses are where only more than {MAX_SPEED_M_PER_S:g} m/s could lead: left out"
        findings.append(f"{_of(jumping)} {text}")
        kept[rows[jumping]] = False
    return kept, tuple(findings)


def rows_of(poses: Trajectory, kept: Mask) -> Trajectory:
    """Return some of the poses."""
    parts = {name: getattr(poses, name)[kept] for name in ("stamps_ns", "positions", "quats_xyzw")}
    return replace(poses, **parts)


def _of(wrong: Mask) -> str:
    return f"{int(wrong.sum())} of {len(wrong)}"
