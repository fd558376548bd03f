"""Trials of localisers and mappers: the pairs that they receive, their calls, and the figures of their results."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, Generic, TypeVar

import numpy as np

from sfr_loc_map.bench.figure_rows import ACCURACY, FigureRow
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.clouds.fields import MAX_PAIR_STAMPS
from sfr_loc_map.io.sequence import LocSequence, NavSequence
from sfr_loc_map.localisation.estimate import TrackingState
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.disparity.semi_global_matching import search_range_of
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.methods.isolated_localiser import IsolatedLocaliser
from sfr_loc_map.methods.isolated_mapper import IsolatedMapper
from sfr_loc_map.methods.isolated_method import IsolatedMethod
from sfr_loc_map.methods.method_call import MethodCall
from sfr_loc_map.methods.registry import Method, MethodLimits
from sfr_loc_map.metrics.config import MapScoreConfig, TrajectoryScoreConfig
from sfr_loc_map.metrics.frames.association import Estimates
from sfr_loc_map.metrics.map.map_score import score_map
from sfr_loc_map.metrics.map.pair_truth import PairTruth
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.trajectory.trajectory_score import score_trajectory
from sfr_loc_map.tables.model import MILLIMETRE, PERCENT, Column, Unit

LIMITS = MethodLimits(call_timeout_s=900.0, memory_mb=16_000, restarts=0)
"""Limits of a method in a comparison; some dense matchers take minutes per pair."""
DEFAULT_RATE_HZ = 10.0  #: Rate of the pairs if the stamps of a source do not define a rate.
ERRORS = (
    ("position", "position_m", MILLIMETRE),
    ("attitude", "attitude_deg", Unit("deg")),
    ("heading", "heading_deg", Unit("deg")),
)
"""Errors of a drive: figure of the score, key in the JSON, and displayed unit."""

Item = TypeVar("Item")
Opened = TypeVar("Opened", bound=IsolatedMethod)
Result = TypeVar("Result")


class Trial(ABC, Generic[Item, Opened, Result]):
    """The pairs of a source, and how the methods of one task are called with them."""

    kind: ClassVar[str]  #: `kind` of the benchmark in the JSON.

    @property
    @abstractmethod
    def title(self) -> str:
        """Title of the table of the benchmark."""

    @property
    @abstractmethod
    def settings(self) -> Mapping[str, object]:
        """Settings of the trial for the JSON."""

    def is_paced(self, method: Method) -> bool:
        """Return whether a method receives the pairs at the rate of their stamps."""
        return False

    @property
    def rate_scale(self) -> float:
        """Ratio of the rate at which a paced method receives the pairs to the recorded rate."""
        return 1.0

    @abstractmethod
    def __len__(self) -> int:
        """Return the number of pairs."""

    @abstractmethod
    def items(self) -> Iterator[tuple[int, Item]]:
        """Yield stamp, ns, and content of each pair."""

    @abstractmethod
    def open(self, method: Method) -> Opened:
        """Start a method."""

    @abstractmethod
    def call(self, opened: Opened, item: Item) -> tuple[Result, MethodCall]:
        """Pass a pair to a method. Return the result and the record of the call."""

    @abstractmethod
    def figures(self, results: Sequence[Result]) -> Iterator[FigureRow]:
        """Yield the figures of the results of a pass."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LocaliserTrial(Trial[StereoPair, IsolatedLocaliser, Transform | None]):
    """A drive. A result is the pose of the left camera relative to its first pose; None for a lost frame.

    The accuracy is reported if the drive has a ground truth.
    """

    kind: ClassVar[str] = "localise"
    sequence: LocSequence
    T_ds_rb: Transform  #: First pose of the rover.
    scoring: TrajectoryScoreConfig
    rate_hz: float | None = None  #: Rate of the pairs for methods that work in the background; None: as recorded.
    hidden: Sequence[Path]  #: Paths that a method must not read.

    @property
    def title(self) -> str:
        """Title of the table of the benchmark."""
        return "Localisation: mean + 3 sigma; host times"

    @property
    def settings(self) -> Mapping[str, object]:
        """Conditions of the sub-trajectories."""
        return {"conditions": list(self.scoring.conditions)}

    @property
    def recorded_rate_hz(self) -> float:
        """Median rate of the recorded pairs."""
        steps_ns = np.diff(self.sequence.stamps_ns)
        step_ns = float(np.median(steps_ns)) if len(steps_ns) else 0.0
        return NS_PER_S / step_ns if step_ns > 0.0 else DEFAULT_RATE_HZ

    def is_paced(self, method: Method) -> bool:
        """Return whether the method works in the background between its calls."""
        return method.is_paced

    @property
    def rate_scale(self) -> float:
        """The requested rate over the recorded rate."""
        return 1.0 if self.rate_hz is None else self.rate_hz / self.recorded_rate_hz

    def __len__(self) -> int:
        return len(self.sequence)

    def items(self) -> Iterator[tuple[int, StereoPair]]:
        """Yield stamp and images of each pair."""
        return ((pair.stamp_ns, pair) for pair in self.sequence.pairs())

    def open(self, method: Method) -> IsolatedLocaliser:
        """Start a localiser. The rover's frame is the left camera, so that all methods estimate the same pose."""
        rig = replace(self.sequence.rig, T_rb_sb=self.sequence.rig.T_sb_left.inverse())
        is_paced = self.is_paced(method)
        return IsolatedLocaliser(
            method,
            rig,
            Transform.identity(),
            LIMITS,
            rate_hz=self.rate_hz or self.recorded_rate_hz,
            rate_scale=self.rate_scale if is_paced else 1.0,
            keeps_rate=is_paced,
            hidden=self.hidden,
        )

    def call(self, opened: IsolatedLocaliser, item: StereoPair) -> tuple[Transform | None, MethodCall]:
        """Localise a pair."""
        estimate, done = opened.localise(item)
        return None if estimate.state is TrackingState.LOST else estimate.T_ds_rb, done

    def figures(self, results: Sequence[Transform | None]) -> Iterator[FigureRow]:
        """Yield for each condition mean + 3 sigma of each error, m and deg, and the number of lost frames."""
        is_lost = np.array([pose is None for pose in results], np.bool_)
        if self.sequence.ground_truth is not None:
            estimates = Estimates.of(rover_trajectory(results, self.sequence, self.T_ds_rb), is_lost)
            yield from self._accuracy(estimates, self.sequence.ground_truth)
        yield FigureRow(("lost",), int(is_lost.sum()), Column("lost"))

    def _accuracy(self, estimates: Estimates, truth: Trajectory) -> Iterator[FigureRow]:
        """Yield the errors for each condition, and the number of sub-trajectories."""
        scored = score_trajectory(estimates, truth, self.scoring)
        assert scored.association is not None  # set by score_trajectory
        score, part = Score(figures=scored.figures), scored.association.reading
        for condition in self.scoring.conditions:
            position = score.figure("position", condition=condition, part=part)
            yield FigureRow((ACCURACY, condition, "count"), 0 if position is None else position.n)
            for figure, key, unit in ERRORS:
                value = score.number(figure, "mean_plus_3sigma", condition=condition, part=part)
                yield FigureRow((ACCURACY, condition, key), value, Column(f"{condition} {figure}", unit))


def rover_trajectory(poses: Sequence[Transform | None], sequence: LocSequence, T_ds_rb: Transform) -> Trajectory:
    """Return the poses of the rover; `poses` are those of the left camera relative to its first pose.

    A lost frame (None) has the last known pose. If the extrinsics are unknown, SB is used as the rover's frame.
    """
    rig = sequence.rig
    T_rb_left = rig.T_sb_left if rig.T_rb_sb is None else rig.T_rb_left
    T_ds_first, T_left_rb = T_ds_rb @ T_rb_left, T_rb_left.inverse()
    stamped, T_first_left = [], Transform.identity()
    for stamp_ns, pose in zip(sequence.stamps_ns, poses, strict=True):
        T_first_left = T_first_left if pose is None else pose
        stamped.append((stamp_ns, T_ds_first @ T_first_left @ T_left_rb))
    return Trajectory.from_poses(stamped)


@dataclass(frozen=True, slots=True, kw_only=True)
class MapperTrial(Trial[PosedStereoPair, IsolatedMapper, PointCloud]):
    """Mapping pairs, each of which is mapped separately. A result is the cloud of a pair.

    All methods search the same disparity range. No method is paced, because pairs may be hours apart. The accuracy is
    reported if every pair has a ground truth.
    """

    kind: ClassVar[str] = "map"
    sequence: NavSequence
    disparities: int  #: Number of disparities that a method searches.
    truths: Sequence[PairTruth | None]
    hidden: Sequence[Path]  #: Paths that a method must not read.

    @classmethod
    def of(cls, sequence: NavSequence, config: MappingConfig, hidden: Sequence[Path]) -> MapperTrial:
        """Return the trial of a source with the disparity range of a configuration.

        Raises InputError for too many pairs.
        """
        truths = [PairTruth.of(item, sequence.rig) for item in sequence.pairs()]
        if len(truths) > MAX_PAIR_STAMPS:
            raise InputError(
                f"the source has {len(truths)} mapping pairs: at most {MAX_PAIR_STAMPS} are allowed in a benchmark"
            )
        disparities = search_range_of(sequence.rig, config).count
        return cls(sequence=sequence, disparities=disparities, truths=truths, hidden=hidden)

    @property
    def title(self) -> str:
        """Title of the table of the benchmark."""
        return f"Maps of single pairs, {self.disparities} disparities; host times"

    @property
    def settings(self) -> Mapping[str, object]:
        """Number of searched disparities."""
        return {"disparities": self.disparities}

    def __len__(self) -> int:
        return len(self.truths)

    def items(self) -> Iterator[tuple[int, PosedStereoPair]]:
        """Yield the stamp of each pair, and the pair with its pose."""
        return ((item.pair.stamp_ns, item) for item in self.sequence.pairs())

    def open(self, method: Method) -> IsolatedMapper:
        """Start a mapper."""
        return IsolatedMapper(method, self.sequence.rig, LIMITS, disparities=self.disparities, hidden=self.hidden)

    def call(self, opened: IsolatedMapper, item: PosedStereoPair) -> tuple[PointCloud, MethodCall]:
        """Map a pair as a map of its own."""
        made, done = opened.begin_map().map_pair(item.pair, item.T_lm_navsb)
        return made.cloud, done

    def figures(self, results: Sequence[PointCloud]) -> Iterator[FigureRow]:
        """Yield the mean number of points per pair, coverage and point errors, m."""
        yield FigureRow(("points",), float(np.mean([len(cloud) for cloud in results])), Column("points"))
        known = [truth for truth in self.truths if truth is not None]
        if len(known) < len(self.truths):
            return
        numbered = [replace(cloud, pair=np.full(len(cloud), number, np.uint8)) for number, cloud in enumerate(results)]
        cloud = replace(PointCloud.concatenate(numbered), fused=False)
        score = Score(figures=score_map(cloud, known, MapScoreConfig()).figures)
        yield FigureRow((ACCURACY, "coverage"), score.number("coverage"), Column("coverage", PERCENT))
        for statistic, title in (("mean", "point error mean"), ("mean_plus_3sigma", "mean + 3 sigma")):
            value = score.number("point_error", statistic)
            yield FigureRow((ACCURACY, statistic), value, Column(title, MILLIMETRE))
