"""What a map score is made of, collected from several topics until it is complete."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import replace
from typing import TypeVar

from sfr_loc_map.geometry.arrays import PointImage
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.config import MAX_PAIRS
from sfr_loc_map.metrics.cloud_error import PairTruth
from sfr_loc_map.pipeline.call_record import CallRecord
from sfr_loc_map.pipeline.online.pair_sets import PairSet, PairSets

T = TypeVar("T")
MAX_KEPT = 2 * MAX_PAIRS
"""True points, poses, sets of pairs and clouds that are kept until the others come."""


class MapInputs:
    """Clouds, and the truth of the pairs that they are made of, by stamp.

    Attributes:
        rig: Rig of the navigation cameras, None until it is known.
    """

    def __init__(self) -> None:
        """Start empty."""
        self.rig: StereoRig | None = None
        self._points: OrderedDict[int, PointImage] = OrderedDict()
        self._poses: OrderedDict[int, Transform] = OrderedDict()
        self._pair_sets = PairSets()
        self._sets: OrderedDict[int, PairSet] = OrderedDict()
        self._clouds: OrderedDict[int, PointCloud] = OrderedDict()

    def add_true_points(self, stamp_ns: int, points: PointImage) -> None:
        """Add the true points `(H, W, 3)` of a pair, metres, LM."""
        _keep(self._points, stamp_ns, points)

    def add_pose(self, stamp_ns: int, T_lm_navsb: Transform) -> None:
        """Add the pose of a pair."""
        _keep(self._poses, stamp_ns, T_lm_navsb)

    def add_call(self, record: CallRecord) -> None:
        """Add a call; those of the mapper say which pairs a cloud is made of."""
        pairs = self._pair_sets.add(record)
        if pairs is not None:
            _keep(self._sets, record.stamp_ns, pairs)

    def add_cloud(self, stamp_ns: int, cloud: PointCloud) -> None:
        """Add a published cloud; its stamp is that of its last pair."""
        _keep(self._clouds, stamp_ns, cloud)

    def take_complete(self) -> Iterator[tuple[PointCloud, list[PairTruth]]]:
        """Yield, and forget, the clouds whose pairs and truth are known, with the truth of each pair."""
        for stamp_ns in list(self._clouds):
            pairs = self._sets.get(stamp_ns)
            if pairs is None:
                continue
            truths = [self._truth_of(stamp) for stamp in pairs.stamps_ns]
            known = [truth for truth in truths if truth is not None]
            if len(known) == len(truths):
                yield replace(self._clouds.pop(stamp_ns), fused=pairs.fused), known

    def _truth_of(self, stamp_ns: int) -> PairTruth | None:
        points, pose = self._points.get(stamp_ns), self._poses.get(stamp_ns)
        if self.rig is None or points is None or pose is None:
            return None
        return PairTruth(points, pose @ self.rig.T_sb_left, self.rig)


def _keep(kept: OrderedDict[int, T], stamp_ns: int, value: T) -> None:
    kept[stamp_ns] = value
    while len(kept) > MAX_KEPT:
        kept.popitem(last=False)
