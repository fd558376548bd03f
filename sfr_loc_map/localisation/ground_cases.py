"""Cases of the ground's motion: what a pair may show, and what follows from it.

`decide` returns the case of a pair: the first row that applies of `FIRST_CASES`, then of the cases with or without a
rival motion. `EFFECTS` says for each case what is reported and what the memory learns. A new case is a member of
`Case`, a row that asks for it, a row in `EFFECTS`, and a branch of `GroundSelector._selection`.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum, auto
from typing import Final

from sfr_loc_map.localisation.findings import Finding
from sfr_loc_map.localisation.ground_evidence import Evidence
from sfr_loc_map.localisation.ground_memory import Effect, GroundMemory, Recovery, Transfers


class Case(Enum):
    """What a pair shows, and which tracks follow the ground."""

    OWN_BODY_TRANSFER = auto()  #: The same as `OWN_BODY`, but parts of the images are of different exposures.
    OWN_BODY = auto()  #: The main motion is that of texture fixed to the camera: the other one is the ground.
    UNTRUSTED = auto()  #: No motion is trusted: the main tracks are kept and the pose is refused.
    CONTRADICTED = auto()  #: The image changed where the main motion predicts no change: the pose is refused.
    PARTIAL_TRANSFER = auto()  #: Parts of the images are of different exposures: the main motion is used.
    DOUBLE_EXPOSURE = auto()  #: Two exposures are blended: the motion of the dominant one is used.
    AMBIGUOUS = auto()  #: Two motions of unknown origin: the one with the larger weight is used.
    RIVAL_TRANSFER = auto()  #: The same as `RIVAL`, but parts of the images are of different exposures.
    RIVAL = auto()  #: The rival of two motions is that of the ground.
    MAIN = auto()  #: The main one of two motions is that of the ground.
    UNCONVINCING = auto()  #: About half of the landmarks follow the only motion, while the ground is unknown.
    HALF_UNEXPLAINED = auto()  #: About half of the landmarks follow the only motion of a known ground.
    UNEXPLAINED = auto()  #: Fewer landmarks than usual follow the only motion of a known ground.
    STILL_IN_DOUBT = auto()  #: Only one motion, but not enough pairs have agreed since the ground was in doubt.
    ONE_MOTION = auto()  #: Only one motion: its tracks, without those fixed to the camera.


Cases = tuple[tuple[Case, Callable[[Evidence], bool]], ...]
"""Rows of a case and the question that it asks; the first row that applies decides.

A row asks its question only if no row above applies.
"""

FIRST_CASES: Final[Cases] = (
    (Case.OWN_BODY_TRANSFER, lambda e: e.is_beside_body and e.may_be_transfer and e.is_transfer_beside_body),
    (Case.OWN_BODY, lambda e: e.is_beside_body),
    (Case.UNTRUSTED, lambda e: not e.main.is_trusted),
    # parts of the images are stale, as those of the pair before were
    (Case.PARTIAL_TRANSFER, lambda e: e.is_unusual and not e.is_contradicted and e.repeats_transfer),
    # one exposure dominates, and its motion explains over half of the landmarks
    (Case.DOUBLE_EXPOSURE, lambda e: not e.is_contradicted and not e.is_half_unexplained and e.is_double_exposure),
)
"""Cases that are decided before a rival of the main motion is searched for."""

ONE_MOTION_CASES: Final[Cases] = (
    (Case.CONTRADICTED, lambda e: e.is_contradicted),
    (Case.PARTIAL_TRANSFER, lambda e: e.is_half_unexplained and e.may_be_transfer),
    (Case.UNCONVINCING, lambda e: e.is_half_unexplained and not e.is_known),
    (Case.HALF_UNEXPLAINED, lambda e: e.is_half_unexplained),
    (Case.UNEXPLAINED, lambda e: e.is_unusual and e.is_known),
    (Case.STILL_IN_DOUBT, lambda e: e.stays_in_doubt),
    (Case.ONE_MOTION, lambda e: True),
)
"""Cases without a rival."""

TWO_MOTION_CASES: Final[Cases] = (
    # one of the two is a standstill: a part of the images is that of the pair before
    (Case.PARTIAL_TRANSFER, lambda e: e.may_be_transfer and e.has_standstill),
    (Case.AMBIGUOUS, lambda e: not (e.is_known and e.is_winner_clear)),
    (Case.RIVAL_TRANSFER, lambda e: e.rival_wins and e.may_be_transfer and e.is_transfer_by_rival),
    (Case.RIVAL, lambda e: e.rival_wins),
    (Case.MAIN, lambda e: True),
)
"""Cases with a rival."""


def decide(evidence: Evidence) -> Case:
    """Return the case of a pair."""
    for case, applies in FIRST_CASES:
        if applies(evidence):
            return case
    cases = ONE_MOTION_CASES if evidence.rival is None else TWO_MOTION_CASES
    return next(case for case, applies in cases if applies(evidence))


TRANSFER: Final = Effect({Finding.PARTIAL_TRANSFER}, transfers=Transfers.ONE_MORE, recovery=Recovery.AFTER_TRANSFERS)
"""What follows from partially transferred images, whatever motion the tracks follow."""

EFFECTS: Final = {
    Case.OWN_BODY_TRANSFER: TRANSFER,
    Case.OWN_BODY: Effect(),
    Case.UNTRUSTED: Effect(),
    Case.CONTRADICTED: Effect(
        {Finding.CONTRADICTED}, leaves_doubt=True, recovery=Recovery.STARTS, outlasts_refusal=True
    ),
    Case.PARTIAL_TRANSFER: TRANSFER,
    # a fault of the images: which motion is the ground's is not in doubt
    Case.DOUBLE_EXPOSURE: Effect({Finding.DOUBLE_EXPOSURE}, recovery=Recovery.STARTS),
    Case.AMBIGUOUS: Effect({Finding.AMBIGUOUS}, leaves_doubt=True, recovery=Recovery.STARTS),
    Case.RIVAL_TRANSFER: TRANSFER,
    Case.RIVAL: Effect(),
    Case.MAIN: Effect(),
    Case.UNCONVINCING: Effect(
        {Finding.GROUND_IN_DOUBT}, leaves_doubt=True, transfers=Transfers.NONE, recovery=Recovery.STARTS
    ),
    Case.HALF_UNEXPLAINED: Effect(
        {Finding.GROUND_IN_DOUBT, Finding.UNEXPLAINED}, transfers=Transfers.NONE, recovery=Recovery.STARTS
    ),
    Case.UNEXPLAINED: Effect({Finding.UNEXPLAINED}, transfers=Transfers.NONE),
    # earlier pairs left the doubt, and this pair may end it
    Case.STILL_IN_DOUBT: Effect(
        {Finding.GROUND_IN_DOUBT}, transfers=Transfers.NONE, recovery=Recovery.STARTS, confirms=True
    ),
    Case.ONE_MOTION: Effect(transfers=Transfers.NONE, confirms=True),
}
"""What follows from each case. `GroundMemory.after` applies what the memory learns."""


def findings_of(case: Case, memory: GroundMemory, *, is_trusted: bool, is_moving: bool) -> frozenset[Finding]:
    """Return the findings in a pair: those of its case; without any, those that earlier pairs leave.

    Args:
        case: The case of the pair.
        memory: Memory before the pair.
        is_trusted: Whether the pose of the selected tracks is trusted.
        is_moving: Whether it is trusted and the image moved.
    """
    findings = frozenset(EFFECTS[case].findings)
    if not findings and is_trusted and memory.still_recovering(is_moving=is_moving) > 0:
        return frozenset({Finding.RECOVERING})
    return findings
