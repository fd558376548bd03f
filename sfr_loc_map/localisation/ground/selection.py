"""Selection of the ground's motion among the rigid motions in an image.

Another rigid motion is searched for among the landmarks that the pose does not explain. The motion of the ground is the
one that more landmarks follow and that continues the previous motion. Landmarks of the other motion (own body, dirt on
the lens, moving objects) are no longer tracked, and their image cells are excluded for several pairs. If the evidence
does not distinguish the two motions, the pose is ambiguous. The package docstring defines the terms and the phases.

`GroundSelector.begin_change` compares the left image with an earlier image, cell by cell, while landmarks are tracked.
`GroundSelector.select` works in four steps:

1. Gather the `Evidence` of the tracks and of the comparison (`evidence`). If many landmarks are unexplained,
   all are first tracked again from the pose of the main motion.
2. Determine the case (`cases.case_of`) and its effect (`cases.effect_of`).
3. Select the tracks that follow the ground, and the landmarks and cells to exclude, by the case (`_selection`).
4. Return the findings (`cases.findings_of`) and the memory for the next pair (`GroundMemory.after`).

In the following examples the rover moves in each pair.

An object with a quarter of the landmarks enters the view while the ground is identified:

| pair | shows | case | finding | memory after the pair |
|---|---|---|---|---|
| 1 | two motions | `TWO_MOTIONS` | none | cells of the object are excluded for seven pairs; still identified |
| 2 | one motion; no landmark is left on the object | `ONE_MOTION` | none | unchanged |

The same object enters the view before the ground is identified:

| pair | shows | case | finding | memory after the pair |
|---|---|---|---|---|
| 1 | two motions | `AMBIGUOUS` | `AMBIGUOUS` | in doubt; ten agreeing pairs are required; recovery takes three pairs |
| 2 to 10 | one motion, also where the object was | `STILL_IN_DOUBT` | `GROUND_IN_DOUBT` | one to nine pairs agreed |
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
from sfr_loc_map.localisation.findings import Finding, Findings, Verdict
from sfr_loc_map.localisation.frontend.stereo_frame import StereoFrame
from sfr_loc_map.localisation.frontend.tracking import Tracks
from sfr_loc_map.localisation.ground.cases import Case, case_of, effect_of, findings_of
from sfr_loc_map.localisation.ground.cell_change import LEVEL, Change, change_of
from sfr_loc_map.localisation.ground.cell_motion import MOVED_PX
from sfr_loc_map.localisation.ground.double_exposure import MIXTURE_LEVEL
from sfr_loc_map.localisation.ground.evidence import CLEAR_RATIO, Evidence
from sfr_loc_map.localisation.ground.identification import Fault, Phase
from sfr_loc_map.localisation.ground.memory import MIN_EXCESS, EarlierImage, Effect, GroundMemory
from sfr_loc_map.localisation.ground.motion_tools import ComparedPair, MotionTools
from sfr_loc_map.localisation.motion_model import Prediction
from sfr_loc_map.localisation.motion_size import MotionSize, size_between
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
NO_ROWS = np.zeros(0, np.intp)  #: No landmarks.


class Selection(NamedTuple):
    """Tracks that follow the ground, and landmarks and cells that do not."""

    tracks: Tracks
    motion_px: float  #: Image motion from the compared image to the pose of the tracks, px.
    is_main: bool = True  #: Whether the tracks follow the main motion.
    not_ground: NDArray[np.intp] = NO_ROWS  #: `(N,)` window rows of the landmarks that do not move with the ground.
    fixed: Mask | None = None  #: `(R, C)` cells that are fixed to the camera.
    dynamic: Mask | None = None  #: `(R, C)` cells that move differently from the ground.
    other_distance: MotionSize = MotionSize(0.0, 0.0)  #: Distance to the pose of the other motion.

    @property
    def is_moving(self) -> bool:
        """Whether the pose is trusted and the image moved."""
        return self.tracks.is_trusted and self.motion_px > MOVED_PX


class Ground(NamedTuple):
    """The ground's motion in a pair."""

    tracks: Tracks  #: Tracks that follow the ground.
    findings: Findings
    not_ground: NDArray[np.intp]  #: `(N,)` window rows of the landmarks that do not move with the ground.
    other_distance: MotionSize  #: Distance to the pose of another possible motion; zero if none was found.
    before: GroundMemory  #: Memory before the pair.
    learnt: GroundMemory  #: Memory with what the pair shows.
    next_earlier: EarlierImage | None  #: Earlier image of the next pairs if they may be compared with this pair.
    outlasts_refusal: bool = False  #: Whether the memory learns from the pair although its pose is refused.

    @classmethod
    def unselected(cls, tracks: Tracks, memory: GroundMemory) -> Ground:
        """Return all tracks as those of the ground, without a comparison with earlier pairs.

        A doubt persists, and the recovery from earlier faults makes no progress.
        """
        assert memory.earlier is not None, "a window has begun"
        earlier = memory.earlier._replace(age=memory.earlier.age + 1)
        learnt = replace(memory, earlier=earlier, previous=None)
        is_in_doubt = memory.identification.phase is Phase.IN_DOUBT
        effect = Effect(Finding.GROUND_IN_DOUBT) if is_in_doubt else Effect()
        findings = findings_of(effect, memory, is_trusted=tracks.is_trusted, is_moving=True)
        return cls(tracks, findings, NO_ROWS, MotionSize(0.0, 0.0), memory, learnt, earlier)

    def memory_after(self, verdict: Verdict) -> GroundMemory:
        """Return the memory after the pair.

        After a refused pair, the previous image is that at the last accepted pose.
        """
        if not verdict.refuses:
            return replace(self.learnt, earlier=self.next_earlier) if verdict.can_be_reference else self.learnt
        return replace(self.learnt, previous=self.before.previous) if self.outlasts_refusal else self.before


class GroundSelector:
    """Selects the ground's motion. No state is kept between calls."""

    def __init__(self, tools: MotionTools) -> None:
        self._tools = tools

    def begin_change(self, frame: StereoFrame, memory: GroundMemory) -> Pending[Change]:
        """Start to compare the left image with an earlier image, cell by cell, while the landmarks are tracked."""
        assert memory.earlier is not None, "a window has begun"
        return beside(change_of, memory.earlier.image, frame.left[LEVEL].image)

    def select(
        self,
        frame: StereoFrame,
        main: Tracks,
        prediction: Prediction,
        memory: GroundMemory,
        recovery: RecoveryImages,
        change: Change,
    ) -> Ground:
        """Return the ground's motion in a pair. The main tracks may follow any motion, trusted or not."""
        assert memory.earlier is not None, "a window has begun"
        earlier = memory.earlier._replace(age=memory.earlier.age + 1)
        far_px = FAR_RATIO * self._tools.shape[1] * earlier.age if memory.is_clear else np.inf
        pair = ComparedPair(frame, prediction, recovery, change, earlier.pose, far_px)
        evidence = self._evidence(pair, main, memory)
        case = case_of(evidence)
        effect = effect_of(case, memory)
        selection = self._selection(case, evidence)
        is_trusted = selection.tracks.is_trusted
        findings = findings_of(effect, memory, is_trusted=is_trusted, is_moving=selection.is_moving)
        excluded = memory.excluded.after_selection(
            selection.fixed,
            selection.dynamic,
            change.stationary,
            self._tools.shape,
            has_excluded=len(selection.not_ground) > 0,
        )
        learnt = memory.after(
            effect,
            evidence.main_motion,
            excluded=excluded,
            earlier=earlier,
            image=frame.left[MIXTURE_LEVEL].image,
            is_moving=selection.is_moving,
        )
        next_earlier = earlier if effect.fault is Fault.TRANSFER else self._earlier_after(pair, selection, earlier)
        return Ground(
            tracks=selection.tracks,
            findings=findings,
            not_ground=selection.not_ground,
            other_distance=selection.other_distance,
            before=memory,
            learnt=learnt,
            next_earlier=next_earlier,
            outlasts_refusal=effect.outlasts_refusal,
        )

    def _evidence(self, pair: ComparedPair, main: Tracks, memory: GroundMemory) -> Evidence:
        """Return the evidence. If many landmarks are unexplained, all are tracked again from the main pose."""
        explained = self._tools.explained(pair, main)
        if main.is_trusted and explained.unexplained_fraction > MIN_EXCESS:
            again = self._tools.refined(pair, main.landmarks, main.pose)
            if again.inlier_count > CLEAR_RATIO * main.inlier_count:
                main = again
                explained = self._tools.explained(pair, again)
        return Evidence(self._tools, pair, main, explained, memory)

    def _earlier_after(self, pair: ComparedPair, selection: Selection, earlier: EarlierImage) -> EarlierImage:
        """Return the image that the next pair is compared with if this pair is not partially transferred."""
        shows_fixed = selection.motion_px > COMPARED_PX
        if shows_fixed or not selection.is_main or earlier.age > COMPARED_PAIRS:
            return EarlierImage(pair.frame.left[LEVEL].image, selection.tracks.pose)
        return earlier

    # ---- the tracks of a case

    def _selection(self, case: Case, evidence: Evidence) -> Selection:
        """Return the tracks that follow the ground, and what to exclude, by the case."""
        match case:
            case Case.OWN_BODY:
                return self._off_own_body(evidence)
            case Case.AMBIGUOUS:
                return self._either_of_two(evidence)
            case Case.TWO_MOTIONS:
                return self._other_of_two(evidence) if evidence.other_wins else self._main_of_two(evidence)
            case Case.UNTRUSTED | Case.PARTIAL_TRANSFER | Case.DOUBLE_EXPOSURE | Case.CONTRADICTED:
                return Selection(evidence.main, evidence.explained.motion_px)
            case (
                Case.HALF_UNEXPLAINED | Case.UNEXPLAINED | Case.AT_REST_IN_DOUBT | Case.STILL_IN_DOUBT | Case.ONE_MOTION
            ):
                explained = evidence.explained
                not_ground = evidence.main.landmarks.rows[explained.on_fixed]
                return Selection(evidence.main, explained.motion_px, not_ground=not_ground, fixed=explained.fixed_cells)

    def _off_own_body(self, evidence: Evidence) -> Selection:
        """Select the motion of the landmarks outside stationary cells, and exclude the landmarks in these cells.

        The host cell of such a landmark is fixed to the camera if the motion would have moved the landmark. Without
        these cells, a keyframe would create new landmarks on the body.
        """
        off_stationary = _present(evidence.motion_off_stationary)
        on_stationary = evidence.explained.on_stationary
        of_ground = self._tools.explained(evidence.pair, replace(evidence.main, pose=off_stationary.pose))
        fixed = self._tools.cells(of_ground.host_cell_index[on_stationary & of_ground.are_moved])
        fixed |= self._tools.explained(evidence.pair, off_stationary).fixed_cells
        return self._tracked_again(evidence, off_stationary, on_stationary, fixed)

    def _either_of_two(self, evidence: Evidence) -> Selection:
        """Select the motion with more weight. Exclude nothing, because the other motion may be the ground's."""
        other = _present(evidence.other)
        distance = size_between(evidence.main.pose, other.pose)
        if not evidence.other_wins:
            return Selection(evidence.main, evidence.explained.motion_px, other_distance=distance)
        tracks = self._tools.refined(evidence.pair, evidence.main.landmarks, other.pose)
        motion_px = self._tools.explained(evidence.pair, tracks).motion_px
        return Selection(tracks, motion_px, is_main=False, other_distance=distance)

    def _other_of_two(self, evidence: Evidence) -> Selection:
        """Select the other motion, and exclude the landmarks that follow only the main motion, and their cells."""
        only_main = evidence.main.inliers & ~evidence.follows_other
        fixed = self._tools.cells(evidence.explained.cell_index[only_main])
        return self._tracked_again(evidence, _present(evidence.other), only_main, fixed)

    def _main_of_two(self, evidence: Evidence) -> Selection:
        """Select the main motion, and exclude what follows the other motion or is fixed to the camera."""
        other = _present(evidence.other)
        fixed = evidence.explained.fixed_cells
        dynamic = self._tools.cells(self._tools.explained(evidence.pair, other).cell_index[other.inliers])
        not_ground = evidence.main.landmarks.rows[evidence.follows_other | evidence.explained.on_fixed]
        motion_px = evidence.explained.motion_px
        return Selection(evidence.main, motion_px, not_ground=not_ground, fixed=fixed, dynamic=dynamic & ~fixed)

    def _tracked_again(self, evidence: Evidence, other: Tracks, excluded: Mask, fixed: Mask) -> Selection:
        """Select another motion: track the main tracks' landmarks again from its pose, without some of them.

        The excluded landmarks `(M,)` and the fixed cells `(R, C)` do not follow this motion.
        """
        landmarks = evidence.main.landmarks
        tracks = self._tools.refined(evidence.pair, landmarks.subset(~excluded), other.pose)
        motion_px = self._tools.explained(evidence.pair, tracks).motion_px
        return Selection(tracks, motion_px, is_main=False, not_ground=landmarks.rows[excluded], fixed=fixed)


def _present(tracks: Tracks | None) -> Tracks:
    """Return the tracks of another motion, which the case guarantees."""
    assert tracks is not None, "the case has another motion"
    return tracks
