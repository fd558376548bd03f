"""Cases of the ground's motion, and their consequences.

`case_of` returns the case of a pair: the first row of `CASES` whose condition is true. `EFFECTS` lists for each case
the reported finding and what the memory learns, and `UNIDENTIFIED_EFFECTS` the differences while the ground is not
identified. A new case requires a member of `Case`, a row in `CASES`, a row in `EFFECTS`, and a branch of
`GroundSelector._selection`.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum, auto
from typing import Final

from sfr_loc_map.localisation.findings import Finding, Findings
from sfr_loc_map.localisation.ground.evidence import Evidence
from sfr_loc_map.localisation.ground.identification import Fault, Phase, Sign
from sfr_loc_map.localisation.ground.memory import Effect, GroundMemory


class Case(Enum):
    """The motions in a pair, and the tracks that are used."""

    #: The main motion is that of texture fixed to the camera. The motion of the other landmarks is the ground's.
    OWN_BODY = auto()
    UNTRUSTED = auto()  #: No motion is trusted. The main tracks are used, and the pose is refused.
    PARTIAL_TRANSFER = auto()  #: Parts of the images come from different exposures. The main motion is used.
    DOUBLE_EXPOSURE = auto()  #: Two exposures are blended. The motion of the dominant exposure is used.
    AMBIGUOUS = auto()  #: Either of two motions may be the ground's. The one with the larger weight is used.
    TWO_MOTIONS = auto()  #: The one of two motions with the larger weight is clearly the ground's.
    CONTRADICTED = auto()  #: The image changed where the only motion predicts no change. The pose is refused.
    HALF_UNEXPLAINED = auto()  #: About half of the landmarks, or more, do not follow the only motion.
    UNEXPLAINED = auto()  #: More landmarks than on earlier ground do not follow the only motion.
    AT_REST_IN_DOUBT = auto()  #: Like `STILL_IN_DOUBT`, and the image did not move.
    STILL_IN_DOUBT = auto()  #: There is one motion, but too few pairs have agreed since the ground was in doubt.
    ONE_MOTION = auto()  #: There is one motion. Its tracks are used, without those fixed to the camera.


CASES: Final[tuple[tuple[Case, Callable[[Evidence], bool]], ...]] = (
    (Case.OWN_BODY, lambda e: e.shows_own_body),
    (Case.UNTRUSTED, lambda e: not e.main.is_trusted),
    # parts of the images are stale, as in the previous pair
    (Case.PARTIAL_TRANSFER, lambda e: e.is_unusual and not e.is_contradicted and e.repeats_transfer),
    # one exposure dominates, and its motion explains more than half of the landmarks
    (Case.DOUBLE_EXPOSURE, lambda e: not e.is_contradicted and not e.is_half_unexplained and e.is_double_exposure),
    # one of two motions is a standstill: part of the images is that of the previous pair
    (Case.PARTIAL_TRANSFER, lambda e: e.has_other and e.may_be_transfer and e.has_standstill),
    (Case.AMBIGUOUS, lambda e: e.has_other and not (e.is_identified and e.is_decided)),
    (Case.TWO_MOTIONS, lambda e: e.has_other),
    (Case.CONTRADICTED, lambda e: e.is_contradicted),
    # half of the landmarks is unexplained, and the fault has not lasted too long for a partial transfer
    (Case.PARTIAL_TRANSFER, lambda e: e.is_half_unexplained and e.may_be_transfer),
    # after more pairs than a partial transfer lasts, many landmarks may be on an object
    (Case.HALF_UNEXPLAINED, lambda e: e.is_half_unexplained),
    (Case.UNEXPLAINED, lambda e: e.is_unusual and e.has_typical),
    # an image without motion neither ends the doubt nor hides a motion
    (Case.AT_REST_IN_DOUBT, lambda e: e.stays_in_doubt and not e.main_motion.moves_image),
    (Case.STILL_IN_DOUBT, lambda e: e.stays_in_doubt),
    (Case.ONE_MOTION, lambda e: True),
)
"""Cases and their conditions. The first condition that is true determines the case.

A condition is evaluated only if all conditions above are false. The first condition that requires another
motion triggers the search for it. The rows below `TWO_MOTIONS` apply to a single motion.
"""


def case_of(evidence: Evidence) -> Case:
    """Return the case of a pair."""
    return next(case for case, applies in CASES if applies(evidence))


EFFECTS: Final = {
    Case.OWN_BODY: Effect(),
    Case.UNTRUSTED: Effect(),
    Case.PARTIAL_TRANSFER: Effect(Finding.PARTIAL_TRANSFER, fault=Fault.TRANSFER),
    # a fault of the images, which does not put the ground's motion in doubt
    Case.DOUBLE_EXPOSURE: Effect(Finding.DOUBLE_EXPOSURE, fault=Fault.SUSPECTED),
    Case.AMBIGUOUS: Effect(Finding.AMBIGUOUS, Sign.DOUBTS, Fault.SUSPECTED),
    Case.TWO_MOTIONS: Effect(),
    Case.CONTRADICTED: Effect(Finding.CONTRADICTED, Sign.DOUBTS, Fault.SUSPECTED, outlasts_refusal=True),
    Case.HALF_UNEXPLAINED: Effect(Finding.GROUND_IN_DOUBT, Sign.DOUBTS, Fault.SUSPECTED),
    Case.UNEXPLAINED: Effect(Finding.UNEXPLAINED),
    Case.AT_REST_IN_DOUBT: Effect(Finding.AT_REST_IN_DOUBT, fault=Fault.SUSPECTED),
    # earlier pairs caused the doubt, and this pair may end it
    Case.STILL_IN_DOUBT: Effect(Finding.GROUND_IN_DOUBT, Sign.AGREES, Fault.SUSPECTED),
    Case.ONE_MOTION: Effect(sign=Sign.AGREES),
}
"""Consequences of each case. `GroundMemory.after` applies them to the memory."""

UNIDENTIFIED_EFFECTS: Final = {
    Case.OWN_BODY: Effect(Finding.BODY_OR_GROUND),
    Case.PARTIAL_TRANSFER: Effect(Finding.TRANSFER_OR_MOTION, fault=Fault.TRANSFER),
    Case.UNEXPLAINED: Effect(Finding.GROUND_IN_DOUBT),
}
"""Consequences of cases that differ while the ground is not identified.

These cases have two motions, or part of the image does not follow the only motion. If no motion has been identified as
the ground's, the motion that is not selected may be the ground's. The pose is then degraded, and its covariance
includes the ambiguity. Beside a body, the covariance of this pose alone is larger, because its cells are excluded from
the next pairs.
"""


def effect_of(case: Case, memory: GroundMemory) -> Effect:
    """Return the consequences of a case, with the memory before the pair."""
    if memory.identification.phase is not Phase.IDENTIFIED:
        return UNIDENTIFIED_EFFECTS.get(case, EFFECTS[case])
    return EFFECTS[case]


def findings_of(effect: Effect, memory: GroundMemory, *, is_trusted: bool, is_moving: bool) -> Findings:
    """Return the findings of an effect; if there are none, `RECOVERING` if faults of earlier pairs degrade this pair.

    Args:
        effect: Effect of the pair's case.
        memory: Memory before the pair.
        is_trusted: Whether the pose of the selected tracks is trusted.
        is_moving: Whether that pose is trusted and the image moved.
    """
    findings = effect.findings
    if not findings and is_trusted and memory.faults.after(Fault.NONE, is_moving=is_moving).recovery_pairs > 0:
        return frozenset({Finding.RECOVERING})
    return findings
