"""Cases of the motions in a pair: how a pair is classified, and the consequences of each case.

A case with a further motion is a class, whose fields are the motions that were found. All other cases are members of
`MainCase`.

| case | motion that is used | what is excluded |
|---|---|---|
| `OwnBody` | that off the body | landmarks in stationary cells, and the cells of the body |
| `Ambiguous` | that with more weight | nothing, because the other motion may be the ground's |
| `Decided` | the main motion | what follows the other motion, or is fixed to the camera |
| | or the other motion | landmarks that follow only the main motion, and their cells |
| `MainCase`, one of `EXCLUDES_NOTHING` | the main motion | nothing |
| `MainCase`, any other member | the main motion | what is fixed to the camera |

`case_of` contains the conditions, `effect_of` the consequences, and `selection.selection_of` the tracks. A new case
requires a member of `MainCase`, or a class here and in `Case`, a condition, and a branch in `effect_of` and in
`selection_of`.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto
from typing import Final

from sfr_loc_map.localisation.findings import Finding
from sfr_loc_map.localisation.ground import searches
from sfr_loc_map.localisation.ground.evidence import Evidence
from sfr_loc_map.localisation.ground.identification import Fault, ImageFaults, Phase, Sign
from sfr_loc_map.localisation.ground.memory import Effect, GroundMemory
from sfr_loc_map.localisation.ground.motion_tools import ComparedPair, Motion
from sfr_loc_map.localisation.ground.two_motions import TwoMotions, weighed


@dataclass(frozen=True, slots=True, eq=False)
class OwnBody:
    """Texture fixed to the camera carries the main motion. The motion of the other landmarks is the ground's."""

    off_body: Motion  #: Motion of the landmarks outside stationary cells.


@dataclass(frozen=True, slots=True, eq=False)
class Ambiguous:
    """Either of two motions may be the ground's."""

    motions: TwoMotions


@dataclass(frozen=True, slots=True, eq=False)
class Decided:
    """There are two motions, and the motion with more weight is clearly the ground's."""

    motions: TwoMotions


class MainCase(Enum):
    """A case in which the main motion is used."""

    UNTRUSTED = auto()  #: No motion is trusted, and the pose is refused.
    PARTIAL_TRANSFER = auto()  #: Parts of the images come from different exposures.
    DOUBLE_EXPOSURE = auto()  #: Two exposures are blended. The main motion is that of the dominant exposure.
    CONTRADICTED = auto()  #: The image changed where the only motion predicts no change. The pose is refused.
    HALF_UNEXPLAINED = auto()  #: About half of the landmarks, or more, do not follow the only motion.
    UNEXPLAINED = auto()  #: More landmarks than on earlier ground do not follow the only motion.
    IN_DOUBT = auto()  #: There is one motion, but too few pairs have agreed since the ground was in doubt.
    ONE_MOTION = auto()  #: There is one motion, and the ground is not in doubt after the pair.


EXCLUDES_NOTHING: Final = frozenset(
    {MainCase.UNTRUSTED, MainCase.PARTIAL_TRANSFER, MainCase.DOUBLE_EXPOSURE, MainCase.CONTRADICTED}
)
"""Cases whose image does not show which landmarks and cells are fixed to the camera."""

Case = OwnBody | Ambiguous | Decided | MainCase


# ---- the case of a pair


def case_of(pair: ComparedPair, main: Motion, evidence: Evidence, memory: GroundMemory) -> Case:
    """Return the case of a pair: that of the first condition that is true. `memory` is that before the pair."""
    if not evidence.is_credible:
        off_body = searches.motion_off_body(pair, main, memory)
        if off_body is not None:
            return OwnBody(off_body)
    if not evidence.is_trusted:
        return MainCase.UNTRUSTED
    # parts of the images are stale, as in the previous pair
    if evidence.is_unusual and evidence.repeats_transfer and not evidence.is_contradicted:
        return MainCase.PARTIAL_TRANSFER
    # one exposure dominates, and its motion explains more than half of the landmarks
    may_dominate = not evidence.is_contradicted and not evidence.is_half_unexplained
    if may_dominate and searches.is_double_exposure(pair, main, memory.last_image):
        return MainCase.DOUBLE_EXPOSURE
    if evidence.is_contradicted or evidence.is_unusual:
        other = searches.other_motion(pair, main, is_contradicted=evidence.is_contradicted)
        if other is not None:
            return case_of_two(weighed(pair, main, other), evidence)
    return case_of_one(evidence)


def case_of_two(motions: TwoMotions, evidence: Evidence) -> Case:
    """Return the case of a pair with two motions."""
    # part of the images is that of the previous pair
    if motions.has_standstill and evidence.may_be_transfer:
        return MainCase.PARTIAL_TRANSFER
    if not (evidence.is_identified and motions.is_decided):
        return Ambiguous(motions)
    return Decided(motions)


def case_of_one(evidence: Evidence) -> Case:
    """Return the case of a pair with one motion, which is trusted."""
    if evidence.is_contradicted:
        return MainCase.CONTRADICTED
    if evidence.is_half_unexplained:
        # after more pairs than a partial transfer lasts, many landmarks may be on an object
        return MainCase.PARTIAL_TRANSFER if evidence.may_be_transfer else MainCase.HALF_UNEXPLAINED
    if evidence.is_unusual and evidence.has_typical:
        return MainCase.UNEXPLAINED
    if evidence.stays_in_doubt:
        return MainCase.IN_DOUBT
    return MainCase.ONE_MOTION


# ---- the consequences of a case


def effect_of(case: Case, evidence: Evidence) -> Effect:
    """Return the consequences of a case: the finding of the pair, and what the memory learns from the pair.

    Three cases differ while the ground is not identified. They have two motions, or part of the image does not follow
    the only motion. The motion that is not selected may then be the ground's, so that the pose is degraded. The
    covariance of the pose includes the ambiguity. For `OwnBody` the covariance includes the unobserved motion instead,
    because the cells of the body are excluded from the next pairs.
    """
    before = evidence.identification
    is_identified = evidence.is_identified
    in_doubt = before.after(Sign.DOUBTS, evidence.support.unexplained_cells)
    match case:
        case OwnBody():
            return Effect(before, None if is_identified else Finding.BODY_OR_GROUND)
        case MainCase.UNTRUSTED | Decided():
            return Effect(before)
        case MainCase.PARTIAL_TRANSFER:
            finding = Finding.PARTIAL_TRANSFER if is_identified else Finding.TRANSFER_OR_MOTION
            return Effect(before, finding, Fault.TRANSFER)
        case MainCase.DOUBLE_EXPOSURE:  # a fault of the images, which does not put the ground's motion in doubt
            return Effect(before, Finding.DOUBLE_EXPOSURE, Fault.SUSPECTED)
        case Ambiguous():
            return Effect(in_doubt, Finding.AMBIGUOUS, Fault.SUSPECTED)
        case MainCase.CONTRADICTED:
            return Effect(in_doubt, Finding.CONTRADICTED, Fault.SUSPECTED, outlasts_refusal=True)
        case MainCase.HALF_UNEXPLAINED:
            return Effect(in_doubt, Finding.GROUND_IN_DOUBT, Fault.SUSPECTED)
        case MainCase.UNEXPLAINED:
            return Effect(before, Finding.UNEXPLAINED if is_identified else Finding.GROUND_IN_DOUBT)
        case MainCase.IN_DOUBT:  # earlier pairs caused the doubt, and a pair with motion may end it
            finding = Finding.GROUND_IN_DOUBT if evidence.support.moves_image else Finding.AT_REST_IN_DOUBT
            return Effect(evidence.after_one_motion, finding, Fault.SUSPECTED, is_typical=True)
        case MainCase.ONE_MOTION:
            return Effect(evidence.after_one_motion, is_typical=True)


def findings_of(effect: Effect, faults: ImageFaults, *, is_trusted: bool) -> frozenset[Finding]:
    """Return the finding of an effect, or else `RECOVERING` if faults of earlier pairs degrade this pair.

    Args:
        effect: Effect of the pair's case.
        faults: Faults of the images after the pair.
        is_trusted: Whether the pose of the selected tracks is trusted.
    """
    if effect.finding is not None:
        return frozenset({effect.finding})
    if is_trusted and faults.recovery_pairs > 0:
        return frozenset({Finding.RECOVERING})
    return frozenset()


def findings_unselected(memory: GroundMemory, *, is_trusted: bool) -> frozenset[Finding]:
    """Return the finding of a pair in which no motion is selected, which has no case.

    The pair ends neither a doubt nor a recovery of the memory, so that these are reported again.
    """
    if memory.identification.phase is Phase.IN_DOUBT:
        return frozenset({Finding.GROUND_IN_DOUBT})
    if is_trusted and memory.faults.degrades_next:
        return frozenset({Finding.RECOVERING})
    return frozenset()
