"""The map of an external node: clouds of pairs taken together, one of all, or points without pixels."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rclpy")

from sensor_msgs.msg import PointCloud2, PointField

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.nodes.messages.point_cloud import cloud_msg, points_from_msg
from sfr_loc_map.nodes.replay.results import ReplayResults


def cloud(count: int, seed: int) -> PointCloud:
    records = np.zeros(count, PointCloud.dtype())
    for name in "xyz":
        records[name] = np.random.default_rng(seed).normal(size=count)
    return PointCloud.from_structured(records)


def results(*stamps_ns: int) -> ReplayResults:
    found = ReplayResults()
    found.published |= {("nav", stamp_ns) for stamp_ns in (10, 20, 30)}
    for stamp_ns in stamps_ns:
        one = cloud(stamp_ns, stamp_ns)
        found.clouds.append((stamp_ns, one))
        found.points.append((stamp_ns, one.xyz.astype(np.float64)))
    return found


def test_clouds_of_each_pair_are_taken_together() -> None:
    whole, points, stamps = results(10, 20, 30).external_map()
    assert whole is not None
    assert points is None
    assert stamps == whole.pair_stamps_ns == (10, 20, 30)
    assert not whole.fused
    assert np.bincount(whole.pair).tolist() == [10, 20, 30]
    np.testing.assert_array_equal(whole.xyz[10:30], cloud(20, 20).xyz)


def test_one_cloud_is_the_map_of_all_pairs() -> None:
    whole, _, stamps = results(30).external_map()
    assert whole is not None
    assert whole.fused
    assert len(whole) == 30
    assert stamps == whole.pair_stamps_ns == (10, 20, 30)


def test_points_without_pixels_stay_points() -> None:
    found = results(10, 20, 30)
    found.clouds.pop()
    whole, points, stamps = found.external_map()
    assert whole is None
    assert points is not None
    assert points.shape == (60, 3)
    assert stamps == (10, 20, 30)
    assert ReplayResults().external_map() == (None, None, ())


@pytest.mark.parametrize(("kind", "code", "order"), [("f4", PointField.FLOAT32, "<"), ("f8", PointField.FLOAT64, ">")])
def test_points_of_any_float_layout_are_read(kind: str, code: int, order: str) -> None:
    values = np.random.default_rng(1).normal(size=(6, 3)).astype(kind)
    size = values.dtype.itemsize
    dtype = np.dtype(
        {"names": list("zxy"), "formats": [order + kind] * 3, "offsets": [0, 2 * size, size], "itemsize": 40}
    )
    records = np.zeros(6, dtype)
    for axis, name in enumerate("xyz"):
        records[name] = values[:, axis]
    offsets = {"z": 0, "x": 2 * size, "y": size}
    fields = [PointField(name=name, offset=offset, datatype=code, count=1) for name, offset in offsets.items()]
    message = PointCloud2(height=2, width=3, fields=fields, is_bigendian=order == ">", point_step=40, row_step=120)
    message.data = records.tobytes()
    np.testing.assert_array_equal(points_from_msg(message), values.astype(np.float64))
    message.row_step = 121
    with pytest.raises(InputError, match="too few"):
        points_from_msg(message)
    message.fields = fields[:2]
    with pytest.raises(InputError, match="no float fields x, y, z"):
        points_from_msg(message)


def test_an_own_cloud_is_one_of_them_and_an_empty_one_has_no_point() -> None:
    one = cloud(7, 3)
    np.testing.assert_array_equal(points_from_msg(cloud_msg(one, 5, "lm")), one.xyz.astype(np.float64))
    assert points_from_msg(cloud_msg(cloud(0, 1), 5, "lm")).shape == (0, 3)
