"""Two motions in one pair: which one has more weight as the motion of the ground, and which is a standstill."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import Mask
from sfr_loc_map.localisation.frontend.tracking import Tracks
from sfr_loc_map.localisation.ground.memory import NEARLY_HALF
from sfr_loc_map.localisation.ground.motion_tools import ComparedPair, Motion
from sfr_loc_map.localisation.ground.searches import CLEAR_RATIO, MIN_DIFFERENCE_PX
from sfr_loc_map.localisation.motion_size import MotionSize, size_between

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
"""A motion repeats the last motion if its distance from the repeated motion (`Guesses.repeated_motion`) is at most this
fraction of the other motion's distance. Distances are image motions. If the two motions are equally far from the
repeated motion, neither repeats the last motion."""


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
