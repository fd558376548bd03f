"""PLY files: text and binary, written binary little endian."""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.cloud import FIELD_TYPES, PointCloud
from sfr_loc_map.io.cloud_records import CloudRecords, cloud_comments, columns_of, records_of
from sfr_loc_map.io.text_numbers import parse_count

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


def ply_bytes(cloud: PointCloud) -> bytes:
    """Return a cloud as a PLY file with all its fields."""
    dtype = PointCloud.dtype()
    properties = [f"property {PLY_NAMES[dtype[name].str[1:]]} {name}" for name in FIELD_TYPES]
    comments = [f"comment {text}" for text in cloud_comments(cloud)]
    vertices = [f"element vertex {len(cloud)}", *properties]
    head = ["ply", "format binary_little_endian 1.0", *comments, *vertices, "end_header"]
    return ("\n".join(head) + "\n").encode() + cloud.to_structured().tobytes()


def read_ply(data: bytes) -> CloudRecords:
    """Return the fields of the vertices of a PLY file; its first element must be the vertices.

    Raises:
        ValueError: If it is broken or of another form.
    """
    end = data.find(b"end_header")
    if not data.startswith(b"ply") or end < 0:
        raise ValueError("it has no PLY header")
    body = data.index(b"\n", end) + 1
    lines = data[:end].decode("ascii", "replace").splitlines()
    order, count, fields = _ply_header(lines)
    dtype = np.dtype([(name, PLY_ORDERS[order] + kind) for name, kind in fields])
    columns = columns_of(data[body:], dtype, count, is_text=order == "ascii")
    comments = (line.removeprefix("comment ").strip() for line in lines if line.startswith("comment "))
    return records_of(columns, comments)


def _ply_header(lines: list[str]) -> tuple[str, int, list[tuple[str, str]]]:
    """Return format, number of points and fields of the vertex element, which must come first."""
    header = [line.split() for line in lines]
    order = next((words[1] for words in header if words[:1] == ["format"]), "")
    elements = _elements(header)
    if order not in PLY_ORDERS or not elements:
        raise ValueError("its PLY header has no known format or no vertices")
    (_, element, count, *_), *body = elements[0]
    if element != "vertex":
        raise ValueError(f"its first element is '{element}' where 'vertex' is needed")
    return order, parse_count(count), [_ply_field(words) for words in body if words[0] == "property"]


def _elements(header: list[list[str]]) -> list[list[list[str]]]:
    """Return the lines of each element, that of its name first."""
    elements: list[list[list[str]]] = []
    for words in header:
        if words[:1] == ["element"]:
            elements.append([words])
        elif words and elements:
            elements[-1].append(words)
    return elements


def _ply_field(words: list[str]) -> tuple[str, str]:
    if words[1] not in PLY_TYPES:
        raise ValueError(f"its vertices have a property of type '{words[1]}', which is not read")
    return words[2], PLY_TYPES[words[1]]
