"""Clouds: round trips through records, choice, joining, checks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from sfr_loc_map.errors import GeometryError
from sfr_loc_map.geometry.cloud import FIELD_TYPES, PointCloud

clouds = hnp.arrays(PointCloud.dtype(), st.integers(0, 6)).map(PointCloud.from_structured)
NAMES = ("xyz", "sigma", "intensity", "u", "v", "pair")


def same(a: PointCloud, b: PointCloud) -> bool:
    return all(
        getattr(a, n).tobytes() == getattr(b, n).tobytes() and getattr(a, n).dtype == getattr(b, n).dtype for n in NAMES
    )


@given(clouds)
def test_records_there_and_back_are_the_same_bits(cloud: PointCloud) -> None:
    records = cloud.to_structured()
    assert records.dtype.itemsize == 5 * 4 + 2 * 2 + 1  # packed: x y z sigma intensity, u v, pair
    assert same(PointCloud.from_structured(records), cloud)


@given(clouds)
def test_order_and_layout_of_the_fields_do_not_matter(cloud: PointCloud) -> None:
    names = list(FIELD_TYPES)[::-1]
    other = np.zeros(len(cloud), np.dtype([(n, FIELD_TYPES[n]) for n in names], align=True))
    for name in names:
        other[name] = cloud.to_structured()[name]
    assert same(PointCloud.from_structured(other), cloud)


@pytest.mark.slow
@given(clouds, clouds)
def test_joined_and_taken_apart(a: PointCloud, b: PointCloud) -> None:
    both = PointCloud.concatenate([a, b])
    assert len(both) == len(a) + len(b)
    of_a = np.arange(len(both)) < len(a)
    assert same(both.select(of_a), a)
    assert same(both.select(np.flatnonzero(~of_a)), b)


def made() -> PointCloud:
    records = np.zeros(2, PointCloud.dtype())
    records["u"] = [65535, 0]
    return PointCloud.from_structured(records)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("xyz", np.zeros((2, 3))),
        ("xyz", np.zeros((2, 4), np.float32)),
        ("sigma", np.zeros(2)),
        ("sigma", np.zeros(3, np.float32)),
        ("u", np.zeros(2, np.int64)),
        ("pair", np.zeros((2, 1), np.uint8)),
    ],
)
def test_wrong_types_and_shapes(name: str, value: np.ndarray) -> None:
    words = "points" if name == "xyz" else f"field '{name}'"
    with pytest.raises(GeometryError, match=words):
        replace(made(), **{name: value})
