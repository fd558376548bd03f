"""Point clouds as files: PLY, PCD and NPZ.

`save_cloud` writes all fields of `FIELD_TYPES` in their types: PLY and PCD in little-endian binary, NPZ with one array
per field. The readers accept fields in any order and of any number type, text and binary files, and clouds with only x,
y, z.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.atomic import atomic_path
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray, Mask
from sfr_loc_map.geometry.cloud import FIELD_TYPES, PointCloud
from sfr_loc_map.geometry.plausibility import MAX_POSITION_M
from sfr_loc_map.inputs import MAX_CLOUD_BYTES, check_is_not_packed, read_bytes, refusing
from sfr_loc_map.io.clouds.fields import CloudFields, Columns
from sfr_loc_map.io.clouds.npz import read_npz, write_npz
from sfr_loc_map.io.clouds.pcd import read_pcd, write_pcd
from sfr_loc_map.io.clouds.ply import read_ply, write_ply
from sfr_loc_map.io.tables.length_units import unit_in_comment
from sfr_loc_map.message_text import alternatives, counted
from sfr_loc_map.suffixes import check_suffix, suffix_of

_log = logging.getLogger(__name__)
PIXEL_FIELDS = ("u", "v", "pair")
SCALAR_PREFIX = "scalar_"
ARCHIVE = ".npz"  #: Suffix of the format that is compressed itself.
SMALLEST_CLOUD_M = 1e-6
"""Smallest cloud: largest coordinate, m. Numbers in another byte order are often smaller."""


@dataclass(frozen=True, slots=True, eq=False)
class LoadedCloud:
    """A cloud as read, without points that have a coordinate that is not finite."""

    xyz: FloatArray
    """`(N, 3)` float64, metres."""
    cloud: PointCloud | None
    """The same points with their pixels; None if the file lacks one of the `PIXEL_FIELDS`. Missing sigma or intensity
    is NaN."""
    grid: tuple[int, int] | None = None
    """Width and height of an organised cloud whose pixels follow from the order of its points; None for others."""
    not_finite: int = 0
    """Number of omitted points that have a coordinate that is not finite; 0 for an organised cloud."""

    @classmethod
    def of(cls, cloud: PointCloud) -> LoadedCloud:
        """Return a cloud with known pixels as if it were read from a file."""
        return cls(cloud.xyz.astype(np.float64), cloud)

    @property
    def pair_stamps_ns(self) -> tuple[int, ...] | None:
        """Stamps of the pairs of the cloud in the order of the points' `pair`; None if unknown."""
        return None if self.cloud is None else self.cloud.pair_stamps_ns

    def of_images(self, width: int, height: int, name: str) -> LoadedCloud:
        """Return the cloud for images of a size.

        Pixels from the order of points are kept only in a cloud of this size.
        """
        if self.grid is None or self.grid == (width, height):
            return self
        columns, rows = self.grid
        _log.warning(
            f"{name} is organised as {columns} x {rows}, but the images are {width} x {height}: the order of its "
            "points does not give pixels, so points are scored by their distance to the nearest true point"
        )
        return replace(self, cloud=None, grid=None)


def load_cloud(path: Path) -> LoadedCloud:
    """Read a cloud; the format is given by the ending of the name (`SUFFIXES`).

    A warning reports fields without which the points have no pixels. Raises InputError if the cloud cannot be read, or
    if a value is invalid.
    """
    fields = _read_fields(path)
    columns = fields.columns
    with np.errstate(invalid="ignore"):  # a signalling NaN would cause a warning
        xyz = np.column_stack([np.asarray(columns[name], np.float64) for name in "xyz"])
    is_valid = np.asarray(np.isfinite(xyz).all(axis=1))
    _check_coordinates(xyz[is_valid], path)
    is_organised = fields.grid is not None
    not_finite = 0 if is_organised else int(np.count_nonzero(~is_valid))  # in organised clouds such points are normal
    is_valid &= ~_placeholders(xyz, path)
    cloud = None
    if missing := [name for name in PIXEL_FIELDS if name not in columns]:
        _log.warning(
            f"cloud '{path}' has no field {', '.join(missing)}: it has {', '.join(columns)}; points are scored by "
            "their distance to the nearest true point"
        )
    else:
        cloud = _point_cloud(fields, is_valid, path)
    return LoadedCloud(xyz[is_valid], cloud, fields.grid, not_finite)


def _check_coordinates(xyz: FloatArray, path: Path) -> None:
    """Raise InputError if a coordinate `(N, 3)` exceeds `MAX_POSITION_M`, or if all are below `SMALLEST_CLOUD_M`."""
    farthest = float(np.abs(xyz).max(initial=0.0))
    if farthest > MAX_POSITION_M:
        raise InputError(
            f"cloud '{path}' has a coordinate of {farthest:g} m: at most {MAX_POSITION_M:g} m is allowed;",
            "check the byte order and the unit of the coordinates",
        )
    if 0.0 < farthest < SMALLEST_CLOUD_M:
        raise InputError(
            f"cloud '{path}': the largest coordinate is {farthest:g} m: at least {SMALLEST_CLOUD_M:g} m is required;",
            "check the byte order and the unit of the coordinates",
        )


def _placeholders(xyz: FloatArray, path: Path) -> Mask:
    """Return which points `(N, 3)` of a cloud are at 0, 0, 0, as some cameras write pixels without a point.

    A warning reports these points. A single point may be at the origin.
    """
    is_origin = np.asarray((xyz == 0.0).all(axis=1))
    count = int(np.count_nonzero(is_origin))
    if count < 2:
        return np.zeros(len(xyz), np.bool_)
    _log.warning(f"cloud '{path}': {count} points at 0, 0, 0 ignored: they are pixels without a point")
    return is_origin


def _read_fields(path: Path) -> CloudFields:
    """Return the fields of a file by their plain names; u and v are added to an organised cloud without pixels.

    `grid` is None if the file itself has pixels. Raises InputError if the file cannot be read or has no x, y, z.
    """
    cloud_format = FORMATS.get(suffix_of(path))
    if cloud_format is None:
        raise InputError(f"cannot read cloud '{path}': a name that ends in {NAMES} is required;", "convert the cloud")
    with refusing(f"cannot read cloud '{path}'", f"give a {NAMES} file"):
        data = read_bytes(path, MAX_CLOUD_BYTES)
        if suffix_of(path) != ARCHIVE:
            check_is_not_packed(data)
    with refusing(f"cloud '{path}' cannot be read", "write it again"):
        fields = cloud_format.read(data)
    for note in fields.notes:
        _log.warning(f"cloud '{path}': {note}")
    if stated := next(filter(unit_in_comment, fields.comments), ""):
        raise InputError(
            f"cloud '{path}' has the comment '{stated[:60]}', which states the unit {unit_in_comment(stated)}: "
            "coordinates in metres are required;",
            "convert the cloud",
        )
    columns = _without_prefix(fields.columns)
    if missing := [name for name in "xyz" if name not in columns]:
        found = ", ".join(columns) or "none"
        raise InputError(f"cloud '{path}' has no field {', '.join(missing)}: it has {found}")
    if "u" in columns or "v" in columns:
        return replace(fields, columns=columns, grid=None)
    if fields.grid is not None:
        columns = _with_pixels_of_grid(columns, *fields.grid)
    return replace(fields, columns=columns)


def _without_prefix(columns: Columns) -> Columns:
    """Return the fields without the prefix that CloudCompare adds to scalar fields.

    A field keeps its prefix if another field already has the name without the prefix.
    """
    plain = {name: name.removeprefix(SCALAR_PREFIX) for name in columns}
    return {name if plain[name] in columns else plain[name]: values for name, values in columns.items()}


def _with_pixels_of_grid(columns: Columns, width: int, height: int) -> Columns:
    """Return the fields with u and v from the order of the points of an organised cloud."""
    points = width * height
    v, u = np.divmod(np.arange(points), width)
    return {**columns, "u": u, "v": v, "pair": columns.get("pair", np.zeros(points))}


def _point_cloud(fields: CloudFields, kept: Mask, path: Path) -> PointCloud:
    """Return the points that a mask `(N,)` selects, with their pixels; raise InputError if a value is invalid.

    An organised cloud counts as not fused unless the file states the opposite.
    """
    fused = fields.fused if fields.grid is None else bool(fields.fused)
    cloud = PointCloud.from_structured(_records(fields.columns, kept, path), fused, fields.pair_stamps_ns)
    _check_values(cloud, path)
    return cloud


def _records(columns: Columns, kept: Mask, path: Path) -> NDArray[np.void]:
    """Return the fields of the points that a mask `(N,)` selects as records; missing fields are NaN."""
    points = np.zeros(int(kept.sum()), PointCloud.dtype())
    for name, kind in FIELD_TYPES.items():
        values = columns[name][kept] if name in columns else np.full(len(points), np.nan)
        if name in PIXEL_FIELDS and len(values):
            limit = np.iinfo(np.dtype(kind)).max
            if not (np.all(values >= 0) and np.all(values <= limit) and np.all(values == np.floor(values))):
                raise InputError(f"cloud '{path}': integers from 0 to {limit} are required in the field {name}")
        with np.errstate(invalid="ignore", over="ignore"):  # values that exceed the type become infinite
            points[name] = values
    return points


def _check_values(cloud: PointCloud, path: Path) -> None:
    """Raise InputError if a sigma is negative, or if a point belongs to a pair without a stamp."""
    if (cloud.sigma < 0.0).any():
        raise InputError(f"cloud '{path}' has a sigma of {np.nanmin(cloud.sigma):g} m:", "at least 0 m is required")
    stamps_ns = cloud.pair_stamps_ns
    if stamps_ns is not None and len(cloud) and cloud.pair.max() >= len(stamps_ns):
        raise InputError(
            f"cloud '{path}' has points of pair {cloud.pair.max()} (counted from 0), but stamps for only "
            f"{counted(len(stamps_ns), 'pair')}:",
            "a stamp for each pair is required",
        )


def save_cloud(path: Path, cloud: PointCloud) -> None:
    """Write a cloud; the format is given by the ending of the name (`SUFFIXES`).

    OutputError if the ending is not one of these, or if the file cannot be written.
    """
    _save_fields(path, CloudFields.of(cloud))


def save_points(path: Path, xyz: FloatArray) -> None:
    """Write points `(N, 3)` without pixels, m; the format is given as for `save_cloud`."""
    _save_fields(path, CloudFields.of_points(xyz))


def _save_fields(path: Path, fields: CloudFields) -> None:
    check_suffix(path, SUFFIXES)
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        FORMATS[suffix_of(path)].write(fields, stream)


class CloudFormat(NamedTuple):
    """The reader and the writer of a format; the reader raises ValueError for corrupt data."""

    read: Callable[[bytes], CloudFields]
    write: Callable[[CloudFields, BinaryIO], None]


FORMATS = {
    ".ply": CloudFormat(read_ply, write_ply),
    ".pcd": CloudFormat(read_pcd, write_pcd),
    ".npz": CloudFormat(read_npz, write_npz),
}
"""Formats of clouds by the ending of the file name."""
SUFFIXES = tuple(FORMATS)
NAMES = alternatives(SUFFIXES)
OTHER_SUFFIXES = (".xyz", ".pts", ".las", ".laz", ".e57", ".obj", ".stl", ".vtk")
"""Endings of clouds of other programs, which are not read."""
