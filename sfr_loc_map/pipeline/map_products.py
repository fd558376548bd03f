"""What a map can be had as besides a cloud and its elevation model: a coloured cloud, covariances."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.io.atomic import atomic_path
from sfr_loc_map.pipeline.dem_figure import height_colours, height_range

COLOURED_TYPE = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1"), ("sigma", "<f4")]
)


def save_coloured_ply(path: Path, cloud: PointCloud) -> None:
    """Write a PLY with x, y, z, red, green, blue and sigma: colour by height, brightness of the image.

    Raises:
        OutputError: If the file cannot be written.
    """
    colours = height_colours(cloud.xyz[:, 2], height_range(cloud.xyz[:, 2])) if len(cloud) else np.zeros((0, 3))
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
