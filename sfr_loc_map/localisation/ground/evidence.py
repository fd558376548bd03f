"""Evidence of a pair about the ground's motion: what its images show, and what earlier pairs have shown.

`evidence_of` collects all evidence, and `cases.CASE_RULES` decides by it. The package docstring defines the terms.
"""

from __future__ import annotations

from typing import NamedTuple

from sfr_loc_map.localisation.ground import searches
from sfr_loc_map.localisation.ground.identification import Identification, Phase
from sfr_loc_map.localisation.ground.memory import GroundMemory, Support
from sfr_loc_map.localisation.ground.motion_tools import ComparedPair, Motion
from sfr_loc_map.localisation.ground.searches import TwoMotions
from sfr_loc_map.localisation.ground.thresholds import MAX_CONTRADICTING, MAX_CONTRADICTING_FIRST, NEARLY_HALF


class Evidence(NamedTuple):
    """Evidence of a pair about its motions, from the pair and from the memory of earlier pairs."""

    # the main motion
    main: Motion
    support: Support  #: What the memory may learn from the main motion.
    is_contradicted: bool  #: Whether many cells changed although the main motion predicts no change.
    is_unusual: bool  #: Whether more landmarks than usual do not follow the main motion.
    is_half_unexplained: bool  #: Whether nearly half of the landmarks do not follow the main motion.
    # the earlier pairs
    identification: Identification  #: Which motion is the ground's, before the pair.
    after_one_motion: Identification  #: The identification after the pair if the main motion is the only motion.
    #: Whether the ground is not uncertain, and earlier pairs show how many landmarks are usually unexplained.
    has_typical: bool
    may_be_transfer: bool  #: Whether the pair may be partially transferred: not too many earlier pairs were.
    follows_transfer: bool  #: Whether the previous pair was partially transferred.
    # searches, each of which is made only if the case depends on its result (`evidence_of`)
    off_body: Motion | None = None  #: Motion of the landmarks off the own body; None if no body was found.
    is_double_exposure: bool = False  #: Whether the left image of this or of the last pair shows two exposures.
    two: TwoMotions | None = None  #: The main motion and a second motion; None if no second motion was found.

    @property
    def is_trusted(self) -> bool:
        """Whether the pose of the main motion is trusted."""
        return self.main.tracks.is_trusted

    @property
    def is_identified(self) -> bool:
        """Whether earlier pairs have identified the ground's motion."""
        return self.identification.phase is Phase.IDENTIFIED

    @property
    def is_credible(self) -> bool:
        """Whether the main motion is trusted, not contradicted, and usual or that of an identified ground."""
        return self.is_trusted and not self.is_contradicted and (self.is_identified or not self.is_unusual)

    @property
    def continues_transfer(self) -> bool:
        """Whether parts of the images are stale, as in the previous pair. No search is required for this decision."""
        return self.follows_transfer and self.may_be_transfer and self.is_unusual and not self.is_contradicted

    @property
    def is_transfer(self) -> bool:
        """Whether parts of the images are stale.

        With two motions, one of them must be a standstill, because stale parts show the previous pair. With one motion,
        nearly half of the landmarks must be unexplained, or more than usual if the previous pair was transferred, too.
        After more pairs than a partial transfer lasts, the other landmarks may be on an object.
        """
        if self.two is not None:
            return self.two.has_standstill and self.may_be_transfer
        is_half_stale = self.is_half_unexplained and self.may_be_transfer and not self.is_contradicted
        return self.continues_transfer or is_half_stale

    @property
    def is_decided(self) -> bool:
        """Whether the heavier of two motions is clearly that of an identified ground."""
        return self.two is not None and self.is_identified and self.two.is_decided

    @property
    def stays_uncertain(self) -> bool:
        """Whether the ground is uncertain after the pair if the main motion is the only motion."""
        return self.after_one_motion.phase is Phase.UNCERTAIN


def evidence_of(pair: ComparedPair, main: Motion, memory: GroundMemory) -> Evidence:
    """Return the evidence of a pair, with the memory before the pair.

    A search takes up to some milliseconds. It is made only if the earlier evidence leaves the case open:

    | search | is made if the main motion |
    |---|---|
    | motion off the own body | is not credible |
    | second exposure | is trusted, not contradicted, and explains more than half of the landmarks |
    | second motion | is trusted, but contradicted or unusual, and there is no second exposure |

    The last two searches are not made if parts of the images are stale as in the previous pair.
    """
    evidence = evidence_of_main(main, memory)
    if not evidence.is_credible:
        off_body = searches.motion_off_body(pair, main, memory)
        if off_body is not None:
            return evidence._replace(off_body=off_body)
    if not evidence.is_trusted or evidence.continues_transfer:
        return evidence
    # one exposure dominates, and its motion explains more than half of the landmarks
    may_dominate = not evidence.is_contradicted and not evidence.is_half_unexplained
    if may_dominate and searches.is_double_exposure(pair, main, memory.last_image):
        return evidence._replace(is_double_exposure=True)
    if evidence.is_contradicted or evidence.is_unusual:
        other = searches.other_motion(pair, main, is_contradicted=evidence.is_contradicted)
        if other is not None:
            return evidence._replace(two=searches.weighed(pair, main, other))
    return evidence


def evidence_of_main(main: Motion, memory: GroundMemory) -> Evidence:
    """Return the evidence of the main motion alone, with the memory before the pair."""
    agreement = main.agreement
    support = Support(
        moves_image=agreement.moves_image,
        unexplained_fraction=agreement.unexplained_fraction,
        unexplained_cells=agreement.cells(agreement.unexplained),
        inlier_cells=agreement.cells(main.tracks.inliers),
    )
    identification = memory.identification
    phase = identification.phase
    is_identified = phase is Phase.IDENTIFIED
    max_contradicting = MAX_CONTRADICTING if is_identified else MAX_CONTRADICTING_FIRST
    return Evidence(
        main=main,
        support=support,
        is_contradicted=agreement.contradicting_fraction > max_contradicting,
        is_unusual=not memory.is_usual(support.unexplained_fraction),
        is_half_unexplained=support.unexplained_fraction >= NEARLY_HALF,
        identification=identification,
        after_one_motion=identification.after(memory.consistency_of(support), support.unexplained_cells),
        has_typical=is_identified or (phase is Phase.LEARNING and memory.typical is not None),
        may_be_transfer=memory.faults.may_be_transfer,
        follows_transfer=memory.faults.transfers > 0,
    )
