"""Trajectory of the rover: straight lines, arcs, point turns, stops, with slip and vibration."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.simulation.config import DriveConfig
from sfr_loc_map.simulation.rover import settle_on_terrain
from sfr_loc_map.simulation.terrain import Terrain

STEP_S = 0.05
"""Time between the states of the trajectory; poses between are interpolated."""
VIBRATION_HZ = 6.0
ARGUMENTS = {"straight": 1, "arc": 2, "turn": 1, "stop": 1, "goto": 2}
NEAR_M = 1e-6
FARTHEST_M = 400.0
"""Largest extent of a path along x or y: the ground is 1024 m wide and centred on the path."""


@dataclass(frozen=True, slots=True)
class _Leg:
    """A segment of constant curvature: a length, or a turn on the spot, or a wait."""

    length_m: float
    turn_rad: float
    wait_s: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """Trajectory of the rover.

    Attributes:
        times_s: `(N,)` float64, seconds from the start.
        origins: `(N, 3)` float64, metres, DS.
        headings: `(N,)` float64, radians, not wrapped.
        rotations: `(N, 3, 3)` float64, RB to DS.
        moving: `(N,)` float64, 1 where the wheels turn.
        vibration: `(M, 4)` float64, standard normal values at `VIBRATION_HZ`.
        config: Settings.
    """

    times_s: FloatArray
    origins: FloatArray
    headings: FloatArray
    rotations: FloatArray
    moving: FloatArray
    vibration: FloatArray
    config: DriveConfig

    @property
    def duration_s(self) -> float:
        """Time from start to end."""
        return float(self.times_s[-1])

    @property
    def count(self) -> int:
        """Number of pairs taken along the path."""
        whole = math.floor(self.duration_s / self.config.period_s + 1e-9) + 1
        return min(whole, self.config.pairs) if self.config.pairs else whole

    def pose(self, time_s: float) -> Transform:
        """Return `T_ds_rb` at a time; shortly before the start and after the end the rover moves as just inside."""
        inside = self._clamped(time_s)
        pose = self._pose_inside(inside)
        if time_s == inside:
            return pose
        # a first exposure that began before the rover moved would show another position than that of its stamp
        return pose @ self._pose_inside(self._clamped(2.0 * inside - time_s)).inverse() @ pose

    def _clamped(self, time_s: float) -> float:
        return min(max(time_s, 0.0), self.duration_s)

    def _pose_inside(self, time_s: float) -> Transform:
        i = min(int(np.searchsorted(self.times_s, time_s, side="right")) - 1, len(self.times_s) - 2)
        share = (time_s - self.times_s[i]) / (self.times_s[i + 1] - self.times_s[i])
        origin = (1 - share) * self.origins[i] + share * self.origins[i + 1]
        rotation = _orthonormal((1 - share) * self.rotations[i] + share * self.rotations[i + 1])
        moving = (1 - share) * self.moving[i] + share * self.moving[i + 1]
        vibration = moving * self._vibration(time_s)
        angles = np.radians(self.config.vibration_deg) * vibration[:3]
        lift = rotation[:, 2] * (self.config.vibration_m * vibration[3])
        return Transform(rotation @ matrix_from_rotvec(angles), origin + lift)

    def _vibration(self, time_s: float) -> FloatArray:
        index = time_s * VIBRATION_HZ
        i = int(index)
        t = index - i
        s = t * t * (3 - 2 * t)
        return np.asarray((1 - s) * self.vibration[i] + s * self.vibration[i + 1])


def make_drive(seed: int, config: DriveConfig, terrain: Terrain) -> Drive:
    """Return the drive of a configuration over a ground.

    Raises:
        ConfigError: If there is no segment, one is not understood, or the path leaves the ground.
    """
    if not config.segments:
        raise ConfigError("drive.segments is empty: give at least one, as 'stop 1', or set drive.enabled=false")
    rng = np.random.default_rng([seed, 5])
    legs = _legs(config)
    states = _states(config, legs, rng)
    times = np.arange(len(states), dtype=np.float64) * STEP_S
    x, y, heading, moving = states.T
    origins, rotations = settle_on_terrain(terrain, x, y, heading)
    vibration = rng.normal(size=(int(times[-1] * VIBRATION_HZ) + 3, 4))
    return Drive(times, origins, heading, rotations, moving, vibration, config)


def _legs(config: DriveConfig) -> list[_Leg]:
    legs: list[_Leg] = []
    x, y, heading = config.start_x_m, config.start_y_m, math.radians(config.start_heading_deg)
    for segment in config.segments:
        word, numbers = _parse(segment)
        if word == "goto":
            dx, dy = numbers[0] - x, numbers[1] - y
            if math.hypot(dx, dy) > NEAR_M:
                turn = math.remainder(math.atan2(dy, dx) - heading, 2 * math.pi)
                new = [_Leg(0.0, turn), _Leg(math.hypot(dx, dy), 0.0)]
            else:
                new = []
        elif word == "straight":
            new = [_Leg(numbers[0], 0.0)]
        elif word == "arc":
            new = [
                _Leg(
                    abs(numbers[0] * math.radians(numbers[1])),
                    math.copysign(1, numbers[0]) * abs(math.radians(numbers[1])),
                )
            ]
        elif word == "turn":
            new = [_Leg(0.0, math.radians(numbers[0]))]
        else:
            new = [_Leg(0.0, 0.0, max(numbers[0], 0.0))]
        for leg in new:
            x, y, heading = _advance(x, y, heading, leg.length_m, leg.turn_rad)
        legs += new
        away = max(abs(x - config.start_x_m), abs(y - config.start_y_m))
        if away > FARTHEST_M:
            raise ConfigError(f"drive.segments go {away:.3g} m away: the ground reaches {FARTHEST_M:g} m")
    return legs


def _parse(segment: str) -> tuple[str, list[float]]:
    word, *rest = segment.split() or [""]
    try:
        numbers = [float(number) for number in rest]
    except ValueError:
        numbers = []
    if ARGUMENTS.get(word) != len(numbers) or not np.isfinite(numbers).all():
        known = "'straight M', 'arc RADIUS_M ANGLE_DEG', 'turn DEG', 'stop S', 'goto X Y'"
        raise ConfigError(f"drive.segments has '{segment}': one of {known} is needed")
    return word, numbers


def _advance(x: float, y: float, heading: float, length: float, turn: float) -> tuple[float, float, float]:
    """Move along a circle: chord of length `l sinc(turn / 2)` at the mean heading."""
    chord = length * float(np.sinc(0.5 * turn / np.pi))
    middle = heading + 0.5 * turn
    return x + chord * math.cos(middle), y + chord * math.sin(middle), heading + turn


def _states(config: DriveConfig, legs: list[_Leg], rng: np.random.Generator) -> FloatArray:
    """Return x, y, heading, moving `(N, 4)` every `STEP_S`."""
    start = (config.start_x_m, config.start_y_m, math.radians(config.start_heading_deg))
    rows = [(*start, 0.0)]
    slip = _MarkovProcess(rng, 2.5)
    for leg in legs:
        base = rows[-1][:3]
        done = 0.0
        while done < 1.0 - 1e-12:
            done = min(done + STEP_S * _rate(config, leg, slip()), 1.0)
            state = _advance(*base, leg.length_m * done, leg.turn_rad * done)
            rows.append((*state, 0.0 if leg.wait_s else 1.0))
    if len(rows) == 1:
        rows *= 2
    return _swayed(config, np.array(rows), rng)


def _rate(config: DriveConfig, leg: _Leg, slip: float) -> float:
    """Return the share of a leg done per second."""
    if leg.wait_s:
        return 1.0 / leg.wait_s
    kept = 1.0 - min(max(config.slip * (1.0 + 0.6 * slip), 0.0), 0.95)
    if abs(leg.length_m) > NEAR_M:  # backwards if it is negative
        return config.speed_m_s * kept / abs(leg.length_m)
    return math.radians(config.turn_rate_deg_s) * kept / max(abs(leg.turn_rad), 1e-9)


def _swayed(config: DriveConfig, rows: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Add smooth sideways drift and heading errors that change only while wheels turn."""
    travelled = np.cumsum(rows[:, 3]) * STEP_S
    knots = int(travelled[-1] / 2.0) + 3
    side, turn = rng.normal(size=(2, knots))
    side[0] = turn[0] = 0.0
    knot = travelled / 2.0
    i = knot.astype(int)
    t = knot - i
    share = t * t * (3 - 2 * t)
    drift = config.sway_m * ((1 - share) * side[i] + share * side[i + 1])
    out = rows.copy()
    out[:, 0] -= drift * np.sin(rows[:, 2])
    out[:, 1] += drift * np.cos(rows[:, 2])
    out[:, 2] += math.radians(config.sway_deg) * ((1 - share) * turn[i] + share * turn[i + 1])
    return out


class _MarkovProcess:
    """A slowly changing standard normal number (first-order Gauss-Markov process)."""

    def __init__(self, rng: np.random.Generator, time_s: float) -> None:
        self._rng, self._keep, self._value = rng, math.exp(-STEP_S / time_s), float(rng.normal())

    def __call__(self) -> float:
        self._value = self._keep * self._value + math.sqrt(1 - self._keep**2) * float(self._rng.normal())
        return self._value


def _orthonormal(matrix: FloatArray) -> FloatArray:
    """Return the rotation nearest to a blend of two near rotations."""
    u, _, vt = np.linalg.svd(matrix)
    return np.asarray(u @ vt)
