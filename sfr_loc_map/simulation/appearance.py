"""Appearance of the world and its light, as the shading takes them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.jit import jit_inline
from sfr_loc_map.simulation.config import GroundConfig, LightConfig, RockConfig
from sfr_loc_map.simulation.pebbles import ShadowDirection
from sfr_loc_map.simulation.terrain import MaterialShares, Terrain


class Surface(NamedTuple):
    """Appearance of ground and rocks.

    Attributes:
        albedo: Mean reflectance of the ground.
        contrast: Strength of the changes of reflectance.
        bump: Strength of the fine relief.
        pebbles: Fill of gravel with pebbles.
        lunar: Share of Lommel-Seeliger against Lambert reflection.
        rock_albedo: Mean reflectance of rocks.
    """

    albedo: float
    contrast: float
    bump: float
    pebbles: float
    lunar: float
    rock_albedo: float


class Light(NamedTuple):
    """Sun, sky and air.

    Attributes:
        sun_x: Unit vector towards the sun, DS.
        sun_y: Unit vector towards the sun, DS.
        sun_z: Unit vector towards the sun, DS.
        shadow: Where shadows fall.
        sky: Light of the sky on level ground, the overhead sun being 1.
        sky_grey: Brightness of the sky above the horizon.
        haze_m: Distance at which haze has taken 63 % of the contrast.
        gain: Factor that gives level mean ground in the sun a brightness of 1.
        target: Brightness of level mean ground in the image, as a share of the full range.
    """

    sun_x: float
    sun_y: float
    sun_z: float
    shadow: ShadowDirection
    sky: float
    sky_grey: float
    haze_m: float
    gain: float
    target: float


class ShadingParameters(NamedTuple):
    """All parameters of the shading.

    Attributes:
        surface: Appearance of ground and rocks.
        light: Sun, sky and air.
        shares: Shares of materials.
        seed: Seed of the ground.
    """

    surface: Surface
    light: Light
    shares: MaterialShares
    seed: np.uint32


def surface_parameters(ground: GroundConfig, rocks: RockConfig) -> Surface:
    """Return the appearance of a configuration."""
    return Surface(
        float(ground.albedo),
        float(ground.contrast),
        float(ground.bump),
        float(ground.pebbles),
        float(ground.lunar),
        float(rocks.albedo),
    )


def shading_parameters(
    surface: Surface, config: LightConfig, sun: FloatArray, target: float, terrain: Terrain
) -> ShadingParameters:
    """Return the parameters of the shading.

    Args:
        surface: Appearance of ground and rocks.
        config: Settings of the light.
        sun: `(3,)` unit vector towards the sun, DS.
        target: Brightness of level mean ground in the image, as a share of the full range.
        terrain: The ground.
    """
    level = reflect(sun[2], 0.5, surface.lunar) * sun[2] + config.sky
    x, y, z = (float(value) for value in sun)
    light = Light(
        x,
        y,
        z,
        ShadowDirection.of(sun),
        float(config.sky),
        float(config.sky_grey),
        float(config.haze_m),
        float(1.0 / (surface.albedo * level)),
        float(target),
    )
    return ShadingParameters(surface, light, terrain.parameters.shares, terrain.parameters.seed)


@jit_inline
def reflect(mu0: float, mu: float, lunar: float) -> float:
    """Lunar-Lambert reflection over the cosine of incidence: `2 L / (mu0 + mu) + 1 - L` (McEwen 1991)."""
    return 2.0 * lunar / (mu0 + mu + 1e-6) + 1.0 - lunar
