"""Selection of the ground's motion among the rigid motions in an image; everything else is excluded while it lasts.

The ground is identified by its motion, not by its place in the image. Landmarks that the pose does not explain are
searched for a second rigid motion. Of two motions the ground's is the one that more landmarks follow and that continues
the motion before. Landmarks and image cells of the other one (own body, dirt on the lens, moving objects) are excluded.
If the evidence does not separate the two, the pose is ambiguous.

`GroundSelector.compare` compares the left image with an earlier one, cell by cell, while the landmarks are tracked.
`GroundSelector.select` works in four steps:

1. Gather the `Evidence` of the tracks and of the comparison (`ground_evidence.py`).
2. `decide` the case: the first row that applies of `FIRST_CASES`, then of the cases with or without a rival motion.
3. Select the tracks that follow the ground, and what is excluded, by the case (`_selection`).
4. Return the findings (`findings_of`) and the memory for the next pair (`_memory_after`; `ground_memory.py`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from enum import Enum, auto
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import Mask
from sfr_loc_map.geometry.camera import Pose, StereoCamera
from sfr_loc_map.geometry.rotation import rotvec_from_matrix
from sfr_loc_map.localisation.excluded_cells import ExcludedCells
from sfr_loc_map.localisation.findings import Finding
from sfr_loc_map.localisation.frontend.cell_change import LEVEL, Change, change_of
from sfr_loc_map.localisation.frontend.cell_motion import MOVED_PX
from sfr_loc_map.localisation.frontend.double_exposure import MIXTURE_LEVEL
from sfr_loc_map.localisation.frontend.landmarks import Landmarks
from sfr_loc_map.localisation.frontend.tracking import StereoFrame, Tracker, Tracks
from sfr_loc_map.localisation.ground_evidence import CLEAR_RATIO, ComparedPair, Evidence, MotionTools
from sfr_loc_map.localisation.ground_memory import (
    MAX_MOVING,
    MIN_UNEXPLAINED,
    ComparedImage,
    Confidence,
    GroundMemory,
    Phase,
    Transfers,
)
from sfr_loc_map.localisation.motion_model import Prediction
from sfr_loc_map.localisation.parallel import Pending, beside
from sfr_loc_map.localisation.relocalisation import RecoveryImages, Relocaliser
from sfr_loc_map.localisation.uncertainty import MotionSize

COMPARED_PX = 3.0  #: Image motion, px, that shows what is fixed to the camera; the compared image is then replaced.
COMPARED_PAIRS = 10  #: Number of pairs after which the compared image is replaced, however slow the motion.
FAR_RATIO = 0.06  #: Image motion per pair, fraction of the width, above which a landmark may not be found again.
NO_ROWS = np.zeros(0, np.intp)  #: No landmarks.


class Case(Enum):
    """What a pair shows, and which tracks follow the ground."""

    OWN_BODY = auto()  #: The main motion is that of texture fixed to the camera: the other one is the ground.
    UNTRUSTED = auto()  #: No motion is trusted: the main tracks are kept and the pose is refused.
    CONTRADICTED = auto()  #: The image changed where the main motion predicts no change: the pose is refused.
    PARTIAL_TRANSFER = auto()  #: Parts of the images are of different exposures: the main motion is used.
    DOUBLE_EXPOSURE = auto()  #: Two exposures are blended: the motion of the dominant one is used.
    AMBIGUOUS = auto()  #: Two motions of unknown origin: the one with the larger weight is used.
    RIVAL = auto()  #: The rival of two motions is that of the ground.
    MAIN = auto()  #: The main one of two motions is that of the ground.
    UNCONVINCING = auto()  #: About half of the landmarks follow the only motion, while the ground is unknown.
    ONE_MOTION = auto()  #: Only one motion: its tracks, without those fixed to the camera.


Cases = tuple[tuple[Case, Callable[[Evidence], bool]], ...]
"""Rows of a case and the question that it asks; the first row that applies decides.

A row asks its question only if no row above applies.
"""

FIRST_CASES: Final[Cases] = (
    (Case.OWN_BODY, lambda e: not e.is_credible and e.beside_static is not None),
    (Case.UNTRUSTED, lambda e: not e.main.is_trusted),
    # parts of the images are stale, as those of the pair before were
    (Case.PARTIAL_TRANSFER, lambda e: e.is_unusual and not e.is_contradicted and e.repeats_transfer),
    # one exposure dominates, and its motion explains over half of the landmarks
    (Case.DOUBLE_EXPOSURE, lambda e: not e.is_contradicted and not e.is_half_unexplained and e.is_double_exposure),
)
"""Cases that are decided before a rival of the main motion is searched for."""

ONE_MOTION_CASES: Final[Cases] = (
    (Case.CONTRADICTED, lambda e: e.is_contradicted),
    (Case.PARTIAL_TRANSFER, lambda e: e.is_unusual and e.may_be_transfer and e.is_half_unexplained),
    (Case.UNCONVINCING, lambda e: e.is_half_unexplained and not e.is_known),
    (Case.ONE_MOTION, lambda e: True),
)
"""Cases without a rival."""

TWO_MOTION_CASES: Final[Cases] = (
    # one of the two is a standstill: a part of the images is that of the pair before
    (Case.PARTIAL_TRANSFER, lambda e: e.may_be_transfer and e.has_standstill),
    (Case.AMBIGUOUS, lambda e: not (e.is_known and e.is_winner_clear)),
    (Case.RIVAL, lambda e: e.rival_wins),
    (Case.MAIN, lambda e: True),
)
"""Cases with a rival."""


def decide(evidence: Evidence) -> Case:
    """Return the case of a pair."""
    for case, applies in FIRST_CASES:
        if applies(evidence):
            return case
    cases = ONE_MOTION_CASES if evidence.rival is None else TWO_MOTION_CASES
    return next(case for case, applies in cases if applies(evidence))


class Effect(NamedTuple):
    """What a case reports by itself, and what it teaches about the ground."""

    finding: Finding | None = None
    leaves_doubt: bool = False  #: Whether the ground's motion is in doubt after the pair.
    transfers: Transfers = Transfers.UNCHANGED
    #: Whether the pair can confirm the ground's motion and what is typical for it. Its findings depend on both.
    confirms: bool = False
    outlasts_refusal: bool = False  #: Whether the memory learns from the pair although its pose is refused.


EFFECTS: Final = {
    Case.OWN_BODY: Effect(),
    Case.UNTRUSTED: Effect(),
    Case.CONTRADICTED: Effect(Finding.CONTRADICTED, leaves_doubt=True, outlasts_refusal=True),
    Case.PARTIAL_TRANSFER: Effect(Finding.PARTIAL_TRANSFER, transfers=Transfers.ONE_MORE),
    Case.DOUBLE_EXPOSURE: Effect(Finding.DOUBLE_EXPOSURE),
    Case.AMBIGUOUS: Effect(Finding.AMBIGUOUS, leaves_doubt=True),
    Case.RIVAL: Effect(),
    Case.MAIN: Effect(),
    Case.UNCONVINCING: Effect(Finding.GROUND_IN_DOUBT, leaves_doubt=True, transfers=Transfers.NONE),
    Case.ONE_MOTION: Effect(transfers=Transfers.NONE, confirms=True),
}
"""What follows from the case alone.

`findings_of` adds what the selection and the memory report. `_memory_after` applies what the pair teaches.
"""


class Selection(NamedTuple):
    """Which tracks follow the ground, and what does not."""

    tracks: Tracks
    motion_px: float  #: Image motion since the compared image by the pose of the tracks, px.
    is_main: bool = True  #: Whether the tracks follow the main motion.
    is_partial: bool = False  #: Whether parts of the images are of another moment than the selected motion.
    not_ground: NDArray[np.intp] = NO_ROWS  #: `(N,)` rows in the window of landmarks that do not move with the ground.
    fixed: Mask | None = None  #: `(R, C)` cells that are fixed to the camera.
    moving: Mask | None = None  #: `(R, C)` cells that move otherwise than the ground.
    rival_distance: MotionSize = MotionSize(0.0, 0.0)  #: Distance to the pose of the motion not selected.

    @property
    def is_moving(self) -> bool:
        """Whether the pose is trusted and the image moved."""
        return self.tracks.is_trusted and self.motion_px > MOVED_PX


class Ground(NamedTuple):
    """The ground's motion in a pair."""

    tracks: Tracks  #: Tracks that follow it.
    findings: frozenset[Finding]
    not_ground: NDArray[np.intp]  #: `(N,)` rows in the window of landmarks that do not move with the ground.
    rival_distance: MotionSize  #: Distance to the pose of another possible motion; zero if none was found.
    memory: GroundMemory  #: Memory for the next pair if the pose is accepted.
    #: Memory for the next pair if it is refused: `memory` if the pair contradicts its pose, else that before the pair.
    memory_if_refused: GroundMemory
    compared: ComparedImage | None  #: Image that the next pair is compared with, if this pair may be a keyframe.

    @classmethod
    def unselected(cls, tracks: Tracks, memory: GroundMemory) -> Ground:
        """Return all tracks as the ground, without a comparison with earlier pairs."""
        accepted = replace(memory, previous=None)
        return cls(tracks, frozenset(), NO_ROWS, MotionSize(0.0, 0.0), accepted, memory, None)

    def accepted(self, *, is_compared: bool) -> GroundMemory:
        """Return the memory after the pose was accepted; whether later images may be compared with this one."""
        if self.compared is None or not is_compared:
            return self.memory
        return replace(self.memory, compared=self.compared)


class GroundSelector:
    """Selects the ground's motion. It holds the tools, and keeps no state between calls."""

    def __init__(
        self, tracker: Tracker, relocaliser: Relocaliser, camera: StereoCamera, shape: tuple[int, int], min_tracked: int
    ) -> None:
        """The shape of the images is (height, width)."""
        self._tools = MotionTools(tracker, relocaliser, camera, shape, min_tracked)

    def compare(self, frame: StereoFrame, memory: GroundMemory) -> Pending[Change]:
        """Begin to compare the left image with an earlier one, cell by cell, while the landmarks are tracked."""
        assert memory.compared is not None, "a window has begun"
        return beside(change_of, memory.compared.image, frame.left[LEVEL].image)

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
        assert memory.compared is not None, "a window has begun"
        compared = memory.compared._replace(age=memory.compared.age + 1)
        far_px = FAR_RATIO * self._tools.shape[1] * compared.age if memory.is_clear else np.inf
        pair = ComparedPair(frame, prediction, recovery, change, compared.pose, far_px)
        evidence = self._evidence(pair, main, memory)
        case = decide(evidence)
        selection = self._selection(case, evidence)
        findings = findings_of(case, evidence, selection)
        after = self._memory_after(case, evidence, selection, findings, compared)
        return Ground(
            tracks=selection.tracks,
            findings=findings,
            not_ground=selection.not_ground,
            rival_distance=selection.rival_distance,
            memory=after,
            memory_if_refused=after if EFFECTS[case].outlasts_refusal else memory,
            compared=self._compared_after(pair, selection, compared),
        )

    def _evidence(self, pair: ComparedPair, main: Tracks, memory: GroundMemory) -> Evidence:
        """Return the evidence; if much is unexplained, all landmarks are searched for again from the main pose."""
        explained = self._tools.explained(pair, main)
        if main.is_trusted and explained.unexplained_fraction > MIN_UNEXPLAINED:
            again = self._tools.tracker.refine(pair.frame, main.landmarks, main.pose, pair.prediction.offset)
            if again.inlier_count > CLEAR_RATIO * main.inlier_count:
                main = again
                explained = self._tools.explained(pair, again)
        return Evidence(self._tools, pair, main, explained, memory)

    def _compared_after(self, pair: ComparedPair, selection: Selection, compared: ComparedImage) -> ComparedImage:
        """Return the image that the next pair is compared with; a partially transferred one is not taken."""
        shows_fixed = selection.motion_px > COMPARED_PX
        is_replaced = shows_fixed or not selection.is_main or compared.age > COMPARED_PAIRS
        if not is_replaced or selection.is_partial:
            return compared
        return ComparedImage(pair.frame.left[LEVEL].image, selection.tracks.pose)

    # ---- the tracks of a case

    def _selection(self, case: Case, evidence: Evidence) -> Selection:
        """Return the tracks that follow the ground, and what does not, by the case."""
        match case:
            case Case.OWN_BODY:
                return self._beside_body(evidence)
            case Case.AMBIGUOUS:
                return self._likelier(evidence)
            case Case.RIVAL:
                return self._rival(evidence)
            case Case.MAIN:
                return self._main_of_two(evidence)
            case Case.UNCONVINCING | Case.ONE_MOTION:
                explained = evidence.explained
                not_ground = evidence.main.landmarks.index[explained.on_fixed]
                return Selection(evidence.main, explained.motion_px, not_ground=not_ground, fixed=explained.fixed_cells)
            case Case.PARTIAL_TRANSFER:
                return Selection(evidence.main, evidence.explained.motion_px, is_partial=True)
            case Case.UNTRUSTED | Case.CONTRADICTED | Case.DOUBLE_EXPOSURE:
                return Selection(evidence.main, evidence.explained.motion_px)

    def _beside_body(self, evidence: Evidence) -> Selection:
        """Select the motion beside static texture, which is excluded as the own body."""
        other = _present(evidence.beside_static)
        fixed = self._tools.explained(evidence.pair, other).fixed_cells
        return self._other(evidence, other, evidence.explained.on_static, fixed)

    def _rival(self, evidence: Evidence) -> Selection:
        """Select the rival; what follows the main motion is excluded."""
        follows_main = evidence.main.inliers & ~evidence.follows_rival
        fixed = self._tools.cells(evidence.explained.cell_index[follows_main])
        return self._other(evidence, _present(evidence.rival), follows_main, fixed)

    def _other(self, evidence: Evidence, other: Tracks, excluded: Mask, fixed: Mask) -> Selection:
        """Select another motion without the landmarks `(M,)` and cells `(R, C)` that do not follow it."""
        landmarks = evidence.main.landmarks
        tracks = self._refined(evidence, landmarks.subset(~excluded), other)
        explained = self._tools.explained(evidence.pair, tracks)
        return Selection(
            tracks,
            explained.motion_px,
            is_main=False,
            is_partial=evidence.memory.shows_other_moment(explained.unexplained_fraction),
            not_ground=landmarks.index[excluded],
            fixed=fixed,
        )

    def _likelier(self, evidence: Evidence) -> Selection:
        """Select the motion with more weight, with all landmarks: the other one may be the ground's."""
        rival = _present(evidence.rival)
        distance = pose_distance(evidence.main.pose, rival.pose)
        if not evidence.rival_wins:
            return Selection(evidence.main, evidence.explained.motion_px, rival_distance=distance)
        tracks = self._refined(evidence, evidence.main.landmarks, rival)
        motion_px = self._tools.explained(evidence.pair, tracks).motion_px
        return Selection(tracks, motion_px, is_main=False, rival_distance=distance)

    def _main_of_two(self, evidence: Evidence) -> Selection:
        """Select the main motion; what follows the rival, or is fixed to the camera, is excluded."""
        rival = _present(evidence.rival)
        fixed = evidence.explained.fixed_cells
        moving = self._tools.cells(self._tools.explained(evidence.pair, rival).cell_index[rival.inliers])
        not_ground = evidence.main.landmarks.index[evidence.follows_rival | evidence.explained.on_fixed]
        motion_px = evidence.explained.motion_px
        return Selection(evidence.main, motion_px, not_ground=not_ground, fixed=fixed, moving=moving & ~fixed)

    def _refined(self, evidence: Evidence, landmarks: Landmarks, start: Tracks) -> Tracks:
        """Track landmarks from the pose of some tracks."""
        pair = evidence.pair
        return self._tools.tracker.refine(pair.frame, landmarks, start.pose, pair.prediction.offset)

    # ---- what is remembered

    def _memory_after(
        self,
        case: Case,
        evidence: Evidence,
        selection: Selection,
        findings: frozenset[Finding],
        compared: ComparedImage,
    ) -> GroundMemory:
        """Return the memory after a pair, by its case and its findings."""
        memory = evidence.memory
        effect = EFFECTS[case]
        transfers = memory.transfers_after(effect.transfers)
        typical = memory.typical
        if effect.confirms:
            typical = memory.typical_after(evidence.explained.unexplained_fraction)
        return GroundMemory(
            excluded=self._excluded_after(evidence, selection),
            compared=compared,
            previous=evidence.pair.frame.left[MIXTURE_LEVEL].image,
            confidence=confidence_after(case, evidence),
            transfers=transfers,
            recovering_pairs=memory.recovering_after(findings, transfers, is_moving=selection.is_moving),
            typical=typical,
        )

    def _excluded_after(self, evidence: Evidence, selection: Selection) -> ExcludedCells:
        """Return the excluded cells after a pair: those of the selection, and earlier ones for a while."""
        excluded = evidence.memory.excluded
        if selection.fixed is not None and selection.fixed.any():
            excluded = excluded.with_fixed(selection.fixed)
        if selection.moving is not None:
            excluded = excluded.with_moving(selection.moving)
        if excluded.mask is None and not len(selection.not_ground):
            return excluded
        return excluded.after_pair(evidence.pair.change.stays, self._tools.shape)


def findings_of(case: Case, evidence: Evidence, selection: Selection) -> frozenset[Finding]:
    """Return all findings in a pair: those of its case, of the selected tracks, and of earlier pairs."""
    findings = set[Finding]()
    effect = EFFECTS[case]
    if effect.finding is not None:
        findings.add(effect.finding)
    if selection.is_partial:
        findings.add(Finding.PARTIAL_TRANSFER)
    if effect.confirms:
        is_in_doubt = confidence_after(case, evidence).phase is Phase.IN_DOUBT
        if evidence.is_half_unexplained or is_in_doubt:
            findings.add(Finding.GROUND_IN_DOUBT)
    is_recovering = evidence.memory.still_recovering(is_moving=selection.is_moving) > 0
    if not findings and selection.tracks.is_trusted and is_recovering:
        findings.add(Finding.RECOVERING)
    if effect.confirms and evidence.is_known and evidence.is_unusual:
        findings.add(Finding.UNEXPLAINED)
    return frozenset(findings)


def confidence_after(case: Case, evidence: Evidence) -> Confidence:
    """Return the confidence in the ground's motion after a pair; a stationary image shows nothing."""
    confidence = evidence.memory.confidence
    effect = EFFECTS[case]
    if effect.leaves_doubt:
        return confidence.after_contradiction(evidence.unexplained_cells)
    if not effect.confirms or evidence.is_known or evidence.explained.motion_px <= MOVED_PX:
        return confidence
    if evidence.memory.excluded.moving_fraction < MAX_MOVING and evidence.covers_doubt:
        return confidence.after_agreement()
    if confidence.phase is Phase.IN_DOUBT and evidence.is_unusual:
        return confidence.after_contradiction(evidence.unexplained_cells)
    return confidence.after_interruption()


def _present(tracks: Tracks | None) -> Tracks:
    """Return the tracks of a case that has them."""
    assert tracks is not None, "the case has another motion"
    return tracks


def pose_distance(one: Pose, other: Pose) -> MotionSize:
    """Return the distance and the angle between two poses."""
    angle = np.linalg.norm(rotvec_from_matrix(one.rotation.T @ other.rotation))
    return MotionSize(float(np.linalg.norm(one.position - other.position)), float(angle))
