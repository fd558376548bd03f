"""State of the localiser between two pairs, and what one pair leads to."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from time import perf_counter
from typing import NamedTuple

from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.backend.sliding_window import LandmarkMap
from sfr_loc_map.localisation.estimate import StateReason, StepEstimate, TrackingState, TrackingStatistics
from sfr_loc_map.localisation.frontend.tracking import Tracks
from sfr_loc_map.localisation.ground_motion import GroundMemory
from sfr_loc_map.localisation.guards import ImageMemory, ShearMean
from sfr_loc_map.localisation.keyframes import KeyframeJob
from sfr_loc_map.localisation.path import Path
from sfr_loc_map.localisation.relocalisation import References


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Everything that is known between two pairs, except for the keyframe that is being made in the background."""

    path: Path  #: Motion, datum, history and accumulated errors.
    calibration: OnlineCalibration  #: Rotation error of the right camera.
    ground: GroundMemory  #: Memory of the selection of the ground.
    landmark_map: LandmarkMap | None = None  #: Window and landmarks; None before a window has begun.
    references: References = References()  #: Images that lost tracking can be recovered from.
    images: ImageMemory | None = None  #: Memory of the check for stale images.
    shear: ShearMean = ShearMean()  #: Memory of the check for sheared rows.
    keyframes: int = 0  #: Number of keyframes since the start.
    settled_from: int = 0  #: Number of keyframes from which a window that began after a gap is no longer degraded.
    status: TrackingState = TrackingState.INITIALISING  #: State published last; a lost pose is not continued.
    reason: StateReason | None = None  #: Reason published last.


class Outcome(NamedTuple):
    """What one pair leads to."""

    state: State
    statistics: TrackingStatistics
    tracks: Tracks | None = None  #: What was tracked, trusted or not; None if nothing was.
    step: StepEstimate | None = None  #: Step to the pose; None if lost.
    keyframe: KeyframeJob | None = None  #: Work of the keyframe that the pair becomes.


class StageClock:
    """Durations of the stages of one call, s, by name."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time within the context to a stage."""
        start = perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + perf_counter() - start
