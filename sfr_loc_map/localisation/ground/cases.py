"""Cases of the motions in a pair: how a pair is classified, and the consequences of each case.

Each case is a class. Its fields are the motions that `case_of` found, if the selection of the tracks requires them.

| case | fields | motion that is used | what is excluded |
|---|---|---|---|
| `OwnBody` | motion off the body | that off the body | landmarks in stationary cells, and the cells of the body |
| `Ambiguous` | two motions | that with more weight | nothing, because the other motion may be the ground's |
| `MainOfTwo` | two motions | the main motion | what follows the other motion, or is fixed to the camera |
| `OtherOfTwo` | two motions | the other motion | landmarks that follow only the main motion, and their cells |
| `Untrusted`, `PartialTransfer`, `DoubleExposure`, `Contradicted` | | the main motion | nothing |
| all other cases | | the main motion | what is fixed to the camera |

`case_of` contains the conditions, `EFFECTS` the consequences, and `selection.selection_of` the tracks. A new case
requires a class here, a member of `Case`, a condition, a row in `EFFECTS`, and a branch in `selection_of`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

from sfr_loc_map.localisation.findings import Finding, Findings
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
class MainOfTwo:
    """There are two motions, and the main motion is clearly the ground's."""

    motions: TwoMotions


@dataclass(frozen=True, slots=True, eq=False)
class OtherOfTwo:
    """There are two motions, and the other motion is clearly the ground's."""

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
class AtRestInDoubt:
    """Like `StillInDoubt`, and the image did not move."""


@dataclass(frozen=True, slots=True)
class StillInDoubt:
    """There is one motion, but too few pairs have agreed since the ground was in doubt."""


@dataclass(frozen=True, slots=True)
class OneMotion:
    """There is one motion, and the ground is not in doubt after the pair."""


Case = (
    OwnBody
    | Untrusted
    | PartialTransfer
    | DoubleExposure
    | Ambiguous
    | MainOfTwo
    | OtherOfTwo
    | Contradicted
    | HalfUnexplained
    | Unexplained
    | AtRestInDoubt
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
    return OtherOfTwo(motions) if motions.other_wins else MainOfTwo(motions)


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
        # an image without motion neither ends the doubt nor hides a motion
        return StillInDoubt() if evidence.support.moves_image else AtRestInDoubt()
    return OneMotion()


# ---- the consequences of a case


class Effects(NamedTuple):
    """Consequences of a case."""

    usual: Effect
    #: Consequences while the ground is not identified; None if they are the same.
    unidentified: Effect | None = None


EFFECTS: Final[dict[type[Case], Effects]] = {
    OwnBody: Effects(
        Effect(),
        # the cells of the body are excluded from the next pairs, so that only the covariance of this pose is larger
        unidentified=Effect(Finding.BODY_OR_GROUND),
    ),
    Untrusted: Effects(Effect()),
    PartialTransfer: Effects(
        Effect(Finding.PARTIAL_TRANSFER, fault=Fault.TRANSFER),
        unidentified=Effect(Finding.TRANSFER_OR_MOTION, fault=Fault.TRANSFER),
    ),
    # a fault of the images, which does not put the ground's motion in doubt
    DoubleExposure: Effects(Effect(Finding.DOUBLE_EXPOSURE, fault=Fault.SUSPECTED)),
    Ambiguous: Effects(Effect(Finding.AMBIGUOUS, Conclusion.DOUBT, Fault.SUSPECTED)),
    MainOfTwo: Effects(Effect()),
    OtherOfTwo: Effects(Effect()),
    Contradicted: Effects(Effect(Finding.CONTRADICTED, Conclusion.DOUBT, Fault.SUSPECTED, outlasts_refusal=True)),
    HalfUnexplained: Effects(Effect(Finding.GROUND_IN_DOUBT, Conclusion.DOUBT, Fault.SUSPECTED)),
    Unexplained: Effects(Effect(Finding.UNEXPLAINED), unidentified=Effect(Finding.GROUND_IN_DOUBT)),
    AtRestInDoubt: Effects(Effect(Finding.AT_REST_IN_DOUBT, fault=Fault.SUSPECTED)),
    # earlier pairs caused the doubt, and this pair may end it
    StillInDoubt: Effects(Effect(Finding.GROUND_IN_DOUBT, Conclusion.ONE_MOTION, Fault.SUSPECTED)),
    OneMotion: Effects(Effect(conclusion=Conclusion.ONE_MOTION)),
}
"""Consequences of each case. `GroundMemory.after` applies them to the memory.

Three cases differ while the ground is not identified. They have two motions, or part of the image does not follow the
only motion. The motion that is not selected may then be the ground's, so that the pose is degraded. The covariance of
the pose includes the ambiguity. For `OwnBody` the covariance includes the unobserved motion instead, because the cells
of the body are excluded from the next pairs.
"""


def effect_of(case: Case, *, is_identified: bool) -> Effect:
    """Return the consequences of a case; `is_identified` tells whether the ground was identified before the pair."""
    effects = EFFECTS[type(case)]
    if effects.unidentified is None or is_identified:
        return effects.usual
    return effects.unidentified


def findings_of(effect: Effect, faults: ImageFaults, *, is_trusted: bool) -> Findings:
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
