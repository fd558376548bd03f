"""Searches in a pair: for its main motion, the ground outside the own body, another motion, and a second exposure.

A search takes up to some milliseconds. `cases.case_of` therefore starts a search only if the case of the pair depends
on its result.
"""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.arrays import FloatImage
from sfr_loc_map.localisation.frontend.tracking import Tracks
from sfr_loc_map.localisation.ground.cell_motion import MOVED_PX
from sfr_loc_map.localisation.ground.double_exposure import MIXTURE_LEVEL
from sfr_loc_map.localisation.ground.evidence import MAX_CONTRADICTING_FIRST
from sfr_loc_map.localisation.ground.memory import MIN_EXCESS, GroundMemory
from sfr_loc_map.localisation.ground.motion_tools import CONVINCING, ComparedPair, Motion

CLEAR_RATIO = 1.4
"""Minimum ratio of the weights, or of the numbers of inliers, for one of two solutions to be clearly better. Chosen by
hand. If larger, more pairs are ambiguous and degraded with a larger covariance. If smaller, a wrong motion is accepted
as clear."""
MIN_STATIONARY_LANDMARKS = 12
"""Minimum number of landmarks in stationary cells for these cells to show the rover. Chosen by hand: twice the
minimum of a pose (`pose_solver.MIN_LANDMARKS`). If smaller, more pairs cost the time of a search. If larger, a small
body is detected only by its cells."""
MIN_DIFFERENCE_PX = 1.0
"""Minimum image motion, px, between the poses of two different motions. Chosen by hand: ten times the usual residual of
an inlier (0.1 px), because two estimates of one motion differ slightly. If larger, slow objects are missed."""
MIN_DIFFERENCE_RATIO = 0.05
"""Minimum ratio of the image motion between the poses of two different motions to the image motion of the main pose.
Chosen by hand, because errors of the prediction grow with the motion. If larger, objects that move nearly like the
ground are missed."""
SEARCHED_UNEXPLAINED = 0.03
"""Minimum fraction of unexplained landmarks for the search for a second exposure, which takes 0.3 ms. The
fraction is at least 0.04 with ghosts of 30 to 69 %, and smaller in most pairs of clean drives."""
MIXTURE_LANDMARKS = 64
"""Number of landmarks in which a second exposure is searched for. Chosen by hand: the standard error of the weight
decreases with the square root of this number, and the time increases with it."""


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
