"""The map of an external node: clouds of pairs taken together, one of all, or points without pixels."""

import numpy as np

from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.nodes.replay.results import ReplayResults


def cloud(count: int) -> PointCloud:
    records = np.zeros(count, PointCloud.dtype())
    for name in "xyz":
        records[name] = np.random.default_rng(count).normal(size=count)
    return PointCloud.from_structured(records)


def results(*stamps_ns: int) -> ReplayResults:
    found = ReplayResults()
    found.published |= {("nav", stamp_ns) for stamp_ns in (10, 20, 30)}
    for stamp_ns in stamps_ns:
        found.clouds.append((stamp_ns, cloud(stamp_ns)))
        found.points.append((stamp_ns, cloud(stamp_ns).xyz.astype(np.float64)))
    return found


def test_clouds_of_each_pair_are_taken_together() -> None:
    whole, points, stamps = results(10, 20, 30).external_map()
    assert points is None
    assert stamps == whole.pair_stamps_ns == (10, 20, 30)
    assert not whole.fused
    assert np.bincount(whole.pair).tolist() == [10, 20, 30]
    np.testing.assert_array_equal(whole.xyz[10:30], cloud(20).xyz)


def test_one_cloud_is_the_map_of_all_pairs() -> None:
    whole, _, stamps = results(30).external_map()
    assert (whole.fused, len(whole)) == (True, 30)
    assert stamps == whole.pair_stamps_ns == (10, 20, 30)


def test_points_without_pixels_stay_points() -> None:
    found = results(10, 20, 30)
    found.clouds.pop()
    whole, points, stamps = found.external_map()
    assert (whole, points.shape, stamps) == (None, (60, 3), (10, 20, 30))
    assert ReplayResults().external_map() == (None, None, ())
