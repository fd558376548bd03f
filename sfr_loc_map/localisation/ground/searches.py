"""Searches in a pair: for its main motion, the motion off the own body, another motion, and a second exposure.

A search takes up to some milliseconds. `evidence.evidence_of` therefore starts a search only if the case of the pair
depends on its result.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatImage, Mask
from sfr_loc_map.localisation.frontend.tracking import Tracks
from sfr_loc_map.localisation.ground.cell_motion import MOVED_PX
from sfr_loc_map.localisation.ground.double_exposure import MIXTURE_LEVEL
from sfr_loc_map.localisation.ground.memory import GroundMemory
from sfr_loc_map.localisation.ground.motion_tools import ComparedPair, Motion
from sfr_loc_map.localisation.ground.thresholds import (
    CLEAR_RATIO,
    CONVINCING,
    MAX_CONTRADICTING_FIRST,
    MIN_DIFFERENCE_PX,
    MIN_DIFFERENCE_RATIO,
    MIN_EXCESS,
    MIN_STATIONARY_LANDMARKS,
    MIXTURE_LANDMARKS,
    NEARLY_HALF,
    OLD_WEIGHT,
    REPEATED_RATIO,
    REPEATED_WEIGHT,
    SEARCHED_UNEXPLAINED,
    STANDSTILL_RATIO,
)
from sfr_loc_map.localisation.motion_size import MotionSize, size_between


def main_motion(pair: ComparedPair, tracks: Tracks) -> Motion:
    """Return the motion of the main tracks.

    If many landmarks are unexplained, all landmarks are tracked again from the pose of this motion. The new tracks are
    used if clearly more landmarks agree.
    """
    main = pair.motion(tracks)
    if not tracks.is_trusted or main.agreement.unexplained_fraction <= MIN_EXCESS:
        return main
    again = pair.tracked_from(tracks.landmarks, tracks.pose)
    return again if again.tracks.inlier_count > CLEAR_RATIO * tracks.inlier_count else main


def motion_off_body(pair: ComparedPair, main: Motion, memory: GroundMemory) -> Motion | None:
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


def other_motion(pair: ComparedPair, main: Motion, *, is_contradicted: bool) -> Motion | None:
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


def is_double_exposure(pair: ComparedPair, main: Motion, last_image: FloatImage | None) -> bool:
    """Return whether the exposures of two pairs are blended in the left image of this pair or of the last pair.

    The dominant exposure is tracked. If the newer exposure dominates, this image also shows the scene from the last
    pose. If the older exposure dominates, poses lag behind by one pair, and the last image also shows the scene from
    the present pose.

    Args:
        pair: The pair.
        main: The main motion.
        last_image: Level `MIXTURE_LEVEL` of the left image at the last pose; None if unknown.
    """
    if main.agreement.unexplained_fraction < SEARCHED_UNEXPLAINED:
        return False
    tracks = main.tracks
    landmarks = tracks.landmarks.subset(tracks.inliers).thinned(MIXTURE_LANDMARKS)
    now = tracks.pose
    last = pair.guesses.standstill
    image = pair.frame.left[MIXTURE_LEVEL].image
    if pair.shows_other(image, landmarks, now, last):
        return True
    return last_image is not None and pair.shows_other(last_image, landmarks, last, now)


def _image_motion_between(pair: ComparedPair, main: Motion, other: Motion) -> float:
    """Return the image motion, px, of the landmarks of the other motion between the poses of the two motions."""
    return pair.image_motion_px(other.tracks, start=main.tracks.pose, end=other.tracks.pose)


def _was_at_rest(pair: ComparedPair, main: Motion, memory: GroundMemory) -> bool:
    """Return whether one motion explained earlier pairs of the window, and the last motion was a standstill."""
    guesses = pair.guesses
    last_px = pair.image_motion_px(main.tracks, start=guesses.standstill, end=guesses.repeated_motion)
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
    repeated = pair.guesses.repeated_motion
    to_own_px = pair.image_motion_px(tracks, start=repeated, end=tracks.pose)
    to_rival_px = pair.image_motion_px(tracks, start=repeated, end=rival.pose)
    return weight * REPEATED_WEIGHT if to_own_px < REPEATED_RATIO * to_rival_px else weight


def _has_standstill(pair: ComparedPair, main: Tracks, other: Tracks) -> bool:
    """Return whether one of two motions is a standstill."""
    last = pair.guesses.standstill
    main_px = pair.image_motion_px(main, start=last, end=main.pose)
    other_px = pair.image_motion_px(other, start=last, end=other.pose)
    last_px = pair.image_motion_px(main, start=last, end=pair.guesses.repeated_motion)
    return min(main_px, other_px) < max(MIN_DIFFERENCE_PX, STANDSTILL_RATIO * last_px)
