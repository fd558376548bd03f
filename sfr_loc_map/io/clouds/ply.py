"""PLY files: text and binary; elements other than `vertex`, and lists, are skipped."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np

from sfr_loc_map.io.clouds.fields import (
    PLAIN_NAN,
    CloudFields,
    Columns,
    check_names_differ,
    ignored_after,
    number_table,
)
from sfr_loc_map.io.number_text import parse_count
from sfr_loc_map.message_text import counted

VERTEX = "vertex"  #: Name of the element with the points.
PLY_TYPES = {
    name: kind
    for kind, names in {
        **{"i1": ("char", "int8"), "u1": ("uchar", "uint8"), "i2": ("short", "int16"), "u2": ("ushort", "uint16")},
        **{"i4": ("int", "int32"), "u4": ("uint", "uint32"), "f4": ("float", "float32"), "f8": ("double", "float64")},
    }.items()
    for name in names
}
PLY_NAMES = {"f8": "double", "f4": "float", "u2": "ushort", "u1": "uchar"}
PLY_ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}
_PLY_END = re.compile(rb"^end_header[^\n]*\n", re.MULTILINE)


def write_ply(fields: CloudFields, stream: BinaryIO) -> None:
    """Write a cloud as a PLY file in little-endian binary."""
    records = fields.records()
    properties = [f"property {PLY_NAMES[records.dtype[name].str[1:]]} {name}" for name in fields.columns]
    comments = [f"comment {text}" for text in fields.property_comments()]
    vertices = [f"element vertex {len(records)}", *properties]
    head = ["ply", "format binary_little_endian 1.0", *comments, *vertices, "end_header"]
    stream.write(("\n".join(head) + "\n").encode())
    stream.write(records.data)


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


@dataclass(frozen=True, slots=True)
class _Element:
    """An element of a PLY file: a list of records with equal properties."""

    name: str
    count: int
    properties: list[_Property]


def read_ply(data: bytes) -> CloudFields:
    """Return the scalar properties of the vertices of a PLY file; other elements and lists are skipped."""
    end = _PLY_END.search(data)
    if not data.startswith(b"ply") or end is None:
        raise ValueError("it has no PLY header, which begins with 'ply' and ends with 'end_header'")
    lines = data[: end.start()].decode("ascii", "replace").splitlines()
    header = [words for line in lines if (words := line.split())]
    order = next((" ".join(words[1:2]) for words in header if words[0] == "format"), "")
    if order not in PLY_ORDERS:
        raise ValueError(f"its PLY format is '{order[:40]}': one of {', '.join(PLY_ORDERS)} is required")
    statements = [line.split(None, 1) for line in lines]
    comments = [words[1] for words in statements if len(words) == 2 and words[0] in ("comment", "obj_info")]
    position = end.end()
    elements = _ply_elements(header, PLY_ORDERS[order])
    read = _ply_text if order == "ascii" else _ply_records
    for element in elements:
        columns, position = read(data, position, element.count, element.properties)
        if element.name == VERTEX:
            notes = ignored_after(data[position:]) if element is elements[-1] else ()
            return CloudFields.with_comments(columns, comments, notes=notes)
    raise ValueError(f"it has no element '{VERTEX}'")


def _ply_elements(header: list[list[str]], order: str) -> list[_Element]:
    """Return the elements that a header declares."""
    elements: list[_Element] = []
    for words in header:
        if words[0] == "element":
            if len(words) != 3:
                raise ValueError(f"its line '{' '.join(words)[:40]}' is not of the form 'element NAME COUNT'")
            elements.append(_Element(words[1], parse_count(words[2]), []))
        elif words[0] == "property" and elements:
            if len(words) != (5 if words[1:2] == ["list"] else 3):
                raise ValueError(f"its line '{' '.join(words)[:40]}' is not of the form 'property TYPE NAME'")
            kinds = words[2:4] if words[1] == "list" else words[1:2]
            if not all(kind in PLY_TYPES for kind in kinds):
                raise ValueError(f"it has a property of type '{' '.join(words[1:-1])}', which is not supported")
            types = [order + PLY_TYPES[kind] for kind in kinds]
            name = words[-1].lower()
            elements[-1].properties.append(_Property(name, types[-1], types[0] if len(types) > 1 else ""))
    if len([element for element in elements if element.name == VERTEX]) > 1:
        raise ValueError(f"it has the element {VERTEX} twice: one list of points is required")
    for element in elements:
        check_names_differ([item.name for item in element.properties], f"its element {element.name}")
    return elements


def _ply_records(data: bytes, position: int, count: int, properties: list[_Property]) -> tuple[Columns, int]:
    """Return the scalar properties of an element, and the offset of the element's end."""
    lists = [item for item in properties if item.length_kind]
    lengths = _first_lengths(data, position, properties) if lists and count else {}
    dtype = np.dtype([field for item in properties for field in item.one(lengths.get(item.name, 0))])
    end = position + count * dtype.itemsize
    scalars = [item.name for item in properties if not item.length_kind]
    if end <= len(data):
        records = np.frombuffer(data, dtype, count, position) if count else np.zeros(0, dtype)
        are_equal = all((records[f"{item.name} length"] == lengths.get(item.name, 0)).all() for item in lists)
        if are_equal:
            return {name: records[name] for name in scalars}, end
    elif not lists:
        found = len(data) - position
        raise ValueError(f"its data has {found} bytes: {count} points of {dtype.itemsize} bytes are required")
    smallest = sum(np.dtype(item.length_kind or item.kind).itemsize for item in properties)
    if count * smallest > len(data) - position:
        raise ValueError(f"its data has {len(data) - position} bytes: {count} records of {smallest} bytes are required")
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
        raise ValueError(f"its data has {len(data) - position} bytes of text: {count} lines are required")
    rows: list[bytes] = []
    lines: list[int] = []  # numbers of the lines in the file, from 1
    line_number = data.count(b"\n", 0, position)
    while len(rows) < count:
        end = data.find(b"\n", position)
        end = len(data) if end < 0 else end
        if position >= len(data):
            raise ValueError(f"its data has {counted(len(rows), 'line')}: {count} are required")
        line_number += 1
        if line := data[position:end].strip():
            rows.append(line)
            lines.append(line_number)
        position = end + 1
    scalars = [item.name for item in properties if not item.length_kind]
    if len(scalars) == len(properties):
        table = number_table(rows, len(scalars))
        return {name: table[:, column] for column, name in enumerate(scalars)}, position
    numbers = [b" ".join(_scalars_of(row, properties, line)) for row, line in zip(rows, lines, strict=True)]
    table = number_table(numbers, len(scalars))
    return {name: table[:, column] for column, name in enumerate(scalars)}, position


def _scalars_of(row: bytes, properties: list[_Property], line: int) -> list[bytes]:
    """Return the scalar properties in a row with lists; raise ValueError if the number of values is wrong."""
    words = PLAIN_NAN.sub(b"nan", row).split()
    scalars: list[bytes] = []
    index = 0
    for item in properties:
        if index < len(words) and item.length_kind:
            index += parse_count(words[index].decode("ascii", "replace"))
        elif index < len(words):
            scalars.append(words[index])
        index += 1
    if index != len(words):
        raise ValueError(f"line {line} has {counted(len(words), 'number')}: {index} are required")
    return scalars
