"""Clouds as NPZ: one array for each field."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.cloud import FIELD_TYPES
from sfr_loc_map.io.clouds.array_file import npz_names, parse_npz
from sfr_loc_map.io.clouds.fields import FUSED, PAIR_STAMPS, CloudFields, check_names_differ, checked_stamps
from sfr_loc_map.io.stamps.stamp_text import STAMP_LIMIT


def write_npz(fields: CloudFields, stream: BinaryIO) -> None:
    """Write a cloud as an NPZ archive."""
    members = {name: np.ascontiguousarray(values) for name, values in fields.columns.items()}
    if fields.fused is not None:
        members[FUSED] = np.array(fields.fused)
    if fields.pair_stamps_ns is not None:
        members[PAIR_STAMPS] = np.array(fields.pair_stamps_ns, np.int64)
    np.savez(stream, **members)  # type: ignore[arg-type]


def read_npz(data: bytes) -> CloudFields:
    """Return the fields of a cloud and its stated properties."""
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
    return CloudFields(columns, _fused_in(members), _pair_stamps_in(members))


def _fused_in(members: Mapping[str, NDArray[Any]]) -> bool | None:
    """Return whether a cloud is fused; None if this is not stated."""
    fused = members.get(FUSED)
    if fused is None:
        return None
    if fused.size != 1 or fused.dtype != np.bool_:
        raise ValueError(f"its array {FUSED} is {fused.size} x {fused.dtype}: one truth value is required")
    return bool(fused.item())


def _pair_stamps_in(members: Mapping[str, NDArray[Any]]) -> tuple[int, ...] | None:
    """Return the stamps of the pairs of a cloud, ns; None if they are not stated."""
    stamps_ns = members.get(PAIR_STAMPS)
    if stamps_ns is None:
        return None
    if stamps_ns.size and (
        stamps_ns.dtype.kind not in "iu" or not ((stamps_ns >= -STAMP_LIMIT) & (stamps_ns < STAMP_LIMIT)).all()
    ):
        raise ValueError(f"its array {PAIR_STAMPS} requires integers: nanoseconds within 146 years of 1970")
    return checked_stamps(stamps_ns.reshape(-1).tolist())
