"""Evidence of a pair about the ground's motion: the conditions of the table of cases (`cases.CASES`).

The terms are defined in the package docstring. Each condition is a property. Properties that search for a motion or
compare two motions are evaluated at their first use and cached, because a search takes some milliseconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sfr_loc_map.geometry.arrays import Mask
from sfr_loc_map.localisation.frontend.tracking import Tracks
from sfr_loc_map.localisation.ground.cell_motion import MOVED_PX, Explained
from sfr_loc_map.localisation.ground.double_exposure import MIXTURE_LEVEL
from sfr_loc_map.localisation.ground.identification import Phase
from sfr_loc_map.localisation.ground.memory import NEARLY_HALF, GroundMemory, MainMotion
from sfr_loc_map.localisation.ground.motion_tools import CONVINCING, ComparedPair, MotionTools

MAX_CONTRADICTING_FIRST = 0.05
"""Maximum fraction of cells that contradict a motion while the ground is not identified. Chosen by hand, above the 1 %
of cells that change by noise alone (`cell_change.NOISE_CORRELATION`). If larger, a fixed reflection is tracked for
longer. If smaller, good poses are refused because of moving shadows."""
MAX_CONTRADICTING = 0.4
"""Maximum fraction of cells that contradict the motion of an identified ground. Chosen by hand below one half, because
an object may fill much of the view of a rover at rest. If larger, a pose that most of the image contradicts is
accepted. If smaller, good poses are refused while a large object is in view."""
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
STANDSTILL_RATIO = 0.15
"""Ratio of the image motion to that of the last motion, below which a motion is a standstill. Chosen by hand. If
larger, a slow object counts as a stale part of the image. If smaller, a stale part tracked with an error counts as an
object."""
OLD_WEIGHT = 3.0
"""Weight of a landmark whose host is older than the newest host; other landmarks have weight 1. Chosen by hand: an
older landmark has followed the ground over a whole keyframe interval. If larger, a body that was tracked for long
outweighs the ground. If smaller, a large object with new landmarks does."""
REPEATED_WEIGHT = 1.5
"""Factor on the weight of a motion that repeats the last motion. Chosen by hand. If larger, a turn of the rover
beside an object is attributed to the object. If smaller, an object with 1.5 times the landmarks of the ground outweighs
it."""
REPEATED_RATIO = 0.5
"""A motion repeats the last motion if the image motion between it and the repeated motion (`Guesses.repeated_motion`)
is at most this fraction of the image motion between the repeated motion and the other motion. If both are equally far,
neither repeats the last motion."""
CLEAR_RATIO = 1.4
"""Minimum ratio of the weights, or of the numbers of inliers, for one of two solutions to be clearly better. Chosen by
hand. If larger, more pairs are ambiguous and degraded with a larger covariance. If smaller, a wrong motion is accepted
as clear."""
SEARCHED_UNEXPLAINED = 0.03
"""Minimum fraction of unexplained landmarks for the search for a second exposure, which takes 0.3 ms. The
fraction is at least 0.04 with ghosts of 30 to 69 %, and smaller in most pairs of clean drives."""
MIXTURE_LANDMARKS = 64
"""Number of landmarks in which a second exposure is searched for. Chosen by hand: the standard error of the weight
decreases with the square root of this number, and the time increases with it."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """Evidence of a pair about the ground's motion."""

    tools: MotionTools
    pair: ComparedPair
    main: Tracks  #: Tracks of the main motion.
    explained: Explained  #: What the main motion explains.
    memory: GroundMemory  #: Memory of earlier pairs.

    # ---- the main motion

    @property
    def is_identified(self) -> bool:
        """Whether earlier pairs have identified the ground's motion."""
        return self.memory.identification.phase is Phase.IDENTIFIED

    @property
    def has_typical(self) -> bool:
        """Whether the ground is not in doubt, and earlier pairs show how many landmarks are usually unexplained."""
        phase = self.memory.identification.phase
        return phase is Phase.IDENTIFIED or (phase is Phase.LEARNING and self.memory.typical is not None)

    @property
    def is_contradicted(self) -> bool:
        """Whether many cells changed although the main motion predicts no change."""
        most = MAX_CONTRADICTING if self.is_identified else MAX_CONTRADICTING_FIRST
        return self.explained.contradicting_fraction > most

    @property
    def is_unusual(self) -> bool:
        """Whether more landmarks than usual do not follow the main motion."""
        return not self.memory.is_usual(self.explained.unexplained_fraction)

    @property
    def is_half_unexplained(self) -> bool:
        """Whether nearly half of the landmarks do not follow the main motion."""
        return self.explained.unexplained_fraction >= NEARLY_HALF

    @property
    def is_credible(self) -> bool:
        """Whether the main motion is trusted, not contradicted, and usual or that of an identified ground."""
        return self.main.is_trusted and not self.is_contradicted and (self.is_identified or not self.is_unusual)

    @cached_property
    def main_motion(self) -> MainMotion:
        """What the memory learns from the main motion."""
        explained = self.explained
        return MainMotion(
            moves_image=explained.motion_px > MOVED_PX,
            unexplained_fraction=explained.unexplained_fraction,
            unexplained_cells=self.tools.cells(explained.cell_index[explained.unexplained]),
            inlier_cells=self.tools.cells(explained.cell_index[self.main.inliers]),
        )

    @property
    def stays_in_doubt(self) -> bool:
        """Whether the ground stays in doubt after the pair if the main motion is the only one."""
        sign = self.memory.sign_of_one_motion(self.main_motion)
        after = self.memory.identification.after(sign, self.main_motion.unexplained_cells)
        return after.phase is Phase.IN_DOUBT

    # ---- partial transfers

    @property
    def may_be_transfer(self) -> bool:
        """Whether the pair may be partially transferred."""
        return self.memory.faults.may_be_transfer

    @property
    def repeats_transfer(self) -> bool:
        """Whether the previous pair was partially transferred, and this pair may be, too."""
        return self.memory.faults.transfers > 0 and self.may_be_transfer

    @cached_property
    def is_double_exposure(self) -> bool:
        """Whether the exposures of two pairs are blended in the left image of this pair or of the previous pair.

        The dominant exposure is tracked. If the newer exposure dominates, this image also shows the scene from the last
        pose. If the older exposure dominates, poses lag behind by one pair, and the previous image also shows the scene
        from the present pose.
        """
        if self.explained.unexplained_fraction < SEARCHED_UNEXPLAINED:
            return False
        landmarks = self.main.landmarks.subset(self.main.inliers).thinned(MIXTURE_LANDMARKS)
        now = self.main.pose
        last = self.pair.prediction.guesses.standstill
        image = self.pair.frame.left[MIXTURE_LEVEL].image
        if self.tools.shows_other(image, landmarks, now, last):
            return True
        previous = self.memory.previous
        return previous is not None and self.tools.shows_other(previous, landmarks, last, now)

    # ---- other motions

    @cached_property
    def motion_off_stationary(self) -> Tracks | None:
        """Tracks of another motion, of the landmarks outside stationary cells; None if not found or if contradicted.

        With such a motion, the stationary cells are assumed to show the rover itself.
        """
        on_stationary = self.explained.on_stationary
        if np.count_nonzero(on_stationary) < MIN_STATIONARY_LANDMARKS:
            return None
        found = self.tools.search(self.pair, self.main.landmarks.subset(~on_stationary))
        if found is None:
            return None
        apart_px = self.tools.image_motion_px(found, start=self.main.pose, end=found.pose)
        if self.main.is_trusted and apart_px < MIN_DIFFERENCE_PX:
            return None
        fraction = self.tools.explained(self.pair, found).contradicting_fraction
        return found if fraction < MAX_CONTRADICTING_FIRST else None

    @property
    def was_at_rest(self) -> bool:
        """Whether one motion explained earlier pairs of the window, and the last motion was a standstill."""
        guesses = self.pair.prediction.guesses
        last_px = self.tools.image_motion_px(self.main, start=guesses.standstill, end=guesses.repeated_motion)
        return self.memory.typical is not None and last_px < MOVED_PX

    @property
    def shows_own_body(self) -> bool:
        """Whether stationary cells show the rover: the main motion is not credible, and another motion was found.

        If the rover was at rest and the ground is not identified, the stationary cells may also show the ground, beside
        an object that begins to move. They then count as the rover only if the minority of the landmarks follows them.
        """
        off_stationary = None if self.is_credible else self.motion_off_stationary
        if off_stationary is None:
            return False
        may_be_object = self.was_at_rest and not self.is_identified
        return not may_be_object or off_stationary.inlier_count > self.main.inlier_count

    @cached_property
    def other(self) -> Tracks | None:
        """Tracks of the other motion, searched for if the main motion is contradicted or unusual; None if not found.

        If the main motion is contradicted, the other motion must not be contradicted. Otherwise, it must explain most
        of the landmarks searched for (`CONVINCING`), or its image motion must differ from that of the main motion.
        """
        if not (self.is_contradicted or self.is_unusual):
            return None
        found = self.tools.search(self.pair, self.main.landmarks.subset(self.explained.unexplained))
        if found is None:
            return None
        if self.is_contradicted:
            fraction = self.tools.explained(self.pair, found).contradicting_fraction
            return None if fraction > MAX_CONTRADICTING_FIRST else found
        if found.inlier_count > CONVINCING * len(found.inliers):
            return found
        least_px = max(MIN_DIFFERENCE_PX, MIN_DIFFERENCE_RATIO * self.explained.motion_px)
        apart_px = self.tools.image_motion_px(found, start=self.main.pose, end=found.pose)
        return found if apart_px > least_px else None

    @property
    def has_other(self) -> bool:
        """Whether the other motion was found."""
        return self.other is not None

    # ---- the main motion against the other motion

    @cached_property
    def has_standstill(self) -> bool:
        """Whether one of the two motions is a standstill: part of the image may be that of the previous pair."""
        standstill = self.pair.prediction.guesses.standstill
        repeated = self.pair.prediction.guesses.repeated_motion
        motions = [tracks for tracks in (self.main, self.other) if tracks is not None]
        slower_px = min(self.tools.image_motion_px(tracks, start=standstill, end=tracks.pose) for tracks in motions)
        last_px = self.tools.image_motion_px(self.main, start=standstill, end=repeated)
        return slower_px < max(MIN_DIFFERENCE_PX, STANDSTILL_RATIO * last_px)

    @cached_property
    def weight_ratio(self) -> float:
        """Weight of the main motion divided by that of the other motion."""
        assert self.other is not None, "asked for only if there is another motion"
        return self._weight(self.main, self.other) / self._weight(self.other, self.main)

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
        explained_fraction = 1.0 - self.explained.unexplained_fraction
        if self.other_wins and self.other is not None:
            other_ratio = self.other.inlier_count / len(self.other.inliers)
            explained_fraction = self.explained.unexplained_fraction * other_ratio
        return explained_fraction >= 1.0 - NEARLY_HALF

    @property
    def follows_other(self) -> Mask:
        """Mask `(M,)` of the landmarks of the main tracks that follow the other motion."""
        follows = np.zeros(len(self.explained.unexplained), np.bool_)
        if self.other is not None:
            follows[np.flatnonzero(self.explained.unexplained)[self.other.inliers]] = True
        return follows

    def _weight(self, tracks: Tracks, other: Tracks) -> float:
        """Return the number of landmarks that follow a motion, weighted by the evidence that it is the ground's."""
        are_old = tracks.landmarks.host != self.main.landmarks.newest_host
        old = float(np.count_nonzero(tracks.inliers & are_old))
        weight = tracks.inlier_count + (OLD_WEIGHT - 1.0) * old
        repeated = self.pair.prediction.guesses.repeated_motion
        to_own_px = self.tools.image_motion_px(tracks, start=repeated, end=tracks.pose)
        to_other_px = self.tools.image_motion_px(tracks, start=repeated, end=other.pose)
        return weight * REPEATED_WEIGHT if to_own_px < REPEATED_RATIO * to_other_px else weight
