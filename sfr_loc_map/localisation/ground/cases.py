"""The table of the decisions about the ground's motion: which case a pair is, and the consequences of each case.

`CASE_RULES` is the table. The first rule whose condition is true for the evidence of a pair decides. A new case
requires a member of `Case` and a rule, and if its condition is new, a field of `Evidence`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from enum import Enum, auto
from typing import Final, NamedTuple

from sfr_loc_map.geometry.arrays import Mask
from sfr_loc_map.localisation.findings import Finding
from sfr_loc_map.localisation.ground.evidence import Evidence, TwoMotions
from sfr_loc_map.localisation.ground.excluded_cells import Exclusion
from sfr_loc_map.localisation.ground.memory import Fault, GroundMemory, ImageFaults, Phase
from sfr_loc_map.localisation.ground.motions import ComparedPair, Motion
from sfr_loc_map.localisation.motion_size import NO_MOTION, MotionSize


class Selection(NamedTuple):
    """The motion that is used as the ground's, and what does not follow this motion."""

    motion: Motion
    is_main: bool  #: Whether the motion is the main motion.
    exclusion: Exclusion  #: Landmarks and cells that do not move with the ground.
    other_distance: MotionSize = NO_MOTION  #: Distance to the pose of another possible motion; zero if none.

    @property
    def is_moving(self) -> bool:
        """Whether the pose is trusted and the image moved."""
        return self.motion.tracks.is_trusted and self.motion.agreement.moves_image


# ---- what a case selects


def select_main(_: ComparedPair, evidence: Evidence) -> Selection:
    """Select the main motion, and exclude what is fixed to the camera."""
    motion = evidence.main
    rows = motion.tracks.landmarks.rows[motion.agreement.on_fixed]
    return Selection(motion, is_main=True, exclusion=Exclusion.of_fixed(rows, motion.agreement.fixed_cells))


def select_main_with_all(pair: ComparedPair, evidence: Evidence) -> Selection:
    """Select the main motion, and exclude nothing, because the image does not show what is fixed to the camera."""
    return Selection(evidence.main, is_main=True, exclusion=Exclusion.nothing(pair.change.stationary.shape))


def select_off_body(pair: ComparedPair, evidence: Evidence) -> Selection:
    """Select the motion of the landmarks outside stationary cells, and exclude the landmarks in these cells.

    The host cell of such a landmark is fixed to the camera if the motion would have moved the landmark. Without these
    cells, a keyframe would create new landmarks on the body.
    """
    found = evidence.off_body
    assert found is not None, "the condition of the case"
    tracks = evidence.main.tracks
    on_stationary = evidence.main.agreement.on_stationary
    of_all = pair.motion(replace(tracks, pose=found.tracks.pose)).agreement
    fixed = of_all.host_cells(on_stationary & of_all.are_moved) | found.agreement.fixed_cells
    return _tracked_without(pair, evidence.main, found, on_stationary, fixed)


def select_heavier(pair: ComparedPair, evidence: Evidence) -> Selection:
    """Select the heavier of two motions. Exclude the landmarks that do not follow this motion, and their cells."""
    two = evidence.two
    assert two is not None, "the condition of the case"
    return _other_of_two(pair, two) if two.other_wins else _main_of_two(two)


def select_heavier_with_all(pair: ComparedPair, evidence: Evidence) -> Selection:
    """Select the heavier of two motions, and exclude nothing, because the other motion may be the ground's."""
    two = evidence.two
    assert two is not None, "the condition of the case"
    motion = two.main
    if two.other_wins:
        motion = pair.tracked_from(two.main.tracks.landmarks, two.other.tracks.pose)
    nothing = Exclusion.nothing(pair.change.stationary.shape)
    return Selection(motion, is_main=not two.other_wins, exclusion=nothing, other_distance=two.distance)


def _main_of_two(motions: TwoMotions) -> Selection:
    """Select the main motion, and exclude what follows the other motion or is fixed to the camera."""
    motion = motions.main
    other = motions.other
    fixed = motion.agreement.fixed_cells
    dynamic = other.agreement.cells(other.tracks.inliers) & ~fixed
    rows = motion.tracks.landmarks.rows[motions.follow_other | motion.agreement.on_fixed]
    return Selection(motion, is_main=True, exclusion=Exclusion(rows, fixed, dynamic))


def _other_of_two(pair: ComparedPair, motions: TwoMotions) -> Selection:
    """Select the other motion, and exclude the landmarks that follow only the main motion, and their cells."""
    only_main = motions.main.tracks.inliers & ~motions.follow_other
    return _tracked_without(pair, motions.main, motions.other, only_main, motions.main.agreement.cells(only_main))


def _tracked_without(pair: ComparedPair, of_all: Motion, other: Motion, excluded: Mask, fixed: Mask) -> Selection:
    """Select another motion: track the main motion's landmarks again from its pose, without some of them.

    The excluded landmarks `(M,)` and the fixed cells `(R, C)` do not follow this motion.
    """
    landmarks = of_all.tracks.landmarks
    motion = pair.tracked_from(landmarks.subset(~excluded), other.tracks.pose)
    return Selection(motion, is_main=False, exclusion=Exclusion.of_fixed(landmarks.rows[excluded], fixed))


# ---- the table


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


class Learns(Enum):
    """What the memory learns from a pair about the ground's motion."""

    NOTHING = auto()
    ONE_MOTION = auto()  #: How consistent the pair is with earlier pairs, and which fraction is typically unexplained.
    UNCERTAINTY = auto()  #: The ground's motion is uncertain.


class Rule(NamedTuple):
    """A case: its condition and its consequences."""

    case: Case
    condition: Callable[[Evidence], bool]  #: Whether the case applies, if no earlier rule does.
    select: Callable[[ComparedPair, Evidence], Selection]  #: Selects the motion, and what to exclude.
    finding: Finding | None = None  #: The finding of the pair.
    #: The finding while the ground is not identified, if it differs. The motion that is not selected may then be the
    #: ground's.
    finding_unidentified: Finding | None = None
    fault: Fault = Fault.NONE  #: What the pair shows about faults of the images.
    learns: Learns = Learns.NOTHING


CASE_RULES: Final = (
    # The covariance includes the unobserved motion and not the ambiguity, because the cells of the body are excluded
    # from the next pairs.
    Rule(
        Case.OWN_BODY,
        lambda evidence: evidence.off_body is not None,
        select_off_body,
        finding_unidentified=Finding.BODY_OR_GROUND,
    ),
    Rule(Case.UNTRUSTED, lambda evidence: not evidence.is_trusted, select_main_with_all),
    Rule(
        Case.TRANSFERRED,
        lambda evidence: evidence.is_transfer,
        select_main_with_all,
        Finding.PARTIAL_TRANSFER,
        Finding.TRANSFER_OR_MOTION,
        fault=Fault.TRANSFER,
    ),
    # A fault of the images does not make the ground's motion uncertain.
    Rule(
        Case.BLENDED,
        lambda evidence: evidence.is_double_exposure,
        select_main_with_all,
        Finding.DOUBLE_EXPOSURE,
        fault=Fault.SUSPECTED,
    ),
    Rule(Case.DECIDED, lambda evidence: evidence.is_decided, select_heavier),
    Rule(
        Case.UNDECIDED,
        lambda evidence: evidence.two is not None,
        select_heavier_with_all,
        Finding.AMBIGUOUS,
        fault=Fault.SUSPECTED,
        learns=Learns.UNCERTAINTY,
    ),
    Rule(
        Case.FALSE_STANDSTILL,
        lambda evidence: evidence.is_contradicted,
        select_main_with_all,
        Finding.CONTRADICTED,
        fault=Fault.SUSPECTED,
        learns=Learns.UNCERTAINTY,
    ),
    Rule(
        Case.HALF_UNEXPLAINED,
        lambda evidence: evidence.is_half_unexplained,
        select_main,
        Finding.GROUND_UNCERTAIN,
        fault=Fault.SUSPECTED,
        learns=Learns.UNCERTAINTY,
    ),
    Rule(
        Case.UNUSUAL,
        lambda evidence: evidence.is_unusual and evidence.has_typical,
        select_main,
        Finding.UNEXPLAINED,
        Finding.GROUND_UNCERTAIN,
    ),
    Rule(
        Case.UNCONFIRMED_AT_REST,
        lambda evidence: evidence.stays_uncertain and not evidence.main.agreement.moves_image,
        select_main,
        Finding.AT_REST_UNCERTAIN,
        fault=Fault.SUSPECTED,
        learns=Learns.ONE_MOTION,
    ),
    Rule(
        Case.UNCONFIRMED,
        lambda evidence: evidence.stays_uncertain,
        select_main,
        Finding.GROUND_UNCERTAIN,
        fault=Fault.SUSPECTED,
        learns=Learns.ONE_MOTION,
    ),
    Rule(Case.ONE_MOTION, lambda _: True, select_main, learns=Learns.ONE_MOTION),
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
