"""The drive: straight lines, arcs, point turns and stops, with slip and vibration, as a trajectory of the rover."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.simulation.config import DriveConfig

STEP_S = 0.05  #: Time between the states of the trajectory, s; poses are interpolated in between.
VIBRATION_HZ = 6.0  #: Rate of the independent values between which the vibration is interpolated (chosen by eye).
SLIP_TIME_S = 2.5  #: Correlation time of the slip, s: 0.4 m of path at the default speed. Chosen by hand.
SLIP_SPREAD = 0.6  #: Ratio of the standard deviation of the slip to its mean. Chosen by hand.
MAX_SLIP = 0.95  #: Largest slip. Chosen by hand.
SWAY_TIME_S = 2.0  #: Driving time between independent values of drift and heading error, s. Chosen by hand.
ARGUMENTS = {"straight": 1, "arc": 2, "turn": 1, "stop": 1, "goto": 2}  #: Number of arguments of each segment.
NEAR_M = 1e-6  #: Lengths and radii, m, and angles, deg, up to this value count as 0.
MAX_AWAY_M = 400.0  #: Largest distance from the start along x or y, m; the ground is 1024 m wide.
COURSE_STEP_RAD = math.radians(1.0)  #: Turn from one position of an arc to the next at which `MAX_AWAY_M` is checked.
LONGEST_S = 20_000.0  #: Longest drive, s: the heights of the ground under the wheels then require 1 GB of memory.
ROUNDING = 1e-9  #: Added to a number of periods, so that a pair at the end of the drive is counted despite rounding.
COMPLETE = 1.0 - 1e-12  #: A leg is complete from this fraction on, because fractions are rounded.


class Leg(NamedTuple):
    """A part of the drive: a path of constant curvature, a point turn (length 0), or a stop (length and turn 0).

    The path is straight if the turn is 0, and driven backwards if the length is negative.
    """

    length_m: float = 0.0
    turn_rad: float = 0.0
    stop_s: float = 0.0  #: Duration of a stop; 0 if the wheels turn.

    @property
    def wheels_turn(self) -> float:
        """1 while the wheels turn, 0 in a stop."""
        return 0.0 if self.stop_s else 1.0

    def fraction_per_s(self, config: DriveConfig, grip: float) -> float:
        """Return the fraction of the leg per second; `grip` is the fraction of the motion that remains after slip."""
        if self.stop_s:
            return 1.0 / self.stop_s
        if self.length_m:
            return config.speed_m_s * grip / abs(self.length_m)
        return math.radians(config.turn_rate_deg_s) * grip / abs(self.turn_rad)


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """Trajectory of the rover."""

    times_s: FloatArray  #: `(N,)` float64, seconds from the start.
    origins: FloatArray  #: `(N, 3)` float64, metres, DS.
    rotations: FloatArray  #: `(N, 3, 3)` float64, RB to DS.
    moving: FloatArray  #: `(N,)` float64, 1 while the wheels turn.
    vibration: FloatArray  #: `(M, 4)` float64, standard normal values at `VIBRATION_HZ`.
    config: DriveConfig  #: Settings.

    @property
    def duration_s(self) -> float:
        """Time from start to end."""
        return float(self.times_s[-1])

    @property
    def count(self) -> int:
        """Number of pairs along the path."""
        whole = math.floor(self.duration_s / self.config.period_s + ROUNDING) + 1
        return min(whole, self.config.pairs) if self.config.pairs else whole

    def pose(self, time_s: float) -> Transform:
        """Return `T_ds_rb` at a time; slightly before the start or after the end, the motion is extrapolated."""
        inside = min(max(time_s, 0.0), self.duration_s)
        pose = self._pose_inside(inside)
        if time_s == inside:
            return pose
        # if the rover were stationary before the start, the first exposure would not be centred on the pose at its
        # stamp
        mirrored = min(max(2.0 * inside - time_s, 0.0), self.duration_s)
        return pose @ self._pose_inside(mirrored).inverse() @ pose

    def _pose_inside(self, time_s: float) -> Transform:
        """Return `T_ds_rb` at a time between start and end."""
        i = min(int(np.searchsorted(self.times_s, time_s, side="right")) - 1, len(self.times_s) - 2)
        fraction = (time_s - self.times_s[i]) / (self.times_s[i + 1] - self.times_s[i])
        origin = (1 - fraction) * self.origins[i] + fraction * self.origins[i + 1]
        u, _, vt = np.linalg.svd((1 - fraction) * self.rotations[i] + fraction * self.rotations[i + 1])
        rotation = np.asarray(u @ vt)  # the rotation nearest to the blend
        moving = (1 - fraction) * self.moving[i] + fraction * self.moving[i + 1]
        before, eased = _smooth(np.array(time_s * VIBRATION_HZ))
        vibration = moving * ((1 - eased) * self.vibration[before] + eased * self.vibration[before + 1])
        angles = np.radians(self.config.vibration_deg) * vibration[:3]
        lift = rotation[:, 2] * (self.config.vibration_m * vibration[3])
        return Transform(rotation @ matrix_from_rotvec(angles), origin + lift)


def legs_of(config: DriveConfig) -> list[Leg]:
    """Return the legs of a path.

    Raises ConfigError if a segment is invalid, if the path goes more than `MAX_AWAY_M` from the start along x or y, or
    if the drive takes longer than `LONGEST_S`.
    """
    legs: list[Leg] = []
    x, y, heading = _start(config)
    for segment in config.segments:
        for leg in _legs_of_segment(segment, x, y, heading):
            course = _course(x, y, heading, leg)
            x, y, heading = course[-1]
            away = max(max(abs(east - config.start_x_m), abs(north - config.start_y_m)) for east, north, _ in course)
            if away > MAX_AWAY_M:
                raise ConfigError(
                    f"drive.segments go {away:.3g} m away from the start: at most {MAX_AWAY_M:g} m are allowed"
                )
            legs.append(leg)
    mean_grip = 1.0 - min(config.slip, MAX_SLIP)
    duration_s = sum(1.0 / leg.fraction_per_s(config, mean_grip) for leg in legs)
    if duration_s > LONGEST_S:
        raise ConfigError(
            f"drive.segments take {duration_s:.3g} s: at most {LONGEST_S:g} s are allowed; shorten the segments, or "
            "increase drive.speed_m_s or drive.turn_rate_deg_s"
        )
    return legs


def _start(config: DriveConfig) -> tuple[float, float, float]:
    """Return x and y, m, and heading, rad, of the start of a drive in DS."""
    return config.start_x_m, config.start_y_m, math.radians(config.start_heading_deg)


def _legs_of_segment(segment: str, x: float, y: float, heading: float) -> list[Leg]:
    """Return the legs of a segment that begins at a position and heading; ConfigError if the segment is invalid."""
    word, *rest = segment.split() or [""]
    try:
        numbers = [float(number) for number in rest]
    except ValueError:
        numbers = []
    if ARGUMENTS.get(word) != len(numbers) or not np.isfinite(numbers).all():
        known = "'straight M', 'arc RADIUS_M ANGLE_DEG', 'turn DEG', 'stop S', 'goto X Y'"
        raise ConfigError(f"drive.segments has '{segment}': one of {known} is required")
    if word == "goto":
        dx = numbers[0] - x
        dy = numbers[1] - y
        length = math.hypot(dx, dy)
        if length <= NEAR_M:
            return []
        turn = math.remainder(math.atan2(dy, dx) - heading, 2 * math.pi)
        straight = Leg(length_m=length)
        return [Leg(turn_rad=turn), straight] if turn else [straight]
    if word == "stop" and numbers[0] <= 0.0:
        raise ConfigError(f"drive.segments has '{segment}': a time greater than 0 s is required")
    if word == "stop":
        return [Leg(stop_s=numbers[0])]
    if min(abs(number) for number in numbers) <= NEAR_M:
        raise ConfigError(f"drive.segments has '{segment}': lengths, radii and angles other than 0 are required")
    if word == "straight":
        return [Leg(length_m=numbers[0])]
    if word == "turn":
        return [Leg(turn_rad=math.radians(numbers[0]))]
    radius = numbers[0]
    angle = math.radians(numbers[1])
    return [Leg(abs(radius) * angle, math.copysign(1.0, radius) * angle)]


def _course(x: float, y: float, heading: float, leg: Leg) -> list[tuple[float, float, float]]:
    """Return positions and headings along a leg: at steps of the first full circle of an arc, and at the end."""
    circle = min(abs(leg.turn_rad), 2.0 * math.pi) if leg.length_m else 0.0
    fractions = [step * COURSE_STEP_RAD / abs(leg.turn_rad) for step in range(1, math.ceil(circle / COURSE_STEP_RAD))]
    return [_advance(x, y, heading, fraction * leg.length_m, fraction * leg.turn_rad) for fraction in (*fractions, 1.0)]


def _advance(x: float, y: float, heading: float, length: float, turn: float) -> tuple[float, float, float]:
    """Return position and heading after an arc: the chord is `length sinc(turn / 2)` long, at the mean heading."""
    chord = length * float(np.sinc(0.5 * turn / np.pi))
    middle = heading + 0.5 * turn
    return x + chord * math.cos(middle), y + chord * math.sin(middle), heading + turn


def states_of(config: DriveConfig, legs: list[Leg], rng: np.random.Generator) -> FloatArray:
    """Return x, y, heading and whether the wheels turn (1 or 0), `(N, 4)`, every `STEP_S`."""
    states = [(*_start(config), 0.0)]
    # a slowly changing standard normal number (first-order Gauss-Markov process)
    slip = float(rng.normal())
    keep = math.exp(-STEP_S / SLIP_TIME_S)
    for leg in legs:
        base = states[-1][:3]
        done = 0.0
        while done < COMPLETE:
            slip = keep * slip + math.sqrt(1 - keep**2) * float(rng.normal())
            grip = 1.0 - min(max(config.slip * (1.0 + SLIP_SPREAD * slip), 0.0), MAX_SLIP)
            done = min(done + STEP_S * leg.fraction_per_s(config, grip), 1.0)
            states.append((*_advance(*base, leg.length_m * done, leg.turn_rad * done), leg.wheels_turn))
    rows = np.array(states if len(states) > 1 else 2 * states)
    # sideways drift and heading errors change smoothly, and only while the wheels turn
    travelled = np.cumsum(rows[:, 3]) * STEP_S
    side, turn = rng.normal(size=(2, int(travelled[-1] / SWAY_TIME_S) + 3))
    side[0] = 0.0
    turn[0] = 0.0
    i, fraction = _smooth(travelled / SWAY_TIME_S)
    drift = config.sway_m * ((1 - fraction) * side[i] + fraction * side[i + 1])
    out = rows.copy()
    out[:, 0] -= drift * np.sin(rows[:, 2])
    out[:, 1] += drift * np.cos(rows[:, 2])
    out[:, 2] += math.radians(config.sway_deg) * ((1 - fraction) * turn[i] + fraction * turn[i + 1])
    return out


def _smooth(knots: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
    """Return the integer part of `knots`, and the fractional part smoothed by a cubic with zero slope at 0 and 1."""
    before = knots.astype(np.intp)
    t = knots - before
    return before, np.asarray(t * t * (3 - 2 * t))
