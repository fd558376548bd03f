from collections.abc import Callable

import numpy as np
import pytest
from scenes import sent
from sensor_msgs.msg import PointCloud2, PointField

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.cloud import FIELD_TYPES, PointCloud
from sfr_loc_map.nodes.messages.point_cloud import cloud_from_msg, cloud_msg, xyz_from_msg

STAMP_NS = 1_700_000_000_123_456_789


def cloud(count: int) -> PointCloud:
    rng = np.random.default_rng(1)
    records = np.zeros(count, PointCloud.dtype())
    for name, kind in FIELD_TYPES.items():
        records[name] = rng.normal(size=count) if kind is np.float32 else rng.integers(0, 200, count)
    return PointCloud.from_structured(records)


@pytest.mark.parametrize("count", [0, 1, 1000])
def test_clouds_come_out_as_they_went_in(count: int) -> None:
    made = cloud(count)
    message = sent(cloud_msg(made, STAMP_NS, "lm"))
    names = [(field.name, field.datatype) for field in message.fields]
    assert names == [(n, 7) for n in ("x", "y", "z", "sigma", "intensity")] + [("u", 4), ("v", 4), ("pair", 2)]
    assert (message.header.frame_id, message.height, message.width, message.is_dense) == ("lm", 1, count, True)
    assert (message.point_step, message.row_step) == (25, 25 * count)
    assert np.array_equal(cloud_from_msg(message).to_structured(), made.to_structured())
    np.testing.assert_array_equal(xyz_from_msg(message), made.xyz.astype(np.float64))


@pytest.mark.parametrize(("kind", "code", "order"), [("f4", PointField.FLOAT32, "<"), ("f8", PointField.FLOAT64, ">")])
def test_points_of_any_float_layout_are_read(kind: str, code: int, order: str) -> None:
    values = np.random.default_rng(1).normal(size=(6, 3)).astype(kind)
    size = values.dtype.itemsize
    offsets = {"z": 0, "x": 2 * size, "y": size}
    dtype = {"names": list(offsets), "formats": [order + kind] * 3, "offsets": [*offsets.values()], "itemsize": 40}
    records = np.zeros(6, np.dtype(dtype))
    for axis, name in enumerate("xyz"):
        records[name] = values[:, axis]
    fields = [PointField(name=name, offset=offset, datatype=code, count=1) for name, offset in offsets.items()]
    message = PointCloud2(height=2, width=3, fields=fields, is_bigendian=order == ">", point_step=40, row_step=120)
    message.data = records.tobytes()
    np.testing.assert_array_equal(xyz_from_msg(message), values.astype(np.float64))
    message.fields = fields[:2]
    with pytest.raises(InputError, match="no field 'y' of float32 or float64"):
        xyz_from_msg(message)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda m: setattr(m, "data", m.data[:-1]), "too few"),
        (lambda m: setattr(m, "width", 2**31), "too few"),
        (lambda m: setattr(m, "height", 2**31), "too few"),
        (lambda m: m.fields.pop(), "no field 'pair' of uint8"),
        (lambda m: setattr(m.fields[0], "datatype", 8), "no field 'x' of float32"),
        (lambda m: setattr(m.fields[0], "offset", 22), "beyond the 25 byte point"),
        (lambda m: setattr(m, "row_step", 1), "too few"),
    ],
)
def test_broken_clouds_are_refused(change: Callable[[PointCloud2], None], words: str) -> None:
    message = cloud_msg(cloud(4), STAMP_NS, "lm")
    change(message)
    with pytest.raises(InputError, match=words):
        cloud_from_msg(message)
