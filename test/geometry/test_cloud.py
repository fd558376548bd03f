"""Point clouds are equal after conversion to records and back."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from sfr_loc_map.geometry.cloud import FIELD_TYPES, PointCloud

clouds = hnp.arrays(PointCloud.dtype(), st.integers(0, 6)).map(PointCloud.from_structured)


def same(a: PointCloud, b: PointCloud) -> bool:
    return a.to_structured().tobytes() == b.to_structured().tobytes()


@given(clouds)
def test_records_there_and_back_are_the_same_bits_whatever_the_order_of_the_fields(cloud: PointCloud) -> None:
    records = cloud.to_structured()
    assert records.dtype.itemsize == 5 * 4 + 2 * 2 + 1  # packed: x y z sigma intensity, u v, pair
    other = np.zeros(len(cloud), np.dtype([(n, FIELD_TYPES[n]) for n in list(FIELD_TYPES)[::-1]], align=True))
    for name in FIELD_TYPES:
        other[name] = records[name]
    assert same(PointCloud.from_structured(records), cloud)
    assert same(PointCloud.from_structured(other), cloud)
