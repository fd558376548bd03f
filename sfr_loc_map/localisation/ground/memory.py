"""Memory of the ground's motion between two pairs, and the phases of its identification.

The ground is identified by its motion. A moving pair has a trusted pose and an image that moved. The first phase is
`LEARNING`:

| phase | meaning | next phase |
|---|---|---|
| `LEARNING` | no single motion has explained several moving pairs yet | `KNOWN` after several pairs that agree |
| `KNOWN` | one motion has explained several moving pairs | `LEARNING` with a new window |
| `IN_DOUBT` | the image contradicted the motion, or two motions competed | `LEARNING` after several pairs that agree |

A case with `leaves_doubt` (`cases.EFFECTS`) leads from each phase to `IN_DOUBT`. A moving pair agrees if few cells are
excluded as dynamic, and if landmarks also follow the motion in the cells that were unexplained earlier. An unusual
moving pair that does not agree prolongs the doubt. `GroundMemory.after` updates the memory with a pair. The terms are
defined in `selection`.

Three values record faults of earlier pairs. They are separate because they answer different questions and because all
combinations occur: a recovery follows a double exposure while the ground is known, and a doubt while it is learnt.

| value | question | set by | reset by |
|---|---|---|---|
| `confidence` | is the tracked motion the ground's? | a case with `leaves_doubt` | pairs that agree |
| `pairs_to_recovery` | may later images be faulty? | partial transfers; `starts_recovery`; stale rows | moving pairs |
| `transfers` | was the previous pair partially transferred? | partial transfers; stale rows | any other case |

A new window also resets `pairs_to_recovery` and `transfers`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum, auto
from typing import NamedTuple

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import FloatImage, Mask
from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.localisation.findings import Finding, Findings
from sfr_loc_map.localisation.frontend.stereo_frame import StereoFrame
from sfr_loc_map.localisation.ground.cell_change import LEVEL
from sfr_loc_map.localisation.ground.excluded_cells import ExcludedCells

# The values here, in `evidence`, in `motion_tools` and in `selection` were chosen by hand on rendered drives
# with injected faults, so that clean drives have no findings, and no error of a faulty drive exceeds five times the
# stated 3 sigma without a finding.

AGREEING_PAIRS = 3
"""Number of moving pairs that one motion must explain until it counts as the ground's, or until a doubtful pair has no
more effect. Chosen by hand. If larger, clean pairs stay degraded for longer after a fault. If smaller, a second faulty
pair after a good pair is published as good."""
LONG_DOUBT_PAIRS = 10
"""The larger number that replaces `AGREEING_PAIRS` after two motions or a contradiction while the ground was unknown,
or after a mostly stale image, because these faults may last longer. Chosen by hand, like `AGREEING_PAIRS`."""
MAX_TRANSFERS = 10
"""Maximum number of consecutive pairs that count as partially transferred. Chosen by hand: such faults are short, and
a longer sequence has another cause. If larger, an object that covers much of the image prevents keyframes for longer.
If smaller, a longer fault counts as two motions."""
MIN_EXCESS = 0.12
"""Minimum excess of the fraction of unexplained landmarks over the typical fraction for an unusual motion. Chosen by
hand. If larger, small objects and stale parts bias the pose without a report. If smaller, clean pairs with many
outliers are degraded."""
AFTER_TRANSFER = 0.5  #: Factor on `MIN_EXCESS` after a partial transfer: the next pair may be affected, too.
MOSTLY_STALE = 0.5  #: Fraction of stale rows from which all rows of the next images may be stale.
MAX_DYNAMIC = MIN_EXCESS
"""A pair with at least this fraction of cells excluded as dynamic does not confirm the ground's motion. It is equal to
`MIN_EXCESS`, because landmarks of these cells would be unexplained. If larger, doubt ends while a large object is
in view. If smaller, doubt lasts while a small object is in view."""
NEARLY_HALF = 0.47
"""Fraction of unexplained landmarks from which a motion is always unusual. Chosen by hand, slightly below the half from
which the majority does not follow the motion. If smaller, pairs with large objects are ambiguous more often."""
MIN_COVERED = 0.5  #: Minimum fraction of the cells in doubt that inliers must cover: the majority.
TYPICAL_FACTOR = 1.25
"""Factor on the typical fraction of unexplained landmarks, because the scatter of the fraction grows with its value.
Chosen by hand. If larger, fewer faults are reported on drives with many outliers. If smaller, clean pairs of such
drives are degraded."""
RISING_GAIN = 0.1
"""Update gain of the typical fraction if the fraction of a pair is larger. Chosen by hand. If the gain is larger, a
fault becomes typical before it is reported. If it is smaller, rougher ground is reported for longer."""
FALLING_GAIN = 0.5
"""Update gain of the typical fraction if the fraction of a pair is smaller. Chosen by hand, so that a fault at the
start has no effect after a few pairs. If the gain is larger, one clean pair makes the next pairs unusual. If the gain
is smaller, later faults are hidden for longer."""


class Phase(Enum):
    """Phase of the identification of the ground's motion."""

    LEARNING = auto()
    KNOWN = auto()
    IN_DOUBT = auto()


@dataclass(frozen=True, slots=True, eq=False)
class Confidence:
    """The phase, and what ends it."""

    phase: Phase = Phase.LEARNING
    pairs_left: int = AGREEING_PAIRS  #: Number of moving pairs that must agree until the phase ends; not used if known.
    unexplained: Mask | None = None  #: `(R, C)` cells of unexplained landmarks; None if not in doubt.

    def after_agreement(self) -> Confidence:
        """Return the confidence after a moving pair that one motion explained."""
        if self.phase is Phase.KNOWN:
            return self
        if self.pairs_left > 1:
            return replace(self, pairs_left=self.pairs_left - 1)
        return Confidence(Phase.KNOWN) if self.phase is Phase.LEARNING else Confidence()

    def after_interruption(self) -> Confidence:
        """Return the confidence after a pair that agreed only partly, or in a new window.

        Learning restarts, and doubt persists.
        """
        return self if self.phase is Phase.IN_DOUBT else Confidence()

    def after_doubt(self, cells: Mask) -> Confidence:
        """Return the confidence after two motions competed, the image contradicted the pose, or half was unexplained.

        Landmarks in the cells `(R, C)` did not follow the motion. The doubt lasts `AGREEING_PAIRS` pairs if the ground
        was known, or if a present doubt had at most this number of pairs left. Otherwise it lasts `LONG_DOUBT_PAIRS`
        pairs.
        """
        is_in_doubt = self.phase is Phase.IN_DOUBT
        is_short = self.phase is Phase.KNOWN or (is_in_doubt and self.pairs_left <= AGREEING_PAIRS)
        if is_in_doubt and self.unexplained is not None:
            cells = self.unexplained | cells
        return Confidence(Phase.IN_DOUBT, AGREEING_PAIRS if is_short else LONG_DOUBT_PAIRS, cells)

    def is_covered_by(self, inliers: Mask) -> bool:
        """Return whether inlier cells `(R, C)` are in or beside at least half of the unexplained cells."""
        if self.unexplained is None:
            return True
        beside = cv2.dilate(inliers.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        return bool((beside & self.unexplained).sum() >= MIN_COVERED * self.unexplained.sum())


class MainMotion(NamedTuple):
    """What the memory learns from the main motion of a pair."""

    moves_image: bool  #: Whether this motion moves the image.
    unexplained_fraction: float  #: Fraction of the landmarks that do not follow this motion.
    unexplained_cells: Mask  #: `(R, C)` cells of these landmarks.
    inlier_cells: Mask  #: `(R, C)` cells of the landmarks that follow this motion.


class Effect(NamedTuple):
    """The finding of a case, and its effect on the memory of the ground."""

    finding: Finding | None = None
    leaves_doubt: bool = False  #: Whether the ground's motion is in doubt after the pair.
    #: Whether the ground's motion must be observed again in several moving pairs, which are degraded.
    starts_recovery: bool = False
    #: Whether the pair can confirm the ground's motion, and updates the typical fraction.
    confirms: bool = False
    outlasts_refusal: bool = False  #: Whether the memory learns from the pair although its pose is refused.

    @property
    def findings(self) -> Findings:
        """The finding as a set; empty without one."""
        return frozenset() if self.finding is None else frozenset({self.finding})

    @property
    def is_transfer(self) -> bool:
        """Whether parts of the images were exposed at different times."""
        return self.finding is Finding.PARTIAL_TRANSFER


class EarlierImage(NamedTuple):
    """Earlier image that the present image is compared with, cell by cell."""

    image: FloatImage  #: Pyramid level `LEVEL` of a left image.
    pose: Pose  #: Pose of the left camera at that image.
    #: Number of pairs that were compared with the image. A refused pair from which the memory does not learn is not
    #: counted. The image motion from which outliers are ignored is proportional to the age (`selection.FAR_RATIO`).
    age: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class GroundMemory:
    """Memory of accepted pairs, of pairs that contradict their pose, and of stale rows."""

    excluded: ExcludedCells  #: Cells that do not move with the ground.
    earlier: EarlierImage | None = None  #: Image at an accepted pose; None before the first window.
    #: Pyramid level `MIXTURE_LEVEL` of the left image at the last known pose; None if that image was not compared with
    #: earlier images.
    previous: FloatImage | None = None
    confidence: Confidence = Confidence()
    transfers: int = 0  #: Number of consecutive partially transferred pairs.
    #: Number of moving pairs that must follow until faults of earlier pairs have no more effect. All of these pairs but
    #: the last are degraded (`Finding.RECOVERING`).
    pairs_to_recovery: int = 0
    #: Typical fraction of unexplained landmarks; None until a pair of the window confirms.
    typical: float | None = None

    @classmethod
    def none(cls, shape: tuple[int, int]) -> GroundMemory:
        """Return the memory before the first pair of images of a shape (height, width)."""
        return cls(ExcludedCells.none(shape))

    @property
    def is_clear(self) -> bool:
        """Whether faults of earlier pairs have no more effect: no recovery, no partial transfer, no doubt."""
        return self.pairs_to_recovery == 0 and self.transfers == 0 and self.confidence.phase is not Phase.IN_DOUBT

    def after(
        self,
        effect: Effect,
        main: MainMotion,
        *,
        excluded: ExcludedCells,
        earlier: EarlierImage,
        image: FloatImage,
        is_moving: bool,
    ) -> GroundMemory:
        """Return the memory after a pair.

        Args:
            effect: Effect of the pair's case.
            main: What the main motion explains.
            excluded: Cells excluded from this pair on, also in a keyframe that the pair becomes.
            earlier: Image that the pair was compared with.
            image: Pyramid level `MIXTURE_LEVEL` of the pair's left image.
            is_moving: Whether the pose of the selected tracks is trusted and the image moved.
        """
        transfers = self.transfers + 1 if effect.is_transfer else 0
        return GroundMemory(
            excluded=excluded,
            earlier=earlier,
            previous=image,
            confidence=self.confidence_after(effect, main),
            transfers=transfers,
            pairs_to_recovery=self.recovering_after(effect, transfers, is_moving=is_moving),
            typical=self.typical_after(main.unexplained_fraction) if effect.confirms else self.typical,
        )

    def confidence_after(self, effect: Effect, main: MainMotion) -> Confidence:
        """Return the confidence in the ground's motion after a pair."""
        if effect.leaves_doubt:
            return self.confidence.after_doubt(main.unexplained_cells)
        return self.confidence_after_one_motion(main) if effect.confirms else self.confidence

    def confidence_after_one_motion(self, main: MainMotion) -> Confidence:
        """Return the confidence after a pair in which the main motion is the only one.

        The pair agrees if few cells are excluded as dynamic, and if inliers cover the cells that were unexplained
        earlier. A stationary image changes nothing.
        """
        confidence = self.confidence
        if confidence.phase is Phase.KNOWN or not main.moves_image:
            return confidence
        if self.excluded.dynamic_fraction < MAX_DYNAMIC and confidence.is_covered_by(main.inlier_cells):
            return confidence.after_agreement()
        if confidence.phase is Phase.IN_DOUBT and not self.is_usual(main.unexplained_fraction):
            return confidence.after_doubt(main.unexplained_cells)
        return confidence.after_interruption()

    def is_usual(self, unexplained: float) -> bool:
        """Return whether a fraction of unexplained landmarks is usual for the ground."""
        margin = AFTER_TRANSFER * MIN_EXCESS if self.transfers else MIN_EXCESS
        return unexplained < min(margin + TYPICAL_FACTOR * (self.typical or 0.0), NEARLY_HALF)

    def typical_after(self, unexplained: float) -> float | None:
        """Return the typical fraction of unexplained landmarks after a pair with one motion.

        The fraction does not change after an unusual pair if the ground is known, or while the ground is in doubt.
        """
        phase = self.confidence.phase
        if phase is Phase.IN_DOUBT or (phase is Phase.KNOWN and not self.is_usual(unexplained)):
            return self.typical
        typical = unexplained if self.typical is None else self.typical
        gain = RISING_GAIN if unexplained > typical else FALLING_GAIN
        return typical + gain * (unexplained - typical)

    def recovering_after(self, effect: Effect, transfers: int, *, is_moving: bool) -> int:
        """Return the value of `pairs_to_recovery` after a pair.

        After a partial transfer, the value is at least the smaller of `transfers` and `AGREEING_PAIRS`.
        """
        if effect.is_transfer:
            return max(self.pairs_to_recovery, min(transfers, AGREEING_PAIRS))
        if effect.starts_recovery:
            return max(self.pairs_to_recovery, AGREEING_PAIRS)
        return self.still_recovering(is_moving=is_moving)

    def still_recovering(self, *, is_moving: bool) -> int:
        """Return the value of `pairs_to_recovery` after a pair without a fault; only moving pairs reduce it."""
        return max(self.pairs_to_recovery - 1, 0) if is_moving else self.pairs_to_recovery

    def in_new_window(self, frame: StereoFrame, pose: Pose) -> GroundMemory:
        """Return the memory in a new window. The ground must be learnt again, and doubt persists."""
        return replace(
            self,
            earlier=EarlierImage(frame.left[LEVEL].image, pose),
            previous=None,
            confidence=self.confidence.after_interruption(),
            transfers=0,
            pairs_to_recovery=0,
            typical=None,
        )

    def after_stale_rows(self, stale: Mask) -> GroundMemory:
        """Return the memory after a pair with stale rows `(H,)`. Later pairs may have stale parts, too."""
        if not stale.any():
            return self
        pairs = LONG_DOUBT_PAIRS if stale.mean() > MOSTLY_STALE else 1
        return replace(self, transfers=max(self.transfers, 1), pairs_to_recovery=max(self.pairs_to_recovery, pairs))
