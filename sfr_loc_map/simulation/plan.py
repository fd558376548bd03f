"""Poses and stamps of the cameras, without the scene."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sfr_loc_map.configuration.parameters import checked
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.extrinsics import mast_head_in_rb
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.simulation.config import MAX_DRIVE_PAIRS, SimulationConfig
from sfr_loc_map.simulation.drive import STEP_S, VIBRATION_HZ, Drive, legs_of, states_of
from sfr_loc_map.simulation.noise import Stream
from sfr_loc_map.simulation.rover import SPACING_M, rig_extrinsics, settle_on_terrain
from sfr_loc_map.simulation.terrain import Terrain
from sfr_loc_map.suite_names import Task

PATH_STEP_M = 0.3  #: Distance between path points, around which ground and rocks are generated.
MAX_PANORAMA_PAIRS = 3  #: Largest number of pairs of a panorama, from which one map is made [1.3].


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Poses and stamps of the cameras, without the scene."""

    config: SimulationConfig  #: Settings.
    terrain: Terrain  #: The ground.
    drive: Drive  #: Trajectory of the rover.
    #: The local map frame: on the ground below RB at the start of the drive, x along the heading, z up.
    T_ds_lm: Transform

    @classmethod
    def make(cls, config: SimulationConfig) -> Plan:
        """Return the plan of a configuration.

        If the drive is disabled, the rover stays at the start of the drive, and the segments are ignored.

        Raises ConfigError if a value is out of range, settings contradict each other, nothing is enabled, or the path
        of an enabled drive is invalid.
        """
        config = checked(config)
        _check_settings(config)
        terrain = Terrain.make(config.seed, config.terrain, config.ground)
        rng = np.random.default_rng([config.seed, Stream.DRIVE])
        legs = legs_of(config.drive) if config.drive.enabled else []
        states = states_of(config.drive, legs, rng)
        times = np.arange(len(states), dtype=np.float64) * STEP_S
        origins, rotations = settle_on_terrain(terrain, *states.T[:3])
        vibration = rng.normal(size=(int(times[-1] * VIBRATION_HZ) + 3, 4))
        drive = Drive(times, origins, rotations, states[:, 3], vibration, config.drive)
        if drive.count > MAX_DRIVE_PAIRS:
            raise ConfigError(
                f"the drive has {drive.count} pairs: at most {MAX_DRIVE_PAIRS} are allowed; increase drive.period_s, "
                "or set drive.pairs"
            )
        start = drive.pose(0.0)
        x, y = start.translation[:2]
        ground = terrain.height(np.array([x]), np.array([y]), np.array([SPACING_M]))[0]
        heading = math.atan2(start.rotation[1, 0], start.rotation[0, 0])
        T_ds_lm = Transform(matrix_from_rotvec([0.0, 0.0, heading]), np.array([x, y, ground]))
        return cls(config, terrain, drive, T_ds_lm)

    def rig(self, task: Task) -> StereoRig:
        """Return the rectified rig of a task; the localisation rig has extrinsics in RB."""
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

    def check_frame(self, task: Task, frame: int) -> None:
        """Raise ConfigError if a task has no pair with the number `frame`."""
        if not 0 <= frame < self.count(task):
            raise ConfigError(f"frame is {frame}: {task} has {self.count(task)} pairs, numbered from 0")

    def stamp_ns(self, task: Task, frame: int) -> int:
        """Return the stamp of a pair, which is the middle of the exposure."""
        period = self.config.panorama.period_s if task is Task.MAPPING else self.config.drive.period_s
        return self.config.start_stamp_ns + round(frame * period * NS_PER_S)

    def rover_pose(self, task: Task, frame: int, delay_s: float = 0.0) -> Transform:
        """Return `T_ds_rb` at the stamp of a pair plus a short delay."""
        return self.drive.pose(0.0 if task is Task.MAPPING else frame * self.config.drive.period_s + delay_s)

    def rig_pose(self, task: Task, frame: int, delay_s: float = 0.0) -> Transform:
        """Return `T_ds_locsb` or `T_ds_navsb` at the stamp of a pair plus a short delay.

        The delay does not move the mapping cameras, because the rover and the mast are stationary in a panorama.
        """
        if task is Task.MAPPING:
            pan = math.radians(self.config.panorama.pan_deg[frame])
            tilt = math.radians(self.config.panorama.tilt_deg[frame])
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
        """Return positions of the rover `(P, 2)`, metres, DS, about 0.3 m apart."""
        if not self.config.drive.enabled:
            return self.drive.origins[:1, :2].copy()
        end_s = (self.count(Task.LOCALISATION) - 1) * self.config.drive.period_s
        last = min(len(self.drive.origins) - 1, math.ceil(end_s / STEP_S))
        positions = self.drive.origins[: last + 1, :2]
        travelled = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1))))
        picks = np.searchsorted(travelled, np.arange(0.0, travelled[-1] + PATH_STEP_M, PATH_STEP_M))
        return np.asarray(positions[np.unique(np.minimum(picks, last))].copy())


def _check_settings(config: SimulationConfig) -> None:
    """Raise ConfigError if settings contradict each other."""
    pans = len(config.panorama.pan_deg)
    tilts = len(config.panorama.tilt_deg)
    if config.panorama.enabled and pans != tilts:
        raise ConfigError(f"panorama has {pans} pans and {tilts} tilts: equal numbers are required")
    if not (config.drive.enabled or config.panorama.enabled):
        raise ConfigError("neither drive nor panorama is enabled: enable at least one")
    if config.panorama.enabled and not pans:
        raise ConfigError("panorama.pan_deg is empty: give the pan and the tilt of a pair, or disable the panorama")
    if config.panorama.enabled and pans > MAX_PANORAMA_PAIRS:
        raise ConfigError(
            f"panorama.pan_deg has {pans} pairs: at most {MAX_PANORAMA_PAIRS} are allowed, from which one map is made"
        )
    if config.drive.enabled and not config.drive.segments:
        raise ConfigError("drive.segments is empty: give a segment ('stop 1')")
    rocks = config.rocks
    if rocks.cover > 0.0 and rocks.smallest_m >= rocks.largest_m:
        raise ConfigError(
            f"rocks.smallest_m is {rocks.smallest_m:g} m and rocks.largest_m {rocks.largest_m:g} m: no rock has "
            "such a size; give a larger rocks.largest_m, or rocks.cover 0"
        )
