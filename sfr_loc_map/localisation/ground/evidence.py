"""Evidence of a pair about the ground's motion: what its images show, and what earlier pairs have shown.

`evidence_of` collects all evidence, and `selection.CASES` decides from this evidence. A search for a further motion
takes up to some milliseconds, and is therefore made only if the earlier evidence leaves the case open:

| search | is made if the main motion |
|---|---|
| `_motion_off_body`: motion off the own body | is not credible, and 12 landmarks lie in stationary cells |
| `_is_double_exposure`: second exposure | is trusted, not contradicted, with 3 % to half of the landmarks unexplained |
| `_other_motion`: second motion | is trusted, but contradicted or unusual |

A search is made only if the searches above it found nothing. The last two are not made if parts of the images are stale
as in the previous pair. The package docstring defines the terms.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatImage, Mask
from sfr_loc_map.localisation.frontend.plane_warp import plane_homographies
from sfr_loc_map.localisation.frontend.tracking import Tracks
from sfr_loc_map.localisation.ground.double_exposure import MIXTURE_LEVEL, shows_second_exposure
from sfr_loc_map.localisation.ground.memory import MIN_EXCESS, NEARLY_HALF, GroundMemory, Shown
from sfr_loc_map.localisation.ground.rigid_motion import CONVINCING, MOVED_PX, ComparedPair, Motion
from sfr_loc_map.localisation.motion_size import MotionSize, size_between

MAX_CONTRADICTING_FIRST: Final = 0.05
"""Maximum fraction of cells that contradict a motion while the ground is not identified, and that contradict a motion
that was found by a search. The value is above the 1 % of cells that change by noise alone
(`cell_change.NOISE_CORRELATION`). If larger, a fixed reflection is tracked for longer. If smaller, good poses are
refused because of moving shadows."""
MAX_CONTRADICTING: Final = 0.4
"""Maximum fraction of cells that contradict the motion of an identified ground. The value is below one half, because an
object may fill much of the view of a rover at rest. If larger, a pose that most of the image contradicts is accepted.
If smaller, good poses are refused while a large object is in view."""
MIN_STATIONARY_LANDMARKS: Final = 12
"""Minimum number of landmarks in stationary cells for these cells to show the rover. The value is twice the minimum of
a pose (`pose_solver.MIN_LANDMARKS`). If smaller, more pairs cost the time of a search. If larger, a small body is
detected only by its cells."""
MIN_DIFFERENCE_PX: Final = 1.0
"""Minimum image motion, px, between the poses of two different motions. The value is ten times the usual residual of an
inlier (0.1 px), because two estimates of one motion differ slightly. If larger, slow objects are missed."""
MIN_DIFFERENCE_RATIO: Final = 0.05
"""Minimum ratio of the image motion between the poses of two different motions to the image motion of the main pose.
Errors of the prediction grow with the motion. If larger, objects that move nearly like the ground are missed."""
SEARCHED_UNEXPLAINED: Final = 0.03
"""Minimum fraction of unexplained landmarks from which a second exposure is searched for. The search takes 0.3 ms. The
fraction is at least 0.04 with ghosts of 30 to 69 %, and smaller in most pairs of clean drives."""
MIXTURE_LANDMARKS: Final = 64
"""Number of landmarks in which a second exposure is searched for. The standard error of the weight decreases with the
square root of this number, and the time increases with it."""
CLEAR_RATIO: Final = 1.4
"""Minimum ratio of the weights, or of the numbers of inliers, for one of two solutions to be clearly better. If larger,
more pairs are ambiguous and degraded with a larger covariance. If smaller, a wrong motion is accepted as clear."""
OLD_WEIGHT: Final = 3.0
"""Weight of a landmark whose host is older than the newest host; other landmarks have weight 1. An older landmark has
followed the ground over a whole keyframe interval. If larger, a body that was tracked for long outweighs the ground. If
smaller, a large object with new landmarks does."""
REPEATED_WEIGHT: Final = 1.5
"""Factor on the weight of a motion that repeats the last motion. If larger, a turn of the rover beside an object is
attributed to the object. If smaller, an object with 1.5 times the landmarks of the ground outweighs the ground."""
REPEATED_RATIO: Final = 0.5
"""A motion repeats the last motion if its distance from the repeated motion (`Prediction.repeated_motion`) is at most
this fraction of the other motion's distance. Distances are image motions. If the two motions are equally far from the
repeated motion, neither repeats the last motion."""
STANDSTILL_RATIO: Final = 0.15
"""Ratio of the image motion to that of the last motion, below which a motion is a standstill. If larger, a slow object
counts as a stale part of the image. If smaller, a stale part tracked with an error counts as an object."""


class Evidence(NamedTuple):
    """Evidence of a pair about its motions, and the memory of the earlier pairs."""

    main: Motion  #: The main motion.
    is_contradicted: bool  #: Whether many cells changed although the main motion predicts no change.
    is_unusual: bool  #: Whether more landmarks than usual do not follow the main motion.
    is_half_unexplained: bool  #: Whether nearly half of the landmarks do not follow the main motion.
    shown_by_main: Shown  #: What the pair shows if the main motion is the only motion.
    memory: GroundMemory  #: Memory of the earlier pairs, before this pair.
    # results of the searches: by default nothing was found or searched for; at most one search has a result
    off_body: Motion | None = None  #: Motion of the landmarks off the own body; None if no body was found.
    is_double_exposure: bool = False  #: Whether the left image of this or of the last pair shows two exposures.
    two: TwoMotions | None = None  #: The main motion and a second motion; None if no second motion was found.

    @property
    def is_trusted(self) -> bool:
        """Whether the pose of the main motion is trusted."""
        return self.main.tracks.is_trusted

    @property
    def is_credible(self) -> bool:
        """Whether the main motion is trusted, not contradicted, and usual or that of an identified ground."""
        is_likely = self.memory.is_identified or not self.is_unusual
        return self.is_trusted and not self.is_contradicted and is_likely

    @property
    def continues_transfer(self) -> bool:
        """Whether parts of the images are stale, as in the previous pair. No search is required for this decision."""
        follows_transfer = self.memory.transfers > 0 and self.memory.may_be_transfer
        return follows_transfer and self.is_unusual and not self.is_contradicted

    @property
    def is_transfer(self) -> bool:
        """Whether parts of the images are stale.

        With two motions, one of them must be a standstill, because stale parts show the previous pair. With one motion,
        nearly half of the landmarks must be unexplained, or more than usual if the previous pair was transferred, too.
        A partial transfer lasts a few pairs only (`memory.MAX_TRANSFERS`). After more pairs, the unexplained landmarks
        may be on an object instead.
        """
        if self.two is not None:
            return self.two.has_standstill and self.memory.may_be_transfer
        is_half_stale = self.is_half_unexplained and self.memory.may_be_transfer and not self.is_contradicted
        return self.continues_transfer or is_half_stale

    @property
    def is_decided(self) -> bool:
        """Whether the heavier of two motions is clearly that of an identified ground."""
        return self.two is not None and self.memory.is_identified and self.two.is_decided

    @property
    def stays_uncertain(self) -> bool:
        """Whether the ground is uncertain after the pair if the main motion is the only motion."""
        return self.memory.stays_uncertain(self.shown_by_main)


def evidence_of(pair: ComparedPair, tracks: Tracks, memory: GroundMemory) -> Evidence:
    """Return the evidence of a pair, with the memory before the pair. The tracks may follow any motion."""
    main = _main_motion(pair, tracks)
    evidence = evidence_of_main(main, memory)
    if not evidence.is_credible:
        off_body = _motion_off_body(pair, main, memory)
        if off_body is not None:
            return evidence._replace(off_body=off_body)
    if not evidence.is_trusted or evidence.continues_transfer:
        return evidence
    # one exposure dominates, and its motion explains more than half of the landmarks
    may_dominate = not evidence.is_contradicted and not evidence.is_half_unexplained
    if may_dominate and _is_double_exposure(pair, main, memory.last_image):
        return evidence._replace(is_double_exposure=True)
    if evidence.is_contradicted or evidence.is_unusual:
        other = _other_motion(pair, main, is_contradicted=evidence.is_contradicted)
        if other is not None:
            return evidence._replace(two=weighed(pair, main, other))
    return evidence


def evidence_of_main(main: Motion, memory: GroundMemory) -> Evidence:
    """Return the evidence of the main motion alone, with the memory before the pair."""
    agreement = main.agreement
    max_contradicting = MAX_CONTRADICTING if memory.is_identified else MAX_CONTRADICTING_FIRST
    return Evidence(
        main=main,
        is_contradicted=agreement.contradicting_fraction > max_contradicting,
        is_unusual=not memory.is_usual(agreement.unexplained_fraction),
        is_half_unexplained=agreement.unexplained_fraction >= NEARLY_HALF,
        shown_by_main=memory.shown_by_one_motion(agreement, main.tracks.inliers),
        memory=memory,
    )


# ---- searches for motions


def _main_motion(pair: ComparedPair, tracks: Tracks) -> Motion:
    """Return the motion of the main tracks.

    If many landmarks are unexplained, all landmarks are tracked again from the pose of this motion. The new tracks are
    used if clearly more landmarks agree.
    """
    main = pair.motion(tracks)
    if not tracks.is_trusted or main.agreement.unexplained_fraction <= MIN_EXCESS:
        return main
    again = pair.tracked_from(tracks.landmarks, tracks.pose)
    return again if again.tracks.inlier_count > CLEAR_RATIO * tracks.inlier_count else main


def _motion_off_body(pair: ComparedPair, main: Motion, memory: GroundMemory) -> Motion | None:
    """Return the motion of the landmarks outside stationary cells; None if the stationary cells do not show the rover.

    Stationary cells show the rover if the landmarks outside agree on another motion, which the image does not
    contradict. If the rover was at rest and the ground is not identified, stationary cells may also show the ground,
    beside an object that begins to move. The cells then count as the rover only if more landmarks follow the motion
    outside the cells than the main motion.
    """
    on_stationary = main.agreement.on_stationary
    if np.count_nonzero(on_stationary) < MIN_STATIONARY_LANDMARKS:
        return None
    found = pair.search(main.tracks.landmarks.subset(~on_stationary))
    if found is None:
        return None
    apart_px = _image_motion_between(pair, main, found)
    if main.tracks.is_trusted and apart_px < MIN_DIFFERENCE_PX:
        return None
    if found.agreement.contradicting_fraction > MAX_CONTRADICTING_FIRST:
        return None
    may_be_object = not memory.is_identified and _was_at_rest(pair, main, memory)
    if may_be_object and found.tracks.inlier_count <= main.tracks.inlier_count:
        return None
    return found


def _other_motion(pair: ComparedPair, main: Motion, *, is_contradicted: bool) -> Motion | None:
    """Search for another motion of the landmarks that the main motion does not explain; None if not found.

    If the main motion is contradicted, the other motion must not be contradicted. Otherwise, the other motion must
    explain most of these landmarks (`CONVINCING`), or its image motion must differ from that of the main motion.
    """
    found = pair.search(main.tracks.landmarks.subset(main.agreement.unexplained))
    if found is None:
        return None
    if is_contradicted:
        return None if found.agreement.contradicting_fraction > MAX_CONTRADICTING_FIRST else found
    if found.tracks.inlier_count > CONVINCING * len(found.tracks.inliers):
        return found
    least_px = max(MIN_DIFFERENCE_PX, MIN_DIFFERENCE_RATIO * main.agreement.motion_px)
    return found if _image_motion_between(pair, main, found) > least_px else None


def _is_double_exposure(pair: ComparedPair, main: Motion, last_image: FloatImage | None) -> bool:
    """Return whether the exposures of two pairs are blended in the left image of this pair or of the last pair.

    The dominant exposure is tracked. If the newer exposure dominates, this image also shows the scene from the last
    pose. If the older exposure dominates, poses lag behind by one pair, and the last image also shows the scene from
    the present pose. The last image is level `MIXTURE_LEVEL` of the left image at the last pose; None if unknown.
    """
    if main.agreement.unexplained_fraction < SEARCHED_UNEXPLAINED:
        return False
    tracks = main.tracks
    landmarks = tracks.landmarks.subset(tracks.inliers).thinned(MIXTURE_LANDMARKS)
    camera = pair.tools.camera
    to_now = plane_homographies(tracks.pose, landmarks.planes, camera, 0.0)
    to_last = plane_homographies(pair.prediction.standstill, landmarks.planes, camera, 0.0)
    image = pair.frame.left[MIXTURE_LEVEL].image
    min_tracked = pair.tools.min_tracked
    if shows_second_exposure(image, landmarks, to_now, to_last, min_tracked):
        return True
    return last_image is not None and shows_second_exposure(last_image, landmarks, to_last, to_now, min_tracked)


def _image_motion_between(pair: ComparedPair, main: Motion, other: Motion) -> float:
    """Return the image motion, px, of the landmarks of the other motion between the poses of the two motions."""
    return pair.image_motion_px(other.tracks, start=main.tracks.pose, end=other.tracks.pose)


def _was_at_rest(pair: ComparedPair, main: Motion, memory: GroundMemory) -> bool:
    """Return whether one motion explained earlier pairs of the window, and the last motion was a standstill."""
    prediction = pair.prediction
    last_px = pair.image_motion_px(main.tracks, start=prediction.standstill, end=prediction.repeated_motion)
    return memory.typical is not None and last_px < MOVED_PX


# ---- comparison of two motions


class TwoMotions(NamedTuple):
    """The main motion, and another motion of landmarks that the main motion does not explain."""

    main: Motion
    other: Motion
    weight_ratio: float  #: Weight of the main motion divided by that of the other motion.
    has_standstill: bool  #: Whether one motion is a standstill: part of the image may be that of the previous pair.

    @property
    def other_wins(self) -> bool:
        """Whether the other motion has more weight than the main motion."""
        return self.weight_ratio < 1.0

    @property
    def is_decided(self) -> bool:
        """Whether one motion is clearly that of the ground.

        The weights of both motions differ by a factor of `CLEAR_RATIO` or more, and the heavier motion explains enough
        landmarks to be the motion of the ground.
        """
        if 1.0 / CLEAR_RATIO < self.weight_ratio < CLEAR_RATIO:
            return False
        unexplained_fraction = self.main.agreement.unexplained_fraction
        explained_fraction = 1.0 - unexplained_fraction
        if self.other_wins:
            other = self.other.tracks
            explained_fraction = unexplained_fraction * (other.inlier_count / len(other.inliers))
        return explained_fraction >= 1.0 - NEARLY_HALF

    @property
    def follow_other(self) -> Mask:
        """Mask `(M,)` of the landmarks of the main tracks that follow the other motion."""
        other = self.other.tracks
        return np.isin(self.main.tracks.landmarks.rows, other.landmarks.rows[other.inliers])

    @property
    def distance(self) -> MotionSize:
        """Distance between the poses of the two motions."""
        return size_between(self.main.tracks.pose, self.other.tracks.pose)


def weighed(pair: ComparedPair, main: Motion, other: Motion) -> TwoMotions:
    """Return the main motion and another motion, with their weights compared."""
    of_main = _weight(pair, main.tracks, other.tracks)
    of_other = _weight(pair, other.tracks, main.tracks)
    return TwoMotions(main, other, of_main / of_other, _has_standstill(pair, main.tracks, other.tracks))


def _weight(pair: ComparedPair, tracks: Tracks, rival: Tracks) -> float:
    """Return the number of landmarks that follow a motion, weighted by the evidence that it is the ground's.

        weight = (new inliers + OLD_WEIGHT old inliers) (REPEATED_WEIGHT if the motion repeats the last motion, else 1)

    An inlier is new if the newest keyframe hosts it.
    """
    newest_host = max(tracks.landmarks.newest_host, rival.landmarks.newest_host)
    are_old = tracks.landmarks.host != newest_host
    old = float(np.count_nonzero(tracks.inliers & are_old))
    weight = tracks.inlier_count + (OLD_WEIGHT - 1.0) * old
    repeated = pair.prediction.repeated_motion
    to_own_px = pair.image_motion_px(tracks, start=repeated, end=tracks.pose)
    to_rival_px = pair.image_motion_px(tracks, start=repeated, end=rival.pose)
    return weight * REPEATED_WEIGHT if to_own_px < REPEATED_RATIO * to_rival_px else weight


def _has_standstill(pair: ComparedPair, main: Tracks, other: Tracks) -> bool:
    """Return whether one of two motions is a standstill."""
    last = pair.prediction.standstill
    main_px = pair.image_motion_px(main, start=last, end=main.pose)
    other_px = pair.image_motion_px(other, start=last, end=other.pose)
    last_px = pair.image_motion_px(main, start=last, end=pair.prediction.repeated_motion)
    return min(main_px, other_px) < max(MIN_DIFFERENCE_PX, STANDSTILL_RATIO * last_px)
