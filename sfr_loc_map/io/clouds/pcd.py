"""PCD files of the Point Cloud Library: text, binary and binary_compressed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, BinaryIO

import numpy as np

from sfr_loc_map.inputs import expansion_limit
from sfr_loc_map.io.clouds.fields import (
    CloudFields,
    Columns,
    check_names_differ,
    ignored_after,
    number_table,
    text_lines,
)
from sfr_loc_map.io.number_text import number_or_nan, parse_count
from sfr_loc_map.message_text import counted

MAX_COUNT = 4096  #: Maximum number of values in one PCD field of a point; descriptors have several hundred.
PCD_TYPES = {"I1", "I2", "I4", "I8", "U1", "U2", "U4", "U8", "F4", "F8"}
PADDING = "_"  #: Name of PCD fields without content.
NO_VIEWPOINT = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]


def write_pcd(fields: CloudFields, stream: BinaryIO) -> None:
    """Write a cloud as a PCD file in little-endian binary."""
    records = fields.records()
    kinds = [records.dtype[name] for name in fields.columns]
    head = [
        "# .PCD v0.7 - Point Cloud Data file format",
        *(f"# {text}" for text in fields.property_comments()),
        "VERSION 0.7",
        f"FIELDS {' '.join(fields.columns)}",
        f"SIZE {' '.join(str(kind.itemsize) for kind in kinds)}",
        f"TYPE {' '.join(kind.kind.upper() for kind in kinds)}",
        f"COUNT {' '.join('1' for _ in kinds)}",
        f"WIDTH {len(records)}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {len(records)}",
        "DATA binary",
    ]
    stream.write(("\n".join(head) + "\n").encode())
    stream.write(records.data)


def read_pcd(data: bytes) -> CloudFields:
    """Return the fields and comments of a PCD file, and the size if the cloud is organised."""
    head, comments, position = _pcd_head(data)
    storage = " ".join(head["DATA"]).lower()
    width, height = _pcd_size(head)
    dtype, body = _pcd_dtype(head), data[position:]
    if storage == "ascii":
        columns, notes = _text_columns(body, dtype, width * height)
    elif storage == "binary":
        columns, notes = _binary_columns(body, dtype, width * height)
    elif storage == "binary_compressed":
        columns, notes = _uncompressed(body, dtype, width * height), ()
    else:
        raise ValueError(f"its data is '{storage}': ascii, binary or binary_compressed is required")
    viewpoint = [number_or_nan(word) for word in head.get("VIEWPOINT", ())]
    if viewpoint not in ([], NO_VIEWPOINT):
        notes += (f"its VIEWPOINT {' '.join(head['VIEWPOINT'])[:60]} is ignored: points are not moved",)
    return CloudFields.with_comments(columns, comments, (width, height) if min(width, height) > 1 else None, notes)


def _pcd_size(head: Mapping[str, Sequence[str]]) -> tuple[int, int]:
    """Return the width and the height in a header; the height of an unorganised cloud is 1."""
    counts = {name: parse_count(head[name][0]) for name in ("WIDTH", "HEIGHT", "POINTS") if name in head}
    height = counts.get("HEIGHT", 1)
    width = counts.get("WIDTH", counts.get("POINTS", 0))
    if counts.get("POINTS", width * height) != width * height:
        raise ValueError(f"POINTS is {head['POINTS'][0]}, but WIDTH and HEIGHT give {width * height}")
    return width, height


def _pcd_dtype(head: Mapping[str, Sequence[str]]) -> np.dtype[Any]:
    """Return the type of a point by the fields in a header; padding fields get a number, so that all names differ."""
    names = head["FIELDS"]
    counts = head.get("COUNT", ["1"] * len(names))
    if not len(names) == len(head["TYPE"]) == len(head["SIZE"]) == len(counts):
        raise ValueError("its header has different numbers of FIELDS, TYPE, SIZE and COUNT")
    fields = []
    for i, (name, kind, size, count) in enumerate(zip(names, head["TYPE"], head["SIZE"], counts, strict=True)):
        if kind + size not in PCD_TYPES or not 1 <= parse_count(count) <= MAX_COUNT:
            raise ValueError(f"its field {name} has TYPE {kind}, SIZE {size}, COUNT {count}, which is not supported")
        shape = () if int(count) == 1 else (int(count),)
        own_name = f"{name}{i}" if name == PADDING else name.lower()
        fields.append((own_name, f"<{kind.lower()}{size}", shape))
    check_names_differ([name for name, _, _ in fields], "it")
    return np.dtype(fields)


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
            name = "FIELDS" if words[0] == "COLUMNS" else words[0]  # version 0.5 has COLUMNS
            if name in head:
                raise ValueError(f"its header has two lines {name}: one is required")
            head[name] = words[1:]
    needed = ["FIELDS", "SIZE", "TYPE", "WIDTH" if "WIDTH" in head else "POINTS"]
    needed += [name for name in ("HEIGHT", "POINTS") if name in head and name not in needed]
    if wrong := [name for name in needed if not head.get(name)]:
        raise ValueError(f"its PCD header has no {' and no '.join(wrong)}")
    return head, comments, position


def _uncompressed(body: bytes, dtype: np.dtype[Any], count: int) -> Columns:
    """Return the scalar fields of binary_compressed data: sizes, then LZF of all values field by field."""
    size, full_size = (int(number) for number in np.frombuffer(body[:8].ljust(8, b"\0"), "<u4"))
    if len(body) < 8:
        raise ValueError(f"its compressed data has {len(body)} bytes: at least the 8 bytes of two sizes are required")
    if size > len(body) - 8:
        raise ValueError(f"its compressed data is truncated: {size} bytes are declared, {len(body) - 8} are present")
    if full_size != count * dtype.itemsize:
        raise ValueError(
            f"its compressed data declares {full_size} uncompressed bytes: {count} points of {dtype.itemsize} bytes "
            "are required"
        )
    if full_size > expansion_limit(size):
        raise ValueError(
            f"its compressed data has {size} bytes and declares {full_size} uncompressed bytes: at most "
            f"{expansion_limit(size)} are allowed"
        )
    from sfr_loc_map.io.clouds.lzf import decompress_lzf  # compiled code is loaded only for such files

    raw = np.zeros(full_size, np.uint8)
    if decompress_lzf(np.frombuffer(body, np.uint8, size, 8), raw) != full_size:
        raise ValueError("its compressed data is corrupt")
    columns, start = {}, 0
    for name in dtype.names or ():
        kind, shape = dtype[name].base, dtype[name].shape
        length = count * dtype[name].itemsize
        if shape == ():
            columns[name] = raw[start : start + length].view(kind)
        start += length
    return columns


def _binary_columns(body: bytes, dtype: np.dtype[Any], count: int) -> tuple[Columns, tuple[str, ...]]:
    """Return the scalar fields of `count` records, and a note on the data after them."""
    if len(body) < count * dtype.itemsize:
        raise ValueError(f"its data has {len(body)} bytes: {count} points of {dtype.itemsize} bytes are required")
    records = np.frombuffer(body, dtype, count)
    columns = {name: records[name] for name in dtype.names or () if dtype[name].shape == ()}
    return columns, ignored_after(body[count * dtype.itemsize :])


def _text_columns(body: bytes, dtype: np.dtype[Any], count: int) -> tuple[Columns, tuple[str, ...]]:
    """Return the scalar fields of `count` lines of text, and a note on the data after them."""
    names = dtype.names or ()
    widths = [int(np.prod(dtype[name].shape)) for name in names]
    if len(body) + 1 < 2 * count * sum(widths):  # each number has a digit and a separator
        raise ValueError(
            f"its data has {len(body)} bytes of text: {count} points of {sum(widths)} numbers are required"
        )
    lines = text_lines(body)
    if len(lines) < count:
        raise ValueError(f"its data has {counted(len(lines), 'line')}: {count} are required")
    table = number_table(lines[:count], sum(widths))
    starts = np.cumsum([0, *widths])
    columns = {name: table[:, starts[i]] for i, name in enumerate(names) if widths[i] == 1}
    return columns, ignored_after(b"\n".join(lines[count:]))
