"""Two state machines of the ground: which motion is the ground's, and whether faults of earlier images have an effect.

Each machine is one immutable value with one function for all transitions by a pair.

`Identification.after` (a pair is consistent with the earlier pairs or not, see `Consistency`):

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

`ImageFaults.after`:

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

from sfr_loc_map.geometry.arrays import Mask
from sfr_loc_map.localisation.ground.thresholds import (
    CONSISTENT_PAIRS,
    LONG_RECOVERY_PAIRS,
    MAX_TRANSFERS,
    MIN_COVERED,
    MOSTLY_STALE,
)

# ---- which motion is the ground's


class Phase(Enum):
    """Phase of the identification of the ground by its motion."""

    LEARNING = auto()  #: No single motion has explained several pairs with motion yet.
    IDENTIFIED = auto()  #: One motion has explained several pairs with motion.
    UNCERTAIN = auto()  #: Two motions competed, the image contradicted the motion, or half of it was unexplained.


class Consistency(Enum):
    """Whether a pair is consistent with a single rigid motion of the ground, as seen in the earlier pairs."""

    UNKNOWN = auto()  #: The pair shows no motion, or faulty images.
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
