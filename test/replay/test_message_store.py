"""The map of a replay: from the call of our node, or from the clouds or points of an external node."""

import numpy as np
import pytest

from sfr_loc_map.calls.call_record import CallRecord
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.replay.message_store import ExternalMaps, Received, ReceivedCloud, ReceivedDrive, ReceivedMaps


def cloud(count: int) -> PointCloud:
    records = np.zeros(count, PointCloud.dtype())
    records["x"] = np.arange(count) + count
    return PointCloud.from_structured(records)


def results(*stamps_ns: int) -> ExternalMaps:
    found = ExternalMaps(sent_ns={10, 20, 30})
    for stamp_ns in stamps_ns:
        found.add_cloud(ReceivedCloud(stamp_ns, cloud(stamp_ns).xyz.astype(np.float64), cloud(stamp_ns)))
    return found


def test_clouds_of_each_pair_are_taken_together_and_one_is_the_map_of_all() -> None:
    whole, points, stamps = results(10, 20, 30).map
    assert (points, whole.fused) == (None, False)
    assert np.bincount(whole.pair).tolist() == [10, 20, 30]
    np.testing.assert_array_equal(whole.xyz[10:30], cloud(20).xyz)
    found = results(30)
    found.clouds[0].cloud.pair[:] = np.arange(30) % 3
    last, _, of_last = found.map
    assert (last.fused, np.bincount(last.pair).tolist()) == (True, [10, 10, 10])
    assert stamps == of_last == whole.pair_stamps_ns == last.pair_stamps_ns == (10, 20, 30)
    assert found.mapped_ns == [10, 20, 30]


@pytest.mark.parametrize("mapped", [(10, 20), (10, 30), (10,), (20,), (30,)])
def test_clouds_of_a_part_of_the_pairs_are_not_the_map_of_all(mapped: tuple[int, ...]) -> None:
    whole, _, stamps = results(*mapped).map
    assert (whole.fused, whole.pair_stamps_ns, stamps) == (False, (10, 20, 30), (10, 20, 30))
    counts = [stamp_ns if stamp_ns in mapped else 0 for stamp_ns in stamps]
    assert np.bincount(whole.pair, minlength=3).tolist() == counts
    answered = Received(maps=results(*mapped)).result(None).nav_pairs
    assert (answered.sent, answered.answered) == (3, len(mapped))


def test_points_without_pixels_stay_points() -> None:
    found = results(10, 20, 30)
    found.clouds[-1] = found.clouds[-1]._replace(cloud=None)
    whole, points, stamps = found.map
    assert (whole, points.shape, stamps) == (None, (60, 3), (10, 20, 30))
    assert ExternalMaps().map == (None, None, ())


def test_a_cloud_is_of_the_pairs_that_its_call_names() -> None:
    """Whatever the order of clouds and calls; a cloud whose call is missing is not complete."""
    found = ReceivedMaps()
    for stamp_ns, points in ((20, 5), (30, 7), (40, 9)):
        found.add_cloud(ReceivedCloud(stamp_ns, cloud(points).xyz, cloud(points)))
    assert found.map == (None, None, ())
    for state, stamp_ns, pairs in (("fused", 30, (10, 30)), ("fused", 20, (20,)), ("mapped_set", 20, (20,))):
        found.add_call(CallRecord(stamp_ns, 0.1, state, pair_stamps_ns=pairs))
    last, _, stamps = found.map
    assert (len(last), last.fused, last.pair_stamps_ns, stamps) == (7, True, (10, 30), (10, 30))
    assert found.map_count == 1


def test_a_node_cannot_state_later_that_a_pose_was_not_lost() -> None:
    found = ReceivedDrive()
    for state in ("lost", "tracking"):
        found.add_call(CallRecord(10, 0.1, state))
    assert [call.state for call in found.records] == ["lost"]


@pytest.mark.parametrize(
    ("poses_ns", "missing"), [([1, 1], 1), ([1, 2], 0), ([1, 2, 2], 0), ([1, 3], 1), ([3, 4], 2), ([], 2)]
)
def test_pairs_without_a_pose_are_missing_however_often_others_are_answered(poses_ns: list[int], missing: int) -> None:
    found = Received()
    found.drive.sent_ns.update((1, 2))
    for stamp_ns in poses_ns:
        found.drive.add_pose((stamp_ns, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)), np.eye(6))
    assert found.result(None).loc_pairs.missing == missing


def test_a_pose_without_a_call_has_a_call_of_unknown_time_and_state() -> None:
    found = ReceivedDrive()
    for stamp_ns in (10, 20):
        found.add_pose((stamp_ns, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)), stamp_ns * np.eye(6))
    found.add_call(CallRecord(20, 0.1, "tracking"))
    unknown, known = found.records
    assert (unknown.stamp_ns, unknown.state, unknown.processing_time_s) == (10, "", None)
    assert unknown.covariance[0, 0] == 10.0
    assert (known.stamp_ns, known.state, known.processing_time_s) == (20, "tracking", 0.1)
