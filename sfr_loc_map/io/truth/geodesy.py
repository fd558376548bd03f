"""Geographic positions in a local frame."""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray

WGS84_M = 6_378_137.0  #: Semi-major axis of the WGS 84 ellipsoid, metres.
WGS84_FLATTENING = 1.0 / 298.257223563  #: Flattening of the WGS 84 ellipsoid.


def enu_m(places: FloatArray) -> FloatArray:
    """Return positions `(N, 3)`, m, relative to the first position, along the axes east, north and up at that position.

    `places` `(N, 3)` contains latitude, deg, longitude, deg, and height above the WGS 84 ellipsoid, m. The conversion
    is that from geographic to topocentric coordinates, EPSG method 9837 (IOGP publication 373-7-2, section 4.1.2).
    """
    latitude = np.radians(places[:, 0])
    longitude = np.radians(places[:, 1])
    eccentricity_squared = WGS84_FLATTENING * (2.0 - WGS84_FLATTENING)
    normal = WGS84_M / np.sqrt(1.0 - eccentricity_squared * np.sin(latitude) ** 2)
    across = (normal + places[:, 2]) * np.cos(latitude)
    polar = (normal * (1.0 - eccentricity_squared) + places[:, 2]) * np.sin(latitude)
    geocentric = np.stack((across * np.cos(longitude), across * np.sin(longitude), polar), axis=1)
    if not len(geocentric):
        return geocentric
    sin_lat, cos_lat = np.sin(latitude[0]), np.cos(latitude[0])
    sin_lon, cos_lon = np.sin(longitude[0]), np.cos(longitude[0])
    east = [-sin_lon, cos_lon, 0.0]
    north = [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat]
    up = [cos_lat * cos_lon, cos_lat * sin_lon, sin_lat]
    return np.asarray((geocentric - geocentric[0]) @ np.array([east, north, up]).T)
