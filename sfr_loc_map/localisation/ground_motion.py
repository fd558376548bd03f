"""Selection of the ground's motion among the rigid motions in an image; everything else is excluded while it lasts.

The landmarks that a pose does not explain are searched for a second rigid motion. The ground's motion is the one that
more landmarks follow and that continues the motion before. The landmarks and image cells of the other motion (own body,
dirt on the lens, moving objects) are excluded. If the evidence does not separate the two, the pose is ambiguous.

The ground is identified by its motion. Until a single rigid motion has explained several moving image pairs (phase
`LEARNING`), a pose that leaves changed image cells unexplained is contradicted, and two competing motions are
ambiguous.

A motion is *contradicted* if many cells changed that it does not move. It is *unusual* if more landmarks than usual do
not follow it. `GroundSelector._decide` goes through this table from top to bottom; the first row that applies decides:

| motion | and | result |
|---|---|---|
| contradicted, untrusted, or unusual and not known | the other landmarks follow a second motion | own body excluded |
| untrusted | | the tracks as they are: the localiser is lost |
| contradicted | no second motion, or that is contradicted, too | the last pose is kept |
| contradicted | a second motion | `_choose` |
| unusual | the pair before was partially transferred | partial transfer |
| unusual | a second motion that differs | `_choose` |
| unusual | nearly half of the landmarks are unexplained | partial transfer |
| otherwise | | one motion; what is fixed to the camera is excluded |

`_choose` takes the motion with more evidence. It returns a partial transfer if one motion is a standstill, and an
ambiguous pose if the evidence is not clear or the ground is not known.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum, auto
from operator import attrgetter
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatImage, Mask
from sfr_loc_map.geometry.camera import Pose, StereoCamera
from sfr_loc_map.geometry.rotation import rotvec_from_matrix
from sfr_loc_map.localisation.frontend.image_cells import (
    LEVEL,
    MOVED_PX,
    Change,
    ExcludedCells,
    Explained,
    cell_counts,
    change_of,
    explain,
)
from sfr_loc_map.localisation.frontend.landmarks import ALIGNED_LANDMARKS, Landmarks
from sfr_loc_map.localisation.frontend.pose_solver import RightOffset
from sfr_loc_map.localisation.frontend.tracking import StereoFrame, Tracker, Tracks
from sfr_loc_map.localisation.guards import Finding
from sfr_loc_map.localisation.motion_model import Guesses
from sfr_loc_map.localisation.relocalisation import References, Relocaliser
from sfr_loc_map.localisation.uncertainty import DirectedError

# The thresholds were chosen on rendered drives with injected faults (docs/decisions/0002-localiser.md), so that clean
# drives have no findings and no error of a faulty drive exceeds five times its stated 3 sigma without one.

# ---- a second motion

MIN_AGREEMENT = 0.3  #: Minimum fraction of the unexplained landmarks that a second motion explains.
CONVINCING = 0.6  #: Fraction of the unexplained landmarks from which a second motion is accepted without further tests.
MIN_DIFFERENCE_PX = 1.0  #: Minimum image motion between two poses that are different motions, px.
MIN_DIFFERENCE_RATIO = 0.05  #: Minimum of the same as a ratio to the image motion of the first pose.
OLD_WEIGHT = 3.0  #: Evidence of a landmark that is older than the newest keyframe; a newer one has 1.
EXPECTED_WEIGHT = 1.5  #: Factor on the evidence of a motion that continues the one before.
CLEAR_RATIO = 1.4  #: Minimum ratio of the evidence for two motions that makes one of them the ground's.
RETRY_RATIO = 1.4  #: Minimum ratio of inliers by which a second refinement replaces the first one.

# ---- unusual and contradicted motions

MIN_UNEXPLAINED = 0.12  #: Fraction of unexplained landmarks, above the typical one, from which a motion is unusual.
MAX_UNEXPLAINED = 0.47  #: Fraction of unexplained landmarks from which a motion is unusual in any case.
TYPICAL_FACTOR = 1.25  #: Factor on the typical fraction of unexplained landmarks.
RISING_GAIN = 0.1  #: Gain of the typical fraction for a pair with a larger fraction.
FALLING_GAIN = 0.5  #: Gain of the typical fraction for a pair with a smaller fraction.
MAX_WRONG_UNKNOWN = 0.05  #: Maximum fraction of cells that contradict a motion while the ground is not known.
MAX_WRONG_KNOWN = 0.4  #: Maximum fraction of cells that contradict the motion of a known ground.
MIN_FIXED = 12  #: Minimum number of landmarks on static texture that may be the own body.
MAX_MOVING = 0.12  #: Fraction of excluded moving cells from which a pair is not explained by one motion.

# ---- phases

LEARNING_PAIRS = 3  #: Moving pairs that one motion must explain before it is the ground's.
SHORT_DOUBT_PAIRS = 3  #: Agreeing pairs that end the doubt about a ground that was known.
LONG_DOUBT_PAIRS = 10  #: Agreeing pairs that end the doubt about a ground that was not known.
SETTLING_PAIRS = 3  #: Moving pairs that stay degraded after a contradicted or ambiguous pose.
STALE_SETTLING_PAIRS = 10  #: Moving pairs that stay degraded after a mostly stale image.
MOSTLY_STALE = 0.5  #: Fraction of stale rows from which an image is mostly stale: later images may be entirely stale.
AFTER_TRANSFER = 0.5  #: Factor on `MIN_UNEXPLAINED` after a partially transferred pair.
MAX_TRANSFERS = 10  #: Maximum number of consecutive pairs that are taken as partially transferred.

# ---- reference image

REFERENCE_PX = 3.0  #: Image motion, px, that shows what is fixed to the camera; the reference image is then replaced.
REFERENCE_PAIRS = 10  #: Number of compared pairs after which the reference image is replaced, however slow the motion.
FAR_RATIO = 0.06  #: Image motion per pair, fraction of the width, above which a landmark may not be found again.

AT_LEAST_UNOBSERVED = DirectedError(0.0, 0.0)  #: Ambiguity of unknown size: the motion since the last pose counts.
NO_ROWS = np.zeros(0, np.intp)


class Prediction(NamedTuple):
    """What is expected of a pair."""

    guesses: Guesses  #: Initial guesses of the left camera's pose.
    offset: RightOffset  #: Offset of the right camera.


class Phase(Enum):
    """What is known about the ground's motion."""

    LEARNING = auto()  #: It is being learnt; `pairs` have agreed so far.
    KNOWN = auto()  #: A single motion has explained several moving pairs.
    IN_DOUBT = auto()  #: Two motions competed; `pairs` more must agree before it is learnt again.


class Confidence(NamedTuple):
    """The phase and its counter."""

    phase: Phase = Phase.LEARNING
    pairs: int = 0

    def agreed(self) -> Confidence:
        """Return the confidence after a moving pair that one motion explained."""
        if self.phase is Phase.KNOWN:
            return self
        if self.phase is Phase.IN_DOUBT:
            return Confidence(Phase.IN_DOUBT, self.pairs - 1) if self.pairs > 1 else Confidence()
        pairs = self.pairs + 1
        return Confidence(Phase.KNOWN) if pairs >= LEARNING_PAIRS else Confidence(Phase.LEARNING, pairs)

    def interrupted(self) -> Confidence:
        """Return the confidence after a pair that agreed only in part, or in a new window: learning starts again."""
        return self if self.phase is Phase.IN_DOUBT else Confidence()

    def doubted(self) -> Confidence:
        """Return the confidence after two motions competed, or cells contradicted the pose.

        A known ground recovers soon; doubt about a ground that was being learnt lasts longer.
        """
        was_known = self.phase is Phase.KNOWN
        recovers = self.phase is Phase.IN_DOUBT and self.pairs <= SHORT_DOUBT_PAIRS
        return Confidence(Phase.IN_DOUBT, SHORT_DOUBT_PAIRS if was_known or recovers else LONG_DOUBT_PAIRS)


class Reference(NamedTuple):
    """Image that the present one is compared with, cell by cell."""

    image: FloatImage  #: Pyramid level `LEVEL` of a left image.
    pose: Pose  #: Pose of the left camera there.
    age: int = 0  #: Number of pairs that were compared with it.


@dataclass(frozen=True, slots=True, eq=False)
class GroundMemory:
    """What is remembered of accepted pairs, and of pairs that contradict their pose."""

    excluded: ExcludedCells  #: Cells that do not move with the ground.
    contradicting: Mask  #: `(R, C)` cells that contradicted a motion since the ground is in doubt.
    reference: Reference | None = None  #: Image of an accepted pose; None before the first window.
    confidence: Confidence = Confidence()
    transfers: int = 0  #: Number of consecutive partially transferred pairs.
    settling: int = 0  #: Number of moving pairs that are still degraded after a doubtful one.
    typical: float | None = None  #: Typical fraction of unexplained landmarks; None before the first pair.

    @classmethod
    def none(cls, shape: tuple[int, int]) -> GroundMemory:
        """Return the memory before the first pair of images of a shape (height, width)."""
        return cls(ExcludedCells.none(shape), np.zeros(cell_counts(shape), np.bool_))

    @property
    def is_clear(self) -> bool:
        """Whether no pair before was contradicted, ambiguous or partially transferred."""
        return self.settling == 0 and self.transfers == 0 and self.confidence.phase is not Phase.IN_DOUBT

    def in_new_window(self, frame: StereoFrame, pose: Pose) -> GroundMemory:
        """Return the memory with a new window. Its ground has not been seen to move; doubt persists."""
        return replace(
            self,
            reference=Reference(frame.left[LEVEL].image, pose),
            confidence=self.confidence.interrupted(),
            transfers=0,
            settling=0,
            typical=None,
        )

    def after_stale_rows(self, stale: Mask) -> GroundMemory:
        """Return the memory after a pair with stale rows `(H,)`: later pairs may have stale parts, too."""
        settling = STALE_SETTLING_PAIRS if stale.mean() > MOSTLY_STALE else 1
        return replace(self, transfers=max(self.transfers, 1), settling=max(self.settling, settling))

    def doubted(self, cells: Mask) -> GroundMemory:
        """Return the memory after it became unknown which motion is the ground's; cells `(R, C)` contradict it."""
        is_in_doubt = self.confidence.phase is Phase.IN_DOUBT
        before = self.contradicting if is_in_doubt else np.zeros_like(self.contradicting)
        return replace(self, confidence=self.confidence.doubted(), contradicting=before | cells)


class Ground(NamedTuple):
    """The ground's motion in a pair."""

    tracks: Tracks  #: Tracks that follow it.
    memory: GroundMemory  #: Memory for the next pair.
    findings: frozenset[Finding] = frozenset()
    not_ground: NDArray[np.intp] = NO_ROWS  #: `(N,)` rows in the window of landmarks that do not move with the ground.
    ambiguity: DirectedError | None = None  #: How far the pose may be another one; None if it is unambiguous.
    is_second: bool = False  #: Whether the tracks follow another motion than the first tracks.
    reference: Reference | None = None  #: Reference image for the next pair, if the pose is accepted.

    def accepted(self, *, is_compared: bool) -> GroundMemory:
        """Return the memory after the pose was accepted; whether later images may be compared with this one."""
        if self.reference is None or not is_compared:
            return self.memory
        return replace(self.memory, reference=self.reference)

    def plus(self, *findings: Finding) -> Ground:
        """Return the ground with further findings."""
        return self._replace(findings=self.findings.union(findings))


class _Pair(NamedTuple):
    """One pair while its ground is selected."""

    frame: StereoFrame
    prediction: Prediction
    references: References
    change: Change  #: Cells that changed, or stayed, since the reference image.
    since: Pose  #: Pose of the reference image.
    far_px: float  #: Image motion beyond which a landmark that was not found contradicts nothing.


class GroundSelector:
    """Selects the ground's motion. It holds the tools, and keeps no state between calls."""

    def __init__(
        self, tracker: Tracker, relocaliser: Relocaliser, camera: StereoCamera, shape: tuple[int, int], min_tracked: int
    ) -> None:
        """The shape of the images is (height, width)."""
        self._tracker = tracker
        self._relocaliser = relocaliser
        self._camera = camera
        self._shape = shape
        self._min_tracked = min_tracked

    def select(
        self, frame: StereoFrame, first: Tracks, prediction: Prediction, memory: GroundMemory, references: References
    ) -> Ground:
        """Return the ground's motion in a pair. The first tracks may follow any motion, trusted or not."""
        assert memory.reference is not None, "a window has begun"
        image = frame.left[LEVEL].image
        reference = memory.reference._replace(age=memory.reference.age + 1)
        far_px = FAR_RATIO * self._shape[1] * reference.age if memory.is_clear else np.inf
        change = change_of(reference.image, image)
        pair = _Pair(frame, prediction, references, change, reference.pose, far_px)
        explained = self._explain(pair, first)
        if first.is_trusted and explained.unexplained_fraction > MIN_UNEXPLAINED:  # retry all landmarks from this pose
            again = self._tracker.refine(frame, first.landmarks, first.pose, prediction.offset)
            if again.inlier_count > RETRY_RATIO * first.inlier_count:
                first = again
                explained = self._explain(pair, again)
        ground = self._decide(pair, first, explained, memory)
        return self._remember(ground, explained, image, reference, change)

    def _remember(
        self, ground: Ground, explained: Explained, image: FloatImage, reference: Reference, change: Change
    ) -> Ground:
        """Update the memory after the decision: excluded cells, settling pairs, and the reference image for later."""
        memory = ground.memory
        excluded = memory.excluded
        if excluded.mask is not None or len(ground.not_ground):
            excluded = excluded.after_pair(change.stays, self._shape)
        is_contradicted = Finding.CONTRADICTED in ground.findings
        is_complete = Finding.PARTIAL_TRANSFER not in ground.findings
        settling = memory.settling
        if is_contradicted or ground.ambiguity is not None:
            settling = max(settling, SETTLING_PAIRS)
        elif not is_complete:
            settling = max(settling, min(memory.transfers, SETTLING_PAIRS))
        elif settling > 0 and ground.tracks.is_trusted:
            settling -= int(explained.motion_px > MOVED_PX)  # a stationary image shows nothing
            if settling > 0:
                ground = ground.plus(Finding.UNSETTLED)
        is_replaced = explained.motion_px > REFERENCE_PX or ground.is_second or reference.age > REFERENCE_PAIRS
        return ground._replace(
            memory=replace(memory, excluded=excluded, settling=settling, reference=reference),
            reference=Reference(image, ground.tracks.pose) if is_replaced and is_complete else reference,
        )

    # ---- the table of cases

    def _decide(self, pair: _Pair, first: Tracks, explained: Explained, memory: GroundMemory) -> Ground:
        """Go through the cases."""
        is_known = memory.confidence.phase is Phase.KNOWN
        is_wrong = explained.contradicting_fraction > (MAX_WRONG_KNOWN if is_known else MAX_WRONG_UNKNOWN)
        is_usual = _is_usual(explained.unexplained_fraction, memory)
        if is_wrong or not first.is_trusted or not (is_known or is_usual):
            outside_body = self._outside_body(pair, first, explained, memory)
            if outside_body is not None:
                return outside_body
        if not first.is_trusted:
            return Ground(first, memory)
        if is_wrong:
            second = self._search(pair, first.landmarks.subset(explained.unexplained))
            if second is None or self._explain(pair, second).contradicting_fraction > MAX_WRONG_UNKNOWN:
                doubted = memory.doubted(self._unexplained_cells(explained))
                return Ground(first, doubted).plus(Finding.CONTRADICTED)
            return self._choose(pair, first, second, explained, memory)
        if not is_usual and 0 < memory.transfers < MAX_TRANSFERS:
            return _partial_transfer(first, memory)
        if not is_usual:
            second = self._search(pair, first.landmarks.subset(explained.unexplained))
            if second is not None and self._differ(pair, first, second, explained.motion_px):
                return self._choose(pair, first, second, explained, memory)
            if explained.unexplained_fraction >= MAX_UNEXPLAINED and memory.transfers < MAX_TRANSFERS:
                return _partial_transfer(first, memory)
        return self._one_motion(first, explained, memory, is_usual=is_usual)

    def _outside_body(self, pair: _Pair, first: Tracks, explained: Explained, memory: GroundMemory) -> Ground | None:
        """Return the motion of the landmarks outside static texture, if they follow one; None otherwise.

        That texture is then taken to be the rover's own body.
        """
        if np.count_nonzero(explained.on_static) < MIN_FIXED:
            return None
        second = self._search(pair, first.landmarks.subset(~explained.on_static))
        if second is None:
            return None
        if first.is_trusted and self._image_motion(pair, second, first.pose) < MIN_DIFFERENCE_PX:
            return None
        by_second = self._explain(pair, second)
        if by_second.contradicting_fraction >= MAX_WRONG_UNKNOWN:
            return None
        return self._second_wins(pair, first, second, explained.on_static, by_second.fixed_cells, memory)

    def _one_motion(self, first: Tracks, explained: Explained, memory: GroundMemory, *, is_usual: bool) -> Ground:
        """Return the only motion, without what is fixed to the camera."""
        was_known = memory.confidence.phase is Phase.KNOWN
        memory = replace(memory, transfers=0)
        if explained.unexplained_fraction >= MAX_UNEXPLAINED and not was_known:
            # what explains hardly half of the landmarks may be anything: it must not become the ground
            memory = memory.doubted(self._unexplained_cells(explained))
        else:
            memory = _with_typical(memory, explained.unexplained_fraction, is_usual=is_usual)
            memory = self._with_confidence(memory, first, explained, is_usual=is_usual)
        if explained.fixed_cells.any():
            memory = replace(memory, excluded=memory.excluded.with_fixed(explained.fixed_cells))
        ground = Ground(first, memory, not_ground=first.landmarks.index[explained.on_fixed])
        if was_known and not is_usual:
            ground = ground.plus(Finding.UNEXPLAINED)
        if explained.unexplained_fraction >= MAX_UNEXPLAINED or memory.confidence.phase is Phase.IN_DOUBT:
            ground = ground._replace(ambiguity=AT_LEAST_UNOBSERVED).plus(Finding.AMBIGUOUS)
        return ground

    def _with_confidence(
        self, memory: GroundMemory, first: Tracks, explained: Explained, *, is_usual: bool
    ) -> GroundMemory:
        """Return the memory with the confidence after a pair of one motion; a stationary pair shows nothing."""
        confidence = memory.confidence
        if confidence.phase is Phase.KNOWN or explained.motion_px <= MOVED_PX:
            return memory
        is_in_doubt = confidence.phase is Phase.IN_DOUBT
        is_covered = not is_in_doubt or self._covers_doubt(first, explained, memory)
        if memory.excluded.moving_fraction < MAX_MOVING and is_covered:
            return replace(memory, confidence=confidence.agreed())
        if is_in_doubt and not is_usual:
            return memory.doubted(self._unexplained_cells(explained))
        return replace(memory, confidence=confidence.interrupted())

    def _choose(self, pair: _Pair, first: Tracks, second: Tracks, explained: Explained, memory: GroundMemory) -> Ground:
        """Return the one of two motions that has more evidence; it is ambiguous if the evidence is not clear.

        The second motion explains the landmarks that the first one does not.
        """
        standstill = pair.prediction.guesses.standstill
        slower_px = min(self._image_motion(pair, tracks, standstill) for tracks in (first, second))
        if memory.transfers < MAX_TRANSFERS and slower_px < MIN_DIFFERENCE_PX:  # a part of the image is stale
            return _partial_transfer(first, memory)
        ratio = self._evidence(pair, first, second) / self._evidence(pair, second, first)
        first_wins = ratio >= 1.0
        winner_fraction = 1.0 - explained.unexplained_fraction
        if not first_wins:
            winner_fraction = explained.unexplained_fraction * second.inlier_count / len(second.inliers)
        is_clear = not 1.0 / CLEAR_RATIO < ratio < CLEAR_RATIO
        if memory.confidence.phase is not Phase.KNOWN or winner_fraction < 1.0 - MAX_UNEXPLAINED or not is_clear:
            tracks = first
            if not first_wins:
                tracks = self._tracker.refine(pair.frame, first.landmarks, second.pose, pair.prediction.offset)
            doubted = memory.doubted(self._unexplained_cells(explained))
            ambiguity = pose_distance(first.pose, second.pose)
            ground = Ground(tracks, doubted, ambiguity=ambiguity, is_second=not first_wins)
            return ground.plus(Finding.AMBIGUOUS)
        follows_second = np.zeros(len(explained.unexplained), np.bool_)
        follows_second[np.flatnonzero(explained.unexplained)[second.inliers]] = True
        if not first_wins:
            follows_first = first.inliers & ~follows_second
            cells = self._cells(explained.cell_index[follows_first])
            return self._second_wins(pair, first, second, follows_first, cells, memory)
        moving = self._cells(self._explain(pair, second).cell_index[second.inliers])
        excluded = memory.excluded.with_fixed(explained.fixed_cells).with_moving(moving & ~explained.fixed_cells)
        not_ground = first.landmarks.index[follows_second | explained.on_fixed]
        return Ground(first, replace(memory, excluded=excluded), not_ground=not_ground)

    def _second_wins(
        self, pair: _Pair, first: Tracks, second: Tracks, excluded: Mask, cells: Mask, memory: GroundMemory
    ) -> Ground:
        """Return the second motion without the landmarks `(M,)` and cells `(R, C)` that do not follow it."""
        memory = replace(memory, excluded=memory.excluded.with_fixed(cells))
        tracks = self._tracker.refine(
            pair.frame, first.landmarks.subset(~excluded), second.pose, pair.prediction.offset
        )
        ground = Ground(tracks, memory, not_ground=first.landmarks.index[excluded], is_second=True)
        usual = MIN_UNEXPLAINED + TYPICAL_FACTOR * (memory.typical or 0.0)
        is_complete = self._explain(pair, tracks).unexplained_fraction < usual
        return ground if is_complete else ground.plus(Finding.PARTIAL_TRANSFER)

    # ---- what the cases ask

    def _explain(self, pair: _Pair, tracks: Tracks, since: Pose | None = None, pose: Pose | None = None) -> Explained:
        """Return what a motion explains: by default from the pose of the reference image to the pose of the tracks."""
        return explain(
            pose or tracks.pose,
            since or pair.since,
            tracks.landmarks.estimates,
            tracks.landmarks.planes.uv,
            tracks.inliers,
            pair.change,
            self._camera,
            self._shape,
            pair.far_px,
        )

    def _image_motion(self, pair: _Pair, tracks: Tracks, since: Pose, pose: Pose | None = None) -> float:
        """Return the image motion of the landmarks, px, from one pose to that of the tracks, or to another one."""
        return self._explain(pair, tracks, since, pose).motion_px

    def _search(self, pair: _Pair, landmarks: Landmarks) -> Tracks | None:
        """Return a motion of some landmarks: from the guesses, then by optical flow; None if too few agree on one."""
        count = len(landmarks.index)
        if count < self._min_tracked:
            return None
        frame = pair.frame
        offset = pair.prediction.offset
        start = self._tracker.align(frame.left, landmarks.thinned(ALIGNED_LANDMARKS), pair.prediction.guesses.all)
        tracks = self._tracker.refine(frame, landmarks, start, offset)
        if tracks.inlier_count < CONVINCING * count:
            pose = self._relocaliser.pose_by_flow(frame, pair.references, landmarks)
            if pose is not None:
                by_flow = self._tracker.refine_from_afar(frame, landmarks, pose, offset)
                tracks = max(tracks, by_flow, key=attrgetter("inlier_count"))
        return tracks if tracks.inlier_count >= max(self._min_tracked, MIN_AGREEMENT * count) else None

    def _evidence(self, pair: _Pair, tracks: Tracks, other: Tracks) -> float:
        """Return the number of landmarks that follow a motion, weighted by how likely it is the ground's."""
        old = float(np.count_nonzero(tracks.inliers & tracks.landmarks.are_old))
        evidence = tracks.inlier_count + (OLD_WEIGHT - 1.0) * old
        expected = pair.prediction.guesses.expected
        to_own = self._image_motion(pair, tracks, expected)
        to_other = self._image_motion(pair, tracks, expected, other.pose)
        return evidence * EXPECTED_WEIGHT if to_own < 0.5 * to_other else evidence

    def _differ(self, pair: _Pair, first: Tracks, second: Tracks, image_motion_px: float) -> bool:
        """Return whether two motions differ: nearly all landmarks follow the second one, or it moves them elsewhere."""
        if second.inlier_count > CONVINCING * len(second.inliers):
            return True
        least_px = max(MIN_DIFFERENCE_PX, MIN_DIFFERENCE_RATIO * image_motion_px)
        return self._image_motion(pair, second, first.pose) > least_px

    def _covers_doubt(self, first: Tracks, explained: Explained, memory: GroundMemory) -> bool:
        """Return whether inliers cover at least half of the contradicting cells, within one cell."""
        seen = self._cells(explained.cell_index[first.inliers]).astype(np.uint8)
        beside = cv2.dilate(seen, np.ones((3, 3), np.uint8)) > 0
        return bool((beside & memory.contradicting).sum() >= 0.5 * memory.contradicting.sum())

    def _unexplained_cells(self, explained: Explained) -> Mask:
        """Return the cells `(R, C)` of the landmarks that the motion does not explain."""
        return self._cells(explained.cell_index[explained.unexplained])

    def _cells(self, numbers: NDArray[np.intp]) -> Mask:
        """Return the cells `(R, C)` of some cell numbers."""
        rows, columns = cell_counts(self._shape)
        found = np.bincount(numbers, minlength=rows * columns + 1)
        return found[:-1].reshape(rows, columns) > 0


def _is_usual(unexplained: float, memory: GroundMemory) -> bool:
    """Return whether a fraction of unexplained landmarks is usual for the ground."""
    margin = AFTER_TRANSFER * MIN_UNEXPLAINED if memory.transfers else MIN_UNEXPLAINED
    return unexplained < min(margin + TYPICAL_FACTOR * (memory.typical or 0.0), MAX_UNEXPLAINED)


def _with_typical(memory: GroundMemory, unexplained: float, *, is_usual: bool) -> GroundMemory:
    """Return the memory with the typical fraction of unexplained landmarks after a pair of one motion.

    An unusual pair of a known ground does not change the fraction, nor does any pair while the ground is in doubt.
    """
    phase = memory.confidence.phase
    if phase is Phase.IN_DOUBT or (phase is Phase.KNOWN and not is_usual):
        return memory
    typical = unexplained if memory.typical is None else memory.typical
    gain = RISING_GAIN if unexplained > typical else FALLING_GAIN
    return replace(memory, typical=typical + gain * (unexplained - typical))


def _partial_transfer(first: Tracks, memory: GroundMemory) -> Ground:
    """Return the first motion of a pair whose parts are of different moments."""
    return Ground(first, replace(memory, transfers=memory.transfers + 1)).plus(Finding.PARTIAL_TRANSFER)


def pose_distance(one: Pose, other: Pose) -> DirectedError:
    """Return the distance and the angle between two poses."""
    angle = np.linalg.norm(rotvec_from_matrix(one.rotation.T @ other.rotation))
    return DirectedError(float(np.linalg.norm(one.position - other.position)), float(angle))
