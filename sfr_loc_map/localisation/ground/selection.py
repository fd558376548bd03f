"""Selection of the ground's motion in a pair: the order of the steps (`GroundSelector.select`).

| step | function | result |
|---|---|---|
| 1 | `changed_cells`, beside the tracking | `Change`: cells that changed since an earlier image |
| 2 | `searches.main_motion` | `Motion`: the main tracks, and how far their motion agrees with the pair |
| 3 | `evidence.evidence_of`, which may search for other motions | `Evidence` |
| 4 | `cases.rule_of` | `Rule`: the case of the pair, with its consequences |
| 5 | `selection_of` | `Selection`: tracks that follow the ground, and what is excluded |
| 6 | `learnt_from` | `GroundMemory` after the pair |
| 7 | `cases.findings_of` | the findings of the pair: at most one |

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
| 1 | two motions | `UNDECIDED` | `AMBIGUOUS` | uncertain for ten consistent pairs; recovery takes three pairs |
| 2 to 10 | one motion, also where the object was | `UNCONFIRMED` | `GROUND_UNCERTAIN` | one to nine consistent pairs |
| 11 | one motion | `ONE_MOTION` | `RECOVERING` | learning; recovery takes two more pairs |
| 12 | one motion | `ONE_MOTION` | `RECOVERING` | one consistent pair; recovery takes one more pair |
| 13 | one motion | `ONE_MOTION` | none | two consistent pairs; the next one identifies the ground |

The lower half of one image repeats the previous image, with new noise, while the ground is identified:

| pair | shows | case | finding | memory after the pair |
|---|---|---|---|---|
| 1 | two motions, one of them a standstill | `TRANSFERRED` | `PARTIAL_TRANSFER` | one transfer |
| 2 | one motion; half the usual excess would be unusual | `ONE_MOTION` | none | no transfer |
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatImage, Mask
from sfr_loc_map.localisation.findings import Finding
from sfr_loc_map.localisation.frontend.stereo_frame import StereoFrame
from sfr_loc_map.localisation.frontend.tracking import Tracks
from sfr_loc_map.localisation.ground import cases, searches
from sfr_loc_map.localisation.ground.cell_change import LEVEL, Change, change_of
from sfr_loc_map.localisation.ground.double_exposure import MIXTURE_LEVEL
from sfr_loc_map.localisation.ground.evidence import Evidence, evidence_of
from sfr_loc_map.localisation.ground.excluded_cells import ExcludedCells, Exclusion
from sfr_loc_map.localisation.ground.identification import Consistency, Fault
from sfr_loc_map.localisation.ground.memory import EarlierImage, GroundMemory, NextMemory
from sfr_loc_map.localisation.ground.motion_tools import ComparedPair, Motion, MotionTools
from sfr_loc_map.localisation.ground.searches import TwoMotions
from sfr_loc_map.localisation.ground.thresholds import COMPARED_PAIRS, COMPARED_PX, FAR_RATIO
from sfr_loc_map.localisation.motion_model import Prediction
from sfr_loc_map.localisation.motion_size import MotionSize
from sfr_loc_map.localisation.relocalisation import RecoveryImages

NO_DISTANCE = MotionSize(0.0, 0.0)


class Selection(NamedTuple):
    """The motion that is used as the ground's, and what does not follow this motion."""

    motion: Motion
    is_main: bool  #: Whether the motion is the main motion.
    exclusion: Exclusion  #: Landmarks and cells that do not move with the ground.
    other_distance: MotionSize = NO_DISTANCE  #: Distance to the pose of another possible motion; zero if none.

    @property
    def is_moving(self) -> bool:
        """Whether the pose is trusted and the image moved."""
        return self.motion.tracks.is_trusted and self.motion.agreement.moves_image


class Ground(NamedTuple):
    """The ground's motion in a pair."""

    tracks: Tracks  #: Tracks that follow the ground.
    findings: frozenset[Finding]
    not_ground: NDArray[np.intp]  #: `(N,)` window rows of the landmarks that do not move with the ground.
    other_distance: MotionSize  #: Distance to the pose of another possible motion; zero if none was found.
    next_memory: NextMemory  #: The memory after the pair, by the verdict on the pair.

    @classmethod
    def unselected(cls, tracks: Tracks, memory: GroundMemory) -> Ground:
        """Return all tracks as those of the ground, without a comparison with earlier pairs.

        An uncertainty, or a recovery from earlier faults, is reported again.
        """
        return cls(
            tracks=tracks,
            findings=cases.findings_unselected(memory, is_trusted=tracks.is_trusted),
            not_ground=np.zeros(0, np.intp),
            other_distance=NO_DISTANCE,
            next_memory=NextMemory.of_unselected(memory),
        )


def changed_cells(frame: StereoFrame, memory: GroundMemory) -> Change:
    """Compare the left image with an earlier image, cell by cell. No pose is required."""
    return change_of(memory.earlier.image, frame.left[LEVEL].image)


class GroundSelector:
    """Selects the ground's motion. No state is kept between calls."""

    def __init__(self, tools: MotionTools) -> None:
        self._tools = tools

    def select(
        self,
        frame: StereoFrame,
        tracks: Tracks,
        prediction: Prediction,
        memory: GroundMemory,
        recovery: RecoveryImages,
        change: Change,
    ) -> Ground:
        """Return the ground's motion in a pair. The tracks may follow any motion, trusted or not."""
        tools = self._tools
        earlier = memory.earlier
        far_px = FAR_RATIO * tools.shape[1] * earlier.age if memory.is_clear else np.inf
        pair = ComparedPair(tools, frame, prediction, recovery, change, earlier.pose, far_px)

        evidence = evidence_of(pair, searches.main_motion(pair, tracks), memory)
        rule = cases.rule_of(evidence)
        selection = selection_of(rule.selects, pair, evidence)

        excluded = memory.excluded.after_pair(selection.exclusion, change.stationary, tools.shape)
        learnt = learnt_from(memory, rule, evidence, selection, excluded, frame.left[MIXTURE_LEVEL].image)
        next_earlier = _next_earlier(frame, selection, earlier, rule.fault)
        is_identified = evidence.is_identified
        is_trusted = selection.motion.tracks.is_trusted
        return Ground(
            tracks=selection.motion.tracks,
            findings=cases.findings_of(rule, learnt.faults, is_identified=is_identified, is_trusted=is_trusted),
            not_ground=selection.exclusion.rows,
            other_distance=selection.other_distance,
            next_memory=NextMemory.of_selected(memory, learnt, next_earlier, outlasts_refusal=rule.outlasts_refusal),
        )


def learnt_from(
    memory: GroundMemory,
    rule: cases.Rule,
    evidence: Evidence,
    selection: Selection,
    excluded: ExcludedCells,
    image: FloatImage,
) -> GroundMemory:
    """Return the memory with what a pair shows, by the rule of its case."""
    support = evidence.support
    identification = memory.identification
    typical = memory.typical
    if rule.learns is cases.Learns.UNCERTAINTY:
        identification = identification.after(Consistency.INCONSISTENT, support.unexplained_cells)
    elif rule.learns is cases.Learns.ONE_MOTION:
        identification = evidence.after_one_motion
        typical = memory.typical_after(support.unexplained_fraction)
    return memory.selected(
        identification=identification,
        faults=memory.faults.after(rule.fault, is_moving=selection.is_moving),
        typical=typical,
        excluded=excluded,
        image=image,
    )


def _next_earlier(frame: StereoFrame, selection: Selection, earlier: EarlierImage, fault: Fault) -> EarlierImage:
    """Return the image that the next pair is compared with: the present left image, or the earlier image again."""
    if fault is Fault.TRANSFER:
        return earlier.older()
    shows_fixed = selection.motion.agreement.motion_px > COMPARED_PX
    if shows_fixed or not selection.is_main or earlier.age > COMPARED_PAIRS:
        return EarlierImage(frame.left[LEVEL].image, selection.motion.tracks.pose)
    return earlier.older()


# ---- the tracks of a case


def selection_of(selects: cases.Selects, pair: ComparedPair, evidence: Evidence) -> Selection:
    """Return the motion that is used as the ground's, and what to exclude, as the rule of the case says."""
    main = evidence.main
    match selects:
        case cases.Selects.MAIN:
            rows = main.tracks.landmarks.rows[main.agreement.on_fixed]
            return Selection(main, is_main=True, exclusion=Exclusion.of_fixed(rows, main.agreement.fixed_cells))
        case cases.Selects.MAIN_WITH_ALL:
            return Selection(main, is_main=True, exclusion=Exclusion.nothing(pair.change.stationary.shape))
        case cases.Selects.OFF_BODY:
            assert evidence.off_body is not None, "the condition of the case"
            return _off_body(pair, main, evidence.off_body)
        case cases.Selects.HEAVIER:
            assert evidence.two is not None, "the condition of the case"
            return _other_of_two(pair, evidence.two) if evidence.two.other_wins else _main_of_two(evidence.two)
        case cases.Selects.HEAVIER_WITH_ALL:
            assert evidence.two is not None, "the condition of the case"
            return _either_of_two(pair, evidence.two)


def _off_body(pair: ComparedPair, main: Motion, off_body: Motion) -> Selection:
    """Select the motion of the landmarks outside stationary cells, and exclude the landmarks in these cells.

    The host cell of such a landmark is fixed to the camera if the motion would have moved the landmark. Without these
    cells, a keyframe would create new landmarks on the body.
    """
    on_stationary = main.agreement.on_stationary
    all_off_body = pair.motion(replace(main.tracks, pose=off_body.tracks.pose)).agreement
    fixed = all_off_body.host_cells(on_stationary & all_off_body.are_moved) | off_body.agreement.fixed_cells
    return _tracked_without(pair, main, off_body, on_stationary, fixed)


def _either_of_two(pair: ComparedPair, motions: TwoMotions) -> Selection:
    """Select the motion with more weight, and exclude nothing."""
    motion = motions.main
    if motions.other_wins:
        motion = pair.tracked_from(motions.main.tracks.landmarks, motions.other.tracks.pose)
    nothing = Exclusion.nothing(pair.change.stationary.shape)
    return Selection(motion, is_main=not motions.other_wins, exclusion=nothing, other_distance=motions.distance)


def _main_of_two(motions: TwoMotions) -> Selection:
    """Select the main motion, and exclude what follows the other motion or is fixed to the camera."""
    main = motions.main
    other = motions.other
    fixed = main.agreement.fixed_cells
    dynamic = other.agreement.cells(other.tracks.inliers) & ~fixed
    rows = main.tracks.landmarks.rows[motions.follow_other | main.agreement.on_fixed]
    return Selection(main, is_main=True, exclusion=Exclusion(rows, fixed, dynamic))


def _other_of_two(pair: ComparedPair, motions: TwoMotions) -> Selection:
    """Select the other motion, and exclude the landmarks that follow only the main motion, and their cells."""
    main = motions.main
    only_main = main.tracks.inliers & ~motions.follow_other
    return _tracked_without(pair, main, motions.other, only_main, main.agreement.cells(only_main))


def _tracked_without(pair: ComparedPair, main: Motion, other: Motion, excluded: Mask, fixed: Mask) -> Selection:
    """Select another motion: track the main tracks' landmarks again from its pose, without some of them.

    The excluded landmarks `(M,)` and the fixed cells `(R, C)` do not follow this motion.
    """
    landmarks = main.tracks.landmarks
    motion = pair.tracked_from(landmarks.subset(~excluded), other.tracks.pose)
    return Selection(motion, is_main=False, exclusion=Exclusion.of_fixed(landmarks.rows[excluded], fixed))
