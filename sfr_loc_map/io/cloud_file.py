"""Point clouds as files: PLY, PCD, NPZ, LAS and LAZ.

Written are all fields of `FIELD_TYPES` in their types: PLY and PCD binary little endian, NPZ one array a field. Read
are any order and any number type of the fields, text and binary, and clouds of other programs with x, y, z alone.
Whether the cloud is fused and which pairs it is made of stand in the file: comments `sfr fused true` and
`sfr pair_stamps_ns 1 2 3` (PLY, PCD), or members of these names (NPZ). LAS and LAZ: `io/las.py`.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sfr_loc_map.errors import InputError, OutputError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.cloud import FIELD_TYPES, PointCloud
from sfr_loc_map.geometry.plausibility import MAX_POSITION_M
from sfr_loc_map.inputs import MAX_CLOUD_BYTES, read_bytes
from sfr_loc_map.io import las
from sfr_loc_map.io.array_file import parse_npz
from sfr_loc_map.io.atomic import atomic_path
from sfr_loc_map.io.cloud_records import FUSED, MAX_PAIR_STAMPS, PAIR_STAMPS, CloudRecords, Columns
from sfr_loc_map.io.pcd import pcd_bytes, read_pcd
from sfr_loc_map.io.ply import ply_bytes, read_ply

SUFFIXES = (".ply", ".pcd", ".npz", *las.SUFFIXES)
PIXEL_FIELDS = ("u", "v", "pair")


@dataclass(frozen=True, slots=True, eq=False)
class LoadedCloud:
    """A cloud as read.

    Attributes:
        xyz: `(N, 3)` float64, metres, points with a number that is not finite left out.
        cloud: The same points with pixel and pair; None where the file does not say them. Where it says neither
            sigma nor intensity, these are NaN.
    """

    xyz: FloatArray
    cloud: PointCloud | None


def load_cloud(path: Path) -> LoadedCloud:
    """Read a cloud, its format by the name's ending (`SUFFIXES`).

    An organised PCD file (height above 1) without u and v gives them by the order of its points, with pair 0.

    Raises:
        InputError: If the file is missing, of another format, broken, or without x, y, z.
        MissingExtraError: If the format needs an extra that is not installed.
    """
    path = Path(path)
    if path.suffix not in READERS:
        raise InputError(f"cloud '{path}' ends in '{path.suffix}': {', '.join(READERS)} are read")
    try:
        records = READERS[path.suffix](read_bytes(path, MAX_CLOUD_BYTES))
    except OSError as error:
        names = ", ".join(READERS)
        raise InputError(f"cannot read cloud '{path}': {error.strerror}; give a file {names}") from error
    except (ValueError, KeyError, IndexError, TypeError) as error:
        raise InputError(f"cloud '{path}' cannot be read: {error}; write it again") from error
    missing = [name for name in "xyz" if name not in records.columns]
    if missing:
        found = ", ".join(records.columns) or "none"
        raise InputError(f"cloud '{path}' has no field {', '.join(missing)}: it has {found}")
    return _loaded(path, records)


def save_cloud(path: Path, cloud: PointCloud) -> None:
    """Write a cloud; the format is that of the name's ending (`SUFFIXES`).

    Raises:
        MissingExtraError: If the format needs an extra that is not installed.
        OutputError: If the ending is another one or the file cannot be written.
    """
    path = Path(path)
    if path.suffix not in WRITERS:
        raise OutputError(f"cannot write cloud '{path}': its name must end in one of {', '.join(WRITERS)}")
    content = WRITERS[path.suffix](cloud)
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def check_cloud_format(path: Path) -> None:
    """Check that clouds of a name's ending can be written, before the work for one is done.

    Raises:
        MissingExtraError: If the format needs an extra that is not installed.
    """
    if path.suffix in las.SUFFIXES:
        las.check_las()


def save_points(path: Path, xyz: FloatArray) -> None:
    """Write points `(N, 3)` alone, without pixels, as .npz.

    Raises:
        OutputError: If the file cannot be written.
    """
    buffer = io.BytesIO()
    np.savez(buffer, x=xyz[:, 0], y=xyz[:, 1], z=xyz[:, 2])
    with atomic_path(path) as temporary:
        temporary.write_bytes(buffer.getvalue())


def _loaded(path: Path, content: CloudRecords) -> LoadedCloud:
    columns = content.columns
    xyz = np.empty((len(columns["x"]), 3))
    with np.errstate(invalid="ignore"):  # a NaN that signals is one like the others
        for axis, name in enumerate("xyz"):
            xyz[:, axis] = columns[name]
    finite = np.isfinite(xyz).all(axis=1)
    farthest = float(np.abs(xyz[finite]).max(initial=0.0))
    if farthest > MAX_POSITION_M:
        raise InputError(f"cloud '{path}' has a coordinate of {farthest:g} m: up to {MAX_POSITION_M:g} m are read")
    if not all(name in columns for name in PIXEL_FIELDS):
        return LoadedCloud(xyz[finite], None)
    records = np.zeros(int(finite.sum()), PointCloud.dtype())
    for name, kind in FIELD_TYPES.items():
        values = columns[name][finite] if name in columns else np.full(len(records), np.nan)
        if name in PIXEL_FIELDS and len(values):
            limit = np.iinfo(np.dtype(kind)).max
            if not (np.all(values >= 0) and np.all(values <= limit) and np.all(values == np.floor(values))):
                raise InputError(f"cloud '{path}': field {name} must hold whole numbers from 0 to {limit}")
        with np.errstate(invalid="ignore", over="ignore"):  # what is too large for the type becomes infinite
            records[name] = values
    return LoadedCloud(xyz[finite], PointCloud.from_structured(records, content.fused, content.pair_stamps_ns))


def _npz_bytes(cloud: PointCloud) -> bytes:
    records, buffer = cloud.to_structured(), io.BytesIO()
    members = {name: np.ascontiguousarray(records[name]) for name in FIELD_TYPES}
    if cloud.fused is not None:
        members[FUSED] = np.array(cloud.fused)
    if cloud.pair_stamps_ns is not None:
        members[PAIR_STAMPS] = np.array(cloud.pair_stamps_ns, np.int64)
    np.savez(buffer, **members)  # type: ignore[arg-type]
    return buffer.getvalue()


def _read_npz(data: bytes) -> CloudRecords:
    columns = parse_npz(data, (*FIELD_TYPES, FUSED, PAIR_STAMPS))
    lengths = {name: len(values) for name, values in columns.items() if name in FIELD_TYPES and values.ndim == 1}
    if len(set(lengths.values())) > 1:
        raise ValueError(f"its arrays differ in length: {lengths}")
    fused, stamps = _said(columns)
    return CloudRecords({name: columns[name] for name in lengths}, fused, stamps)


def _said(members: Columns) -> tuple[bool | None, tuple[int, ...] | None]:
    """Return whether the cloud of an archive is fused, and the stamps of its pairs; None for what it does not say."""
    fused, stamps = members.get(FUSED), members.get(PAIR_STAMPS)
    if fused is not None and (fused.shape != () or fused.dtype != np.bool_):
        raise ValueError(f"its member '{FUSED}' is {fused.dtype} {fused.shape}: one truth value is needed")
    if stamps is not None and (stamps.ndim != 1 or stamps.dtype.kind not in "iu" or len(stamps) > MAX_PAIR_STAMPS):
        raise ValueError(f"its member '{PAIR_STAMPS}' is {stamps.dtype} {stamps.shape}: whole nanoseconds are needed")
    return None if fused is None else bool(fused), None if stamps is None else tuple(stamps.tolist())


READERS: dict[str, Callable[[bytes], CloudRecords]] = {
    ".ply": read_ply,
    ".pcd": read_pcd,
    ".npz": _read_npz,
    **dict.fromkeys(las.SUFFIXES, las.read_las),
}
"""What reads a cloud, by the ending of the file."""
WRITERS: dict[str, Callable[[PointCloud], bytes]] = {
    ".ply": ply_bytes,
    ".pcd": pcd_bytes,
    ".npz": _npz_bytes,
    ".las": lambda cloud: las.las_bytes(cloud, compressed=False),
    ".laz": lambda cloud: las.las_bytes(cloud, compressed=True),
}
"""What writes a cloud, by the ending of the file."""
