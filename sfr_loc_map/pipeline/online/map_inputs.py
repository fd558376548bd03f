"""What a map score is made of, collected from several topics until it is complete."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator
from typing import TypeVar

from sfr_loc_map.geometry.arrays import PointImage
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.config import MAX_PAIRS
from sfr_loc_map.metrics.cloud.cloud_truth import PairTruth

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
        self._mapped_ns: list[int] = []
        self._sets_ns: OrderedDict[int, list[int]] = OrderedDict()
        self._clouds: OrderedDict[int, PointCloud] = OrderedDict()

    def add_true_points(self, stamp_ns: int, points: PointImage) -> None:
        """Add the true points `(H, W, 3)` of a pair, metres, LM."""
        _keep(self._points, stamp_ns, points)

    def add_pose(self, stamp_ns: int, T_lm_navsb: Transform) -> None:
        """Add the pose of a pair."""
        _keep(self._poses, stamp_ns, T_lm_navsb)

    def add_mapped(self, stamp_ns: int) -> None:
        """Add a pair that was mapped: it belongs to the next cloud."""
        self._mapped_ns.append(stamp_ns)

    def add_fused(self, stamp_ns: int) -> None:
        """Add a fusion of the pairs mapped since the one before."""
        _keep(self._sets_ns, stamp_ns, self._mapped_ns)
        self._mapped_ns = []

    def add_cloud(self, stamp_ns: int, cloud: PointCloud) -> None:
        """Add a fused cloud; its stamp is that of its last pair."""
        _keep(self._clouds, stamp_ns, cloud)

    def take_complete(self) -> Iterator[tuple[PointCloud, list[PairTruth]]]:
        """Yield, and forget, the clouds whose pairs and truth are known, with the truth of each pair."""
        for stamp_ns in list(self._clouds):
            stamps = self._sets_ns.get(stamp_ns)
            truths = [self._truth_of(stamp) for stamp in stamps or ()]
            known = [truth for truth in truths if truth is not None]
            if stamps is not None and len(known) == len(stamps):
                yield self._clouds.pop(stamp_ns), known

    def _truth_of(self, stamp_ns: int) -> PairTruth | None:
        points, pose = self._points.get(stamp_ns), self._poses.get(stamp_ns)
        if self.rig is None or points is None or pose is None:
            return None
        return PairTruth(points, pose @ self.rig.T_sb_left, self.rig)


def _keep(kept: OrderedDict[int, T], stamp_ns: int, value: T) -> None:
    kept[stamp_ns] = value
    while len(kept) > MAX_KEPT:
        kept.popitem(last=False)
