"""The rover and its drive: its pose on the ground, where its cameras are and when; RB is x forward, y left, z up [3.2].

A path is made of straight lines, arcs, point turns and stops, with slip and vibration.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.extrinsics import MAST_XY_RB_M, TILT_AXIS_Z_RB_M, mast_head_in_rb
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import NS_PER_S, Task
from sfr_loc_map.simulation.config import CamerasConfig, DriveConfig, SimulationConfig
from sfr_loc_map.simulation.terrain import Mesh, Terrain

GROUND_HEIGHT_RB_M = -0.540  #: Height of the ground plane in RB when deployed on flat ground [3.2.1].
WHEELS_RB_M = np.array([(x, y) for x in (0.62, 0.0, -0.62) for y in (0.52, -0.52)])
"""Positions of the six wheels in RB, metres (size of a fetch rover; the document gives none)."""
WHEEL_RADIUS_M = 0.18  #: m; assumed, as the positions are.
HALF_WIDTH_M = 0.70  #: Half of the width that is kept clear of large rocks; the wheels are at 0.52 m.
_ROLLING = np.linspace(-0.75, 0.75, 7) * WHEEL_RADIUS_M  # points under a wheel, along its direction, that can touch
_SPACING_M = 0.02  # spacing of the heights on which a wheel stands, m


def settle_on_terrain(
    terrain: Terrain, x: FloatArray, y: FloatArray, heading: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return position and attitude of RB with all wheels on the ground.

    Each wheel touches where its rim first meets the ground; a rocker-bogie suspension averages the wheels, so the
    body is parallel to the least-squares plane through the six wheel centres. Places of the origin `(N,)` in DS, m,
    headings from east to north; returns origins `(N, 3)` and rotations `(N, 3, 3)`, RB to DS.
    """
    c, s = np.cos(heading), np.sin(heading)
    wx = x[:, None] + c[:, None] * WHEELS_RB_M[:, 0] - s[:, None] * WHEELS_RB_M[:, 1]
    wy = y[:, None] + s[:, None] * WHEELS_RB_M[:, 0] + c[:, None] * WHEELS_RB_M[:, 1]
    px = (wx[..., None] + c[:, None, None] * _ROLLING).ravel()
    py = (wy[..., None] + s[:, None, None] * _ROLLING).ravel()
    ground = terrain.height(px, py, np.full(len(px), _SPACING_M)).reshape(*wx.shape, len(_ROLLING))
    centres = (ground + np.sqrt(WHEEL_RADIUS_M**2 - _ROLLING**2)).max(axis=2)
    design = np.column_stack((np.ones(len(WHEELS_RB_M)), WHEELS_RB_M))
    plane = centres @ np.linalg.pinv(design).T
    forward = np.stack((c, s, plane[:, 1]), axis=-1)
    left = np.stack((-s, c, plane[:, 2]), axis=-1)
    up = np.cross(forward, left)
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    rotation = np.stack((forward, np.cross(up, forward), up), axis=-1)
    # The plane of the wheels' centres passes below the origin along z of RB, not along the plumb line.
    height = plane[:, 0] + (-GROUND_HEIGHT_RB_M - WHEEL_RADIUS_M) / up[:, 2]
    return np.stack((x, y, height), axis=-1), rotation


def rover_mesh() -> Mesh:
    """Return a rover of boxes in RB that casts the shadow: deck, wheels, mast and mast head."""
    mast_x, mast_y = MAST_XY_RB_M
    boxes = [((-0.65, -0.45, -0.20), (0.55, 0.45, 0.10)), ((-0.75, -0.60, 0.10), (0.45, 0.60, 0.14))]
    boxes.append(((mast_x - 0.04, mast_y - 0.04, 0.10), (mast_x + 0.04, mast_y + 0.04, TILT_AXIS_Z_RB_M)))
    boxes.append(((mast_x - 0.08, mast_y - 0.18, TILT_AXIS_Z_RB_M), (mast_x + 0.08, mast_y + 0.18, 0.75)))
    low, high = GROUND_HEIGHT_RB_M, GROUND_HEIGHT_RB_M + 2 * WHEEL_RADIUS_M
    for x, y in WHEELS_RB_M:
        boxes.append(((x - 0.15, y - 0.07, low + 0.01), (x + 0.15, y + 0.07, high)))
    faces = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    triangles = np.array([t for a, b, c, d in faces for t in ((a, b, c), (a, c, d))], np.int32)
    parts = []
    for ends in boxes:
        corners = np.array([[ends[(k >> axis) & 1][axis] for axis in range(3)] for k in range(8)], np.float32)
        parts.append(Mesh(corners, np.zeros_like(corners), triangles, np.zeros(len(triangles), np.int32)))
    return Mesh.join(parts)


STEP_S = 0.05  #: Time between the states of the trajectory; poses between are interpolated.
VIBRATION_HZ = 6.0  #: Rate of the independent values between which the vibration is interpolated.
ARGUMENTS = {"straight": 1, "arc": 2, "turn": 1, "stop": 1, "goto": 2}  #: Numbers of each segment.
NEAR_M = 1e-6  #: Length below which a segment has no motion.
FARTHEST_M = 400.0  #: Largest extent of a path along x or y: the ground is 1024 m wide and centred on the path.


Leg = tuple[float, float, float]
"""A segment of constant curvature: a length, m, and the turn along it, rad; a turn on the spot; or a wait, s."""


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """Trajectory of the rover."""

    times_s: FloatArray  #: `(N,)` float64, seconds from the start.
    origins: FloatArray  #: `(N, 3)` float64, metres, DS.
    rotations: FloatArray  #: `(N, 3, 3)` float64, RB to DS.
    moving: FloatArray  #: `(N,)` float64, 1 where the wheels turn.
    vibration: FloatArray  #: `(M, 4)` float64, standard normal values at `VIBRATION_HZ`.
    config: DriveConfig  #: Settings.

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
        inside = min(max(time_s, 0.0), self.duration_s)
        pose = self._pose_inside(inside)
        if time_s == inside:
            return pose
        # a first exposure that began before the rover moved would show another position than that of its stamp
        mirrored = min(max(2.0 * inside - time_s, 0.0), self.duration_s)
        return pose @ self._pose_inside(mirrored).inverse() @ pose

    def _pose_inside(self, time_s: float) -> Transform:
        i = min(int(np.searchsorted(self.times_s, time_s, side="right")) - 1, len(self.times_s) - 2)
        share = (time_s - self.times_s[i]) / (self.times_s[i + 1] - self.times_s[i])
        origin = (1 - share) * self.origins[i] + share * self.origins[i + 1]
        u, _, vt = np.linalg.svd((1 - share) * self.rotations[i] + share * self.rotations[i + 1])
        rotation = np.asarray(u @ vt)  # the nearest to the blend
        moving = (1 - share) * self.moving[i] + share * self.moving[i + 1]
        before, eased = _smooth(np.array(time_s * VIBRATION_HZ))
        vibration = moving * ((1 - eased) * self.vibration[before] + eased * self.vibration[before + 1])
        angles = np.radians(self.config.vibration_deg) * vibration[:3]
        lift = rotation[:, 2] * (self.config.vibration_m * vibration[3])
        return Transform(rotation @ matrix_from_rotvec(angles), origin + lift)


def _legs(config: DriveConfig) -> list[Leg]:
    legs: list[Leg] = []
    x, y, heading = config.start_x_m, config.start_y_m, math.radians(config.start_heading_deg)
    for segment in config.segments:
        word, *rest = segment.split() or [""]
        try:
            numbers = [float(number) for number in rest]
        except ValueError:
            numbers = []
        if ARGUMENTS.get(word) != len(numbers) or not np.isfinite(numbers).all():
            known = "'straight M', 'arc RADIUS_M ANGLE_DEG', 'turn DEG', 'stop S', 'goto X Y'"
            raise ConfigError(f"drive.segments has '{segment}': one of {known} is needed")
        if word == "goto":
            dx, dy = numbers[0] - x, numbers[1] - y
            turn, length = math.remainder(math.atan2(dy, dx) - heading, 2 * math.pi), math.hypot(dx, dy)
            new = [(0.0, turn, 0.0), (length, 0.0, 0.0)] if length > NEAR_M else []
        elif word == "straight":
            new = [(numbers[0], 0.0, 0.0)]
        elif word == "arc":
            angle = math.radians(numbers[1])
            new = [(abs(numbers[0] * angle), math.copysign(1, numbers[0]) * abs(angle), 0.0)]
        elif word == "turn":
            new = [(0.0, math.radians(numbers[0]), 0.0)]
        else:
            new = [(0.0, 0.0, max(numbers[0], 0.0))]
        for length_m, turn_rad, _ in new:
            x, y, heading = _advance(x, y, heading, length_m, turn_rad)
        legs += new
        away = max(abs(x - config.start_x_m), abs(y - config.start_y_m))
        if away > FARTHEST_M:
            raise ConfigError(f"drive.segments go {away:.3g} m away: the ground reaches {FARTHEST_M:g} m")
    return legs


def _advance(x: float, y: float, heading: float, length: float, turn: float) -> tuple[float, float, float]:
    """Move along a circle: chord of length `l sinc(turn / 2)` at the mean heading."""
    chord = length * float(np.sinc(0.5 * turn / np.pi))
    middle = heading + 0.5 * turn
    return x + chord * math.cos(middle), y + chord * math.sin(middle), heading + turn


def _states(config: DriveConfig, legs: list[Leg], rng: np.random.Generator) -> FloatArray:
    """Return x, y, heading, moving `(N, 4)` every `STEP_S`."""
    states = [(config.start_x_m, config.start_y_m, math.radians(config.start_heading_deg), 0.0)]
    # a slowly changing standard normal number (first-order Gauss-Markov process of 2.5 s)
    slip, keep = float(rng.normal()), math.exp(-STEP_S / 2.5)
    for length_m, turn_rad, wait_s in legs:
        base = states[-1][:3]
        done = 0.0
        while done < 1.0 - 1e-12:
            slip = keep * slip + math.sqrt(1 - keep**2) * float(rng.normal())
            kept = 1.0 - min(max(config.slip * (1.0 + 0.6 * slip), 0.0), 0.95)
            if wait_s:  # share of the leg done per second
                rate = 1.0 / wait_s
            elif abs(length_m) > NEAR_M:  # backwards if it is negative
                rate = config.speed_m_s * kept / abs(length_m)
            else:
                rate = math.radians(config.turn_rate_deg_s) * kept / max(abs(turn_rad), 1e-9)
            done = min(done + STEP_S * rate, 1.0)
            states.append((*_advance(*base, length_m * done, turn_rad * done), 0.0 if wait_s else 1.0))
    rows = np.array(states if len(states) > 1 else 2 * states)
    # smooth sideways drift and heading errors that change only while wheels turn
    travelled = np.cumsum(rows[:, 3]) * STEP_S
    side, turn = rng.normal(size=(2, int(travelled[-1] / 2.0) + 3))
    side[0] = turn[0] = 0.0
    i, share = _smooth(travelled / 2.0)
    drift = config.sway_m * ((1 - share) * side[i] + share * side[i + 1])
    out = rows.copy()
    out[:, 0] -= drift * np.sin(rows[:, 2])
    out[:, 1] += drift * np.cos(rows[:, 2])
    out[:, 2] += math.radians(config.sway_deg) * ((1 - share) * turn[i] + share * turn[i + 1])
    return out


def _smooth(knots: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
    """Return the whole part of numbers, and a cubic share of the way to the next, at rest at both."""
    before = knots.astype(np.intp)
    t = knots - before
    return before, np.asarray(t * t * (3 - 2 * t))


PATH_STEP_M = 0.3  #: Distance between the points of the path about which ground and rocks are made.


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Where the cameras are and when, without the scene: quick to make."""

    config: SimulationConfig  #: Settings.
    terrain: Terrain  #: The ground.
    drive: Drive  #: Trajectory of the rover.
    #: The local map frame: below RB at the start of the drive, on the ground, x along the heading, z up.
    T_ds_lm: Transform

    @classmethod
    def make(cls, config: SimulationConfig) -> Plan:
        """Return the plan of a configuration; ConfigError if there is nothing to make, or the path is wrong."""
        pans, tilts = len(config.panorama.pan_deg), len(config.panorama.tilt_deg)
        if pans != tilts:
            raise ConfigError(f"panorama has {pans} pans and {tilts} tilts: give as many of both")
        if not (config.drive.enabled or config.panorama.enabled):
            raise ConfigError("neither drive nor panorama is enabled: enable at least one")
        if not config.drive.segments:
            raise ConfigError("drive.segments is empty: give at least one, as 'stop 1', or set drive.enabled=false")
        terrain = Terrain.make(config.seed, config.terrain, config.ground)
        rng = np.random.default_rng([config.seed, 5])
        states = _states(config.drive, _legs(config.drive), rng)
        times = np.arange(len(states), dtype=np.float64) * STEP_S
        origins, rotations = settle_on_terrain(terrain, *states.T[:3])
        vibration = rng.normal(size=(int(times[-1] * VIBRATION_HZ) + 3, 4))
        drive = Drive(times, origins, rotations, states[:, 3], vibration, config.drive)
        start = drive.pose(0.0)
        x, y = start.translation[:2]
        ground = terrain.height(np.array([x]), np.array([y]), np.array([0.02]))[0]
        heading = math.atan2(start.rotation[1, 0], start.rotation[0, 0])
        T_ds_lm = Transform(matrix_from_rotvec([0.0, 0.0, heading]), np.array([x, y, ground]))
        return cls(config, terrain, drive, T_ds_lm)

    def rig(self, task: Task) -> StereoRig:
        """Return the rectified rig of a task; that of localisation has its extrinsics in RB."""
        mapping = task is Task.MAPPING
        cameras = self.config.nav if mapping else self.config.loc
        centre = (0.5 * (cameras.width - 1), 0.5 * (cameras.height - 1))
        T_rb_sb = None if mapping else rig_extrinsics(cameras)
        focal = cameras.focal_px
        return StereoRig(cameras.width, cameras.height, focal, focal, *centre, cameras.baseline_m, T_rb_sb)

    def count(self, task: Task) -> int:
        """Return the number of pairs of a task."""
        if task is Task.MAPPING:
            return len(self.config.panorama.pan_deg) if self.config.panorama.enabled else 0
        return self.drive.count if self.config.drive.enabled else 0

    def stamp_ns(self, task: Task, frame: int) -> int:
        """Return the stamp of a pair: the middle of its exposure."""
        period = self.config.panorama.period_s if task is Task.MAPPING else self.config.drive.period_s
        return self.config.start_stamp_ns + round(frame * period * NS_PER_S)

    def rover_pose(self, task: Task, frame: int, delay_s: float = 0.0) -> Transform:
        """Return `T_ds_rb` of a pair, or shortly before or after its stamp."""
        return self.drive.pose(0.0 if task is Task.MAPPING else frame * self.config.drive.period_s + delay_s)

    def rig_pose(self, task: Task, frame: int, delay_s: float = 0.0) -> Transform:
        """Return `T_ds_locsb` or `T_ds_navsb` of a pair, or shortly before or after its stamp."""
        if task is Task.MAPPING:
            panorama = self.config.panorama
            pan, tilt = math.radians(panorama.pan_deg[frame]), math.radians(panorama.tilt_deg[frame])
            return self.rover_pose(task, frame) @ mast_head_in_rb(pan, tilt) @ rig_extrinsics(self.config.nav)
        return self.rover_pose(task, frame, delay_s) @ rig_extrinsics(self.config.loc)

    def lm_pose(self, frame: int) -> Transform:
        """Return `T_lm_navsb` of a mapping pair."""
        return self.T_ds_lm.inverse() @ self.rig_pose(Task.MAPPING, frame)

    def trajectory(self) -> Trajectory:
        """Return the true poses of RB in DS at the stamps of the localisation pairs."""
        task = Task.LOCALISATION
        return Trajectory.from_poses(
            (self.stamp_ns(task, k), self.rover_pose(task, k)) for k in range(self.count(task))
        )

    def path(self) -> FloatArray:
        """Return positions of the rover `(P, 2)`, metres, DS, some 0.3 m apart."""
        if not self.config.drive.enabled:
            return self.drive.origins[:1, :2].copy()
        end_s = (self.count(Task.LOCALISATION) - 1) * self.config.drive.period_s
        last = min(len(self.drive.origins) - 1, math.ceil(end_s / STEP_S))
        positions = self.drive.origins[: last + 1, :2]
        travelled = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1))))
        picks = np.searchsorted(travelled, np.arange(0.0, travelled[-1] + PATH_STEP_M, PATH_STEP_M))
        return np.asarray(positions[np.unique(np.minimum(picks, last))].copy())


def rig_extrinsics(cameras: CamerasConfig) -> Transform:
    """Return the pose of a stereo rig on its carrier (RB or mast head)."""
    angles = (cameras.roll_deg, cameras.pitch_deg, cameras.yaw_deg)
    about_x, about_y, about_z = (matrix_from_rotvec(math.radians(a) * np.eye(3)[k]) for k, a in enumerate(angles))
    return Transform(about_z @ about_y @ about_x, np.array([cameras.x_m, cameras.y_m, cameras.z_m]))
