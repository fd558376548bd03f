"""Which of the motions in the images is the ground's; what follows another one is left out while it lasts.

Nothing is the ground before it has been seen to move: until one motion has explained a moving image, a pose that leaves
changing cells where they are is refused, and two motions are in doubt.
"""

from __future__ import annotations

from collections.abc import Sequence
from operator import attrgetter
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatImage, Mask
from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.geometry.rotation import rotvec_from_matrix
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.frontend.image_cells import LEVEL, MOVED_PX, Change, ImageCells, Judged, change_of, judge
from sfr_loc_map.localisation.frontend.landmarks import Landmarks
from sfr_loc_map.localisation.frontend.pose_solver import RightOffset
from sfr_loc_map.localisation.frontend.tracking import StereoFrame, Tracker, TrackingResult
from sfr_loc_map.localisation.relocalisation import Relocaliser

MIN_AGREEMENT = 0.3  #: Share of the unexplained landmarks that a second motion must explain.
CONVINCING = 0.6  #: Share from which it is one in any case, and not sought by flow as well.
MIN_DIFFERENCE_PX = 1.0  #: Image motion between two poses that are two motions,
DIFFERENCE_SHARE = 0.05  #: and the least share of the motion itself: some landmarks agree on one that is a little off.
OLD = 3.0  #: Weight of a landmark that is older than the newest keyframe.
CLEAR = 1.4  #: Ratio of the evidence for two motions from which the ground's is known.
EXPECTED = 1.5  #: Factor on the evidence for a motion that continues the one before.
MIN_SHARE, MAX_SHARE = 0.12, 0.47
"""Share of the landmarks in view that must be unexplained, beyond the typical one, before a pair is unusual: a second
motion is sought; and from which on it is in any case."""
MORE_THAN_USUAL = 1.25  #: Factor on the typical share, which is added.
TYPICAL_SHARE, LESS_SHARE = 0.1, 0.5  #: Share of a pair in the typical share: of one that has more, and less.
MAX_WRONG_FIRST, MAX_WRONG = 0.05, 0.4
"""Share of the cells that may contradict a pose, before the ground was seen to move and after."""
MIN_FIXED = 12  #: Fewest landmarks that are taken as fixed to the camera.
AGREED = 3  #: Pairs that one motion must explain before it is the ground's.
SETTLED = 3  #: Pairs of one motion from which on, after one that contradicted its pose, they are not late any more.
DOUBTED = 10  #: As many more where there were two motions before.
AFTER_TEAR = 0.5  #: Part of the share that makes a pair unusual where the one before was torn.
MOSTLY = 0.5  #: Share of the rows beyond which an image is mostly old.
MAX_TEARS = 10  #: Pairs in a row that may be of several exposures: what lasts longer is something else.
ENOUGH_PX = 3.0  #: Image motion that tells well what is fixed to the camera: the next image is compared with this one.
FAR_SHARE = 0.06
"""Share of the width by which a motion moves a landmark in a pair beyond which it may not be found again."""
MAX_AGE = 10  #: Pairs after which an image is no longer compared with, however slow the motion.
NO_ROWS = np.zeros(0, np.intp)


class Guesses(NamedTuple):
    """Initial guesses of the left camera's pose, constant velocity and standstill first, and the right one's error."""

    poses: Sequence[Pose]
    offset: RightOffset


class GroundMotion(NamedTuple):
    """The ground's motion in a pair."""

    result: TrackingResult  #: Tracking by it.
    dynamic: NDArray[np.intp] = NO_ROWS  #: `(N,)` rows in the window of landmarks that follow another motion.
    #: Metres and radians by which the pose may be wrong besides what no image shows, as it is not known which motion is
    #: the ground's; None if it is.
    doubt: tuple[float, float] | None = None
    whole: bool = True  #: Whether the pair is of one exposure.
    sheared: bool = False  #: Whether its parts may be of different moments, as its rows, or as nothing explains more.
    shear: float = 0.0  #: Squared shear of the rows over its variance, per degree of freedom.
    seen: bool = True  #: Whether the image agrees that anything moved like that.


class GroundMotionFinder:
    """Tells the ground's motion from that of the own body, of dirt and of moving objects.

    Landmarks that a pose does not explain are searched for a second rigid motion. The ground's is the one that more
    landmarks follow and that continues the motion before; the landmarks of the other are left out, and the cells of
    the image where they are. Where the two cannot be told apart the pose is in doubt.
    """

    def __init__(self, tracker: Tracker, relocaliser: Relocaliser, rig: StereoRig, config: LocalisationConfig) -> None:
        self._tracker, self._relocaliser = tracker, relocaliser
        self._shape, self._min_tracked, self._camera = (rig.height, rig.width), config.min_tracked, rig.camera
        self.cells = ImageCells(self._shape)
        nothing = np.zeros(self.cells.count, np.bool_)
        self._change, self._doubted = Change(nothing, nothing), nothing
        self._agreed = 0

    def begin(self, frame: StereoFrame, pose: Pose) -> None:
        """Begin with a window: its ground has not been seen to move."""
        self._tears = self._age = self._unsettled = 0
        self._agreed = min(self._agreed, 0)  # what was in doubt still is
        self._typical: float | None = None
        self._image: FloatImage = frame.left[LEVEL].image
        self._still = pose  # where that image was taken

    def find(self, frame: StereoFrame, first: TrackingResult, guesses: Guesses) -> GroundMotion:
        """Return the ground's motion in a pair; the first result may follow any motion, trusted or not."""
        image = frame.left[LEVEL].image
        self._change = change_of(self._image, image)
        self._age += 1
        judged = self._judge(first)
        if first.trusted and judged.share > MIN_SHARE:  # a pose from few landmarks may show where the others are
            again = self._tracker.refine(frame, first.landmarks, first.pose, guesses.offset)
            if again.inlier_count > CLEAR * first.inlier_count:
                first, judged = again, self._judge(again)
        ground = self._find(frame, first, judged, guesses)
        result = ground.result
        if self.cells.mask is not None or len(ground.dynamic):
            self.cells.age(self._change.stays)
        if not ground.seen or ground.doubt is not None:
            self._unsettled = max(self._unsettled, SETTLED)
        elif not ground.whole:
            self._unsettled = max(self._unsettled, min(self._tears, SETTLED))
        elif self._unsettled > 0 and result.trusted:
            self._unsettled -= judged.far > MOVED_PX  # what stands tells nothing
            ground = ground._replace(sheared=ground.sheared or self._unsettled > 0)
        enough = judged.far > ENOUGH_PX or result is not first or self._age > MAX_AGE
        if result.trusted and ground.seen and ground.whole and enough:
            self._image, self._still, self._age = image, result.pose, 0
        return ground

    def _judge(self, result: TrackingResult, since: Pose | None = None, pose: Pose | None = None) -> Judged:
        """Return what the motion since the image compared with, or a pose, to a result, or another pose, explains."""
        estimates, host_uv = result.landmarks.estimates, result.landmarks.planes.uv
        start, end = since or self._still, pose or result.pose
        # a landmark that races by is not found again; after a pair that was not clear it may as well contradict
        clear = self._unsettled == 0 and self._tears == 0 and self._agreed >= 0
        far_px = FAR_SHARE * self._shape[1] * self._age if clear else np.inf
        return judge(end, start, estimates, host_uv, result.inliers, self._change, self._camera, self._shape, far_px)

    def _find(self, frame: StereoFrame, first: TrackingResult, judged: Judged, guesses: Guesses) -> GroundMotion:
        stays, known = judged.stays, self._agreed >= AGREED
        wrong = judged.wrong > (MAX_WRONG if known else MAX_WRONG_FIRST)
        typical = judged.share if self._typical is None else self._typical
        margin = AFTER_TEAR * MIN_SHARE if self._tears else MIN_SHARE
        usual = judged.share < min(margin + MORE_THAN_USUAL * (self._typical or 0.0), MAX_SHARE)
        if (wrong or not first.trusted or not (known or usual)) and np.count_nonzero(stays) >= MIN_FIXED:
            # what stays is rather the own body than the ground
            second = self._search(frame, first.landmarks.subset(~stays), guesses)
            if second is not None and not (first.trusted and self._motion(second, first.pose) < MIN_DIFFERENCE_PX):
                by_second = self._judge(second)
                if by_second.wrong < MAX_WRONG_FIRST:
                    return self._second_wins(frame, first, second, stays, by_second.cells, guesses)
        if not first.trusted:
            return GroundMotion(first)
        if wrong:
            second = self._search(frame, first.landmarks.subset(judged.rest), guesses)
            if second is None or self._judge(second).wrong > MAX_WRONG_FIRST:
                self._doubt(judged)
                return GroundMotion(first, seen=False)
            return self._decide(frame, first, second, judged, guesses)
        if 0 < self._tears < MAX_TEARS and not usual:
            return self._torn(first)
        if not usual:
            second = self._search(frame, first.landmarks.subset(judged.rest), guesses)
            if second is not None and self._differ(first, second, judged.far):
                return self._decide(frame, first, second, judged, guesses)
            if judged.share >= MAX_SHARE and self._tears < MAX_TEARS:
                return self._torn(first)
        self._tears = 0
        settled = usual if known else self._agreed >= 0
        if settled:  # what is learnt in doubt would be typical of the doubt
            more = judged.share - typical
            self._typical = typical + (TYPICAL_SHARE if more > 0.0 else LESS_SHARE) * more
        if not known and judged.far > MOVED_PX:
            if self.cells.moving_share < MIN_SHARE and (self._agreed >= 0 or self._covers(first, judged)):
                self._agreed += 1
            elif self._agreed < 0 and not usual:
                self._doubt(judged)
            else:
                self._agreed = min(self._agreed, 0)
        # one motion; what is fixed to the camera is left out
        if judged.cells.any():
            self.cells.leave_out(judged.cells, np.zeros_like(judged.cells))
        doubt = (0.0, 0.0) if judged.share >= MAX_SHARE or self._agreed < 0 else None
        return GroundMotion(first, first.landmarks.index[judged.fixed], doubt, sheared=known and not usual)

    def tear(self, stale: Mask) -> None:
        """Take a pair that is torn, some rows `(H,)` old: those after it may be.

        Where most are, each of those after it may look like the one before as a whole.
        """
        self._tears, self._unsettled = 1, DOUBTED if stale.mean() > MOSTLY else 1

    def _doubt(self, judged: Judged) -> None:
        """Take it as unknown which motion is the ground's."""
        before = self._doubted if self._agreed < 0 else np.zeros_like(self._doubted)
        short = self._agreed >= AGREED or -SETTLED <= self._agreed < 0
        self._agreed = -SETTLED if short else -DOUBTED
        self._doubted = before | self._cells(judged.cell[judged.rest])

    def _covers(self, first: TrackingResult, judged: Judged) -> bool:
        """Tell whether a motion is now seen in half of the cells that have contradicted one."""
        seen = cv2.dilate(self._cells(judged.cell[first.inliers]).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        return bool((seen & self._doubted).sum() >= 0.5 * self._doubted.sum())

    def _torn(self, first: TrackingResult) -> GroundMotion:
        self._tears += 1
        return GroundMotion(first, whole=False)

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
        return result if result.inlier_count >= max(self._min_tracked, MIN_AGREEMENT * count) else None

    def _decide(
        self, frame: StereoFrame, first: TrackingResult, second: TrackingResult, judged: Judged, guesses: Guesses
    ) -> GroundMotion:
        """Return the motion with more evidence, in doubt if not clearly so; the second one tracks the rest."""
        still = guesses.poses[1]
        if self._tears < MAX_TEARS and min(self._motion(x, still) for x in (first, second)) < MIN_DIFFERENCE_PX:
            return self._torn(first)  # part of the image is that of the pair before
        expected = guesses.poses[0]
        ratio = self._evidence(first, second, expected) / self._evidence(second, first, expected)
        by_second = judged.share * second.inlier_count / len(second.inliers)
        explained = by_second if ratio < 1.0 else 1.0 - judged.share
        if self._agreed < AGREED or explained < 1.0 - MAX_SHARE or 1.0 / CLEAR < ratio < CLEAR:
            doubt = pose_distance(first.pose, second.pose)
            self._doubt(judged)
            if ratio < 1.0:
                first = self._tracker.refine(frame, first.landmarks, second.pose, guesses.offset)
            return GroundMotion(first, doubt=doubt)
        follows = np.zeros(len(judged.rest), np.bool_)
        follows[np.flatnonzero(judged.rest)[second.inliers]] = True
        if ratio < 1.0:
            others = first.inliers & ~follows
            return self._second_wins(frame, first, second, others, self._cells(judged.cell[others]), guesses)
        moving = self._cells(self._judge(second).cell[second.inliers])
        self.cells.leave_out(judged.cells, moving & ~judged.cells)
        return GroundMotion(first, first.landmarks.index[follows | judged.fixed])

    def _second_wins(
        self,
        frame: StereoFrame,
        first: TrackingResult,
        second: TrackingResult,
        dynamic: Mask,
        cells: Mask,
        guesses: Guesses,
    ) -> GroundMotion:
        """Return the second motion; landmarks `(M,)` and cells `(R, C)` that do not follow it are left out."""
        self.cells.leave_out(cells, np.zeros_like(cells))
        result = self._tracker.refine(frame, first.landmarks.subset(~dynamic), second.pose, guesses.offset)
        whole = self._judge(result).share < MIN_SHARE + MORE_THAN_USUAL * (self._typical or 0.0)
        return GroundMotion(result, first.landmarks.index[dynamic], whole=whole)

    def _evidence(self, result: TrackingResult, other: TrackingResult, expected: Pose) -> float:
        """Return the number of landmarks that follow a motion, weighted by how probable it is for the ground."""
        count = result.inlier_count + (OLD - 1.0) * float(np.count_nonzero(result.inliers & result.landmarks.are_old))
        mine, theirs = self._motion(result, expected), self._motion(result, expected, other.pose)
        return count * EXPECTED if mine < 0.5 * theirs else count

    def _motion(self, result: TrackingResult, since: Pose, pose: Pose | None = None) -> float:
        """Return how far its landmarks move, pixels, from one pose to that of the result, or to another one."""
        return self._judge(result, since, pose).far

    def _cells(self, cells: NDArray[np.intp]) -> Mask:
        """Return the cells `(R, C)` of some numbers."""
        found = np.bincount(cells, minlength=self.cells.count[0] * self.cells.count[1] + 1)
        return found[:-1].reshape(self.cells.count) > 0

    def _differ(self, first: TrackingResult, second: TrackingResult, far_px: float) -> bool:
        """Tell whether nearly all landmarks agree on the second pose, or both poses see them at different pixels.

        The first moves them by so many pixels.
        """
        least = max(MIN_DIFFERENCE_PX, DIFFERENCE_SHARE * far_px)
        return second.inlier_count > CONVINCING * len(second.inliers) or self._motion(second, first.pose) > least


def pose_distance(one: Pose, other: Pose) -> tuple[float, float]:
    """Return the distance, metres, and the angle, radians, between two poses."""
    angle = np.linalg.norm(rotvec_from_matrix(one.rotation.T @ other.rotation))
    return float(np.linalg.norm(one.position - other.position)), float(angle)
