"""A configured world: its scene, where the cameras are, and what they see."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.frames import mast_head_in_rb
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.simulation.config import CamerasConfig, SimulationConfig
from sfr_loc_map.simulation.drive import Drive, make_drive
from sfr_loc_map.simulation.mesh import Mesh, ground_mesh
from sfr_loc_map.simulation.noise import sub_seed
from sfr_loc_map.simulation.rays import camera_pose, pixel_rays, sample_offsets, sun_rays
from sfr_loc_map.simulation.renderer import (
    BAND_RAYS,
    SKY_OBJECT,
    Occluder,
    Tracer,
    hidden,
    see,
    sun_seen,
)
from sfr_loc_map.simulation.rocks import place_rocks, rock_mesh
from sfr_loc_map.simulation.rover import HALF_WIDTH_M, rover_mesh
from sfr_loc_map.simulation.sensor import Sensor
from sfr_loc_map.simulation.shading import look_values, shade
from sfr_loc_map.simulation.terrain import Terrain

LOC, NAV = 0, 1
SKY, SHADOW, UNSEEN = 1, 2, 4
"""Bits of a mask: no surface; no sun; not seen by the right camera."""
WAY_STEP_M = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Where the cameras are and when, without the scene: quick to make.

    Attributes:
        config: Settings.
        terrain: The ground.
        drive: The way.
        T_ds_lm: The local map frame: below RB at the start of the way, on the ground, x along the heading, z up.
    """

    config: SimulationConfig
    terrain: Terrain
    drive: Drive
    T_ds_lm: Transform

    @classmethod
    def make(cls, config: SimulationConfig) -> Plan:
        """Return the plan of a configuration.

        Raises:
            ConfigError: If pans and tilts do not match, nothing is asked for, or the way or the distortion is wrong.
        """
        if len(config.panorama.pan_deg) != len(config.panorama.tilt_deg):
            raise ConfigError(
                f"panorama has {len(config.panorama.pan_deg)} pans and {len(config.panorama.tilt_deg)} tilts: "
                "give as many of both"
            )
        if not (config.drive.enabled or config.panorama.enabled):
            raise ConfigError("neither drive nor panorama is enabled: enable at least one")
        if len(config.sensor.distortion) != 4:
            raise ConfigError(f"sensor.distortion has {len(config.sensor.distortion)} numbers: k1 k2 p1 p2 are needed")
        terrain = Terrain.make(config.seed, config.terrain, config.ground)
        drive = make_drive(config.seed, config.drive, terrain)
        start = drive.pose(0.0)
        x, y = start.translation[:2]
        ground = terrain.height(np.array([x]), np.array([y]), np.array([0.02]))[0]
        heading = math.atan2(start.rotation[1, 0], start.rotation[0, 0])
        place = Transform(matrix_from_rotvec([0.0, 0.0, heading]), np.array([x, y, ground]))
        return cls(config, terrain, drive, place)

    def rig(self, task: int) -> StereoRig:
        """Return the rectified rig of a task; that of localisation knows its place in RB."""
        cameras = self.config.nav if task == NAV else self.config.loc
        centre = (0.5 * (cameras.width - 1), 0.5 * (cameras.height - 1))
        place = None if task == NAV else bench_place(cameras)
        return StereoRig(
            cameras.width, cameras.height, cameras.focal_px, cameras.focal_px, *centre, cameras.baseline_m, place
        )

    def count(self, task: int) -> int:
        """Return the number of pairs of a task."""
        if task == NAV:
            return len(self.config.panorama.pan_deg) if self.config.panorama.enabled else 0
        return self.drive.count if self.config.drive.enabled else 0

    def stamp_ns(self, task: int, frame: int) -> int:
        """Return the stamp of a pair: the middle of its exposure."""
        period = self.config.panorama.period_s if task == NAV else self.config.drive.period_s
        return self.config.start_stamp_ns + round(frame * period * 1e9)

    def rover_pose(self, task: int, frame: int, delay_s: float = 0.0) -> Transform:
        """Return `T_ds_rb` of a pair, or shortly before or after its stamp."""
        return self.drive.pose(0.0 if task == NAV else frame * self.config.drive.period_s + delay_s)

    def bench_pose(self, task: int, frame: int, delay_s: float = 0.0) -> Transform:
        """Return `T_ds_locsb` or `T_ds_navsb` of a pair, or shortly before or after its stamp."""
        if task == NAV:
            panorama = self.config.panorama
            pan, tilt = math.radians(panorama.pan_deg[frame]), math.radians(panorama.tilt_deg[frame])
            return self.rover_pose(NAV, frame) @ mast_head_in_rb(pan, tilt) @ bench_place(self.config.nav)
        return self.rover_pose(LOC, frame, delay_s) @ bench_place(self.config.loc)

    def lm_pose(self, frame: int) -> Transform:
        """Return `T_lm_navsb` of a mapping pair."""
        return self.T_ds_lm.inverse() @ self.bench_pose(NAV, frame)

    def trajectory(self) -> Trajectory:
        """Return the true poses of RB in DS at the stamps of the localisation pairs."""
        period = self.config.drive.period_s
        return Trajectory.from_poses(
            (self.stamp_ns(LOC, k), self.drive.pose(k * period)) for k in range(self.count(LOC))
        )

    def way(self) -> FloatArray:
        """Return places of the rover `(P, 2)`, metres, DS, some 0.3 m apart."""
        if not self.config.drive.enabled:
            return self.drive.origins[:1, :2].copy()
        last = min(len(self.drive.origins) - 1, math.ceil((self.count(LOC) - 1) * self.config.drive.period_s / 0.05))
        places = self.drive.origins[: last + 1, :2]
        travelled = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))))
        picks = np.searchsorted(travelled, np.arange(0.0, travelled[-1] + WAY_STEP_M, WAY_STEP_M))
        return np.asarray(places[np.unique(np.minimum(picks, last))].copy())


def bench_place(cameras: CamerasConfig) -> Transform:
    """Return the place of a stereo bench on its carrier (RB or mast head)."""
    angles = (cameras.roll_deg, cameras.pitch_deg, cameras.yaw_deg)
    about_x, about_y, about_z = (matrix_from_rotvec(math.radians(a) * np.eye(3)[k]) for k, a in enumerate(angles))
    return Transform(about_z @ about_y @ about_x, np.array([cameras.x_m, cameras.y_m, cameras.z_m]))


class World:
    """The scene of a plan, ready to be seen."""

    def __init__(self, plan: Plan) -> None:
        """Build the scene: a few seconds.

        Raises:
            MissingExtraError: If the ray tracer is not installed.
        """
        config = plan.config
        self.plan = plan
        way = plan.way()
        rocks = place_rocks(config.seed, config.rocks, plan.terrain, way, HALF_WIDTH_M)
        self._tracer = Tracer(Mesh.join([ground_mesh(plan.terrain, way), rock_mesh(config.seed, config.rocks, rocks)]))
        elevation, azimuth = math.radians(config.light.sun_elevation_deg), math.radians(config.light.sun_azimuth_deg)
        level = math.cos(elevation)
        self._sun = np.array([level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)])
        self._look = look_values(config.ground, config.rocks, config.light, self._sun)
        self._rover = Tracer(rover_mesh()) if config.light.rover_shadow else None
        self._sensors = [Sensor(config.seed, task, config.sensor, plan.rig(task)) for task in (LOC, NAV)]

    def picture(self, task: int, frame: int, camera: int) -> NDArray[np.uint8]:
        """Return the rectified picture `(H, W)` of a camera (0 left, 1 right)."""
        bright = self.brightness(task, frame, camera)
        return self._sensors[task].picture(bright, frame, camera)

    def brightness(self, task: int, frame: int, camera: int) -> NDArray[np.float32]:
        """Return the raw brightness `(H, W)` before the sensor, as a share of the full range."""
        rig, sensor = self.plan.rig(task), self.plan.config.sensor
        total = np.zeros(rig.height * rig.width, np.float32)
        for k, (du, dv, moment) in enumerate(sample_offsets(sensor.samples)):
            delay = moment * sensor.exposure_s
            pose = camera_pose(self.plan.bench_pose(task, frame, delay), rig, bool(camera))
            occluder = self._occluder(task, frame, delay)
            for start in range(0, len(total), BAND_RAYS):
                pixels = np.arange(start, min(start + BAND_RAYS, len(total)))
                u, v = self._sensors[task].raw_to_rectified(pixels % rig.width + du, pixels // rig.width + dv)
                key = sub_seed(self.plan.config.seed, 20, task, frame, camera, k, start)
                total[pixels] += self._band(rig, pose, u, v, key, occluder)
        return (total / np.float32(sensor.samples)).reshape(rig.height, rig.width)

    def truth(self, frame: int) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """Return what the left mapping camera sees at each pixel's centre.

        Returns:
            Points `(H, W, 3)`, metres, LM, NaN for the sky; mask `(H, W)` of the bits `SKY`, `SHADOW`, `UNSEEN`.
        """
        rig = self.plan.rig(NAV)
        T_ds_sb = self.plan.bench_pose(NAV, frame)
        left, right = (camera_pose(T_ds_sb, rig, side) for side in (False, True))
        count = rig.height * rig.width
        points, mask = np.empty((count, 3), np.float32), np.zeros(count, np.uint8)
        T_lm_ds = self.plan.T_ds_lm.inverse()
        occluder = self._occluder(NAV, frame, 0.0)
        for start in range(0, count, BAND_RAYS):
            pixels = np.arange(start, min(start + BAND_RAYS, count))
            rays = pixel_rays(
                rig, (pixels % rig.width).astype(float), (pixels // rig.width).astype(float), left.rotation
            )
            hits = see(self._tracer, left.translation, rays)
            sky = hits.objects == SKY_OBJECT
            points[pixels] = np.where(sky[:, None], np.nan, T_lm_ds.apply(hits.points))
            suns = np.repeat(self._sun[None].astype(np.float32), len(pixels), axis=0)
            lit = sun_seen(self._tracer, hits, suns, occluder)
            unseen = hidden(self._tracer, hits, right, rig)
            mask[pixels] = SKY * sky + SHADOW * (~sky & (lit == 0)) + UNSEEN * unseen
        return points.reshape(rig.height, rig.width, 3), mask.reshape(rig.height, rig.width)

    def _occluder(self, task: int, frame: int, delay_s: float) -> Occluder | None:
        return None if self._rover is None else Occluder(self._rover, self.plan.rover_pose(task, frame, delay_s))

    def _band(
        self,
        rig: StereoRig,
        pose: Transform,
        u: FloatArray,
        v: FloatArray,
        key: np.uint32,
        occluder: Occluder | None,
    ) -> NDArray[np.float32]:
        rays = pixel_rays(rig, u, v, pose.rotation)
        hits = see(self._tracer, pose.translation, rays)
        radius = math.radians(self.plan.config.light.sun_radius_deg)
        lit = sun_seen(self._tracer, hits, sun_rays(self._sun, radius, len(u), key), occluder)
        out = np.empty(len(u), np.float32)
        shade(
            hits.points, hits.normals, hits.objects, lit, rays, hits.ranges, 1.0 / rig.fx, self._look,
            self.plan.terrain.shares, self.plan.terrain.seed, self.plan.config.sensor.target_grey, out,
        )  # fmt: skip
        return out
