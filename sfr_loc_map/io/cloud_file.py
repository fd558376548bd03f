"""Point clouds as files: PLY, PCD and NPZ.

Written are all fields of `FIELD_TYPES` in their types: PLY and PCD binary little endian, NPZ one array a field. Read
are any order and any number type of the fields, text and binary, and clouds of other programs with x, y, z alone.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import InputError, OutputError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.cloud import FIELD_TYPES, PointCloud
from sfr_loc_map.geometry.plausibility import MAX_POSITION_M
from sfr_loc_map.inputs import MAX_CLOUD_BYTES, read_bytes, refusing
from sfr_loc_map.io.array_file import parse_npz
from sfr_loc_map.io.atomic import atomic_path
from sfr_loc_map.io.text_table import parse_count

Columns = dict[str, NDArray[Any]]  # values of each field, one a point
PIXEL_FIELDS = ("u", "v", "pair")
FUSED, PAIR_STAMPS = "fused", "pair_stamps_ns"
"""Names of what a file says of its cloud: comments `sfr fused true`, `sfr pair_stamps_ns 1 2 3`, or members of NPZ."""
MAX_PAIR_STAMPS = 256  #: As many pairs as the points' `pair` can name.
MAX_COUNT = 4096  #: Most values of one field of a point of PCD: descriptors have some hundreds.
PCD_TYPES = {"I1", "I2", "I4", "I8", "U1", "U2", "U4", "U8", "F4", "F8"}
PLY_TYPES = {
    name: kind
    for kind, names in {
        **{"i1": ("char", "int8"), "u1": ("uchar", "uint8"), "i2": ("short", "int16"), "u2": ("ushort", "uint16")},
        **{"i4": ("int", "int32"), "u4": ("uint", "uint32"), "f4": ("float", "float32"), "f8": ("double", "float64")},
    }.items()
    for name in names
}
PLY_NAMES = {"f4": "float", "u2": "ushort", "u1": "uchar"}
PLY_ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True, slots=True, eq=False)
class LoadedCloud:
    """A cloud as read, points with a coordinate that is not finite left out."""

    xyz: FloatArray
    """`(N, 3)` float64, metres."""
    cloud: PointCloud | None
    """The same points; None where the file does not say pixel and pair. Sigma or intensity that it lacks are NaN."""


def load_cloud(path: Path) -> LoadedCloud:
    """Read a cloud, its format by the name's ending (`SUFFIXES`)."""
    names = ", ".join(SUFFIXES)
    if path.suffix not in _FORMATS:
        raise InputError(f"cloud '{path}' ends in '{path.suffix}': {names} are read")
    with refusing(f"cannot read cloud '{path}'", f"give a file {names}"):
        data = read_bytes(path, MAX_CLOUD_BYTES)
    with refusing(f"cloud '{path}' cannot be read", "write it again"):
        columns, comments = _FORMATS[path.suffix][0](data)
        fused, pair_stamps_ns = _said(comments)
    missing = [name for name in "xyz" if name not in columns]
    if missing:
        found = ", ".join(columns) or "none"
        raise InputError(f"cloud '{path}' has no field {', '.join(missing)}: it has {found}")
    with np.errstate(invalid="ignore"):  # a NaN that signals is one like the others
        xyz = np.column_stack([np.asarray(columns[name], np.float64) for name in "xyz"])
    finite = np.isfinite(xyz).all(axis=1)
    farthest = float(np.abs(xyz[finite]).max(initial=0.0))
    if farthest > MAX_POSITION_M:
        raise InputError(f"cloud '{path}' has a coordinate of {farthest:g} m: up to {MAX_POSITION_M:g} m are read")
    if not all(name in columns for name in PIXEL_FIELDS):
        return LoadedCloud(xyz[finite], None)
    points = np.zeros(int(finite.sum()), PointCloud.dtype())
    for name, kind in FIELD_TYPES.items():
        values = columns[name][finite] if name in columns else np.full(len(points), np.nan)
        if name in PIXEL_FIELDS and len(values):
            limit = np.iinfo(np.dtype(kind)).max
            if not (np.all(values >= 0) and np.all(values <= limit) and np.all(values == np.floor(values))):
                raise InputError(f"cloud '{path}': field {name} must hold whole numbers from 0 to {limit}")
        with np.errstate(invalid="ignore", over="ignore"):  # what is too large for the type becomes infinite
            points[name] = values
    return LoadedCloud(xyz[finite], PointCloud.from_structured(points, fused, pair_stamps_ns))


def save_cloud(path: Path, cloud: PointCloud) -> None:
    """Write a cloud; the format is that of the name's ending (`SUFFIXES`)."""
    if path.suffix not in _FORMATS:
        raise OutputError(f"cannot write cloud '{path}': its name must end in one of {', '.join(SUFFIXES)}")
    content = _FORMATS[path.suffix][1](cloud)
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def save_points(path: Path, xyz: FloatArray) -> None:
    """Write points `(N, 3)` alone, without pixels, as .npz."""
    with atomic_path(path) as temporary:
        np.savez(temporary, x=xyz[:, 0], y=xyz[:, 1], z=xyz[:, 2])


def _comments(cloud: PointCloud) -> list[str]:
    comments = [] if cloud.fused is None else [f"sfr {FUSED} {str(cloud.fused).lower()}"]
    if cloud.pair_stamps_ns is not None:
        comments.append(f"sfr {PAIR_STAMPS} {' '.join(map(str, cloud.pair_stamps_ns))}")
    return comments


def _said(comments: Iterable[str]) -> tuple[bool | None, tuple[int, ...] | None]:
    """Return whether a cloud is fused and the stamps of its pairs, None for what the comments do not say."""
    said: dict[str, str] = {}
    for text in comments:
        sign, name, value = (*text.split(" ", 2), "", "")[:3]
        if sign == "sfr" and said.setdefault(name, value.strip()) != value.strip():
            raise ValueError(f"its comments 'sfr {name}' differ")
    fused, stamps = said.get(FUSED), said.get(PAIR_STAMPS)
    if fused not in (None, "true", "false"):
        raise ValueError(f"'sfr {FUSED} {fused[:40]}' must end in true or false")
    words = (stamps or "").split()
    whole = all(word.isascii() and word.isdecimal() and len(word) < 20 and int(word) < 2**63 for word in words)
    if len(words) > MAX_PAIR_STAMPS or not whole:
        raise ValueError(f"'sfr {PAIR_STAMPS}' must list whole nanoseconds")
    return None if fused is None else fused == "true", None if stamps is None else tuple(map(int, words))


def _columns(body: bytes, dtype: np.dtype[Any], count: int, *, is_text: bool) -> Columns:
    """Return the scalar fields of `count` records, as bytes or as text with one record a line."""
    names = dtype.names or ()
    if not is_text:
        if len(body) < count * dtype.itemsize:
            raise ValueError(f"{len(body)} bytes found where {count} points of {dtype.itemsize} bytes are needed")
        records = np.frombuffer(body, dtype, count)
        return {name: records[name] for name in names if dtype[name].shape == ()}
    widths = [int(np.prod(dtype[name].shape)) for name in names]
    table = np.zeros((0, sum(widths)))
    if len(body) + 1 < 2 * count * sum(widths):  # each number has a digit and an end
        raise ValueError(f"{len(body)} bytes of text found where {count} points of {sum(widths)} numbers are needed")
    if count:
        lines = b"\n".join(line for line in body.splitlines() if line.partition(b"#")[0].strip())  # numpy warns of them
        table = np.loadtxt(io.BytesIO(lines), np.float64, ndmin=2, max_rows=count)
    if table.shape != (count, sum(widths)):
        raise ValueError(f"{table.shape} numbers found where {(count, sum(widths))} are needed")
    starts = np.cumsum([0, *widths])
    return {name: table[:, starts[i]] for i, name in enumerate(names) if widths[i] == 1}


def _ply_bytes(cloud: PointCloud) -> bytes:
    dtype = PointCloud.dtype()
    properties = [f"property {PLY_NAMES[dtype[name].str[1:]]} {name}" for name in FIELD_TYPES]
    comments = [f"comment {text}" for text in _comments(cloud)]
    vertices = [f"element vertex {len(cloud)}", *properties]
    head = ["ply", "format binary_little_endian 1.0", *comments, *vertices, "end_header"]
    return ("\n".join(head) + "\n").encode() + cloud.to_structured().tobytes()


def _read_ply(data: bytes) -> tuple[Columns, list[str]]:
    """Return the fields of the vertices of a PLY file, which must be its first element."""
    end = data.find(b"end_header")
    if not data.startswith(b"ply") or end < 0:
        raise ValueError("it has no PLY header")
    body = data.index(b"\n", end) + 1
    lines = data[:end].decode("ascii", "replace").splitlines()
    header = [words for line in lines if (words := line.split())]
    order = next((words[1] for words in header if words[0] == "format"), "")
    elements = [number for number, words in enumerate(header) if words[0] == "element"]
    if order not in PLY_ORDERS or not elements:
        raise ValueError("its PLY header has no known format or no vertices")
    first, *others = elements
    _, element, count, *_ = header[first]
    if element != "vertex":
        raise ValueError(f"its first element is '{element}' where 'vertex' is needed")
    fields = []
    for words in header[first + 1 : others[0] if others else None]:
        if words[0] == "property":
            if words[1] not in PLY_TYPES:
                raise ValueError(f"its vertices have a property of type '{words[1]}', which is not read")
            fields.append((words[2], PLY_ORDERS[order] + PLY_TYPES[words[1]]))
    columns = _columns(data[body:], np.dtype(fields), parse_count(count), is_text=order == "ascii")
    return columns, [line.removeprefix("comment ") for line in lines if line.startswith("comment ")]


def _pcd_bytes(cloud: PointCloud) -> bytes:
    kinds = [PointCloud.dtype()[name] for name in FIELD_TYPES]
    head = [
        "# .PCD v0.7 - Point Cloud Data file format",
        *(f"# {text}" for text in _comments(cloud)),
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


def _read_pcd(data: bytes) -> tuple[Columns, list[str]]:
    """Return the fields of a PCD file; an organised one has u and v by the order of its points, hence is not fused."""
    head: dict[str, list[str]] = {}
    comments: list[str] = []
    position = 0
    while "DATA" not in head:
        end = data.find(b"\n", position)
        if end < 0:
            raise ValueError("it has no PCD header")
        line = data[position:end].decode("ascii", "replace").strip()
        position, words = end + 1, line.split()
        if line.startswith("#"):
            comments.append(line.removeprefix("#").strip())
        elif words:
            head[words[0]] = words[1:]
    if head["DATA"] not in (["ascii"], ["binary"]):
        raise ValueError(f"its data is '{' '.join(head['DATA'])}' where ascii or binary is needed")
    width, height = parse_count(head["WIDTH"][0]), parse_count(head["HEIGHT"][0])
    points = width * height
    if "POINTS" in head and parse_count(head["POINTS"][0]) != points:
        raise ValueError(f"it has POINTS {head['POINTS'][0]} where WIDTH and HEIGHT say {points}")
    fields, names = [], head["FIELDS"]
    layout = zip(names, head["TYPE"], head["SIZE"], head.get("COUNT", ["1"] * len(names)), strict=True)
    for i, (name, kind, size, count) in enumerate(layout):
        if kind + size not in PCD_TYPES or not 1 <= parse_count(count) <= MAX_COUNT:
            raise ValueError(f"its field {name} has TYPE {kind}, SIZE {size}, COUNT {count}, which is not read")
        shape = () if int(count) == 1 else (int(count),)
        fields.append((f"{name}{i}" if name == "_" else name, f"<{kind.lower()}{size}", shape))  # `_` is padding
    columns = _columns(data[position:], np.dtype(fields), points, is_text=head["DATA"] == ["ascii"])
    if height > 1 and "u" not in columns and "v" not in columns:
        v, u = np.divmod(np.arange(points), max(width, 1))
        columns = {**columns, "u": u, "v": v, "pair": columns.get("pair", np.zeros(points))}
        if not any(text.startswith(f"sfr {FUSED} ") for text in comments):
            comments.append(f"sfr {FUSED} false")
    return columns, comments


def _npz_bytes(cloud: PointCloud) -> bytes:
    records, buffer = cloud.to_structured(), io.BytesIO()
    members = {name: np.ascontiguousarray(records[name]) for name in FIELD_TYPES}
    if cloud.fused is not None:
        members[FUSED] = np.array(cloud.fused)
    if cloud.pair_stamps_ns is not None:
        members[PAIR_STAMPS] = np.array(cloud.pair_stamps_ns, np.int64)
    np.savez(buffer, **members)  # type: ignore[arg-type]
    return buffer.getvalue()


def _read_npz(data: bytes) -> tuple[Columns, list[str]]:
    members = parse_npz(data, (*FIELD_TYPES, FUSED, PAIR_STAMPS))
    columns = {name: values for name, values in members.items() if name in FIELD_TYPES and values.ndim == 1}
    lengths = {name: len(values) for name, values in columns.items()}
    if len(set(lengths.values())) > 1:
        raise ValueError(f"its arrays differ in length: {lengths}")
    said = {name: members[name].reshape(-1).tolist() for name in (FUSED, PAIR_STAMPS) if name in members}
    return columns, [f"sfr {name} {' '.join(map(str, values)).lower()}" for name, values in said.items()]


_FORMATS: dict[str, tuple[Callable[[bytes], tuple[Columns, list[str]]], Callable[[PointCloud], bytes]]] = {
    ".ply": (_read_ply, _ply_bytes),
    ".pcd": (_read_pcd, _pcd_bytes),
    ".npz": (_read_npz, _npz_bytes),
}
"""What reads and what writes a cloud, by the ending of the file."""
SUFFIXES = tuple(_FORMATS)
