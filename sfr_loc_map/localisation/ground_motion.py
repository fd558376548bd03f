"""Which of the motions in the images is the ground's; what follows another one is left out while it lasts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import Mask
from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.frontend.foreign_regions import ForeignRegions
from sfr_loc_map.localisation.frontend.landmarks import ENOUGH_TO_FOLLOW, Landmarks
from sfr_loc_map.localisation.frontend.motion_segmentation import (
    MIN_FIXED,
    Unexplained,
    high_distance,
    pose_difference,
    project,
    stays_in,
    unexplained_by,
)
from sfr_loc_map.localisation.frontend.right_offset import RightOffset
from sfr_loc_map.localisation.frontend.tracking import StereoFrame, Tracker, TrackingResult
from sfr_loc_map.localisation.relocalisation import Relocaliser
from sfr_loc_map.localisation.torn_images import TearWatch, Wholeness

MIN_AGREEMENT = 0.3
"""Share of the unexplained landmarks that a second motion must explain."""
CONVINCING = 0.6
"""Share from which it is one in any case, and not sought by flow as well."""
MIN_DIFFERENCE_PX = 1.0
"""Image motion between two poses that are two motions."""
STILL_PX = 1.0
"""Image motion below which a pose is a standstill."""
OLD = 3.0
"""Weight of a landmark that is older than the newest keyframe."""
STAYING = 2.0
"""Divisor, before the first motion, of the evidence for a motion whose landmarks stay in the image."""
CLEAR = 1.4
"""Ratio of the evidence for two motions from which the ground's is known."""
EXPECTED = 1.5
"""Factor on the evidence for a motion that continues the one before."""

MIN_SHARE, MAX_SHARE = 0.12, 0.47
"""Share of the landmarks in view that must be unexplained before a second motion is sought, and from which the pose is
in doubt without one."""
MORE_THAN_USUAL = 1.25
"""Factor on the share in which no second motion was found, before one is sought again."""
FORGET = 0.99
"""Factor per pair by which that share is forgotten."""


@dataclass(frozen=True, slots=True, eq=False)
class Guesses:
    """Initial guesses of the left camera's pose.

    Attributes:
        poses: Constant velocity, standstill, others.
        offset: Rotation error of the right camera.
    """

    poses: Sequence[Transform]
    offset: RightOffset

    @property
    def expected(self) -> Pose:
        """Constant velocity."""
        return Pose.of(self.poses[0])

    @property
    def still(self) -> Pose:
        """Standstill."""
        return Pose.of(self.poses[1])


@dataclass(frozen=True, slots=True, eq=False)
class Motions:
    """Two motions in a pair.

    Attributes:
        first: Tracking of all landmarks, by the first one.
        second: Tracking of some landmarks, by the second one.
        rest: `(M,)` which of the first's landmarks these are.
    """

    first: TrackingResult
    second: TrackingResult
    rest: Mask


@dataclass(frozen=True, slots=True, eq=False)
class GroundMotion:
    """The ground's motion in a pair.

    Attributes:
        result: Tracking by it.
        foreign: `(N,)` rows in the window of landmarks that follow another motion.
        doubt: Metres and radians by which the pose may be wrong, as two motions cannot be told apart; None if they can.
        wholeness: Whether the pair is of one exposure.
    """

    result: TrackingResult
    foreign: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, np.intp))
    doubt: tuple[float, float] | None = None
    wholeness: Wholeness = Wholeness.WHOLE


class GroundMotionFinder:
    """Tells the ground's motion from that of the own body, of dirt and of moving objects.

    Landmarks that a pose does not explain are searched for a second rigid motion. The ground's is the one that more
    landmarks follow and that continues the motion before; the landmarks of the other are left out, and the regions of
    the image where they are. Where the two cannot be told apart the pose is in doubt.

    Attributes:
        regions: Where the left image does not move with the ground.
        doubt, wholeness: Of the last pair, see `GroundMotion`.
    """

    def __init__(self, tracker: Tracker, relocaliser: Relocaliser, rig: StereoRig, config: LocalisationConfig) -> None:
        """Start before the first pair."""
        self._tracker, self._relocaliser = tracker, relocaliser
        self.regions = ForeignRegions((rig.height, rig.width), min(config.max_features, ENOUGH_TO_FOLLOW))
        self._min_tracked, self._camera = config.min_tracked, rig.camera
        self._usual_share, self._has_moved, self._in_doubt = 0.0, False, False
        self._tears = TearWatch()
        self.doubt: tuple[float, float] | None = None
        self.wholeness = Wholeness.WHOLE

    def find(
        self, frame: StereoFrame, first: TrackingResult, guesses: Guesses
    ) -> tuple[TrackingResult, NDArray[np.intp]]:
        """Return tracking by the ground's motion, and the rows `(N,)` of landmarks that follow another one.

        Args:
            frame: The pair.
            first: Tracking result that may follow any motion, trusted or not.
            guesses: Initial guesses of the pose.
        """
        ground = self._find(frame, first, guesses)
        self.doubt, self.wholeness = ground.doubt, ground.wholeness
        return ground.result, ground.foreign

    def skip(self, stale: Mask) -> None:
        """Leave a torn pair as it is, of which rows `(H,)` are blanked; the next ones may be torn there too."""
        self._tears.tear(stale)
        self.doubt, self.wholeness = None, Wholeness.WHOLE

    def _find(self, frame: StereoFrame, first: TrackingResult, guesses: Guesses) -> GroundMotion:
        self.regions.update(frame.image, frame.left.levels[0])
        self._usual_share *= FORGET
        if not self._tracker.trusts(first):
            return self._without_fixed(frame, first, guesses)
        unexplained = unexplained_by(first, frame, self._camera)
        wholeness = self._tears.judge(unexplained)
        if wholeness is Wholeness.TORN:  # what disagrees is of another moment, and is needed to tell the next tear
            return GroundMotion(first, wholeness=wholeness)
        ground = self._of_exposure(frame, first, unexplained, guesses)
        return replace(ground, wholeness=max(wholeness, ground.wholeness))

    def _of_exposure(
        self, frame: StereoFrame, first: TrackingResult, unexplained: Unexplained, guesses: Guesses
    ) -> GroundMotion:
        rest = unexplained.rows & ~unexplained.fixed
        share = unexplained.share_of(rest)
        if share < max(MIN_SHARE, MORE_THAN_USUAL * self._usual_share) and share < MAX_SHARE:
            self._in_doubt = False
            return self._first_alone(frame, first, unexplained.fixed, guesses)
        second = self._search(frame, first.landmarks.subset(rest), guesses)
        if second is not None and self._differ(first, second):
            if self._has_moved and self._tears.is_torn(self._by_both(frame, first, second, guesses)):
                return GroundMotion(first, wholeness=Wholeness.TORN)
            return self._decide(frame, Motions(first, second, rest), guesses)
        self._usual_share = max(self._usual_share, share)
        ground = self._first_alone(frame, first, unexplained.fixed, guesses)
        return ground if share < MAX_SHARE else replace(ground, doubt=self._any_motion(first.pose, guesses))

    def _by_both(
        self, frame: StereoFrame, first: TrackingResult, second: TrackingResult, guesses: Guesses
    ) -> Iterator[Unexplained]:
        """Yield what either of two motions does not explain of all landmarks."""
        yield unexplained_by(first, frame, self._camera)
        by_second = self._tracker.refine(frame, first.landmarks, second.pose, guesses.offset)
        yield unexplained_by(by_second, frame, self._camera)

    def _without_fixed(self, frame: StereoFrame, first: TrackingResult, guesses: Guesses) -> GroundMotion:
        """Return the motion of all landmarks that are not fixed to the camera; the first result without one."""
        landmarks = first.landmarks
        fixed = stays_in(frame, landmarks)
        second = None
        if fixed.sum() >= MIN_FIXED:
            second = self._search(frame, landmarks.subset(~fixed), guesses)
        if second is None:
            return GroundMotion(first)
        return self._second_wins(frame, Motions(first, second, ~fixed), guesses)

    def _search(self, frame: StereoFrame, landmarks: Landmarks, guesses: Guesses) -> TrackingResult | None:
        """Return the motion of some landmarks, from the guesses, then by flow; None where too few agree on one."""
        if len(landmarks) < self._min_tracked:
            return None
        start = self._tracker.align(frame.left, landmarks, guesses.poses)
        result = self._tracker.refine(frame, landmarks, start, guesses.offset)
        if result.inlier_count < CONVINCING * len(landmarks):
            pose = self._relocaliser.pose_by_flow(frame, landmarks)
            if pose is not None:
                by_flow = self._tracker.refine_from_afar(frame, landmarks, pose, guesses.offset)
                result = max(result, by_flow, key=lambda item: item.inlier_count)
        enough = max(self._min_tracked, MIN_AGREEMENT * len(landmarks))
        return result if result.inlier_count >= enough else None

    def _first_alone(self, frame: StereoFrame, first: TrackingResult, fixed: Mask, guesses: Guesses) -> GroundMotion:
        """Return the first motion; what is fixed to the camera is left out."""
        self._note_motion(first, guesses)
        return GroundMotion(first, self._leave_out(frame, first, fixed))

    def _decide(self, frame: StereoFrame, motions: Motions, guesses: Guesses) -> GroundMotion:
        """Return the motion with clearly more evidence, otherwise the one with more of it, in doubt."""
        first, second = motions.first, motions.second
        ratio = self._evidence(frame, first, second, guesses) / self._evidence(frame, second, first, guesses)
        self._in_doubt = 1.0 / CLEAR < ratio < CLEAR
        if self._in_doubt:
            doubt = pose_difference(first.pose, second.pose)
            if ratio < 1.0:
                first = self._tracker.refine(frame, first.landmarks, second.pose, guesses.offset)
            return GroundMotion(first, doubt=doubt)
        if ratio < 1.0:
            return self._second_wins(frame, motions, guesses)
        foreign = np.zeros(len(first.landmarks), np.bool_)
        foreign[np.flatnonzero(motions.rest)[second.inliers]] = True
        seen = first.observations.copy()
        seen[motions.rest] = second.observations
        self._note_motion(first, guesses)
        return GroundMotion(first, self._leave_out(frame, replace(first, observations=seen), foreign))

    def _second_wins(self, frame: StereoFrame, motions: Motions, guesses: Guesses) -> GroundMotion:
        """Return the second motion; what follows the first one is left out."""
        first, second = motions.first, motions.second
        foreign = ~motions.rest & (first.inliers | stays_in(frame, first.landmarks))
        rows = self._leave_out(frame, first, foreign)
        result = self._tracker.refine(frame, first.landmarks.subset(~foreign), second.pose, guesses.offset)
        self._note_motion(result, guesses)
        return GroundMotion(result, rows)

    def _evidence(self, frame: StereoFrame, result: TrackingResult, other: TrackingResult, guesses: Guesses) -> float:
        """Return the number of landmarks that follow a motion, weighted by how probable it is for the ground.

        Landmarks that several keyframes agreed on were ground before.
        """
        inliers, landmarks = result.inliers, result.landmarks
        count = float(inliers.sum())
        if not self._has_moved:
            # the own body is not known before the first motion: what stays is rather it than the ground
            stays = stays_in(frame, landmarks)[inliers]
            return count / STAYING if stays.mean() > 0.5 else count
        if self._in_doubt:  # what is old or expected may follow the wrong motion
            return count
        count += (OLD - 1.0) * float((inliers & landmarks.are_old).sum())
        mine, theirs = (project(item.pose, landmarks, self._camera) for item in (result, other))
        expected = project(guesses.expected, landmarks, self._camera)
        closer = high_distance(mine, expected) < 0.5 * high_distance(theirs, expected)
        return count * EXPECTED if closer else count

    def _any_motion(self, pose: Pose, guesses: Guesses) -> tuple[float, float]:
        """Return the larger of the motion found and the one expected, metres and radians."""
        steps = np.array([pose_difference(item, guesses.still) for item in (pose, guesses.expected)])
        return float(steps[:, 0].max()), float(steps[:, 1].max())

    def _differ(self, first: TrackingResult, second: TrackingResult) -> bool:
        """Tell whether nearly all landmarks agree on the second pose, or both poses see them at different pixels."""
        if second.inlier_count > CONVINCING * len(second.landmarks):
            return True
        landmarks = second.landmarks.subset(second.inliers)
        uv = (project(item.pose, landmarks, self._camera) for item in (first, second))
        return high_distance(*uv) > MIN_DIFFERENCE_PX

    def _note_motion(self, result: TrackingResult, guesses: Guesses) -> None:
        if not self._has_moved:
            uv = (project(pose, result.landmarks, self._camera) for pose in (result.pose, guesses.still))
            self._has_moved = high_distance(*uv) > STILL_PX

    def _leave_out(self, frame: StereoFrame, result: TrackingResult, foreign: Mask) -> NDArray[np.intp]:
        """Mark where foreign landmarks `(M,)` of a result are; return their rows in the window."""
        if not foreign.any():
            return np.zeros(0, np.intp)
        landmarks = result.landmarks
        fixed = stays_in(frame, landmarks)
        uv = np.where(fixed[:, None], landmarks.uv, result.observations[:, :2])
        self.regions.add(uv, fixed, landmarks.patches.level(0).values[:, 0], foreign & np.isfinite(uv[:, 0]))
        return landmarks.index[foreign]
