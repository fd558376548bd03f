"""Two state machines of the ground: which motion is the ground's, and whether faults of earlier images have an effect.

Each machine is one immutable value with one function for all transitions by a pair.

`Identification.after`:

| from | a pair | to |
|---|---|---|
| `LEARNING` | agrees, for the third time | `IDENTIFIED` |
| `LEARNING` | agrees only partly | `LEARNING`, counted from the start |
| `IDENTIFIED` | doubts | `IN_DOUBT` for 3 pairs |
| `LEARNING` | doubts | `IN_DOUBT` for 10 pairs |
| `IN_DOUBT` | doubts | `IN_DOUBT`, for 10 pairs if more than 3 were left, otherwise for 3 pairs |
| `IN_DOUBT` | agrees: the last of these pairs | `LEARNING` |

In addition, `Identification.restarted` leads from `LEARNING` and `IDENTIFIED` to `LEARNING`, counted from the start, if
the pair is lost or begins a window.

`ImageFaults.after`:

| a pair | transfers in a row | moving pairs to recovery |
|---|---|---|
| is partially transferred | + 1 | at least 3, or the number of transfers if smaller |
| shows a double exposure, an ambiguity or a doubt | 0 | at least 3 |
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

AGREEING_PAIRS = 3
"""Number of moving pairs that one motion must explain until it counts as the ground's, or until a faulty pair no longer
has an effect. Chosen by hand. If larger, clean pairs stay degraded for longer after a fault. If smaller, a second
faulty pair after a good pair is published as good."""
LONG_DOUBT_PAIRS = 10
"""The larger number that replaces `AGREEING_PAIRS` after two motions or a contradiction while the ground was not
identified, or after a mostly stale image, because these faults may last longer. Chosen by hand, like
`AGREEING_PAIRS`."""
MAX_TRANSFERS = 10
"""Maximum number of consecutive pairs that count as partially transferred. Chosen by hand: such faults are short, and
a longer sequence has another cause. If larger, an object that covers much of the image prevents keyframes for longer.
If smaller, a longer fault counts as two motions."""
MOSTLY_STALE = 0.5  #: Fraction of stale rows from which all rows of the next images may be stale.
MIN_COVERED = 0.5  #: Minimum fraction of the cells in doubt that inliers must cover: the majority.


# ---- which motion is the ground's


class Phase(Enum):
    """Phase of the identification of the ground by its motion."""

    LEARNING = auto()  #: No single motion has explained several moving pairs yet.
    IDENTIFIED = auto()  #: One motion has explained several moving pairs.
    IN_DOUBT = auto()  #: Two motions competed, the image contradicted the motion, or half of it was unexplained.


class Sign(Enum):
    """What a pair shows about the ground's motion."""

    NOTHING = auto()
    AGREES = auto()  #: One motion explains a moving pair, also where landmarks were unexplained earlier.
    AGREES_PARTLY = auto()  #: One motion is found, but a dynamic object is in view or earlier cells stay unexplained.
    DOUBTS = auto()  #: Two motions compete, the image contradicts the motion, or about half is unexplained.


@dataclass(frozen=True, slots=True, eq=False)
class Identification:
    """The phase, and what ends it."""

    phase: Phase = Phase.LEARNING
    pairs_left: int = AGREEING_PAIRS  #: Number of pairs that must agree until the phase ends; not used if identified.
    unexplained: Mask | None = None  #: `(R, C)` cells of unexplained landmarks; None if not in doubt.

    def after(self, sign: Sign, unexplained: Mask) -> Identification:
        """Return the identification after a pair. Its unexplained landmarks are in the cells `unexplained` `(R, C)`."""
        match sign, self.phase:
            case (Sign.DOUBTS, _):
                return self._in_doubt(unexplained)
            case (Sign.AGREES, Phase.LEARNING | Phase.IN_DOUBT) if self.pairs_left > 1:
                return replace(self, pairs_left=self.pairs_left - 1)
            case (Sign.AGREES, Phase.LEARNING):
                return Identification(Phase.IDENTIFIED)
            case (Sign.AGREES, Phase.IN_DOUBT):
                return Identification(Phase.LEARNING)
            case (Sign.AGREES_PARTLY, Phase.LEARNING):
                return Identification(Phase.LEARNING)
        return self

    def restarted(self) -> Identification:
        """Return the identification after a lost pair or in a new window: the ground must be learnt again.

        Doubt persists.
        """
        return self if self.phase is Phase.IN_DOUBT else Identification(Phase.LEARNING)

    def _in_doubt(self, cells: Mask) -> Identification:
        """Return the identification in doubt about landmarks in some cells, in addition to those of a present doubt.

        The doubt is short if the ground was identified, or if a present doubt had at most `AGREEING_PAIRS` pairs left.
        """
        is_in_doubt = self.phase is Phase.IN_DOUBT
        is_short = self.phase is Phase.IDENTIFIED or (is_in_doubt and self.pairs_left <= AGREEING_PAIRS)
        if is_in_doubt and self.unexplained is not None:
            cells = self.unexplained | cells
        return Identification(Phase.IN_DOUBT, AGREEING_PAIRS if is_short else LONG_DOUBT_PAIRS, cells)

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
    SUSPECTED = auto()  #: The next moving pairs are degraded, because their images may be faulty, too.
    TRANSFER = auto()  #: Parts of the images were exposed at different times.


class ImageFaults(NamedTuple):
    """Faults of earlier images that have an effect on the next pairs."""

    transfers: int = 0  #: Number of consecutive partially transferred pairs up to the last pair.
    #: Number of moving pairs that must follow until earlier faults have no effect. All of these pairs but the last
    #: are degraded (`Finding.RECOVERING`).
    recovery_pairs: int = 0

    @property
    def degrades_next(self) -> bool:
        """Whether a trusted pair without another finding is degraded next, if its image moves."""
        return self.recovery_pairs > 1

    def after(self, fault: Fault, *, is_moving: bool) -> ImageFaults:
        """Return the faults after a pair. Only moving pairs without a fault reduce the recovery."""
        match fault:
            case Fault.TRANSFER:
                transfers = self.transfers + 1
                return ImageFaults(transfers, max(self.recovery_pairs, min(transfers, AGREEING_PAIRS)))
            case Fault.SUSPECTED:
                return ImageFaults(0, max(self.recovery_pairs, AGREEING_PAIRS))
            case Fault.NONE:
                return ImageFaults(0, max(self.recovery_pairs - int(is_moving), 0))

    def after_stale_rows(self, stale: Mask) -> ImageFaults:
        """Return the faults after a pair with stale rows `(H,)`. Later pairs may have stale parts, too."""
        pairs = LONG_DOUBT_PAIRS if stale.mean() > MOSTLY_STALE else 1
        return ImageFaults(max(self.transfers, 1), max(self.recovery_pairs, pairs))

    @property
    def may_be_transfer(self) -> bool:
        """Whether the next pair may be partially transferred. Many such pairs in a row have another cause."""
        return self.transfers < MAX_TRANSFERS
