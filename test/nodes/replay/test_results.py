"""The map of an external node: clouds of pairs taken together, one of all, or points without pixels."""

import numpy as np

from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.nodes.replay.results import ReplayResults


def cloud(count: int) -> PointCloud:
    records = np.zeros(count, PointCloud.dtype())
    records["x"] = np.arange(count) + count
    return PointCloud.from_structured(records)


def results(*stamps_ns: int) -> ReplayResults:
    points = [(stamp_ns, cloud(stamp_ns).xyz.astype(np.float64)) for stamp_ns in stamps_ns]
    published = {("nav", stamp_ns) for stamp_ns in (10, 20, 30)}
    return ReplayResults(
        published=published, points=points, clouds=[(stamp_ns, cloud(stamp_ns)) for stamp_ns in stamps_ns]
    )


def test_clouds_of_each_pair_are_taken_together_and_one_is_the_map_of_all() -> None:
    whole, points, stamps = results(10, 20, 30).external_map()
    assert (points, whole.fused) == (None, False)
    assert np.bincount(whole.pair).tolist() == [10, 20, 30]
    np.testing.assert_array_equal(whole.xyz[10:30], cloud(20).xyz)
    last, _, of_last = results(30).external_map()
    assert (last.fused, len(last)) == (True, 30)
    assert stamps == of_last == whole.pair_stamps_ns == last.pair_stamps_ns == (10, 20, 30)


def test_points_without_pixels_stay_points() -> None:
    found = results(10, 20, 30)
    found.clouds.pop()
    whole, points, stamps = found.external_map()
    assert (whole, points.shape, stamps) == (None, (60, 3), (10, 20, 30))
    assert ReplayResults().external_map() == (None, None, ())
