"""Digests, accuracy, time and memory of the mapper on a source; `compare.py` records and compares them.

The digests are of every output: disparities, points, sigma, statistics, warnings, fused clouds and terrain grids. Each
source is mapped three times: as given, with fitted poses, and with disturbed images. Disturbed images have a rotated
right camera, unequal exposure and saturated rows, so that the digests cover the corrections.
"""

from __future__ import annotations

import hashlib
import resource
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.mapping import FusedMap, Mapper, MappingConfig, PairMap, point_covariances, terrain_grid
from sfr_loc_map.mapping.config import MAX_PAIRS

RIGHT_ROTATION_DEG = (0.06, 0.4, 0.08)  #: Pitch, yaw and roll of the right camera of the disturbed pairs.
GAIN, OFFSET = 0.85, 18.0  #: Gain and offset, grey levels, of the right image of the disturbed pairs.
SATURATED_FRACTION = 0.1  #: Fraction of the rows of the disturbed pairs that are white.

Images = NDArray[np.float32]


def open_pairs(path: Path) -> tuple[StereoRig, list[PosedStereoPair]]:
    """Return the rig and up to three pairs of a source; the first pairs of a drive all get the identity pose."""
    source = open_source(path)
    if source.nav is not None:
        return source.nav.rig, list(source.nav.pairs())
    assert source.loc is not None
    first = [pair for pair, _ in zip(source.loc.pairs(), range(MAX_PAIRS), strict=False)]
    return source.loc.rig, [PosedStereoPair(pair, Transform.identity()) for pair in first]


def true_disparities(path: Path, rig: StereoRig, pairs: Sequence[PosedStereoPair]) -> Iterator[Images | None]:
    """Yield the true disparity `(H, W)` of each pair, pixels, NaN where unknown; None without truth."""
    kitti = path / "disparity.png"  # disparity * 256, 0 where unknown
    for item in pairs:
        if kitti.exists():
            stored = np.asarray(cv2.imread(str(kitti), cv2.IMREAD_UNCHANGED), np.float32)
            yield np.where(stored > 0, stored / 256.0, np.nan).astype(np.float32)
        elif item.truth is None:
            yield None
        else:
            depth = (item.T_lm_navsb @ rig.T_sb_left).inverse().apply(item.truth)[..., 2]
            yield np.asarray(rig.fx * rig.baseline_m / depth, np.float32)


def disturbed(pair: StereoPair, rig: StereoRig) -> StereoPair:
    """Return the pair with a rotated, unequally exposed right camera and with saturated rows."""
    K = rig.camera_matrix
    turn = K @ matrix_from_rotvec(np.radians(RIGHT_ROTATION_DEG)) @ np.linalg.inv(K)
    size = (rig.width, rig.height)
    turned = cv2.warpPerspective(pair.right, turn, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    left = pair.left.copy()
    right = np.clip(np.rint(GAIN * turned + OFFSET), 0, 255).astype(np.uint8)
    middle = rig.height // 2
    rows = slice(middle, middle + int(SATURATED_FRACTION * rig.height))
    left[rows] = 255
    right[rows] = 255
    return StereoPair(pair.stamp_ns, left, right)


def digest(value: object) -> str:
    """Return a short hash of an array, a transform, numbers or text."""
    if isinstance(value, np.ndarray):
        data = f"{value.dtype} {value.shape}".encode() + np.ascontiguousarray(value).tobytes()
    elif isinstance(value, Mapping):
        data = repr(sorted((name, float(number)) for name, number in value.items())).encode()
    else:
        data = repr(value).encode()
    return hashlib.sha256(data).hexdigest()[:16]


def hashes_of_map(result: PairMap | FusedMap) -> dict[str, str]:
    """Return the hashes of the outputs of a call by name."""
    cloud = result.cloud
    found = {name: digest(getattr(cloud, name)) for name in ("xyz", "sigma", "intensity", "u", "v", "pair", "fused")}
    found["stamps"] = digest(cloud.pair_stamps_ns)
    found["random_sigma"] = digest(result.random_sigma)
    found["statistics"] = digest(result.statistics)
    found["warnings"] = digest(result.warnings)
    if isinstance(result, PairMap):
        found["disparity"] = digest(result.disparity_px)
        found["validity"] = digest(np.isfinite(result.disparity_px))
    else:
        found["poses"] = digest(np.stack([pose.matrix for pose in result.poses_lm_left]))
    return found


def hashes_of_terrain(fused: FusedMap, rig: StereoRig, config: MappingConfig) -> dict[str, str]:
    """Return the hashes of the terrain grids and of the point covariances, or of the error if there is no grid."""
    try:
        grid = terrain_grid(fused.cloud, config.terrain, fused.poses_lm_left, fused.random_sigma)
    except MappingError as error:
        return {"terrain": digest(str(error))}
    layers = {item.name: getattr(grid, item.name) for item in fields(grid)}
    elevation = layers.pop("elevation")
    layers |= {name: getattr(elevation, name) for name in ("height_m", "sigma_m", "count", "origin_m", "cell_m")}
    layers["covariance"] = point_covariances(fused.cloud, fused.poses_lm_left, rig.fx)
    return {f"terrain_{name}": digest(values) for name, values in layers.items()}


def visible_in_both(truth_px: Images) -> NDArray[np.bool_]:
    """Return the mask `(H, W)` of pixels with a known disparity that are visible in the right image."""
    rows, cols = truth_px.shape
    y, x = np.nonzero(np.isfinite(truth_px))
    disparity = truth_px[y, x]
    column = np.rint(x - disparity).astype(np.intp)
    inside = (column >= 0) & (column < cols)
    y, x, disparity, column = y[inside], x[inside], disparity[inside], column[inside]
    nearest = np.full((rows, cols), -np.inf, np.float32)
    np.maximum.at(nearest, (y, column), disparity)
    visible = np.zeros((rows, cols), np.bool_)
    visible[y, x] = nearest[y, column] <= disparity + 1.0
    return visible


def sigma_in_pixels(result: PairMap, sigma: Images, rig: StereoRig) -> NDArray[np.float64]:
    """Return the disparity sigma `(H, W)`, pixels, of range sigmas `(N,)`; NaN for pixels without a point."""
    cloud = result.cloud
    x = (cloud.u - rig.cx) / rig.fx
    y = (cloud.v - rig.cy) / rig.fy
    disparity = result.disparity_px[cloud.v, cloud.u]
    out = np.full(result.disparity_px.shape, np.nan)
    out[cloud.v, cloud.u] = sigma * disparity**2 / (rig.fx * rig.baseline_m * np.sqrt(x * x + y * y + 1.0))
    return out


def accuracy(result: PairMap, truth_px: Images, item: PosedStereoPair, rig: StereoRig) -> dict[str, float]:
    """Return the accuracy of a pair's map over the pixels with a known true disparity."""
    nearest_px = rig.fx * rig.baseline_m / MappingConfig().max_range_m
    known = visible_in_both(truth_px) & (truth_px >= nearest_px)
    error_px = np.abs(result.disparity_px - truth_px)
    mapped = known & np.isfinite(error_px)
    error = error_px[mapped]
    cloud = result.cloud
    random_px = sigma_in_pixels(result, result.random_sigma, rig)
    total_px = sigma_in_pixels(result, cloud.sigma, rig)
    figures = {
        "density": mapped.sum() / known.sum(),
        "bad_2_percent": 100.0 * (error > 2.0).mean(),
        "bad_3_percent": 100.0 * (error > 3.0).mean(),
        "mae_px": error.mean(),
        "mad_sigma_px": 1.4826 * np.median(error),
        "random_sigma_px": np.median(random_px[mapped]),
        "z_squared_random": np.median(np.square(error / random_px[mapped])),
        "z_squared": np.median(np.square(error / total_px[mapped])),
        "within_3_sigma_random": (error < 3.0 * random_px[mapped]).mean(),
    }
    if item.truth is not None:
        centre = (item.T_lm_navsb @ rig.T_sb_left).translation
        true_points = item.truth[cloud.v, cloud.u]
        distance = np.linalg.norm(true_points - centre, axis=1)
        error_m = np.linalg.norm(cloud.xyz - true_points, axis=1)
        for near, far in ((0.0, 4.0), (4.0, 10.0)):
            inside = error_m[(distance >= near) & (distance < far)]
            if len(inside):
                figures[f"mean_mm_{near:g}_{far:g}"] = 1e3 * inside.mean()
                figures[f"mean_plus_3sigma_mm_{near:g}_{far:g}"] = 1e3 * (inside.mean() + 3.0 * inside.std())
    return {name: float(value) for name, value in figures.items()}


def outputs_of(path: Path) -> tuple[dict[str, dict[str, str]], dict[str, dict[str, float]]]:
    """Return the digests of a source by variant and output, and the accuracy by pair if there is a ground truth."""
    rig, pairs = open_pairs(path)
    truths = list(true_disparities(path, rig, pairs))
    spoilt = [replace(item, pair=disturbed(item.pair, rig)) for item in pairs]
    plain = MappingConfig()
    digests: dict[str, dict[str, str]] = {}
    figures: dict[str, dict[str, float]] = {}
    variants = {
        "given": (pairs, plain),
        "fitted": (pairs, replace(plain, refine_poses=True)),
        "disturbed": (spoilt, plain),
    }
    for variant, (items, config) in variants.items():
        mapper = Mapper(rig, config)
        try:
            maps = [mapper.process(item.pair, item.T_lm_navsb, index) for index, item in enumerate(items)]
            fused = mapper.fuse(maps)
        except MappingError as error:
            digests[variant] = {"refused": digest(str(error))}
            continue
        outputs = {f"pair {index}": hashes_of_map(result) for index, result in enumerate(maps)}
        outputs["fused"] = hashes_of_map(fused) | hashes_of_terrain(fused, rig, config)
        digests[variant] = {f"{call} {name}": text for call, found in outputs.items() for name, text in found.items()}
        if variant == "given":
            for index, (result, truth, item) in enumerate(zip(maps, truths, items, strict=True)):
                if truth is not None:
                    figures[f"pair {index}"] = accuracy(result, truth, item, rig)
    return digests, figures


def measure(sources: Sequence[Path]) -> dict[str, float]:
    """Return the process time of each call, s, and the peak memory of the process, MiB, by source."""
    found = {}
    for path in sources:
        rig, pairs = open_pairs(path)
        mapper = Mapper(rig)
        mapper.warm_up()
        maps = []
        for index, item in enumerate(pairs):
            begin = time.process_time()
            maps.append(mapper.process(item.pair, item.T_lm_navsb, index))
            found[f"{path.name} pair {index} s"] = time.process_time() - begin
        begin = time.process_time()
        mapper.fuse(maps)
        found[f"{path.name} fuse s"] = time.process_time() - begin
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
        found[f"{path.name} peak MiB"] = peak
    return found
