"""Point clouds as files: PLY, PCD and NPZ.

`save_cloud` writes all fields of `FIELD_TYPES` in their types: PLY and PCD in little-endian binary, NPZ with one array
per field. The readers accept any order and number type of the fields, text and binary, and clouds with only x, y, z.
"""

from __future__ import annotations

import io
import logging
import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.atomic import atomic_path
from sfr_loc_map.errors import InputError, OutputError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.cloud import FIELD_TYPES, PointCloud
from sfr_loc_map.geometry.plausibility import MAX_POSITION_M
from sfr_loc_map.inputs import MAX_CLOUD_BYTES, expansion_limit, read_bytes, refusing
from sfr_loc_map.io.clouds.array_file import npz_names, parse_npz
from sfr_loc_map.io.tables.number_text import number_or_nan, parse_count
from sfr_loc_map.io.tables.stamps import parse_stamp_ns

_log = logging.getLogger(__name__)
Columns = dict[str, NDArray[Any]]  # values of each field, one per point
Grid = tuple[int, int] | None  # width and height of an organised cloud
PIXEL_FIELDS = ("u", "v", "pair")
FUSED, PAIR_STAMPS = "fused", "pair_stamps_ns"
"""Names of properties of a cloud: comments `sfr fused true` and `sfr pair_stamps_ns 1 2 3`, or members of NPZ."""
MAX_PAIR_STAMPS = 256  #: Number of pairs that the field `pair` of points can distinguish.
MAX_COUNT = 4096  #: Maximum number of values in one PCD field of a point; descriptors have several hundred.
PCD_TYPES = {"I1", "I2", "I4", "I8", "U1", "U2", "U4", "U8", "F4", "F8"}
PLY_TYPES = {
    name: kind
    for kind, names in {
        **{"i1": ("char", "int8"), "u1": ("uchar", "uint8"), "i2": ("short", "int16"), "u2": ("ushort", "uint16")},
        **{"i4": ("int", "int32"), "u4": ("uint", "uint32"), "f4": ("float", "float32"), "f8": ("double", "float64")},
    }.items()
    for name in names
}
PADDING = "_"  #: Name of PCD fields without content.
NO_VIEWPOINT = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
PLY_NAMES = {"f4": "float", "u2": "ushort", "u1": "uchar"}
_PLAIN_NAN = re.compile(rb"[-+]?(?:nan\([a-z0-9_]*\)|1\.#(?:qnan|snan|ind)[a-z0-9]*)", re.IGNORECASE)
_PLY_END = re.compile(rb"^end_header[^\n]*\n", re.MULTILINE)
PLY_ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True, slots=True, eq=False)
class LoadedCloud:
    """A cloud as read, without points that have a coordinate that is not finite."""

    xyz: FloatArray
    """`(N, 3)` float64, metres."""
    cloud: PointCloud | None
    """The same points; None if the file has no pixels and pairs. Missing sigma or intensity is NaN."""
    grid: Grid = None
    """Width and height of an organised cloud whose pixels follow from the order of its points; None for others."""
    not_finite: int = 0
    """Number of omitted points that have a coordinate that is not finite; 0 for an organised cloud."""

    def of_images(self, width: int, height: int, name: str) -> LoadedCloud:
        """Return the cloud for images of a size; pixels from the order of the points are kept only for this size."""
        if self.grid is None or self.grid == (width, height):
            return self
        columns, rows = self.grid
        _log.warning(
            f"{name} is organised as {columns} x {rows}, but the images are {width} x {height}: the order of its "
            "points does not give pixels, so points are scored by their distance to the nearest true point"
        )
        return replace(self, cloud=None, grid=None)


def load_cloud(path: Path) -> LoadedCloud:
    """Read a cloud; the format is given by the ending of the name (`SUFFIXES`)."""
    names = ", ".join(SUFFIXES)
    suffix = path.suffix.lower()
    if suffix not in _FORMATS:
        raise InputError(f"cloud '{path}' ends in '{path.suffix}': {names} are supported; convert the cloud")
    with refusing(f"cannot read cloud '{path}'", f"give a file {names}"):
        data = read_bytes(path, MAX_CLOUD_BYTES)
    with refusing(f"cloud '{path}' cannot be read", "write it again"):
        columns, comments, grid = _FORMATS[suffix][0](data)
        if grid is not None and "u" not in columns and "v" not in columns:
            columns, comments = _with_pixels(columns, comments, *grid)
        else:
            grid = None
        fused, pair_stamps_ns = _stated(comments)
    missing = [name for name in "xyz" if name not in columns]
    if missing:
        found = ", ".join(columns) or "none"
        raise InputError(f"cloud '{path}' has no field {', '.join(missing)}: it has {found}")
    with np.errstate(invalid="ignore"):  # signalling NaN
        xyz = np.column_stack([np.asarray(columns[name], np.float64) for name in "xyz"])
    finite = np.isfinite(xyz).all(axis=1)
    not_finite = 0 if grid is not None else int(np.count_nonzero(~finite))  # normal in organised clouds
    farthest = float(np.abs(xyz[finite]).max(initial=0.0))
    if farthest > MAX_POSITION_M:
        raise InputError(f"cloud '{path}' has a coordinate of {farthest:g} m: up to {MAX_POSITION_M:g} m are allowed")
    if not all(name in columns for name in PIXEL_FIELDS):
        return LoadedCloud(xyz[finite], None, not_finite=not_finite)
    points = np.zeros(int(finite.sum()), PointCloud.dtype())
    for name, kind in FIELD_TYPES.items():
        values = columns[name][finite] if name in columns else np.full(len(points), np.nan)
        if name in PIXEL_FIELDS and len(values):
            limit = np.iinfo(np.dtype(kind)).max
            if not (np.all(values >= 0) and np.all(values <= limit) and np.all(values == np.floor(values))):
                raise InputError(f"cloud '{path}': field {name} must contain integers from 0 to {limit}")
        with np.errstate(invalid="ignore", over="ignore"):  # values that exceed the type become infinite
            points[name] = values
    return LoadedCloud(xyz[finite], PointCloud.from_structured(points, fused, pair_stamps_ns), grid, not_finite)


def _with_pixels(columns: Columns, comments: list[str], width: int, height: int) -> tuple[Columns, list[str]]:
    """Return the fields with u and v from the order of the points of an organised cloud, which is not fused."""
    points = width * height
    v, u = np.divmod(np.arange(points), width)
    columns = {**columns, "u": u, "v": v, "pair": columns.get("pair", np.zeros(points))}
    if not any(text.startswith(f"sfr {FUSED} ") for text in comments):
        comments = [*comments, f"sfr {FUSED} false"]
    return columns, comments


def save_cloud(path: Path, cloud: PointCloud) -> None:
    """Write a cloud; the format is given by the ending of the name (`SUFFIXES`)."""
    if path.suffix.lower() not in _FORMATS:
        raise OutputError(f"cannot write cloud '{path}': its name must end in one of {', '.join(SUFFIXES)}")
    content = _FORMATS[path.suffix.lower()][1](cloud)
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def save_points(path: Path, xyz: FloatArray) -> None:
    """Write points `(N, 3)` without pixels as .npz."""
    with atomic_path(path) as temporary:
        np.savez(temporary, x=xyz[:, 0], y=xyz[:, 1], z=xyz[:, 2])


def _comments(cloud: PointCloud) -> list[str]:
    comments = [] if cloud.fused is None else [f"sfr {FUSED} {str(cloud.fused).lower()}"]
    if cloud.pair_stamps_ns is not None:
        comments.append(f"sfr {PAIR_STAMPS} {' '.join(map(str, cloud.pair_stamps_ns))}")
    return comments


def _stated(comments: Iterable[str]) -> tuple[bool | None, tuple[int, ...] | None]:
    """Return whether a cloud is fused, and the stamps of its pairs, by its comments; None if not stated."""
    stated: dict[str, str] = {}
    for text in comments:
        sign, name, value = (*text.split(" ", 2), "", "")[:3]
        if sign == "sfr" and stated.setdefault(name, value.strip()) != value.strip():
            raise ValueError(f"its comments 'sfr {name}' contradict each other")
    fused, stamps = stated.get(FUSED), stated.get(PAIR_STAMPS)
    if fused not in (None, "true", "false"):
        raise ValueError(f"'sfr {FUSED} {fused[:40]}' must end in true or false")
    words = (stamps or "").split()
    if len(words) > MAX_PAIR_STAMPS:
        raise ValueError(f"'sfr {PAIR_STAMPS}' lists {len(words)} stamps: at most {MAX_PAIR_STAMPS} are allowed")
    try:
        stamps_ns = tuple(map(parse_stamp_ns, words))
    except ValueError as error:
        raise ValueError(f"'sfr {PAIR_STAMPS}': {error}") from error
    return None if fused is None else fused == "true", None if stamps is None else stamps_ns


def _check_names_differ(names: Sequence[str], where: str) -> None:
    """Raise ValueError if a name occurs twice, because either field might have the values."""
    if doubled := sorted(name for name, count in Counter(names).items() if count > 1):
        raise ValueError(f"{where} has the field {doubled[0]} twice")


def _columns(body: bytes, dtype: np.dtype[Any], count: int, *, is_text: bool) -> Columns:
    """Return the scalar fields of `count` records in binary, or in text with one record per line."""
    names = dtype.names or ()
    if not is_text:
        if len(body) < count * dtype.itemsize:
            raise ValueError(f"{len(body)} bytes found where {count} points of {dtype.itemsize} bytes are required")
        records = np.frombuffer(body, dtype, count)
        return {name: records[name] for name in names if dtype[name].shape == ()}
    widths = [int(np.prod(dtype[name].shape)) for name in names]
    if len(body) + 1 < 2 * count * sum(widths):  # each number has a digit and a separator
        raise ValueError(f"{len(body)} bytes of text found where {count} points of {sum(widths)} numbers are required")
    table = _number_table(body, count, sum(widths))
    starts = np.cumsum([0, *widths])
    return {name: table[:, starts[i]] for i, name in enumerate(names) if widths[i] == 1}


def _ply_bytes(cloud: PointCloud) -> bytes:
    dtype = PointCloud.dtype()
    properties = [f"property {PLY_NAMES[dtype[name].str[1:]]} {name}" for name in FIELD_TYPES]
    comments = [f"comment {text}" for text in _comments(cloud)]
    vertices = [f"element vertex {len(cloud)}", *properties]
    head = ["ply", "format binary_little_endian 1.0", *comments, *vertices, "end_header"]
    return ("\n".join(head) + "\n").encode() + cloud.to_structured().tobytes()


@dataclass(frozen=True, slots=True)
class _Property:
    """A property of a PLY element: numpy's type of its values and, if it is a list, of its length."""

    name: str
    kind: str
    length_kind: str = ""

    def one(self, length: int) -> list[tuple[str, str] | tuple[str, str, tuple[int]]]:
        """Return the fields of one record; a list has `length` values."""
        if not self.length_kind:
            return [(self.name, self.kind)]
        return [(f"{self.name} length", self.length_kind), (self.name, self.kind, (length,))]


def _read_ply(data: bytes) -> tuple[Columns, list[str], Grid]:
    """Return the scalar properties of the vertices of a PLY file; other elements and lists are skipped."""
    end = _PLY_END.search(data)
    if not data.startswith(b"ply") or end is None:
        raise ValueError("it has no PLY header, which begins with 'ply' and ends with 'end_header'")
    body = end.end()
    lines = data[: end.start()].decode("ascii", "replace").splitlines()
    header = [words for line in lines if (words := line.split())]
    order = next((" ".join(words[1:2]) for words in header if words[0] == "format"), "")
    if order not in PLY_ORDERS:
        raise ValueError(f"its PLY format is '{order[:40]}': one of {', '.join(PLY_ORDERS)} is required")
    comments = [line.removeprefix("comment ") for line in lines if line.startswith("comment ")]
    position = body
    for name, count, properties in _ply_elements(header, PLY_ORDERS[order]):
        read = _ply_text if order == "ascii" else _ply_records
        columns, position = read(data, position, count, properties)
        if name == "vertex":
            return columns, comments, None
    raise ValueError("it has no element 'vertex'")


def _ply_elements(header: list[list[str]], order: str) -> list[tuple[str, int, list[_Property]]]:
    """Return name, count and properties of each element."""
    elements: list[tuple[str, int, list[_Property]]] = []
    for words in header:
        if words[0] == "element":
            if len(words) != 3:
                raise ValueError(f"its line '{' '.join(words)[:40]}' is not of the form 'element NAME COUNT'")
            elements.append((words[1], parse_count(words[2]), []))
        elif words[0] == "property" and elements:
            if len(words) != (5 if words[1:2] == ["list"] else 3):
                raise ValueError(f"its line '{' '.join(words)[:40]}' is not of the form 'property TYPE NAME'")
            kinds = words[2:4] if words[1] == "list" else words[1:2]
            if not all(kind in PLY_TYPES for kind in kinds):
                raise ValueError(f"it has a property of type '{' '.join(words[1:-1])}', which is not supported")
            types = [order + PLY_TYPES[kind] for kind in kinds]
            name = words[-1].lower()
            elements[-1][2].append(_Property(name, types[-1], types[0] if len(types) > 1 else ""))
    for element, _, properties in elements:
        _check_names_differ([item.name for item in properties], f"its element {element}")
    return elements


def _ply_records(data: bytes, position: int, count: int, properties: list[_Property]) -> tuple[Columns, int]:
    """Return the scalar properties of an element, and the offset of the element's end."""
    lists = [item for item in properties if item.length_kind]
    lengths = [_first_lengths(data, position, properties)] if lists and count else [{}]
    dtype = np.dtype([field for item in properties for field in item.one(lengths[0].get(item.name, 0))])
    end = position + count * dtype.itemsize
    scalars = [item.name for item in properties if not item.length_kind]
    if end <= len(data):
        records = np.frombuffer(data, dtype, count, position) if count else np.zeros(0, dtype)
        alike = all((records[f"{item.name} length"] == lengths[0].get(item.name, 0)).all() for item in lists)
        if alike:
            return {name: records[name] for name in scalars}, end
    elif not lists:
        found = len(data) - position
        raise ValueError(f"{found} bytes found where {count} points of {dtype.itemsize} bytes are required")
    smallest = sum(np.dtype(item.length_kind or item.kind).itemsize for item in properties)
    if count * smallest > len(data) - position:
        raise ValueError(f"{len(data) - position} bytes found where {count} records of {smallest} bytes are required")
    return _ply_uneven(data, position, count, properties)


def _first_lengths(data: bytes, position: int, properties: list[_Property]) -> dict[str, int]:
    """Return the lengths of the lists of the first record."""
    lengths = {}
    for item in properties:
        if item.length_kind:
            lengths[item.name] = _length(data, position, item)
            position += np.dtype(item.length_kind).itemsize
        position += np.dtype(item.kind).itemsize * lengths.get(item.name, 1)
    return lengths


def _length(data: bytes, position: int, item: _Property) -> int:
    if position + np.dtype(item.length_kind).itemsize > len(data):
        raise ValueError("its data is truncated within a list")
    length = int(np.frombuffer(data, item.length_kind, 1, position)[0])
    if not 0 <= length <= len(data):
        raise ValueError(f"a list '{item.name}' declares {length} values, more than the file can contain")
    return length


def _ply_uneven(data: bytes, position: int, count: int, properties: list[_Property]) -> tuple[Columns, int]:
    """Return the scalar properties of records whose lists vary in length."""
    columns = {item.name: np.zeros(count, item.kind) for item in properties if not item.length_kind}
    for row in range(count):
        for item in properties:
            length = 1
            if item.length_kind:
                length = _length(data, position, item)
                position += np.dtype(item.length_kind).itemsize
            size = np.dtype(item.kind).itemsize * length
            if position + size > len(data):
                raise ValueError(f"its data is truncated in record {row + 1} of {count}")
            if not item.length_kind:
                columns[item.name][row] = np.frombuffer(data, item.kind, 1, position)[0]
            position += size
    return columns, position


def _ply_text(data: bytes, position: int, count: int, properties: list[_Property]) -> tuple[Columns, int]:
    """Return the scalar properties of an element in text, with one line per record, and the offset of its end."""
    if count * 2 > len(data) - position + 1:
        raise ValueError(f"{len(data) - position} bytes of text found where {count} lines are required")
    rows: list[bytes] = []
    while len(rows) < count:
        end = data.find(b"\n", position)
        end = len(data) if end < 0 else end
        if position >= len(data):
            raise ValueError(f"{len(rows)} lines found where {count} are required")
        if line := data[position:end].strip():
            rows.append(line)
        position = end + 1
    scalars = [item.name for item in properties if not item.length_kind]
    if len(scalars) == len(properties):
        table = _number_table(b"\n".join(rows), count, len(scalars))
        return {name: table[:, column] for column, name in enumerate(scalars)}, position
    values = np.zeros((count, len(scalars)))
    for row, line in enumerate(rows):
        words = _PLAIN_NAN.sub(b"nan", line).split()
        place, column = 0, 0
        for item in properties:
            if item.length_kind:
                place += 1 + parse_count(words[place].decode("ascii", "replace"))
            else:
                values[row, column] = float(words[place])
                place, column = place + 1, column + 1
    return {name: values[:, column] for column, name in enumerate(scalars)}, position


def _number_table(body: bytes, count: int, width: int) -> FloatArray:
    """Return `count` lines of `width` numbers; NaN may be in the notation of Windows."""
    if not count or not width:
        return np.zeros((count, width))
    lines = b"\n".join(line for line in body.splitlines() if line.partition(b"#")[0].strip())  # numpy warns of them
    table = np.loadtxt(io.BytesIO(_PLAIN_NAN.sub(b"nan", lines)), np.float64, ndmin=2, max_rows=count)
    if table.shape != (count, width):
        raise ValueError(f"{table.shape} numbers found where {(count, width)} are required")
    return table


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


def _read_pcd(data: bytes) -> tuple[Columns, list[str], Grid]:
    """Return the fields and comments of a PCD file, and the size if the cloud is organised."""
    head, comments, position = _pcd_head(data)
    storage = " ".join(head["DATA"]).lower()
    if storage not in ("ascii", "binary", "binary_compressed"):
        raise ValueError(f"its data is '{storage}' where ascii, binary or binary_compressed is required")
    size_of_grid = {name: parse_count(head[name][0]) for name in ("WIDTH", "HEIGHT", "POINTS") if name in head}
    height = size_of_grid.get("HEIGHT", 1)
    width = size_of_grid.get("WIDTH", size_of_grid.get("POINTS", 0))
    points = width * height
    if size_of_grid.get("POINTS", points) != points:
        raise ValueError(f"it has POINTS {head['POINTS'][0]} where WIDTH and HEIGHT give {points}")
    viewpoint = [number_or_nan(word) for word in head.get("VIEWPOINT", ())]
    if viewpoint not in ([], NO_VIEWPOINT):
        _log.warning(f"the VIEWPOINT {' '.join(head['VIEWPOINT'])[:60]} of a PCD file is ignored: points are not moved")
    fields, names = [], head["FIELDS"]
    counts = head.get("COUNT", ["1"] * len(names))
    if not len(names) == len(head["TYPE"]) == len(head["SIZE"]) == len(counts):
        raise ValueError("its header has different numbers of FIELDS, TYPE, SIZE and COUNT")
    for i, (name, kind, size, count) in enumerate(zip(names, head["TYPE"], head["SIZE"], counts, strict=True)):
        if kind + size not in PCD_TYPES or not 1 <= parse_count(count) <= MAX_COUNT:
            raise ValueError(f"its field {name} has TYPE {kind}, SIZE {size}, COUNT {count}, which is not supported")
        shape = () if int(count) == 1 else (int(count),)
        own_name = f"{name}{i}" if name == PADDING else name.lower()
        fields.append((own_name, f"<{kind.lower()}{size}", shape))
    _check_names_differ([name for name, _, _ in fields], "it")
    if storage == "binary_compressed":
        columns = _uncompressed(data[position:], np.dtype(fields), points)
    else:
        columns = _columns(data[position:], np.dtype(fields), points, is_text=storage == "ascii")
    return columns, comments, (width, height) if min(width, height) > 1 else None


def _pcd_head(data: bytes) -> tuple[dict[str, list[str]], list[str], int]:
    """Return the words of each line of a PCD header by its first word, the comments, and the offset of the data."""
    head: dict[str, list[str]] = {}
    comments: list[str] = []
    position = 0
    while "DATA" not in head:
        end = data.find(b"\n", position)
        if end < 0:
            raise ValueError("it has no PCD header, which has the lines FIELDS, SIZE, TYPE, WIDTH and DATA")
        line = data[position:end].decode("ascii", "replace").strip()
        position, words = end + 1, line.split()
        if line.startswith("#"):
            comments.append(line.removeprefix("#").strip())
        elif words:
            head["FIELDS" if words[0] == "COLUMNS" else words[0]] = words[1:]  # COLUMNS of version 0.5
    needed = ["FIELDS", "SIZE", "TYPE", "WIDTH" if "WIDTH" in head else "POINTS"]
    needed += [name for name in ("HEIGHT", "POINTS") if name in head and name not in needed]
    if wrong := [name for name in needed if not head.get(name)]:
        raise ValueError(f"its PCD header has no {' and no '.join(wrong)}")
    return head, comments, position


def _uncompressed(body: bytes, dtype: np.dtype[Any], count: int) -> Columns:
    """Return the scalar fields of binary_compressed data: sizes, then LZF of all values field by field."""
    size, whole = (int(number) for number in np.frombuffer(body[:8].ljust(8, b"\0"), "<u4"))
    if size > len(body) - 8 or whole != count * dtype.itemsize or whole > expansion_limit(size):
        raise ValueError(f"{len(body)} compressed bytes found for {count} points of {dtype.itemsize} bytes")
    from sfr_loc_map.io.clouds.lzf import decompress_lzf  # compiled code is loaded only for such files

    raw = np.zeros(whole, np.uint8)
    if decompress_lzf(np.frombuffer(body, np.uint8, size, 8), raw) != whole:
        raise ValueError("its compressed data is corrupt")
    columns, start = {}, 0
    for name in dtype.names or ():
        kind, shape = dtype[name].base, dtype[name].shape
        length = count * dtype[name].itemsize
        if shape == ():
            columns[name] = raw[start : start + length].view(kind)
        start += length
    return columns


def _npz_bytes(cloud: PointCloud) -> bytes:
    records, buffer = cloud.to_structured(), io.BytesIO()
    members = {name: np.ascontiguousarray(records[name]) for name in FIELD_TYPES}
    if cloud.fused is not None:
        members[FUSED] = np.array(cloud.fused)
    if cloud.pair_stamps_ns is not None:
        members[PAIR_STAMPS] = np.array(cloud.pair_stamps_ns, np.int64)
    np.savez(buffer, **members)  # type: ignore[arg-type]
    return buffer.getvalue()


def _read_npz(data: bytes) -> tuple[Columns, list[str], Grid]:
    members = parse_npz(data, (*FIELD_TYPES, FUSED, PAIR_STAMPS))
    names = npz_names(data)
    if not members.keys() >= set("xyz"):
        raise ValueError(f"it has the arrays {', '.join(names)[:80] or 'none'}: x, y and z are required")
    _check_names_differ([name.lower() for name in names if name.lower() in members], "it")
    columns = {name: values for name, values in members.items() if name in FIELD_TYPES}
    if several := [name for name, values in columns.items() if values.ndim != 1]:
        raise ValueError(f"its array {several[0]} has the shape {columns[several[0]].shape}: one number per point (N,)")
    lengths = {name: len(values) for name, values in columns.items()}
    if len(set(lengths.values())) > 1:
        raise ValueError(f"its arrays differ in length: {lengths}")
    said = {name: members[name].reshape(-1).tolist() for name in (FUSED, PAIR_STAMPS) if name in members}
    return columns, [f"sfr {name} {' '.join(map(str, values)).lower()}" for name, values in said.items()], None


_FORMATS: dict[str, tuple[Callable[[bytes], tuple[Columns, list[str], Grid]], Callable[[PointCloud], bytes]]] = {
    ".ply": (_read_ply, _ply_bytes),
    ".pcd": (_read_pcd, _pcd_bytes),
    ".npz": (_read_npz, _npz_bytes),
}
"""Reader and writer of clouds by the ending of the file name."""
SUFFIXES = tuple(_FORMATS)
OTHER_SUFFIXES = (".xyz", ".pts", ".las", ".laz", ".e57", ".obj", ".stl", ".vtk")
"""Endings of clouds of other programs, which are not read."""
