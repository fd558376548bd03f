"""Memory of the ground between two pairs (`GroundMemory`), with two state machines.

The memory is one immutable value. Its methods, and `selection` for a pair in which a motion was selected, are its only
changes.

`Identification.after`: which motion is the ground's. A pair is consistent with the earlier pairs or not
(`Consistency`).

| from | a pair is | to |
|---|---|---|
| `LEARNING` | consistent, for the third time | `IDENTIFIED` |
| `LEARNING` | partly consistent | `LEARNING`, counted from the start |
| `IDENTIFIED` | inconsistent | `UNCERTAIN` for 3 pairs |
| `LEARNING` | inconsistent | `UNCERTAIN` for 10 pairs |
| `UNCERTAIN`, more than 3 pairs left | inconsistent | `UNCERTAIN` for 10 pairs |
| `UNCERTAIN`, at most 3 pairs left | inconsistent | `UNCERTAIN` for 3 pairs |
| `UNCERTAIN` | consistent, and the last of these pairs | `LEARNING` |

In addition, `Identification.relearning` leads from `LEARNING` and `IDENTIFIED` to `LEARNING`, counted from the start,
if the pair is lost or a window begins.

`ImageFaults.after`: whether faults of earlier images have an effect.

| a pair | transfers in a row | pairs with motion to recovery |
|---|---|---|
| is partially transferred | + 1 | at least 3, or the number of transfers if smaller |
| shows a double exposure, an ambiguity or an uncertainty | 0 | at least 3 |
| has no fault, and the image moved | 0 | - 1 |

In addition, `ImageFaults.after_stale_rows` sets at least 1 transfer, and a recovery of at least 1 pair, or of 10 pairs
if most rows are stale. A new window begins without faults.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum, auto
from typing import NamedTuple

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import FloatImage, Mask, read_only
from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.frontend.stereo_frame import StereoFrame
from sfr_loc_map.localisation.ground.cell_change import LEVEL
from sfr_loc_map.localisation.ground.cell_motion import Agreement
from sfr_loc_map.localisation.ground.excluded_cells import ExcludedCells
from sfr_loc_map.localisation.ground.thresholds import (
    AFTER_TRANSFER,
    CONSISTENT_PAIRS,
    FALLING_GAIN,
    LONG_RECOVERY_PAIRS,
    MAX_DYNAMIC,
    MAX_TRANSFERS,
    MIN_COVERED,
    MIN_EXCESS,
    MOSTLY_STALE,
    NEARLY_HALF,
    RISING_GAIN,
    TYPICAL_FACTOR,
)

# ---- which motion is the ground's


class Phase(Enum):
    """Phase of the identification of the ground by its motion."""

    LEARNING = auto()  #: No single motion has explained several pairs with motion yet.
    IDENTIFIED = auto()  #: One motion has explained several pairs with motion.
    UNCERTAIN = auto()  #: Two motions competed, the image contradicted the motion, or half of it was unexplained.


class Consistency(Enum):
    """Whether a pair is consistent with a single rigid motion of the ground, as seen in the earlier pairs."""

    UNKNOWN = auto()  #: The pair shows no motion.
    CONSISTENT = auto()  #: One motion explains a pair with motion, also where landmarks were unexplained earlier.
    PARTIAL = auto()  #: One motion is found, but a dynamic object is in view, or earlier cells stay unexplained.
    INCONSISTENT = auto()  #: Two motions compete, the image contradicts the motion, or about half is unexplained.


@dataclass(frozen=True, slots=True, eq=False)
class Identification:
    """The phase, and what ends it."""

    phase: Phase = Phase.LEARNING
    #: Number of consistent pairs until the phase ends; not used if identified.
    pairs_left: int = CONSISTENT_PAIRS
    unexplained: Mask | None = None  #: `(R, C)` cells of unexplained landmarks; None if not uncertain.

    def after(self, consistency: Consistency, unexplained: Mask) -> Identification:
        """Return the identification after a pair. Its unexplained landmarks are in the cells `unexplained` `(R, C)`."""
        match consistency, self.phase:
            case (Consistency.INCONSISTENT, _):
                return self._uncertain(unexplained)
            case (Consistency.CONSISTENT, Phase.LEARNING | Phase.UNCERTAIN) if self.pairs_left > 1:
                return replace(self, pairs_left=self.pairs_left - 1)
            case (Consistency.CONSISTENT, Phase.LEARNING):
                return Identification(Phase.IDENTIFIED)
            case (Consistency.CONSISTENT, Phase.UNCERTAIN):
                return Identification(Phase.LEARNING)
            case (Consistency.PARTIAL, Phase.LEARNING):
                return Identification(Phase.LEARNING)
        return self

    def relearning(self) -> Identification:
        """Return the identification after a lost pair or in a new window: the ground must be learnt again.

        An uncertainty persists.
        """
        return self if self.phase is Phase.UNCERTAIN else Identification(Phase.LEARNING)

    def _uncertain(self, cells: Mask) -> Identification:
        """Return the identification that is uncertain about landmarks in some cells.

        The cells of a present uncertainty are added. The uncertainty is short if the ground was identified, or if a
        present uncertainty had at most `CONSISTENT_PAIRS` pairs left.
        """
        is_uncertain = self.phase is Phase.UNCERTAIN
        is_short = self.phase is Phase.IDENTIFIED or (is_uncertain and self.pairs_left <= CONSISTENT_PAIRS)
        if is_uncertain and self.unexplained is not None:
            cells = self.unexplained | cells
        return Identification(Phase.UNCERTAIN, CONSISTENT_PAIRS if is_short else LONG_RECOVERY_PAIRS, cells)

    def is_covered_by(self, inliers: Mask) -> bool:
        """Return whether inlier cells `(R, C)` are in or beside at least half of the unexplained cells."""
        if self.unexplained is None:
            return True
        beside = cv2.dilate(inliers.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        return bool((beside & self.unexplained).sum() >= MIN_COVERED * self.unexplained.sum())


# ---- faults of earlier images


class Fault(Enum):
    """What a pair shows about faults of the images."""

    NONE = auto()
    SUSPECTED = auto()  #: The next pairs with motion are degraded, because their images may be faulty, too.
    TRANSFER = auto()  #: Parts of the images were exposed at different times.


class ImageFaults(NamedTuple):
    """Faults of earlier images that have an effect on the next pairs."""

    transfers: int = 0  #: Number of consecutive partially transferred pairs up to the last pair.
    #: Number of pairs with motion that must follow until earlier faults have no effect. All of these pairs but the
    #: last are degraded (`Finding.RECOVERING`).
    recovery_pairs: int = 0

    @property
    def degrades_next(self) -> bool:
        """Whether a trusted pair without another finding is degraded next, if its image moves."""
        return self.recovery_pairs > 1

    def after(self, fault: Fault, *, is_moving: bool) -> ImageFaults:
        """Return the faults after a pair. Only pairs with motion and without a fault reduce the recovery."""
        match fault:
            case Fault.TRANSFER:
                transfers = self.transfers + 1
                return ImageFaults(transfers, max(self.recovery_pairs, min(transfers, CONSISTENT_PAIRS)))
            case Fault.SUSPECTED:
                return ImageFaults(0, max(self.recovery_pairs, CONSISTENT_PAIRS))
            case Fault.NONE:
                return ImageFaults(0, max(self.recovery_pairs - int(is_moving), 0))

    def after_stale_rows(self, stale: Mask) -> ImageFaults:
        """Return the faults after a pair with stale rows `(H,)`. Later pairs may have stale parts, too."""
        pairs = LONG_RECOVERY_PAIRS if stale.mean() > MOSTLY_STALE else 1
        return ImageFaults(max(self.transfers, 1), max(self.recovery_pairs, pairs))

    @property
    def may_be_transfer(self) -> bool:
        """Whether the next pair may be partially transferred. Many such pairs in a row have another cause."""
        return self.transfers < MAX_TRANSFERS


# ---- the memory


class EarlierImage(NamedTuple):
    """Earlier image that the next image is compared with, cell by cell."""

    image: FloatImage  #: Pyramid level `LEVEL` of a left image.
    pose: Pose  #: Pose of the left camera at that image.
    #: Number of pairs from the image to the next pair. A refused pair counts only if the memory learns from it. The
    #: greater the age, the farther an outlier may move before it is ignored (`thresholds.FAR_RATIO`).
    age: int = 1

    def older(self) -> EarlierImage:
        """Return the same image with its age increased by one pair."""
        return self._replace(age=self.age + 1)


NO_IMAGE = EarlierImage(read_only(np.zeros((0, 0), np.float32)), Pose.of(Transform.identity()))
"""Earlier image before the first window. No pair is compared with it."""


@dataclass(frozen=True, slots=True, eq=False)
class GroundMemory:
    """Memory of accepted pairs, of pairs that contradict their pose, and of stale rows.

    The table shows how each event changes each component. Other components stay as they are.

    | component | `learnt_from` | `unselected` | `window_begun` | `adjusted` | `lost` | `rows_stale` | `window_failed` |
    |---|---|---|---|---|---|---|---|
    | `excluded` | = cells after the pair | | | | | | one pair older |
    | `earlier` | = pair, or older | one pair older | = first image | pose | | | |
    | `last_image` | = image of the pair | = None | = None | | | | |
    | `identification` | by the case | | learnt again | | learnt again | | |
    | `faults` | by the case | | = none | | | by the rows | |
    | `typical` | by the case | | = None | | | | |

    | event | is |
    |---|---|
    | `selection.learnt_from` | a pair in which the ground's motion was selected, by its case |
    | `unselected` | a pair with a frozen left image or with stale rows, in which no motion was selected |
    | `window_begun` | a pair begins a window |
    | `adjusted` | the adjustment of a keyframe in the background has ended |
    | `lost` | a pair is lost |
    | `rows_stale` | stale rows are detected in a pair, before its other changes |
    | `window_failed` | a textured pair has too few landmarks for a window |

    What is learnt by `learnt_from` and `unselected` depends on the verdict on the pair, too (`Ground.memory_after`).
    """

    excluded: ExcludedCells  #: Cells that do not move with the ground.
    earlier: EarlierImage = NO_IMAGE  #: Image at an accepted pose, for the detection of changed cells.
    #: Left image at the last accepted pose, pyramid level `MIXTURE_LEVEL`, for the detection of double exposures; None
    #: if the ground's motion was not selected in that pair.
    last_image: FloatImage | None = None
    identification: Identification = Identification()  #: Which motion is the ground's.
    faults: ImageFaults = ImageFaults()  #: Faults of earlier images.
    #: Typical fraction of unexplained landmarks; None until one motion has explained a pair of the window.
    typical: float | None = None

    @classmethod
    def none(cls, shape: tuple[int, int]) -> GroundMemory:
        """Return the memory before the first pair of images of a shape (height, width)."""
        return cls(ExcludedCells.none(shape))

    # ---- what the memory shows

    @property
    def is_identified(self) -> bool:
        """Whether earlier pairs have identified the ground's motion."""
        return self.identification.phase is Phase.IDENTIFIED

    @property
    def is_clear(self) -> bool:
        """Whether earlier pairs no longer have an effect: the images have no fault, and the ground is not uncertain."""
        return self.faults == ImageFaults() and self.identification.phase is not Phase.UNCERTAIN

    def is_usual(self, unexplained: float) -> bool:
        """Return whether a fraction of unexplained landmarks is usual for the ground.

            unexplained < min(MIN_EXCESS + TYPICAL_FACTOR typical, NEARLY_HALF)

        After a partial transfer, `MIN_EXCESS` is multiplied by `AFTER_TRANSFER`.
        """
        margin = AFTER_TRANSFER * MIN_EXCESS if self.faults.transfers else MIN_EXCESS
        return unexplained < min(margin + TYPICAL_FACTOR * (self.typical or 0.0), NEARLY_HALF)

    def consistency_of(self, main: Agreement, inliers: Mask) -> Consistency:
        """Return whether a pair is consistent with the earlier pairs, if the main motion is the only motion.

        A pair with motion is consistent if few cells are excluded as dynamic, and if inliers cover the cells that were
        unexplained earlier. An unusual pair that is not consistent prolongs an uncertainty.
        """
        if not main.moves_image:
            return Consistency.UNKNOWN
        is_covered = self.identification.is_covered_by(main.cells(inliers))
        if self.excluded.dynamic_fraction < MAX_DYNAMIC and is_covered:
            return Consistency.CONSISTENT
        is_uncertain = self.identification.phase is Phase.UNCERTAIN
        if is_uncertain and not self.is_usual(main.unexplained_fraction):
            return Consistency.INCONSISTENT
        return Consistency.PARTIAL

    def typical_after(self, unexplained: float) -> float | None:
        """Return the typical fraction of unexplained landmarks, updated by a pair that one motion explains.

        The fraction changes only while the ground is not uncertain. Once there is a typical fraction, an unusual pair
        is not learnt (`Case.UNUSUAL`).
        """
        if self.identification.phase is Phase.UNCERTAIN:
            return self.typical
        typical = unexplained if self.typical is None else self.typical
        gain = RISING_GAIN if unexplained > typical else FALLING_GAIN
        return typical + gain * (unexplained - typical)

    # ---- events

    def unselected(self) -> GroundMemory:
        """Return the memory after a pair in which no motion was selected.

        An uncertainty persists, and the recovery from earlier faults makes no progress. Excluded cells do not age,
        because stationary cells, which renew the lifetime of cells fixed to the camera, are not detected in such a
        pair.
        """
        return replace(self, earlier=self.earlier.older(), last_image=None)

    def window_begun(self, frame: StereoFrame, pose: Pose) -> GroundMemory:
        """Return the memory in a new window. The ground must be learnt again, and an uncertainty persists."""
        return replace(
            self,
            earlier=EarlierImage(frame.left[LEVEL].image, pose),
            last_image=None,
            identification=self.identification.relearning(),
            faults=ImageFaults(),
            typical=None,
        )

    def adjusted(self, T_after_before: Transform) -> GroundMemory:
        """Return the memory after an adjustment moved the last pose in the world.

        The earlier image moves with it, so that the image motion between the two remains.
        """
        pose = Pose.of(T_after_before @ Transform(*self.earlier.pose))
        return replace(self, earlier=self.earlier._replace(pose=pose))

    def lost(self) -> GroundMemory:
        """Return the memory after a lost pair. The tracks of the next pairs may follow another motion."""
        return replace(self, identification=self.identification.relearning())

    def window_failed(self, shape: tuple[int, int]) -> GroundMemory:
        """Return the memory after a textured pair with too few landmarks for a new window.

        The excluded cells may be the cause, so that they age. The shape of the images is (height, width).
        """
        return replace(self, excluded=self.excluded.older(shape))

    def rows_stale(self, stale: Mask) -> GroundMemory:
        """Return the memory after a pair was compared with the previous pair. Its stale rows are `(H,)`."""
        if not stale.any():
            return self
        return replace(self, faults=self.faults.after_stale_rows(stale))
