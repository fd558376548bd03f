"""Selection of the ground's motion in a pair: the table of the cases, and what each case selects.

`select_ground` contains the steps of a pair. `CASES` is the table, and the first case whose condition is true for the
evidence of a pair decides. The case states which motion is the ground's, what is excluded, which finding the pair has,
and what the memory learns. A new case requires a row in `CASES`, and if its condition is new, a field of `Evidence`.

If the left image is frozen, or if rows are stale, no motion is selected (`Ground.unselected`).

In the following examples the rover moves in each pair.

An object with a quarter of the landmarks is in view for one pair while the ground is identified:

| pair | shows | case | finding | memory after the pair |
|---|---|---|---|---|
| 1 | two motions | `DECIDED` | none | cells of the object are excluded for seven pairs; still identified |
| 2 | one motion; no landmark is left on the object | `ONE_MOTION` | none | unchanged |

The same object is in view for one pair before the ground is identified:

| pair | shows | case | finding | memory after the pair |
|---|---|---|---|---|
| 1 | two motions | `AMBIGUOUS` | `AMBIGUOUS` | uncertain for ten consistent pairs; recovery takes three pairs |
| 2 to 10 | one motion in all cells | `GROUND_UNCERTAIN` | `GROUND_UNCERTAIN` | one to nine consistent pairs |
| 11 | one motion | `ONE_MOTION` | `RECOVERING` | learning; recovery takes two more pairs |
| 12 | one motion | `ONE_MOTION` | `RECOVERING` | one consistent pair; recovery takes one more pair |
| 13 | one motion | `ONE_MOTION` | none | two consistent pairs; the next one identifies the ground |

The lower half of one image repeats the previous image, with new noise, while the ground is identified:

| pair | shows | case | finding | memory after the pair |
|---|---|---|---|---|
| 1 | two motions, one of them a standstill | `PARTIAL_TRANSFER` | `PARTIAL_TRANSFER` | one transfer |
| 2 | one motion; half the usual excess would be unusual | `ONE_MOTION` | none | no transfer |
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import Mask
from sfr_loc_map.localisation.findings import Finding
from sfr_loc_map.localisation.frontend.right_camera import RightCameraOffset
from sfr_loc_map.localisation.frontend.stereo_frame import StereoFrame
from sfr_loc_map.localisation.frontend.tracking import Tracks
from sfr_loc_map.localisation.ground.cell_change import LEVEL, Change, change_of
from sfr_loc_map.localisation.ground.evidence import Evidence, TwoMotions, evidence_of
from sfr_loc_map.localisation.ground.memory import GroundMemory, Shown
from sfr_loc_map.localisation.ground.rigid_motion import (
    FAR_RATIO,
    ComparedPair,
    Exclusion,
    Motion,
    MotionTools,
    Selection,
)
from sfr_loc_map.localisation.motion_model import Prediction
from sfr_loc_map.localisation.motion_size import NO_MOTION, MotionSize
from sfr_loc_map.localisation.relocalisation import RecoveryImages


class Ground(NamedTuple):
    """The ground's motion in a pair."""

    tracks: Tracks  #: Tracks that follow the ground.
    findings: frozenset[Finding]  #: At most one finding.
    not_ground: NDArray[np.intp]  #: `(N,)` window rows of the landmarks that do not move with the ground.
    other_distance: MotionSize  #: Distance to the pose of another possible motion; zero if none was found.
    learnt: GroundMemory  #: The memory after the pair, before the verdict (`GroundMemory.after_verdict`).

    @classmethod
    def unselected(cls, tracks: Tracks, memory: GroundMemory) -> Ground:
        """Return all tracks as those of the ground, without a comparison with earlier pairs.

        The pair ends neither an uncertainty of the ground nor a recovery from earlier faults, which are therefore
        reported again.
        """
        findings: frozenset[Finding] = frozenset()
        if memory.is_uncertain:
            findings = frozenset({Finding.GROUND_UNCERTAIN})
        elif tracks.is_trusted and memory.recovery_pairs > 1:
            findings = frozenset({Finding.RECOVERING})
        return cls(
            tracks=tracks,
            findings=findings,
            not_ground=np.zeros(0, np.intp),
            other_distance=NO_MOTION,
            learnt=memory.unselected(),
        )


def changed_cells(frame: StereoFrame, memory: GroundMemory) -> Change:
    """Compare the left image with an earlier image, cell by cell. No pose is required."""
    return change_of(memory.earlier.image, frame.left[LEVEL].image)


def select_ground(
    tools: MotionTools,
    frame: StereoFrame,
    tracks: Tracks,
    prediction: Prediction,
    offset: RightCameraOffset,
    memory: GroundMemory,
    recovery: RecoveryImages,
    change: Change,
) -> Ground:
    """Return the ground's motion in a pair. The tracks may follow any motion, trusted or not."""
    earlier = memory.earlier
    far_px = FAR_RATIO * tools.shape[1] * earlier.age if memory.is_clear else np.inf
    pair = ComparedPair(tools, frame, prediction, offset, recovery, change, earlier.pose, far_px)
    evidence = evidence_of(pair, tracks, memory)
    case = case_of(evidence)
    selection = case.select(pair, evidence)
    learnt = memory.after_pair(pair, evidence.main.agreement, case.shown or evidence.shown_by_main, selection)
    return Ground(
        tracks=selection.motion.tracks,
        findings=findings_of(case, evidence, after=learnt, is_trusted=selection.motion.tracks.is_trusted),
        not_ground=selection.exclusion.rows,
        other_distance=selection.other_distance,
        learnt=learnt,
    )


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
    of_all = pair.motion(tracks._replace(pose=found.tracks.pose)).agreement
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


class Case(NamedTuple):
    """A case of a pair: its condition and its consequences."""

    condition: Callable[[Evidence], bool]  #: Whether the case applies, if no earlier case does.
    select: Callable[[ComparedPair, Evidence], Selection]  #: Selects the motion, and what to exclude.
    #: What the pair shows to the memory; None for what the main motion alone shows (`Evidence.shown_by_main`).
    shown: Shown | None
    finding: Finding | None = None  #: The finding of the pair.
    #: The finding while the ground is not identified, if it differs. The motion that is not selected may then be the
    #: ground's.
    finding_unidentified: Finding | None = None
    finding_at_rest: Finding | None = None  #: The finding if the image did not move, if it differs.


OWN_BODY: Final = Case(
    lambda evidence: evidence.off_body is not None,
    select_off_body,
    Shown.NOTHING,
    finding_unidentified=Finding.BODY_OR_GROUND,
)
"""Texture fixed to the camera carries the main motion; the other landmarks follow the ground. The covariance includes
the unobserved motion and not the ambiguity, because the cells of the body are excluded from the next pairs."""
UNTRUSTED: Final = Case(lambda evidence: not evidence.is_trusted, select_main_with_all, Shown.NOTHING)
"""No motion is trusted, and the pose is refused."""
PARTIAL_TRANSFER: Final = Case(
    lambda evidence: evidence.is_transfer,
    select_main_with_all,
    Shown.PARTIAL_TRANSFER,
    Finding.PARTIAL_TRANSFER,
    finding_unidentified=Finding.TRANSFER_OR_MOTION,
)
"""Parts of the images come from different exposures."""
DOUBLE_EXPOSURE: Final = Case(
    lambda evidence: evidence.is_double_exposure, select_main_with_all, Shown.DOUBLE_EXPOSURE, Finding.DOUBLE_EXPOSURE
)
"""Two exposures are blended. The main motion is that of the dominant exposure."""
DECIDED: Final = Case(lambda evidence: evidence.is_decided, select_heavier, Shown.NOTHING)
"""There are two motions, and the motion with more weight is clearly the ground's."""
AMBIGUOUS: Final = Case(
    lambda evidence: evidence.two is not None, select_heavier_with_all, Shown.UNCERTAIN_GROUND, Finding.AMBIGUOUS
)
"""Either of two motions may be the ground's."""
CONTRADICTED: Final = Case(
    lambda evidence: evidence.is_contradicted, select_main_with_all, Shown.UNCERTAIN_GROUND, Finding.CONTRADICTED
)
"""The image changed where the only motion predicts no change. The pose is refused."""
HALF_UNEXPLAINED: Final = Case(
    lambda evidence: evidence.is_half_unexplained, select_main, Shown.UNCERTAIN_GROUND, Finding.GROUND_UNCERTAIN
)
"""About half of the landmarks, or more, do not follow the only motion."""
UNEXPLAINED: Final = Case(
    lambda evidence: evidence.is_unusual and evidence.memory.has_typical,
    select_main,
    Shown.NOTHING,
    Finding.UNEXPLAINED,
    finding_unidentified=Finding.GROUND_UNCERTAIN,
)
"""More landmarks than on earlier ground do not follow the only motion."""
GROUND_UNCERTAIN: Final = Case(
    lambda evidence: evidence.stays_uncertain,
    select_main,
    shown=None,
    finding=Finding.GROUND_UNCERTAIN,
    finding_at_rest=Finding.AT_REST_UNCERTAIN,
)
"""There is one motion, but too few consistent pairs have followed the pairs that made the ground uncertain."""
ONE_MOTION: Final = Case(lambda _: True, select_main, shown=None)
"""There is one motion, and the ground is not uncertain after the pair."""

CASES: Final = (
    OWN_BODY,
    UNTRUSTED,
    PARTIAL_TRANSFER,
    DOUBLE_EXPOSURE,
    DECIDED,
    AMBIGUOUS,
    CONTRADICTED,
    HALF_UNEXPLAINED,
    UNEXPLAINED,
    GROUND_UNCERTAIN,
    ONE_MOTION,
)
"""The cases in the order of precedence.

A case with a finding has the name of this finding. There are two exceptions: `OWN_BODY` has a finding only while the
ground is not identified, and the finding of `HALF_UNEXPLAINED` is `GROUND_UNCERTAIN`.
"""


def case_of(evidence: Evidence) -> Case:
    """Return the first case whose condition is true for the evidence of a pair."""
    return next(case for case in CASES if case.condition(evidence))


def findings_of(case: Case, evidence: Evidence, *, after: GroundMemory, is_trusted: bool) -> frozenset[Finding]:
    """Return the finding of a case, or else `RECOVERING` if faults of earlier pairs degrade this pair.

    Args:
        case: Case of the pair.
        evidence: Evidence of the pair, with the memory before the pair.
        after: Memory after the pair.
        is_trusted: Whether the pose of the selected tracks is trusted.
    """
    finding = case.finding
    if case.finding_unidentified is not None and not evidence.memory.is_identified:
        finding = case.finding_unidentified
    if case.finding_at_rest is not None and not evidence.main.agreement.moves_image:
        finding = case.finding_at_rest
    if finding is not None:
        return frozenset({finding})
    return frozenset({Finding.RECOVERING} if is_trusted and after.recovery_pairs > 0 else ())
