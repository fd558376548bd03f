"""Clouds as NPZ: one array for each field."""

from __future__ import annotations

from typing import BinaryIO

import numpy as np

from sfr_loc_map.geometry.cloud import FIELD_TYPES
from sfr_loc_map.io.clouds.array_file import npz_names, parse_npz
from sfr_loc_map.io.clouds.fields import FUSED, PAIR_STAMPS, CloudFields, check_names_differ, stated_in


def write_npz(fields: CloudFields, stream: BinaryIO) -> None:
    """Write a cloud as an NPZ archive."""
    members = {name: np.ascontiguousarray(values) for name, values in fields.columns.items()}
    fused, pair_stamps_ns = stated_in(fields.comments)
    if fused is not None:
        members[FUSED] = np.array(fused)
    if pair_stamps_ns is not None:
        members[PAIR_STAMPS] = np.array(pair_stamps_ns, np.int64)
    np.savez(stream, **members)  # type: ignore[arg-type]


def read_npz(data: bytes) -> CloudFields:
    """Return the fields of a cloud and its stated properties as comments."""
    members = parse_npz(data, (*FIELD_TYPES, FUSED, PAIR_STAMPS))
    names = npz_names(data)
    if not members.keys() >= set("xyz"):
        raise ValueError(f"it has the arrays {', '.join(names)[:80] or 'none'}: x, y and z are required")
    check_names_differ([name.lower() for name in names if name.lower() in members], "it")
    columns = {name: values for name, values in members.items() if name in FIELD_TYPES}
    if several := [name for name, values in columns.items() if values.ndim != 1]:
        raise ValueError(
            f"its array {several[0]} has the shape {columns[several[0]].shape}: one number per point, (N,), is required"
        )
    lengths = {name: len(values) for name, values in columns.items()}
    if len(set(lengths.values())) > 1:
        raise ValueError(f"its arrays differ in length: {lengths}")
    stated = {name: members[name].reshape(-1).tolist() for name in (FUSED, PAIR_STAMPS) if name in members}
    comments = [f"sfr {name} {' '.join(map(str, values)).lower()}" for name, values in stated.items()]
    return CloudFields(columns, comments)
