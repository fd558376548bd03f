"""Cases of the ground's motion: what a pair may show, and what follows from it.

`case_of` returns the case of a pair: the first row of `CASES` whose question is answered by yes. `EFFECTS` says for
each case what is reported and what the memory learns. A new case is a member of `Case`, a row in `CASES`, a row in
`EFFECTS`, and a branch of `GroundSelector._selection`.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum, auto
from typing import Final

from sfr_loc_map.localisation.findings import Finding, Findings
from sfr_loc_map.localisation.ground_evidence import Evidence
from sfr_loc_map.localisation.ground_memory import Effect, GroundMemory


class Case(Enum):
    """What a pair shows, and which tracks follow the ground."""

    OWN_BODY = auto()  #: The main motion is that of texture fixed to the camera: the other one is the ground.
    UNTRUSTED = auto()  #: No motion is trusted: the main tracks are kept and the pose is refused.
    PARTIAL_TRANSFER = auto()  #: Parts of the images are of different exposures: the main motion is used.
    DOUBLE_EXPOSURE = auto()  #: Two exposures are blended: the motion of the dominant one is used.
    AMBIGUOUS = auto()  #: Two motions of unknown origin: the one with the larger weight is used.
    TWO_MOTIONS = auto()  #: Two motions: the one with the larger weight is clearly that of the ground.
    CONTRADICTED = auto()  #: The image changed where the only motion predicts no change: the pose is refused.
    HALF_UNEXPLAINED = auto()  #: About half of the landmarks do not follow the only motion.
    UNEXPLAINED = auto()  #: More landmarks than usual do not follow the only motion of a known ground.
    STILL_IN_DOUBT = auto()  #: Only one motion, but not enough pairs have agreed since the ground was in doubt.
    ONE_MOTION = auto()  #: Only one motion: its tracks, without those fixed to the camera.


CASES: Final[tuple[tuple[Case, Callable[[Evidence], bool]], ...]] = (
    (Case.OWN_BODY, lambda e: e.is_beside_body),
    (Case.UNTRUSTED, lambda e: not e.main.is_trusted),
    # parts of the images are stale, as those of the pair before were
    (Case.PARTIAL_TRANSFER, lambda e: e.is_unusual and not e.is_contradicted and e.repeats_transfer),
    # one exposure dominates, and its motion explains over half of the landmarks
    (Case.DOUBLE_EXPOSURE, lambda e: not e.is_contradicted and not e.is_half_unexplained and e.is_double_exposure),
    # one of two motions is a standstill: a part of the images is that of the pair before
    (Case.PARTIAL_TRANSFER, lambda e: e.has_rival and e.may_be_transfer and e.has_standstill),
    (Case.AMBIGUOUS, lambda e: e.has_rival and not (e.is_known and e.is_winner_clear)),
    (Case.TWO_MOTIONS, lambda e: e.has_rival),
    (Case.CONTRADICTED, lambda e: e.is_contradicted),
    (Case.PARTIAL_TRANSFER, lambda e: e.is_half_unexplained and e.may_be_transfer),
    # in more pairs than a partial transfer lasts: many landmarks may be of an object
    (Case.HALF_UNEXPLAINED, lambda e: e.is_half_unexplained),
    (Case.UNEXPLAINED, lambda e: e.is_unusual and e.is_known),
    (Case.STILL_IN_DOUBT, lambda e: e.stays_in_doubt),
    (Case.ONE_MOTION, lambda e: True),
)
"""Rows of a case and the question that it asks; the first row that applies decides.

A row asks its question only if no row above applies. A rival of the main motion is searched for by the first row that
asks for one. The rows below `TWO_MOTIONS` are those of a single motion.
"""


def case_of(evidence: Evidence) -> Case:
    """Return the case of a pair."""
    return next(case for case, applies in CASES if applies(evidence))


EFFECTS: Final = {
    Case.OWN_BODY: Effect(),
    Case.UNTRUSTED: Effect(),
    Case.PARTIAL_TRANSFER: Effect(Finding.PARTIAL_TRANSFER),
    # a fault of the images: which motion is the ground's is not in doubt
    Case.DOUBLE_EXPOSURE: Effect(Finding.DOUBLE_EXPOSURE, starts_recovery=True),
    Case.AMBIGUOUS: Effect(Finding.AMBIGUOUS, leaves_doubt=True, starts_recovery=True),
    Case.TWO_MOTIONS: Effect(),
    Case.CONTRADICTED: Effect(Finding.CONTRADICTED, leaves_doubt=True, starts_recovery=True, outlasts_refusal=True),
    Case.HALF_UNEXPLAINED: Effect(Finding.GROUND_IN_DOUBT, leaves_doubt=True, starts_recovery=True),
    Case.UNEXPLAINED: Effect(Finding.UNEXPLAINED),
    # earlier pairs left the doubt, and this pair may end it
    Case.STILL_IN_DOUBT: Effect(Finding.GROUND_IN_DOUBT, starts_recovery=True, confirms=True),
    Case.ONE_MOTION: Effect(confirms=True),
}
"""What follows from each case. `GroundMemory.after` applies what the memory learns."""


def findings_of(case: Case, memory: GroundMemory, *, is_trusted: bool, is_moving: bool) -> Findings:
    """Return the findings in a pair: those of its case; without any, those that earlier pairs leave.

    Args:
        case: The case of the pair.
        memory: Memory before the pair.
        is_trusted: Whether the pose of the selected tracks is trusted.
        is_moving: Whether it is trusted and the image moved.
    """
    findings = EFFECTS[case].findings
    if not findings and is_trusted and memory.still_recovering(is_moving=is_moving) > 0:
        return frozenset({Finding.RECOVERING})
    return findings
