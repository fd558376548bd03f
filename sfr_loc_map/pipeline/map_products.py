"""What a map can be had as besides a cloud: elevation model, image, coloured cloud, covariances."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import OutputError
from sfr_loc_map.geometry.arrays import ColourImage
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.io.atomic import atomic_path
from sfr_loc_map.mapping.terrain.elevation import ElevationModel

HEIGHT_QUANTILES = (0.01, 0.99)
"""Heights between these fill the range of colours; what is beyond takes the colour at the end."""
LIGHT = np.array([-1.0, 1.0, 1.5])
"""Direction towards the light of the shaded image: from the upper left, as on maps."""
AMBIENT = 0.35
BRIDGED_SHARE = 0.1
"""Share of weighted neighbours that must have a height for a gap to be bridged in the image."""
RIM_SHARE = 0.01
VOID = (32, 32, 32)
COLOURED_TYPE = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1"), ("sigma", "<f4")]
)


def save_elevation(path: Path, model: ElevationModel) -> None:
    """Write an elevation model as NPZ.

    Its arrays: `height_m`, `sigma_m`, `count` (rows along y, columns along x of LM), `origin_m` (x and y of the outer
    corner of cell (0, 0)), `cell_m`.

    Raises:
        OutputError: If the file cannot be written.
    """
    with atomic_path(path) as temporary:
        np.savez_compressed(
            temporary,
            height_m=model.height_m,
            sigma_m=model.sigma_m,
            count=model.count,
            origin_m=np.array(model.origin_m),
            cell_m=np.array(model.cell_m),
        )


def save_elevation_figure(path: Path, model: ElevationModel) -> None:
    """Write a PNG of the heights, coloured and shaded, y of LM upwards, cells without height dark.

    Raises:
        OutputError: If the file cannot be written.
    """
    with atomic_path(path) as temporary:
        if not cv2.imwrite(str(temporary), elevation_figure(model)[::-1]):
            raise OutputError(f"cannot write '{path}': the image could not be encoded")


def elevation_figure(model: ElevationModel) -> ColourImage:
    """Return heights as colours, shaded by their slopes, `(R, C, 3)` in the order blue, green, red.

    For the look of it gaps of a cell or two are bridged, and sparse rows and columns at the rim are left out.
    """
    heights = _bridged(model.height_m)[_dense(model.count)]
    known = np.isfinite(heights)
    filled = np.where(known, heights, np.float32(np.nanmedian(model.height_m)))
    slope_y, slope_x = np.gradient(filled.astype(np.float64), model.cell_m) if min(filled.shape) > 1 else (0.0, 0.0)
    light = LIGHT / np.linalg.norm(LIGHT)
    lit = (light[2] - slope_x * light[0] - slope_y * light[1]) / np.sqrt(1.0 + np.square(slope_x) + np.square(slope_y))
    shade = AMBIENT + (1.0 - AMBIENT) * np.clip(lit / light[2], 0.0, 1.3)
    image = height_colours(filled, known) * np.asarray(shade)[..., None]
    image[~known] = VOID
    return np.asarray(np.clip(image, 0.0, 255.0), np.uint8)


def _bridged(height_m: NDArray[np.float32]) -> NDArray[np.float32]:
    known = np.isfinite(height_m).astype(np.float32)
    total, share = (cv2.GaussianBlur(image, (0, 0), 1.0) for image in (np.where(known > 0, height_m, 0.0), known))
    near = np.asarray(total / np.maximum(share, 1e-6), np.float32)
    near[share < BRIDGED_SHARE] = np.nan
    return np.where(known > 0, height_m, near)


def _dense(count: NDArray[np.int32]) -> tuple[slice, slice]:
    """Return the rows and columns between which nearly all cells with points lie."""
    some = count > 0
    spans = []
    for axis in (1, 0):
        share = np.cumsum(some.sum(axis=axis)) / some.sum()
        first, last = np.searchsorted(share, RIM_SHARE), np.searchsorted(share, 1.0 - RIM_SHARE)
        spans.append(slice(int(first), int(last) + 1))
    return spans[0], spans[1]


def height_colours(height_m: NDArray[np.float32], known: NDArray[np.bool_]) -> ColourImage:
    """Return colours `(..., 3)`, in the order blue, green, red, of heights; those not known do not set the range."""
    low, high = np.quantile(height_m[known], HEIGHT_QUANTILES)
    level = np.clip((height_m - low) / max(high - low, 1e-6), 0.0, 1.0)
    flat = np.asarray(np.rint(255.0 * level), np.uint8).reshape(-1, 1)
    return np.asarray(cv2.applyColorMap(flat, cv2.COLORMAP_VIRIDIS), np.uint8).reshape(*height_m.shape, 3)


def save_coloured_ply(path: Path, cloud: PointCloud) -> None:
    """Write a PLY with x, y, z, red, green, blue and sigma: colour by height, brightness of the image.

    Raises:
        OutputError: If the file cannot be written.
    """
    colours = height_colours(cloud.xyz[:, 2], np.ones(len(cloud), np.bool_)) if len(cloud) else np.zeros((0, 3))
    bright = max(float(np.quantile(cloud.intensity, 0.95)), 1.0) if len(cloud) else 1.0
    lit = np.clip(colours * np.clip(cloud.intensity / bright, 0.2, 1.2)[:, None], 0.0, 255.0).astype(np.uint8)
    records = np.empty(len(cloud), COLOURED_TYPE)
    records["x"], records["y"], records["z"] = cloud.xyz.T
    records["blue"], records["green"], records["red"] = lit.T
    records["sigma"] = cloud.sigma
    kinds = {"f4": "float", "u1": "uchar"}
    properties = [f"property {kinds[COLOURED_TYPE[name].str[1:]]} {name}" for name in COLOURED_TYPE.names or ()]
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(cloud)}", *properties, "end_header"]
    with atomic_path(path) as temporary:
        temporary.write_bytes(("\n".join(head) + "\n").encode() + records.tobytes())


def save_covariances(path: Path, covariance_m2: NDArray[np.float32], random_sigma_m: NDArray[np.float32]) -> None:
    """Write the uncertainty of a cloud's points, in its order, as NPZ.

    Its arrays: `covariance_m2` `(N, 3, 3)`, and `random_sigma_m` `(N,)`, the part of sigma along the ray that differs
    from point to point.

    Raises:
        OutputError: If the file cannot be written.
    """
    with atomic_path(path) as temporary:
        np.savez_compressed(temporary, covariance_m2=covariance_m2, random_sigma_m=random_sigma_m)
