"""Evidence of a pair about its main motion. No search for another motion is required to collect this evidence.

`cases` classifies a pair by its `Evidence`. The package docstring defines the terms.
"""

from __future__ import annotations

from typing import NamedTuple

from sfr_loc_map.localisation.ground.identification import Identification, Phase
from sfr_loc_map.localisation.ground.memory import NEARLY_HALF, GroundMemory, Support
from sfr_loc_map.localisation.ground.motion_tools import Motion

MAX_CONTRADICTING_FIRST = 0.05
"""Maximum fraction of cells that contradict a motion while the ground is not identified. Chosen by hand, above the 1 %
of cells that change by noise alone (`cell_change.NOISE_CORRELATION`). If larger, a fixed reflection is tracked for
longer. If smaller, good poses are refused because of moving shadows."""
MAX_CONTRADICTING = 0.4
"""Maximum fraction of cells that contradict the motion of an identified ground. Chosen by hand below one half, because
an object may fill much of the view of a rover at rest. If larger, a pose that most of the image contradicts is
accepted. If smaller, good poses are refused while a large object is in view."""


class Evidence(NamedTuple):
    """Evidence about the main motion of a pair, from the pair and from the memory of earlier pairs."""

    support: Support  #: What the memory may learn from the main motion.
    is_trusted: bool  #: Whether the pose of the main motion is trusted.
    identification: Identification  #: Which motion is the ground's, before the pair.
    after_one_motion: Identification  #: The identification after the pair if the main motion is the only motion.
    #: Whether the ground is not in doubt, and earlier pairs show how many landmarks are usually unexplained.
    has_typical: bool
    is_contradicted: bool  #: Whether many cells changed although the main motion predicts no change.
    is_unusual: bool  #: Whether more landmarks than usual do not follow the main motion.
    is_half_unexplained: bool  #: Whether nearly half of the landmarks do not follow the main motion.
    may_be_transfer: bool  #: Whether the pair may be partially transferred.
    repeats_transfer: bool  #: Whether the previous pair was partially transferred, and this pair may be, too.

    @property
    def is_identified(self) -> bool:
        """Whether earlier pairs have identified the ground's motion."""
        return self.identification.phase is Phase.IDENTIFIED

    @property
    def stays_in_doubt(self) -> bool:
        """Whether the ground is in doubt after the pair if the main motion is the only motion."""
        return self.after_one_motion.phase is Phase.IN_DOUBT

    @property
    def is_credible(self) -> bool:
        """Whether the main motion is trusted, not contradicted, and usual or that of an identified ground."""
        return self.is_trusted and not self.is_contradicted and (self.is_identified or not self.is_unusual)


def evidence_of(main: Motion, memory: GroundMemory) -> Evidence:
    """Return the evidence of the main motion, with the memory before the pair."""
    agreement = main.agreement
    support = Support(
        moves_image=agreement.moves_image,
        unexplained_fraction=agreement.unexplained_fraction,
        unexplained_cells=agreement.cells(agreement.unexplained),
        inlier_cells=agreement.cells(main.tracks.inliers),
    )
    phase = memory.identification.phase
    is_identified = phase is Phase.IDENTIFIED
    max_contradicting = MAX_CONTRADICTING if is_identified else MAX_CONTRADICTING_FIRST
    may_be_transfer = memory.faults.may_be_transfer
    return Evidence(
        support=support,
        is_trusted=main.tracks.is_trusted,
        identification=memory.identification,
        after_one_motion=memory.identification.after(memory.sign_of_one_motion(support), support.unexplained_cells),
        has_typical=is_identified or (phase is Phase.LEARNING and memory.typical is not None),
        is_contradicted=agreement.contradicting_fraction > max_contradicting,
        is_unusual=not memory.is_usual(support.unexplained_fraction),
        is_half_unexplained=support.unexplained_fraction >= NEARLY_HALF,
        may_be_transfer=may_be_transfer,
        repeats_transfer=may_be_transfer and memory.faults.transfers > 0,
    )
