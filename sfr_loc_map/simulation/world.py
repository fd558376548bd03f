"""The scene of a plan, and the images and ground truth of the cameras."""

from __future__ import annotations

from collections.abc import Iterator
from enum import IntFlag

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.geometry.arrays import FloatImage, GreyImage, IntArray, PointImage
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.simulation import tracer
from sfr_loc_map.simulation.ground_mesh import Mesh, ground_mesh
from sfr_loc_map.simulation.noise import Stream, sub_seed
from sfr_loc_map.simulation.plan import Plan
from sfr_loc_map.simulation.rocks import place_rocks, rock_meshes
from sfr_loc_map.simulation.rover import HALF_WIDTH_M, rover_mesh
from sfr_loc_map.simulation.sensor import TASK_SEEDS, sensor_image
from sfr_loc_map.simulation.shading import shade, shading_parameters, sun_direction
from sfr_loc_map.suite_names import SIDES, Side, Task


class MaskBit(IntFlag):
    """Bits of the mask of a mapping image."""

    SKY = 1  #: No surface.
    SHADOW = 2  #: Not lit by the sun.
    OCCLUDED = 4  #: Not visible to the right camera.


class World:
    """The scene of a plan, ready for rendering."""

    def __init__(self, plan: Plan) -> None:
        """Build the scene, which takes a few seconds. Raises MissingExtraError if the ray tracer is not installed."""
        config = plan.config
        self.plan = plan
        path = plan.path()
        rocks = place_rocks(config.seed, config.rocks, plan.terrain, path, HALF_WIDTH_M)
        meshes = [ground_mesh(plan.terrain, path), *rock_meshes(config.seed, config.rocks, rocks)]
        self._tracer = tracer.Tracer(Mesh.join(meshes))
        self._sun = sun_direction(config.light)
        self._shading = shading_parameters(config, self._sun, plan.terrain)
        self._rover = tracer.Tracer(rover_mesh()) if config.light.rover_shadow else None

    def image(self, task: Task, frame: int, side: Side) -> GreyImage:
        """Return the rectified image `(H, W)` uint8 of a camera. Raises the errors of `brightness`."""
        config = self.plan.config
        return sensor_image(self.brightness(task, frame, side), config.seed, config.sensor, task, frame, side)

    def brightness(self, task: Task, frame: int, side: Side) -> FloatImage:
        """Return the brightness `(H, W)` before the sensor, as a fraction of the full range.

        Raises ConfigError if the task has no pair of this number, or if the side is neither "left" nor "right".
        """
        if side not in SIDES:
            raise ConfigError(f"side is {side!r}: one of {', '.join(SIDES)} is required")
        self.plan.check_frame(task, frame)
        config = self.plan.config
        rig = self.plan.rig(task)
        sensor = config.sensor
        sun_radius_rad = np.radians(config.light.sun_radius_deg)
        total = np.zeros(rig.height * rig.width, np.float32)
        for k, (du, dv, moment) in enumerate(tracer.sample_offsets(sensor.samples)):
            delay = moment * sensor.exposure_s
            T_ds_cam = tracer.camera_pose(self.plan.rig_pose(task, frame, delay), rig, side)
            occluder = self._occluder(task, frame, delay)
            for pixels in _bands(len(total)):
                u = pixels % rig.width + du
                v = pixels // rig.width + dv
                rays = tracer.pixel_rays(rig, T_ds_cam, u, v)
                hits = tracer.trace_primary_rays(self._tracer, T_ds_cam.translation, rays)
                key = sub_seed(
                    config.seed, Stream.SUN_SAMPLES, TASK_SEEDS[task], frame, SIDES.index(side), k, int(pixels[0])
                )
                suns = tracer.sun_rays(self._sun, sun_radius_rad, len(pixels), key)
                lit = tracer.trace_shadow_rays(self._tracer, hits, suns, occluder)
                bright = np.empty(len(pixels), np.float32)
                shade(hits, rays, lit, 1.0 / rig.fx, self._shading, bright)
                total[pixels] += bright
        return (total / np.float32(sensor.samples)).reshape(rig.height, rig.width)

    def truth(self, frame: int) -> tuple[PointImage, NDArray[np.uint8]]:
        """Return the points `(H, W, 3)` of the left image, m, LM, NaN for sky, and the mask `(H, W)` of `MaskBit`.

        Raises ConfigError if the panorama has no pair of this number.
        """
        self.plan.check_frame(Task.MAPPING, frame)
        rig = self.plan.rig(Task.MAPPING)
        T_ds_sb = self.plan.rig_pose(Task.MAPPING, frame)
        T_ds_left = tracer.camera_pose(T_ds_sb, rig, "left")
        T_ds_right = tracer.camera_pose(T_ds_sb, rig, "right")
        count = rig.height * rig.width
        points = np.empty((count, 3), np.float32)
        mask = np.zeros(count, np.uint8)
        T_lm_ds = self.plan.T_ds_lm.inverse()
        occluder = self._occluder(Task.MAPPING, frame, 0.0)
        for pixels in _bands(count):
            rays = tracer.pixel_rays(rig, T_ds_left, pixels % rig.width, pixels // rig.width)
            hits = tracer.trace_primary_rays(self._tracer, T_ds_left.translation, rays)
            sky = hits.objects == tracer.SKY
            points[pixels] = np.where(sky[:, None], np.nan, T_lm_ds.apply(hits.points))
            suns = np.repeat(self._sun[None].astype(np.float32), len(pixels), axis=0)
            lit = tracer.trace_shadow_rays(self._tracer, hits, suns, occluder)
            occluded = tracer.occlusion_mask(self._tracer, hits, T_ds_right, rig)
            mask[pixels] = MaskBit.SKY * sky + MaskBit.SHADOW * (~sky & (lit == 0)) + MaskBit.OCCLUDED * occluded
        return points.reshape(rig.height, rig.width, 3), mask.reshape(rig.height, rig.width)

    def _occluder(self, task: Task, frame: int, delay_s: float) -> tuple[tracer.Tracer, Transform] | None:
        """Return the boxes of the rover with their pose in DS; None if the rover casts no shadow."""
        return None if self._rover is None else (self._rover, self.plan.rover_pose(task, frame, delay_s))


def _bands(count: int) -> Iterator[IntArray]:
    """Yield the pixel indices of an image in blocks that are traced together."""
    for start in range(0, count, tracer.BAND_RAYS):
        yield np.arange(start, min(start + tracer.BAND_RAYS, count))
