"""Selection of the ground's motion in a pair: the order of the steps (`GroundSelector.select`).

| step | function | result |
|---|---|---|
| 1 | `GroundSelector.begin_change`, in a second thread | `Change`: cells that changed since an earlier image |
| 2 | `searches.main_motion` | `Motion`: the main tracks, and how far their motion agrees with the pair |
| 3 | `evidence.evidence_of` | `Evidence`: conditions of the pair and of the memory |
| 4 | `cases.case_of`, which may search for other motions | `Case`, with the motions that it found |
| 5 | `selection_of` | `Selection`: tracks that follow the ground, and what is excluded |
| 6 | `cases.effect_of`, `GroundMemory.after` | `NextMemory` |
| 7 | `cases.findings_of` | the findings of the pair: at most one |

If the left image is frozen, or if rows are stale, no motion is selected (`Ground.unselected`).

In the following examples the rover moves in each pair.

An object with a quarter of the landmarks is in view for one pair while the ground is identified:

| pair | shows | case | finding | memory after the pair |
|---|---|---|---|---|
| 1 | two motions | `Decided` | none | cells of the object are excluded for seven pairs; still identified |
| 2 | one motion; no landmark is left on the object | `ONE_MOTION` | none | unchanged |

The same object is in view for one pair before the ground is identified:

| pair | shows | case | finding | memory after the pair |
|---|---|---|---|---|
| 1 | two motions | `Ambiguous` | `AMBIGUOUS` | in doubt; ten agreeing pairs are required; recovery takes three pairs |
| 2 to 10 | one motion, also where the object was | `IN_DOUBT` | `GROUND_IN_DOUBT` | one to nine pairs agreed |
| 11 | one motion | `ONE_MOTION` | `RECOVERING` | learning; recovery takes two more pairs |
| 12 | one motion | `ONE_MOTION` | `RECOVERING` | one pair agreed; recovery takes one more pair |
| 13 | one motion | `ONE_MOTION` | none | two pairs agreed; the next one identifies the ground |

The lower half of one image repeats the previous image, with new noise, while the ground is identified:

| pair | shows | case | finding | memory after the pair |
|---|---|---|---|---|
| 1 | two motions, one of them a standstill | `PARTIAL_TRANSFER` | `PARTIAL_TRANSFER` | one transfer |
| 2 | one motion; half the usual excess would be unusual | `ONE_MOTION` | none | no transfer |
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import Mask
from sfr_loc_map.localisation.findings import Finding
from sfr_loc_map.localisation.frontend.stereo_frame import StereoFrame
from sfr_loc_map.localisation.frontend.tracking import Tracks
from sfr_loc_map.localisation.ground import cases, searches
from sfr_loc_map.localisation.ground.cell_change import LEVEL, Change, change_of
from sfr_loc_map.localisation.ground.double_exposure import MIXTURE_LEVEL
from sfr_loc_map.localisation.ground.evidence import evidence_of
from sfr_loc_map.localisation.ground.excluded_cells import Exclusion
from sfr_loc_map.localisation.ground.identification import Fault
from sfr_loc_map.localisation.ground.memory import EarlierImage, GroundMemory, NextMemory
from sfr_loc_map.localisation.ground.motion_tools import ComparedPair, Motion, MotionTools
from sfr_loc_map.localisation.ground.two_motions import TwoMotions
from sfr_loc_map.localisation.motion_model import Prediction
from sfr_loc_map.localisation.motion_size import MotionSize
from sfr_loc_map.localisation.relocalisation import RecoveryImages
from sfr_loc_map.parallel import Pending, beside

COMPARED_PX = 3.0
"""Image motion, px, above which cells fixed to the camera are detected, and the compared image is replaced. Chosen by
hand: it exceeds `cell_motion.MOVED_PX`, the motion at which a cell counts as moved, so that most cells have moved."""
COMPARED_PAIRS = 10
"""Number of pairs after which the compared image is replaced at any speed, because light and exposure change. Chosen by
hand. If larger, such changes count as changes of the scene. If smaller, fixed cells are not detected in slow motion."""
FAR_RATIO = 0.06
"""Image motion per pair, as a fraction of the width, above which a landmark is often not found again. Slightly above
the flow that triggers a keyframe (`keyframes.KEYFRAME_FLOW`)."""
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
    memory: NextMemory  #: The memory after the pair.

    @classmethod
    def unselected(cls, tracks: Tracks, memory: GroundMemory) -> Ground:
        """Return all tracks as those of the ground, without a comparison with earlier pairs.

        A doubt, or a recovery from earlier faults, is reported again.
        """
        return cls(
            tracks=tracks,
            findings=cases.findings_unselected(memory, is_trusted=tracks.is_trusted),
            not_ground=np.zeros(0, np.intp),
            other_distance=NO_DISTANCE,
            memory=NextMemory.of_unselected(memory),
        )


class GroundSelector:
    """Selects the ground's motion. No state is kept between calls."""

    def __init__(self, tools: MotionTools) -> None:
        self._tools = tools

    def begin_change(self, frame: StereoFrame, memory: GroundMemory) -> Pending[Change]:
        """Start to compare the left image with an earlier image, cell by cell, while the landmarks are tracked."""
        return beside(change_of, memory.earlier.image, frame.left[LEVEL].image)

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

        main = searches.main_motion(pair, tracks)
        evidence = evidence_of(main, memory)
        case = cases.case_of(pair, main, evidence, memory)
        selection = selection_of(case, pair, main)

        effect = cases.effect_of(case, evidence)
        learnt = memory.after(
            effect,
            evidence.support,
            is_moving=selection.is_moving,
            excluded=memory.excluded.after_pair(selection.exclusion, change.stationary, tools.shape),
            image=frame.left[MIXTURE_LEVEL].image,
        )
        next_earlier = _next_earlier(frame, selection, earlier, effect.fault)
        is_trusted = selection.motion.tracks.is_trusted
        return Ground(
            tracks=selection.motion.tracks,
            findings=cases.findings_of(effect, learnt.faults, is_trusted=is_trusted),
            not_ground=selection.exclusion.rows,
            other_distance=selection.other_distance,
            memory=NextMemory.of_selected(memory, learnt, next_earlier, outlasts_refusal=effect.outlasts_refusal),
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


def selection_of(case: cases.Case, pair: ComparedPair, main: Motion) -> Selection:
    """Return the motion that is used as the ground's, and what to exclude, by the case."""
    match case:
        case cases.OwnBody(off_body):
            return _off_body(pair, main, off_body)
        case cases.Ambiguous(motions):
            return _either_of_two(pair, motions)
        case cases.Decided(motions):
            return _other_of_two(pair, motions) if motions.other_wins else _main_of_two(motions)
        case cases.MainCase():
            return _main(pair, main, case)


def _main(pair: ComparedPair, main: Motion, case: cases.MainCase) -> Selection:
    """Select the main motion. Exclude what is fixed to the camera, if the case shows what is fixed."""
    if case in cases.EXCLUDES_NOTHING:
        return Selection(main, is_main=True, exclusion=Exclusion.nothing(pair.change.stationary.shape))
    rows = main.tracks.landmarks.rows[main.agreement.on_fixed]
    return Selection(main, is_main=True, exclusion=Exclusion.of_fixed(rows, main.agreement.fixed_cells))


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
    """Select the motion with more weight. Exclude nothing, because the other motion may be the ground's."""
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
