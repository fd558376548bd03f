"""The maps of a run in progress: clouds wait for the truth of their pairs, and the worst map decides the verdict."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

from msgspec.structs import replace as struct_replace

from sfr_loc_map.calls.call_record import CallRecord
from sfr_loc_map.geometry.arrays import PointImage
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.latest import Latest
from sfr_loc_map.mapping.config import MAX_PAIRS
from sfr_loc_map.metrics.config import MappingState, VerdictState
from sfr_loc_map.metrics.figures.results import MapResult
from sfr_loc_map.metrics.figures.rows import figure_row
from sfr_loc_map.metrics.figures.subjects import LimitSection
from sfr_loc_map.metrics.judging.judge import judged_by
from sfr_loc_map.metrics.judging.limited import task_of
from sfr_loc_map.metrics.map.pair_truth import PairTruth
from sfr_loc_map.metrics.score.limits import Limits
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.suite_names import Task

MAX_KEPT = 2 * MAX_PAIRS  #: Maximum number of true points, poses and clouds that wait for their counterparts.
OF_CLOUD = (LimitSection.MAP, LimitSection.COMPLETENESS)  #: Sections with the limits on a single map.


class MapToScore(NamedTuple):
    """A map whose truth is complete."""

    stamp_ns: int  #: Stamp of the last pair.
    cloud: PointCloud
    truths: list[PairTruth]  #: Truth of each pair of the cloud, in the order of the points' `pair`.
    expected_pairs: int  #: Number of pairs that the map must contain: its own, and earlier pairs of no other map.


class MapInputs:
    """Clouds and the truth of their pairs by stamp, kept until they can be scored."""

    def __init__(self) -> None:
        self.rig: StereoRig | None = None  #: Rig of the navigation cameras; None before camera_info is received.
        self._true_points = Latest[int, PointImage](MAX_KEPT)  # `(H, W, 3)` of each pair, metres, LM
        self._poses = Latest[int, Transform](MAX_KEPT)  # `T_lm_navsb` of each pair
        self._clouds = Latest[int, PointCloud](MAX_KEPT)  # clouds as published, with the stamp of the last pair
        self.begin_run()

    def begin_run(self) -> None:
        """Discard the fusions and the stamps of the pairs that maps must contain.

        Clouds and truth are kept, because clouds of the new run may arrive before this run is detected.
        """
        self._fusions = Latest[int, CallRecord](MAX_KEPT)  # fusions by the stamp of their cloud
        self.pair_stamps_ns = set[int]()  # stamps of received mapping pairs, which the maps of the run must contain
        # pairs that the scored and refused maps must contain, by the stamp of the last pair of the map
        self._counted = dict[int, set[int]]()
        self._refused = dict[int, int]()  # number of pairs of each refused map by the stamp of its last pair

    @property
    def refused_pairs(self) -> int:
        """Number of mapping pairs whose map was refused."""
        return sum(self._refused.values())

    @property
    def unmapped_pairs(self) -> int:
        """Number of mapping pairs that no scored map must contain: their map is missing or was refused."""
        return self.refused_pairs + len(self.pair_stamps_ns.difference(*self._counted.values()))

    def set_rig(self, rig: StereoRig) -> None:
        """Set the rig of the following pairs."""
        self.rig = rig

    def add_true_points(self, stamp_ns: int, points: PointImage) -> None:
        """Add the true points `(H, W, 3)` of a mapping pair, metres in LM."""
        self._true_points[stamp_ns] = points

    def add_cloud(self, stamp_ns: int, cloud: PointCloud) -> None:
        """Add a published cloud; its stamp is that of its last pair."""
        self._clouds[stamp_ns] = cloud

    def add_pose(self, stamp_ns: int, T_lm_navsb: Transform) -> None:
        """Add the pose of a mapping pair."""
        self._poses[stamp_ns] = T_lm_navsb
        self.pair_stamps_ns.add(stamp_ns)

    def add_call(self, record: CallRecord) -> None:
        """Add a call. The call of a fusion names the pairs of its cloud."""
        if record.state == MappingState.FUSED and record.pair_stamps_ns:
            self._fusions[record.stamp_ns] = record

    def take_complete(self) -> Iterator[MapToScore]:
        """Yield and remove the clouds whose pairs and truth are known, in the order of their stamps.

        A cloud whose last pair is not a received pair of this run is skipped, because it was made in a previous run.
        """
        for stamp_ns in sorted(self._clouds):
            fusion = self._fusions.get(stamp_ns)
            if fusion is None or self.rig is None:
                continue
            wanted_ns = fusion.pair_stamps_ns
            last_ns = max(wanted_ns)
            if last_ns not in self.pair_stamps_ns:
                continue
            if not all(stamp in self._true_points and stamp in self._poses for stamp in wanted_ns):
                continue
            T_sb_left = self.rig.T_sb_left
            truths = [PairTruth(self._true_points[s], self._poses[s] @ T_sb_left, self.rig) for s in wanted_ns]
            cloud = replace(self._clouds.pop(stamp_ns), fused=fusion.is_fused, pair_stamps_ns=wanted_ns)
            expected_ns = self._expected_ns(last_ns) | set(wanted_ns)
            self._counted[last_ns] = expected_ns
            self._refused.pop(last_ns, None)
            yield MapToScore(last_ns, cloud, truths, len(expected_ns))

    def refuse(self, made: MapToScore) -> None:
        """Count the pairs of a map that cannot be scored as unmapped, until another map ends with the same pair."""
        self._refused[made.stamp_ns] = made.expected_pairs

    def _expected_ns(self, last_ns: int) -> set[int]:
        """Return the pairs up to `last_ns` that belong to no other map, whatever the order in which maps arrive.

        Another map was already taken, is named by the call of its fusion, or is a cloud that waits for its truth and
        contains all pairs up to its stamp.
        """
        others = [stamps_ns for other_ns, stamps_ns in self._counted.items() if other_ns != last_ns]
        fusions = [set(call.pair_stamps_ns) for call in self._fusions.values()]
        others += [stamps_ns for stamps_ns in fusions if max(stamps_ns) != last_ns]
        waiting_ns = (stamp_ns for stamp_ns in self._clouds if stamp_ns in self.pair_stamps_ns and stamp_ns < last_ns)
        begin_ns = max(waiting_ns, default=-1)
        return {stamp_ns for stamp_ns in self.pair_stamps_ns if begin_ns < stamp_ns <= last_ns}.difference(*others)


class JudgedMap(NamedTuple):
    """A map with its verdict by the limits on a map."""

    made: MapResult
    rank: tuple[int, int, float]
    """Rank of the verdict, number of missed limits and point error, m, the last two with a negative sign. The worst map
    has the smallest rank. An unknown error counts as the largest error."""
    missed: frozenset[str]  #: Names of the missed limits.


class LiveMaps:
    """Judges each map of a run by the limits on a map, and keeps the worst map and the number of maps.

    Maps are compared by their verdict, then by the number of missed limits, then by the point error.
    """

    def __init__(self, limits: Limits | None, *, partial: bool) -> None:
        """Start a run that has no maps yet. Each map is judged by those of the `limits` that apply to a map."""
        chosen = () if limits is None else limits.limits
        chosen = tuple(each for each in chosen if each.section in OF_CLOUD and task_of(each) is Task.MAPPING)
        self._limits = None if limits is None else struct_replace(limits, limits=chosen)
        self._partial = partial
        self._count = 0
        self._worst: JudgedMap | None = None
        self._missed = frozenset[str]()  # names of the limits that any map missed

    def add(self, made: MapResult) -> None:
        """Judge a map, and keep it if it is worse than the previous maps."""
        judged = self._judged(made)
        if self._worst is None or judged.rank < self._worst.rank:
            self._worst = judged
        self._missed |= judged.missed
        self._count += 1

    @property
    def result(self) -> MapResult | None:
        """The result of the worst map, with the number of maps if there are several; None without a map."""
        if self._worst is None:
            return None
        made = self._worst.made
        if self._count < 2:
            return made
        caveat = f"the figures of the map are those of the worst of {self._count} maps"
        if others := sorted(self._missed - self._worst.missed):
            caveat += f"; other maps missed the limits {', '.join(others)}"
        figures = (*made.figures, figure_row("maps", value=self._count))
        return replace(made, figures=figures, caveats=(*made.caveats, caveat))

    def _judged(self, made: MapResult) -> JudgedMap:
        score = judged_by(Score(figures=made.figures, cloud=made.cloud), self._limits, partial=self._partial)
        missed = frozenset(verdict.name for verdict in score.missed)
        # A score has no verdict only if the map is complete and no limit applies to it. It ranks like one that passes.
        state = VerdictState.PASS if score.verdict is None else score.verdict
        error_m = score.number("point_error", "mean_plus_3sigma", part=None)
        rank = (state.rank, -len(missed), -math.inf if error_m is None else -error_m)
        return JudgedMap(made, rank, missed)
