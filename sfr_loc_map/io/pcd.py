"""PCD files: text and binary, written binary."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from sfr_loc_map.geometry.cloud import FIELD_TYPES, PointCloud
from sfr_loc_map.io.cloud_records import CloudRecords, cloud_comments, columns_of, records_of
from sfr_loc_map.io.text_numbers import parse_count

PCD_TYPES = {"I1", "I2", "I4", "I8", "U1", "U2", "U4", "U8", "F4", "F8"}
MAX_COUNT = 4096
"""Most values of one field of a point: descriptors have some hundreds."""


def pcd_bytes(cloud: PointCloud) -> bytes:
    """Return a cloud as a binary PCD file with all its fields."""
    kinds = [PointCloud.dtype()[name] for name in FIELD_TYPES]
    head = [
        "# .PCD v0.7 - Point Cloud Data file format",
        *(f"# {text}" for text in cloud_comments(cloud)),
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


def read_pcd(data: bytes) -> CloudRecords:
    """Return the fields of a PCD file.

    An organised one without u and v gives them by the order of its points: they are one image's, hence not fused.

    Raises:
        ValueError: If it is broken or of another form.
        KeyError: If its header misses a line.
    """
    head, start, comments = _header(data)
    if head["DATA"] not in (["ascii"], ["binary"]):
        raise ValueError(f"its data is '{' '.join(head['DATA'])}' where ascii or binary is needed")
    width, height = parse_count(head["WIDTH"][0]), parse_count(head["HEIGHT"][0])
    if "POINTS" in head and parse_count(head["POINTS"][0]) != width * height:
        raise ValueError(f"it has POINTS {head['POINTS'][0]} where WIDTH and HEIGHT say {width * height}")
    columns = columns_of(data[start:], _record_type(head), width * height, is_text=head["DATA"] == ["ascii"])
    if height > 1 and "u" not in columns and "v" not in columns:
        v, u = np.divmod(np.arange(width * height), width)
        columns = {**columns, "u": u, "v": v, "pair": columns.get("pair", np.zeros(width * height))}
        records = records_of(columns, comments)
        return replace(records, fused=bool(records.fused))
    return records_of(columns, comments)


def _header(data: bytes) -> tuple[dict[str, list[str]], int, list[str]]:
    """Return the words of each line of the header by its first word, where the data begins, and the comments."""
    head: dict[str, list[str]] = {}
    comments: list[str] = []
    position = 0
    while "DATA" not in head:
        end = data.find(b"\n", position)
        if end < 0:
            raise ValueError("it has no PCD header")
        line = data[position:end].decode("ascii", "replace").strip()
        position = end + 1
        words = line.split()
        if line.startswith("#"):
            comments.append(line.removeprefix("#").strip())
        elif words:
            head[words[0]] = words[1:]
    return head, position, comments


def _record_type(head: dict[str, list[str]]) -> np.dtype[Any]:
    names = head["FIELDS"]
    layout = zip(names, head["TYPE"], head["SIZE"], head.get("COUNT", ["1"] * len(names)), strict=True)
    fields = []
    for i, (name, kind, size, count) in enumerate(layout):
        if kind + size not in PCD_TYPES or not 1 <= parse_count(count) <= MAX_COUNT:
            raise ValueError(f"its field {name} has TYPE {kind}, SIZE {size}, COUNT {count}, which is not read")
        fields.append((f"{name}{i}" if name == "_" else name, f"<{kind.lower()}{size}", int(count)))  # `_` is padding
    return np.dtype([(name, kind) if count == 1 else (name, kind, (count,)) for name, kind, count in fields])
