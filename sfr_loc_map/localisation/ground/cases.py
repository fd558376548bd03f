"""The table of the decisions about the ground's motion: which case a pair is, and the consequences of each case.

`CASE_RULES` is the table. The first rule whose condition is true for the evidence of a pair decides. A new case
requires a member of `Case` and a rule, and if its condition is new, a field of `Evidence`.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum, auto
from typing import Final, NamedTuple

from sfr_loc_map.localisation.findings import Finding
from sfr_loc_map.localisation.ground.evidence import Evidence
from sfr_loc_map.localisation.ground.identification import Fault, ImageFaults, Phase
from sfr_loc_map.localisation.ground.memory import GroundMemory


class Case(Enum):
    """The case of a pair."""

    OWN_BODY = auto()  #: Texture fixed to the camera carries the main motion; the other landmarks follow the ground.
    UNTRUSTED = auto()  #: No motion is trusted, and the pose is refused.
    TRANSFERRED = auto()  #: Parts of the images come from different exposures.
    BLENDED = auto()  #: Two exposures are blended. The main motion is that of the dominant exposure.
    DECIDED = auto()  #: There are two motions, and the motion with more weight is clearly the ground's.
    UNDECIDED = auto()  #: Either of two motions may be the ground's.
    FALSE_STANDSTILL = auto()  #: The image changed where the only motion predicts no change. The pose is refused.
    HALF_UNEXPLAINED = auto()  #: About half of the landmarks, or more, do not follow the only motion.
    UNUSUAL = auto()  #: More landmarks than on earlier ground do not follow the only motion.
    UNCONFIRMED_AT_REST = auto()  #: Like `UNCONFIRMED`, but the image did not move, so that it shows a rover at rest.
    UNCONFIRMED = auto()  #: There is one motion, but too few consistent pairs followed those that made it uncertain.
    ONE_MOTION = auto()  #: There is one motion, and the ground is not uncertain after the pair.


class Selects(Enum):
    """Which motion is used as the ground's, and which landmarks and cells are excluded (`selection.selection_of`)."""

    MAIN = auto()  #: The main motion. Excluded is what is fixed to the camera.
    #: The main motion. Nothing is excluded, because the image does not show what is fixed to the camera.
    MAIN_WITH_ALL = auto()
    OFF_BODY = auto()  #: The motion off the body. Excluded are landmarks in stationary cells, and the body's cells.
    #: The heavier of two motions. Excluded are landmarks that do not follow this motion, and their cells.
    HEAVIER = auto()
    HEAVIER_WITH_ALL = auto()  #: The heavier of two motions. Nothing is excluded, as the other may be the ground's.


class Learns(Enum):
    """What the memory learns from a pair about the ground's motion."""

    NOTHING = auto()
    ONE_MOTION = auto()  #: How consistent the pair is with earlier pairs, and which fraction is typically unexplained.
    UNCERTAINTY = auto()  #: The ground's motion is uncertain.


class Rule(NamedTuple):
    """A case: its condition and its consequences."""

    case: Case
    condition: Callable[[Evidence], bool]  #: Whether the case applies, if no earlier rule does.
    selects: Selects
    finding: Finding | None = None  #: The finding of the pair.
    #: The finding while the ground is not identified, if it differs. The motion that is not selected may then be the
    #: ground's.
    finding_unidentified: Finding | None = None
    fault: Fault = Fault.NONE  #: What the pair shows about faults of the images.
    learns: Learns = Learns.NOTHING
    outlasts_refusal: bool = False  #: Whether the memory learns from the pair although its pose is refused.


CASE_RULES: Final = (
    # The covariance includes the unobserved motion and not the ambiguity, because the cells of the body are excluded
    # from the next pairs.
    Rule(
        Case.OWN_BODY,
        lambda evidence: evidence.off_body is not None,
        Selects.OFF_BODY,
        finding_unidentified=Finding.BODY_OR_GROUND,
    ),
    Rule(Case.UNTRUSTED, lambda evidence: not evidence.is_trusted, Selects.MAIN_WITH_ALL),
    Rule(
        Case.TRANSFERRED,
        lambda evidence: evidence.is_transfer,
        Selects.MAIN_WITH_ALL,
        Finding.PARTIAL_TRANSFER,
        Finding.TRANSFER_OR_MOTION,
        fault=Fault.TRANSFER,
    ),
    # A fault of the images does not make the ground's motion uncertain.
    Rule(
        Case.BLENDED,
        lambda evidence: evidence.is_double_exposure,
        Selects.MAIN_WITH_ALL,
        Finding.DOUBLE_EXPOSURE,
        fault=Fault.SUSPECTED,
    ),
    Rule(Case.DECIDED, lambda evidence: evidence.is_decided, Selects.HEAVIER),
    Rule(
        Case.UNDECIDED,
        lambda evidence: evidence.two is not None,
        Selects.HEAVIER_WITH_ALL,
        Finding.AMBIGUOUS,
        fault=Fault.SUSPECTED,
        learns=Learns.UNCERTAINTY,
    ),
    Rule(
        Case.FALSE_STANDSTILL,
        lambda evidence: evidence.is_contradicted,
        Selects.MAIN_WITH_ALL,
        Finding.CONTRADICTED,
        fault=Fault.SUSPECTED,
        learns=Learns.UNCERTAINTY,
        outlasts_refusal=True,
    ),
    Rule(
        Case.HALF_UNEXPLAINED,
        lambda evidence: evidence.is_half_unexplained,
        Selects.MAIN,
        Finding.GROUND_UNCERTAIN,
        fault=Fault.SUSPECTED,
        learns=Learns.UNCERTAINTY,
    ),
    Rule(
        Case.UNUSUAL,
        lambda evidence: evidence.is_unusual and evidence.has_typical,
        Selects.MAIN,
        Finding.UNEXPLAINED,
        Finding.GROUND_UNCERTAIN,
    ),
    Rule(
        Case.UNCONFIRMED_AT_REST,
        lambda evidence: evidence.stays_uncertain and not evidence.support.moves_image,
        Selects.MAIN,
        Finding.AT_REST_UNCERTAIN,
        fault=Fault.SUSPECTED,
        learns=Learns.ONE_MOTION,
    ),
    Rule(
        Case.UNCONFIRMED,
        lambda evidence: evidence.stays_uncertain,
        Selects.MAIN,
        Finding.GROUND_UNCERTAIN,
        fault=Fault.SUSPECTED,
        learns=Learns.ONE_MOTION,
    ),
    Rule(Case.ONE_MOTION, lambda _: True, Selects.MAIN, learns=Learns.ONE_MOTION),
)
"""The cases in the order of precedence, with their conditions and consequences."""


def rule_of(evidence: Evidence) -> Rule:
    """Return the rule of a pair: the first rule whose condition is true."""
    return next(rule for rule in CASE_RULES if rule.condition(evidence))


def findings_of(rule: Rule, faults: ImageFaults, *, is_identified: bool, is_trusted: bool) -> frozenset[Finding]:
    """Return the finding of a rule, or else `RECOVERING` if faults of earlier pairs degrade this pair.

    Args:
        rule: Rule of the pair.
        faults: Faults of the images after the pair.
        is_identified: Whether the ground was identified before the pair.
        is_trusted: Whether the pose of the selected tracks is trusted.
    """
    finding = rule.finding
    if not is_identified and rule.finding_unidentified is not None:
        finding = rule.finding_unidentified
    if finding is not None:
        return frozenset({finding})
    if is_trusted and faults.recovery_pairs > 0:
        return frozenset({Finding.RECOVERING})
    return frozenset()


def findings_unselected(memory: GroundMemory, *, is_trusted: bool) -> frozenset[Finding]:
    """Return the finding of a pair in which no motion is selected, which has no case.

    The pair ends neither an uncertainty nor a recovery of the memory, so that these are reported again.
    """
    if memory.identification.phase is Phase.UNCERTAIN:
        return frozenset({Finding.GROUND_UNCERTAIN})
    if is_trusted and memory.faults.degrades_next:
        return frozenset({Finding.RECOVERING})
    return frozenset()
