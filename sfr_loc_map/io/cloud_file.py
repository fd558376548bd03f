"""Point clouds as files: PLY, PCD and NPZ.

Written are all fields of `FIELD_TYPES` in their types: PLY and PCD binary little endian, NPZ one array a field. Read
are any order and any number type of the fields, text and binary, and clouds of other programs with x, y, z alone.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import InputError, OutputError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.cloud import FIELD_TYPES, PointCloud
from sfr_loc_map.io.atomic import atomic_path

PLY_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
PLY_NAMES = {"f4": "float", "u2": "ushort", "u1": "uchar"}
PLY_ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}
SUFFIXES = (".ply", ".pcd", ".npz")
PIXEL_FIELDS = ("u", "v", "pair")
Columns = dict[str, NDArray[Any]]


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
    """Read a cloud (.ply, .pcd, .npz).

    An organised PCD file (height above 1) without u and v gives them by the place of its points, with pair 0.

    Raises:
        InputError: If the file is missing, of another format, broken, or without x, y, z.
    """
    path = Path(path)
    readers: dict[str, Callable[[bytes], Columns]] = {".ply": _read_ply, ".pcd": _read_pcd, ".npz": _read_npz}
    if path.suffix not in readers:
        raise InputError(f"cloud '{path}' ends in '{path.suffix}': {', '.join(readers)} are read")
    try:
        columns = readers[path.suffix](path.read_bytes())
    except OSError as error:
        raise InputError(f"cannot read cloud '{path}': {error.strerror}; give a .ply, .pcd or .npz file") from error
    except (ValueError, KeyError, IndexError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"cloud '{path}' cannot be read: {error}; write it again") from error
    missing = [name for name in "xyz" if name not in columns]
    if missing:
        raise InputError(f"cloud '{path}' has no field {', '.join(missing)}: it has {', '.join(columns) or 'none'}")
    return _loaded(path, columns)


def save_cloud(path: Path, cloud: PointCloud) -> None:
    """Write a cloud; the format is that of the name's ending (.ply, .pcd, .npz).

    Raises:
        OutputError: If the ending is another one or the file cannot be written.
    """
    path = Path(path)
    writers: dict[str, Callable[[PointCloud], bytes]] = {".ply": _ply_bytes, ".pcd": _pcd_bytes, ".npz": _npz_bytes}
    if path.suffix not in writers:
        raise OutputError(f"cannot write cloud '{path}': its name must end in one of {', '.join(writers)}")
    with atomic_path(path) as temporary:
        temporary.write_bytes(writers[path.suffix](cloud))


def _loaded(path: Path, columns: Columns) -> LoadedCloud:
    xyz = np.stack([np.asarray(columns[name], np.float64).reshape(-1) for name in "xyz"], axis=1)
    finite = np.isfinite(xyz).all(axis=1)
    if not all(name in columns for name in PIXEL_FIELDS):
        return LoadedCloud(xyz[finite], None)
    records = np.zeros(int(finite.sum()), PointCloud.dtype())
    for name, kind in FIELD_TYPES.items():
        values = columns[name][finite] if name in columns else np.full(len(records), np.nan)
        if name in PIXEL_FIELDS and len(values):
            limit = np.iinfo(np.dtype(kind)).max
            if not (np.all(values >= 0) and np.all(values <= limit) and np.all(values == np.floor(values))):
                raise InputError(f"cloud '{path}': field {name} must hold whole numbers from 0 to {limit}")
        records[name] = values
    return LoadedCloud(xyz[finite], PointCloud.from_structured(records))


def _ply_bytes(cloud: PointCloud) -> bytes:
    dtype = PointCloud.dtype()
    properties = [f"property {PLY_NAMES[dtype[name].str[1:]]} {name}" for name in FIELD_TYPES]
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(cloud)}", *properties, "end_header"]
    return ("\n".join(head) + "\n").encode() + cloud.to_structured().tobytes()


def _pcd_bytes(cloud: PointCloud) -> bytes:
    kinds = [PointCloud.dtype()[name] for name in FIELD_TYPES]
    head = [
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        f"FIELDS {' '.join(FIELD_TYPES)}",
        f"SIZE {' '.join(str(kind.itemsize) for kind in kinds)}",
        f"TYPE {' '.join(kind.kind.upper() for kind in kinds)}",
        f"COUNT {' '.join('1' for _ in kinds)}",
        f"WIDTH {len(cloud)}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {len(cloud)}",
        "DATA binary",
    ]
    return ("\n".join(head) + "\n").encode() + cloud.to_structured().tobytes()


def _npz_bytes(cloud: PointCloud) -> bytes:
    records, buffer = cloud.to_structured(), io.BytesIO()
    np.savez(buffer, **{name: np.ascontiguousarray(records[name]) for name in FIELD_TYPES})  # type: ignore[arg-type]
    return buffer.getvalue()


def _read_npz(data: bytes) -> Columns:
    with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
        columns = {name: arrays[name] for name in arrays.files}
    lengths = {name: len(values) for name, values in columns.items() if name in FIELD_TYPES and values.ndim == 1}
    if len(set(lengths.values())) > 1:
        raise ValueError(f"its arrays differ in length: {lengths}")
    return {name: columns[name] for name in lengths}


def _read_ply(data: bytes) -> Columns:
    end = data.find(b"end_header")
    if not data.startswith(b"ply") or end < 0:
        raise ValueError("it has no PLY header")
    body = data.index(b"\n", end) + 1
    order, count, fields = _ply_header(data[:end].decode("ascii", "replace").splitlines())
    dtype = np.dtype([(name, PLY_ORDERS[order] + kind) for name, kind in fields])
    return _records(data[body:], dtype, count, is_text=order == "ascii")


def _ply_header(lines: list[str]) -> tuple[str, int, list[tuple[str, str]]]:
    """Return format, number of points and fields of the vertex element, which must come first."""
    order, count, fields, element = "", -1, [], ""
    for words in (line.split() for line in lines):
        if words[:1] == ["format"]:
            order = words[1]
        elif words[:1] == ["element"]:
            if not element and words[1] != "vertex":
                raise ValueError(f"its first element is '{words[1]}' where 'vertex' is needed")
            element = words[1]
            count = int(words[2]) if element == "vertex" else count
        elif words[:1] == ["property"] and element == "vertex":
            if words[1] not in PLY_TYPES:
                raise ValueError(f"its vertices have a property of type '{words[1]}', which is not read")
            fields.append((words[2], PLY_TYPES[words[1]]))
    if order not in PLY_ORDERS or count < 0:
        raise ValueError("its PLY header has no known format or no vertices")
    return order, count, fields


def _read_pcd(data: bytes) -> Columns:
    head: dict[str, list[str]] = {}
    place = 0
    while "DATA" not in head:
        end = data.find(b"\n", place)
        if end < 0:
            raise ValueError("it has no PCD header")
        words = data[place:end].decode("ascii", "replace").split()
        place = end + 1
        if words and not words[0].startswith("#"):
            head[words[0]] = words[1:]
    if head["DATA"] not in (["ascii"], ["binary"]):
        raise ValueError(f"its data is '{' '.join(head['DATA'])}' where ascii or binary is needed")
    layout = zip(
        head["FIELDS"], head["TYPE"], head["SIZE"], head.get("COUNT", ["1"] * len(head["FIELDS"])), strict=True
    )
    fields = [
        (f"{name}{i}" if name == "_" else name, f"<{kind.lower()}{size}", int(n))
        for i, (name, kind, size, n) in enumerate(layout)
    ]
    width, height = int(head["WIDTH"][0]), int(head["HEIGHT"][0])
    dtype = np.dtype([(name, kind) if n == 1 else (name, kind, (n,)) for name, kind, n in fields])
    columns = _records(data[place:], dtype, width * height, is_text=head["DATA"] == ["ascii"])
    if height > 1 and "u" not in columns and "v" not in columns:
        v, u = np.divmod(np.arange(width * height), width)
        columns = {**columns, "u": u, "v": v, "pair": columns.get("pair", np.zeros(width * height))}
    return columns


def _records(body: bytes, dtype: np.dtype[Any], count: int, *, is_text: bool) -> Columns:
    """Return the scalar columns of `count` records."""
    if is_text:
        table = np.loadtxt(io.BytesIO(body), np.float64, ndmin=2, max_rows=count) if count else np.zeros((0, 0))
        widths = [int(np.prod(dtype[name].shape)) for name in dtype.names or ()]
        if table.shape != (count, sum(widths)) and count:
            raise ValueError(f"{table.shape} numbers found where {(count, sum(widths))} are needed")
        starts = np.cumsum([0, *widths])
        table = table.reshape(count, sum(widths))
        return {n: table[:, starts[i]] for i, n in enumerate(dtype.names or ()) if widths[i] == 1}
    if len(body) < count * dtype.itemsize:
        raise ValueError(f"{len(body)} bytes found where {count} points of {dtype.itemsize} bytes are needed")
    records = np.frombuffer(body, dtype, count)
    return {name: records[name] for name in dtype.names or () if dtype[name].shape == ()}
