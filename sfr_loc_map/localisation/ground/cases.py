"""Cases of the motions in a pair: how a pair is classified, and the consequences of each case.

Each case is a class. Its fields are the values on which its consequences and the selection of the tracks depend.

| case | fields | motion that is used | what is excluded |
|---|---|---|---|
| `OwnBody` | motion off the body | that off the body | landmarks in stationary cells, and the cells of the body |
| `Ambiguous` | two motions | that with more weight | nothing, because the other motion may be the ground's |
| `Decided` | two motions | the main motion | what follows the other motion, or is fixed to the camera |
| | | or the other motion | landmarks that follow only the main motion, and their cells |
| `Untrusted`, `PartialTransfer`, `DoubleExposure`, `Contradicted` | | the main motion | nothing |
| all other cases | | the main motion | what is fixed to the camera |

`case_of` contains the conditions, `effect_of` the consequences, and `selection.selection_of` the tracks. A new case
requires a class here, a member of `Case`, a condition, and a branch in `effect_of` and in `selection_of`.
"""

from __future__ import annotations

from dataclasses import dataclass

from sfr_loc_map.localisation.findings import Finding
from sfr_loc_map.localisation.ground import searches
from sfr_loc_map.localisation.ground.evidence import Evidence
from sfr_loc_map.localisation.ground.identification import Fault, ImageFaults
from sfr_loc_map.localisation.ground.memory import Conclusion, Effect, GroundMemory
from sfr_loc_map.localisation.ground.motion_tools import ComparedPair, Motion
from sfr_loc_map.localisation.ground.two_motions import TwoMotions, weighed


@dataclass(frozen=True, slots=True, eq=False)
class OwnBody:
    """Texture fixed to the camera carries the main motion. The motion of the other landmarks is the ground's."""

    off_body: Motion  #: Motion of the landmarks outside stationary cells.


@dataclass(frozen=True, slots=True)
class Untrusted:
    """No motion is trusted, and the pose is refused."""


@dataclass(frozen=True, slots=True)
class PartialTransfer:
    """Parts of the images come from different exposures."""


@dataclass(frozen=True, slots=True)
class DoubleExposure:
    """Two exposures are blended. The main motion is that of the dominant exposure."""


@dataclass(frozen=True, slots=True, eq=False)
class Ambiguous:
    """Either of two motions may be the ground's."""

    motions: TwoMotions


@dataclass(frozen=True, slots=True, eq=False)
class Decided:
    """There are two motions, and the motion with more weight is clearly the ground's."""

    motions: TwoMotions


@dataclass(frozen=True, slots=True)
class Contradicted:
    """The image changed where the only motion predicts no change. The pose is refused."""


@dataclass(frozen=True, slots=True)
class HalfUnexplained:
    """About half of the landmarks, or more, do not follow the only motion."""


@dataclass(frozen=True, slots=True)
class Unexplained:
    """More landmarks than on earlier ground do not follow the only motion."""


@dataclass(frozen=True, slots=True)
class StillInDoubt:
    """There is one motion, but too few pairs have agreed since the ground was in doubt."""

    moves_image: bool  #: Whether the motion moves the image. A pair without motion does not end the doubt.


@dataclass(frozen=True, slots=True)
class OneMotion:
    """There is one motion, and the ground is not in doubt after the pair."""


Case = (
    OwnBody
    | Untrusted
    | PartialTransfer
    | DoubleExposure
    | Ambiguous
    | Decided
    | Contradicted
    | HalfUnexplained
    | Unexplained
    | StillInDoubt
    | OneMotion
)


# ---- the case of a pair


def case_of(pair: ComparedPair, main: Motion, evidence: Evidence, memory: GroundMemory) -> Case:
    """Return the case of a pair: that of the first condition that is true. `memory` is that before the pair."""
    if not evidence.is_credible:
        off_body = searches.motion_off_body(pair, main, memory)
        if off_body is not None:
            return OwnBody(off_body)
    if not evidence.is_trusted:
        return Untrusted()
    # parts of the images are stale, as in the previous pair
    if evidence.is_unusual and evidence.repeats_transfer and not evidence.is_contradicted:
        return PartialTransfer()
    # one exposure dominates, and its motion explains more than half of the landmarks
    may_dominate = not evidence.is_contradicted and not evidence.is_half_unexplained
    if may_dominate and searches.is_double_exposure(pair, main, memory.last_image):
        return DoubleExposure()
    if evidence.is_contradicted or evidence.is_unusual:
        other = searches.other_motion(pair, main, is_contradicted=evidence.is_contradicted)
        if other is not None:
            return case_of_two(weighed(pair, main, other), evidence)
    return case_of_one(evidence)


def case_of_two(motions: TwoMotions, evidence: Evidence) -> Case:
    """Return the case of a pair with two motions."""
    # part of the images is that of the previous pair
    if motions.has_standstill and evidence.may_be_transfer:
        return PartialTransfer()
    if not (evidence.is_identified and motions.is_decided):
        return Ambiguous(motions)
    return Decided(motions)


def case_of_one(evidence: Evidence) -> Case:
    """Return the case of a pair with one motion, which is trusted."""
    if evidence.is_contradicted:
        return Contradicted()
    if evidence.is_half_unexplained:
        # after more pairs than a partial transfer lasts, many landmarks may be on an object
        return PartialTransfer() if evidence.may_be_transfer else HalfUnexplained()
    if evidence.is_unusual and evidence.has_typical:
        return Unexplained()
    if evidence.stays_in_doubt:
        return StillInDoubt(evidence.support.moves_image)
    return OneMotion()


# ---- the consequences of a case


def effect_of(case: Case, *, is_identified: bool) -> Effect:
    """Return the consequences of a case; `is_identified` tells whether the ground was identified before the pair.

    Three cases differ while the ground is not identified. They have two motions, or part of the image does not follow
    the only motion. The motion that is not selected may then be the ground's, so that the pose is degraded. The
    covariance of the pose includes the ambiguity. For `OwnBody` the covariance includes the unobserved motion instead,
    because the cells of the body are excluded from the next pairs.
    """
    match case:
        case OwnBody():
            return Effect() if is_identified else Effect(Finding.BODY_OR_GROUND)
        case Untrusted() | Decided():
            return Effect()
        case PartialTransfer():
            finding = Finding.PARTIAL_TRANSFER if is_identified else Finding.TRANSFER_OR_MOTION
            return Effect(finding, fault=Fault.TRANSFER)
        case DoubleExposure():  # a fault of the images, which does not put the ground's motion in doubt
            return Effect(Finding.DOUBLE_EXPOSURE, fault=Fault.SUSPECTED)
        case Ambiguous():
            return Effect(Finding.AMBIGUOUS, Conclusion.DOUBT, Fault.SUSPECTED)
        case Contradicted():
            return Effect(Finding.CONTRADICTED, Conclusion.DOUBT, Fault.SUSPECTED, outlasts_refusal=True)
        case HalfUnexplained():
            return Effect(Finding.GROUND_IN_DOUBT, Conclusion.DOUBT, Fault.SUSPECTED)
        case Unexplained():
            return Effect(Finding.UNEXPLAINED if is_identified else Finding.GROUND_IN_DOUBT)
        case StillInDoubt(moves_image):  # earlier pairs caused the doubt, and a pair with motion may end it
            finding = Finding.GROUND_IN_DOUBT if moves_image else Finding.AT_REST_IN_DOUBT
            return Effect(finding, Conclusion.ONE_MOTION, Fault.SUSPECTED)
        case OneMotion():
            return Effect(conclusion=Conclusion.ONE_MOTION)


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
