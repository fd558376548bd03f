"""Which of the motions in the images is the ground's; what follows another one is left out while it lasts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, Mask
from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.geometry.rotation import rotvec_from_matrix
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.frontend.dynamic_regions import (
    MIN_FIXED,
    DynamicRegions,
    Unexplained,
    project,
    stays_in,
    unexplained_by,
    where_seen,
)
from sfr_loc_map.localisation.frontend.landmarks import ENOUGH_TO_FOLLOW, Landmarks
from sfr_loc_map.localisation.frontend.pose_solver import RightOffset
from sfr_loc_map.localisation.frontend.tracking import StereoFrame, Tracker, TrackingResult
from sfr_loc_map.localisation.image_checks import Exposure, TearWatch
from sfr_loc_map.localisation.relocalisation import Relocaliser

MIN_AGREEMENT = 0.3  #: Share of the unexplained landmarks that a second motion must explain.
CONVINCING = 0.6  #: Share from which it is one in any case, and not sought by flow as well.
MIN_DIFFERENCE_PX = 1.0  #: Image motion between two poses that are two motions.
STILL_PX = 1.0  #: Image motion below which a pose is a standstill.
OLD = 3.0  #: Weight of a landmark that is older than the newest keyframe.
STAYING = 2.0  #: Divisor, before the first motion, of the evidence for a motion whose landmarks stay in the image.
CLEAR = 1.4  #: Ratio of the evidence for two motions from which the ground's is known.
EXPECTED = 1.5  #: Factor on the evidence for a motion that continues the one before.

MIN_SHARE, MAX_SHARE = 0.12, 0.47
"""Share of the landmarks in view that must be unexplained before a second motion is sought, and from which the pose is
in doubt without one."""
MORE_THAN_USUAL = 1.25  #: Factor on the share in which no second motion was found, before one is sought again.
FORGET = 0.99  #: Factor per pair by which that share is forgotten.
NO_ROWS = np.zeros(0, np.intp)


class Guesses(NamedTuple):
    """Initial guesses of the left camera's pose, constant velocity and standstill first, and the right one's error."""

    poses: Sequence[Pose]
    offset: RightOffset


class GroundMotion(NamedTuple):
    """The ground's motion in a pair."""

    result: TrackingResult  #: Tracking by it.
    dynamic: NDArray[np.intp] = NO_ROWS  #: `(N,)` rows in the window of landmarks that follow another motion.
    #: Metres and radians by which the pose may be wrong, as two motions cannot be told apart; None if they can.
    doubt: tuple[float, float] | None = None
    exposure: Exposure = Exposure.WHOLE  #: Whether the pair is of one exposure.


class GroundMotionFinder:
    """Tells the ground's motion from that of the own body, of dirt and of moving objects.

    Landmarks that a pose does not explain are searched for a second rigid motion. The ground's is the one that more
    landmarks follow and that continues the motion before; the landmarks of the other are left out, and the regions of
    the image where they are. Where the two cannot be told apart the pose is in doubt.
    """

    def __init__(self, tracker: Tracker, relocaliser: Relocaliser, rig: StereoRig, config: LocalisationConfig) -> None:
        self._tracker, self._relocaliser = tracker, relocaliser
        self._shape = rig.height, rig.width
        self.regions = DynamicRegions(self._shape, min(config.max_features, ENOUGH_TO_FOLLOW))
        self.tears = TearWatch()
        self._min_tracked, self._camera = config.min_tracked, rig.camera
        self._usual_share, self._has_moved, self._in_doubt = 0.0, False, False

    def find(self, frame: StereoFrame, first: TrackingResult, guesses: Guesses) -> GroundMotion:
        """Return the ground's motion in a pair; the first result may follow any motion, trusted or not."""
        if self.regions.mask is not None:
            self.regions.update(frame.image, frame.left[0].image)
        self._usual_share *= FORGET
        if not first.trusted:
            return self._without_fixed(frame, first, guesses)
        unexplained = unexplained_by(first, frame, self._camera)
        exposure = Exposure.WHOLE if self.tears.stale is None else self.tears.judge(unexplained)
        if exposure is Exposure.TORN:  # what disagrees is of another moment, and is needed to tell the next tear
            return GroundMotion(first, exposure=exposure)
        rest = unexplained.rows & ~unexplained.fixed
        share = float(rest.sum() / max(int(unexplained.in_view.sum()), 1))
        searched = share >= MAX_SHARE or share >= max(MIN_SHARE, MORE_THAN_USUAL * self._usual_share)
        if searched:
            second = self._search(frame, first.landmarks.subset(rest), guesses)
            if second is not None and self._differ(first, second):
                if self._has_moved and self.tears.is_torn(self._by_both(frame, first, second, guesses)):
                    return GroundMotion(first, exposure=Exposure.TORN)
                return self._decide(frame, first, second, rest, guesses)._replace(exposure=exposure)
            self._usual_share = max(self._usual_share, share)
        else:
            self._in_doubt = False
        # one motion; what is fixed to the camera is left out
        if not self._has_moved:
            self._note_motion(first, guesses)
        dynamic = self._leave_out(frame, first, unexplained.fixed) if unexplained.fixed.any() else NO_ROWS
        doubt = None
        if share >= MAX_SHARE:  # any motion: the larger of the one found and the one expected
            expected, still = guesses.poses[:2]
            steps = np.array([pose_distance(pose, still) for pose in (first.pose, expected)])
            doubt = float(steps[:, 0].max()), float(steps[:, 1].max())
        return GroundMotion(first, dynamic, doubt, exposure)

    def _by_both(
        self, frame: StereoFrame, first: TrackingResult, second: TrackingResult, guesses: Guesses
    ) -> Iterator[Unexplained]:
        yield unexplained_by(first, frame, self._camera)
        by_second = self._tracker.refine(frame, first.landmarks, second.pose, guesses.offset)
        yield unexplained_by(by_second, frame, self._camera)

    def _without_fixed(self, frame: StereoFrame, first: TrackingResult, guesses: Guesses) -> GroundMotion:
        """Return the motion of all landmarks that are not fixed to the camera; the first result without one."""
        fixed = stays_in(frame, first.landmarks)
        second = None
        if np.count_nonzero(fixed) >= MIN_FIXED:
            second = self._search(frame, first.landmarks.subset(~fixed), guesses)
        return GroundMotion(first) if second is None else self._second_wins(frame, first, second, ~fixed, guesses)

    def _search(self, frame: StereoFrame, landmarks: Landmarks, guesses: Guesses) -> TrackingResult | None:
        """Return the motion of some landmarks, from the guesses, then by flow; None where too few agree on one."""
        count = len(landmarks.index)
        if count < self._min_tracked:
            return None
        start = self._tracker.align(frame.left, landmarks.few, guesses.poses)
        result = self._tracker.refine(frame, landmarks, start, guesses.offset)
        if result.inlier_count < CONVINCING * count:
            pose = self._relocaliser.pose_by_flow(frame, landmarks)
            if pose is not None:
                by_flow = self._tracker.refine_from_afar(frame, landmarks, pose, guesses.offset)
                result = max(result, by_flow, key=attrgetter("inlier_count"))
        enough = max(self._min_tracked, MIN_AGREEMENT * count)
        return result if result.inlier_count >= enough else None

    def _decide(
        self, frame: StereoFrame, first: TrackingResult, second: TrackingResult, rest: Mask, guesses: Guesses
    ) -> GroundMotion:
        """Return the motion with more evidence, in doubt if not clearly so; the second one tracks the `rest` `(M,)`."""
        expected = guesses.poses[0]
        ratio = self._evidence(frame, first, second, expected) / self._evidence(frame, second, first, expected)
        self._in_doubt = 1.0 / CLEAR < ratio < CLEAR
        if self._in_doubt:
            doubt = pose_distance(first.pose, second.pose)
            if ratio < 1.0:
                first = self._tracker.refine(frame, first.landmarks, second.pose, guesses.offset)
            return GroundMotion(first, doubt=doubt)
        if ratio < 1.0:
            return self._second_wins(frame, first, second, rest, guesses)
        dynamic = np.zeros(len(rest), np.bool_)
        dynamic[np.flatnonzero(rest)[second.inliers]] = True
        seen = first.observations.copy()
        seen[rest] = second.observations
        self._note_motion(first, guesses)
        return GroundMotion(first, self._leave_out(frame, first, dynamic, seen))

    def _second_wins(
        self, frame: StereoFrame, first: TrackingResult, second: TrackingResult, rest: Mask, guesses: Guesses
    ) -> GroundMotion:
        dynamic = ~rest & (first.inliers | stays_in(frame, first.landmarks))
        rows = self._leave_out(frame, first, dynamic)
        result = self._tracker.refine(frame, first.landmarks.subset(~dynamic), second.pose, guesses.offset)
        self._note_motion(result, guesses)
        return GroundMotion(result, rows)

    def _evidence(self, frame: StereoFrame, result: TrackingResult, other: TrackingResult, expected: Pose) -> float:
        """Return the number of landmarks that follow a motion, weighted by how probable it is for the ground."""
        inliers, landmarks = result.inliers, result.landmarks
        count = float(result.inlier_count)
        if not self._has_moved:
            # the own body is not known before the first motion: what stays is rather it than the ground
            stays = stays_in(frame, landmarks)[inliers]
            return count / STAYING if stays.mean() > 0.5 else count
        if self._in_doubt:  # what is old or expected may follow the wrong motion
            return count
        count += (OLD - 1.0) * float(np.count_nonzero(inliers & landmarks.are_old))
        mine, theirs, continued = (
            project(pose, landmarks, self._camera) for pose in (result.pose, other.pose, expected)
        )
        return count * EXPECTED if high_distance(mine, continued) < 0.5 * high_distance(theirs, continued) else count

    def _differ(self, first: TrackingResult, second: TrackingResult) -> bool:
        """Tell whether nearly all landmarks agree on the second pose, or both poses see them at different pixels."""
        if second.inlier_count > CONVINCING * len(second.inliers):
            return True
        landmarks = second.landmarks.subset(second.inliers)
        uv = (project(item.pose, landmarks, self._camera) for item in (first, second))
        return high_distance(*uv) > MIN_DIFFERENCE_PX

    def _note_motion(self, result: TrackingResult, guesses: Guesses) -> None:
        if self._has_moved:
            return
        (hosts, rays, inverse_depth, _), host_uv = result.landmarks.estimates, result.landmarks.planes.uv
        moved, still = (
            where_seen(pose, hosts, rays, inverse_depth, host_uv, self._camera, self._shape)[0]
            for pose in (result.pose, guesses.poses[1])
        )
        self._has_moved = bool(np.nanpercentile(np.linalg.norm(moved - still, axis=1), 90) > STILL_PX)

    def _leave_out(
        self, frame: StereoFrame, result: TrackingResult, dynamic: Mask, seen: FloatArray | None = None
    ) -> NDArray[np.intp]:
        """Mark where dynamic landmarks `(M,)` of a result are seen; return their rows in the window."""
        if not dynamic.any():
            return NO_ROWS
        landmarks, seen = result.landmarks, result.observations if seen is None else seen
        fixed = stays_in(frame, landmarks)
        uv = np.where(fixed[:, None], landmarks.planes.uv, seen[:, :2])
        shown = dynamic & np.isfinite(uv[:, 0])
        self.regions.add(frame.image, uv[shown], fixed[shown], landmarks.patches[0].values[:, 0][shown])
        return landmarks.index[dynamic]


def high_distance(uv: FloatArray, other: FloatArray) -> float:
    """Return the 90th percentile of the distances of pixels `(N, 2)` from others that are not NaN; 0 if all are."""
    distance = np.linalg.norm(uv - other, axis=1)
    distance = distance[np.isfinite(distance)]
    return float(np.percentile(distance, 90)) if len(distance) else 0.0


def pose_distance(one: Pose, other: Pose) -> tuple[float, float]:
    """Return the distance, metres, and the angle, radians, between two poses."""
    angle = np.linalg.norm(rotvec_from_matrix(one.rotation.T @ other.rotation))
    return float(np.linalg.norm(one.position - other.position)), float(angle)
