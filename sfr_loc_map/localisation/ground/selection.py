"""Selection of the ground's motion in a pair: the order of the steps (`select_ground`).

| step | function | result |
|---|---|---|
| 1 | `changed_cells`, beside the tracking | `Change`: cells that changed since an earlier image |
| 2 | `evidence.evidence_of`, which may search for other motions | `Evidence` |
| 3 | `cases.rule_of` | `Rule`: the case of the pair, with its consequences |
| 4 | `Rule.select` | `Selection`: tracks that follow the ground, and what is excluded |
| 5 | `learnt_from` | `GroundMemory` after the pair |
| 6 | `cases.findings_of` | the findings of the pair: at most one |

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

from sfr_loc_map.localisation.findings import Finding, Verdict
from sfr_loc_map.localisation.frontend.stereo_frame import StereoFrame
from sfr_loc_map.localisation.frontend.tracking import Tracks
from sfr_loc_map.localisation.ground import cases
from sfr_loc_map.localisation.ground.cell_change import LEVEL, Change, change_of
from sfr_loc_map.localisation.ground.double_exposure import MIXTURE_LEVEL
from sfr_loc_map.localisation.ground.evidence import Evidence, evidence_of
from sfr_loc_map.localisation.ground.memory import Consistency, EarlierImage, Fault, GroundMemory
from sfr_loc_map.localisation.ground.motions import ComparedPair, MotionTools
from sfr_loc_map.localisation.ground.thresholds import COMPARED_PAIRS, COMPARED_PX, FAR_RATIO
from sfr_loc_map.localisation.motion_model import Prediction
from sfr_loc_map.localisation.motion_size import NO_MOTION, MotionSize
from sfr_loc_map.localisation.relocalisation import RecoveryImages


class Ground(NamedTuple):
    """The ground's motion in a pair."""

    tracks: Tracks  #: Tracks that follow the ground.
    findings: frozenset[Finding]
    not_ground: NDArray[np.intp]  #: `(N,)` window rows of the landmarks that do not move with the ground.
    other_distance: MotionSize  #: Distance to the pose of another possible motion; zero if none was found.
    learnt: GroundMemory  #: The memory after the pair, if later pairs may be compared with it.

    @classmethod
    def unselected(cls, tracks: Tracks, memory: GroundMemory) -> Ground:
        """Return all tracks as those of the ground, without a comparison with earlier pairs.

        An uncertainty, or a recovery from earlier faults, is reported again.
        """
        return cls(
            tracks=tracks,
            findings=cases.findings_unselected(memory, is_trusted=tracks.is_trusted),
            not_ground=np.zeros(0, np.intp),
            other_distance=NO_MOTION,
            learnt=memory.unselected(),
        )

    def memory_after(self, verdict: Verdict, before: GroundMemory) -> GroundMemory:
        """Return the memory after the verdict on the pair, from the memory before the pair.

        A pair that is not learnt, which most refused pairs are, leaves the memory as it was (`findings.RULES`). The
        present image replaces the compared image only if later pairs may be compared with it, and the image at the last
        pose only if the pose is accepted.
        """
        if not verdict.is_learnt:
            return before
        learnt = self.learnt
        if verdict.refuses:
            learnt = replace(learnt, last_image=before.last_image)
        if verdict.refuses or not verdict.can_be_reference:
            learnt = replace(learnt, earlier=before.earlier.older())
        return learnt


def changed_cells(frame: StereoFrame, memory: GroundMemory) -> Change:
    """Compare the left image with an earlier image, cell by cell. No pose is required."""
    return change_of(memory.earlier.image, frame.left[LEVEL].image)


def select_ground(
    tools: MotionTools,
    frame: StereoFrame,
    tracks: Tracks,
    prediction: Prediction,
    memory: GroundMemory,
    recovery: RecoveryImages,
    change: Change,
) -> Ground:
    """Return the ground's motion in a pair. The tracks may follow any motion, trusted or not."""
    earlier = memory.earlier
    far_px = FAR_RATIO * tools.shape[1] * earlier.age if memory.is_clear else np.inf
    pair = ComparedPair(tools, frame, prediction, recovery, change, earlier.pose, far_px)

    evidence = evidence_of(pair, tracks, memory)
    rule = cases.rule_of(evidence)
    selection = rule.select(pair, evidence)
    learnt = learnt_from(pair, rule, evidence, selection, memory)

    tracks = selection.motion.tracks
    is_identified = evidence.is_identified
    findings = cases.findings_of(rule, learnt.faults, is_identified=is_identified, is_trusted=tracks.is_trusted)
    return Ground(
        tracks=tracks,
        findings=findings,
        not_ground=selection.exclusion.rows,
        other_distance=selection.other_distance,
        learnt=learnt,
    )


def learnt_from(
    pair: ComparedPair, rule: cases.Rule, evidence: Evidence, selection: cases.Selection, memory: GroundMemory
) -> GroundMemory:
    """Return the memory with what a pair shows, by the rule of its case."""
    main = evidence.main.agreement
    identification = memory.identification
    typical = memory.typical
    if rule.learns is cases.Learns.UNCERTAINTY:
        identification = identification.after(Consistency.INCONSISTENT, main.cells(main.unexplained))
    elif rule.learns is cases.Learns.ONE_MOTION:
        identification = evidence.after_one_motion
        typical = memory.typical_after(main.unexplained_fraction)
    return GroundMemory(
        excluded=memory.excluded.after_pair(selection.exclusion, pair.change.stationary, pair.tools.shape),
        earlier=_next_earlier(pair.frame, selection, memory.earlier, rule.fault),
        last_image=pair.frame.left[MIXTURE_LEVEL].image,
        identification=identification,
        faults=memory.faults.after(rule.fault, is_moving=selection.is_moving),
        typical=typical,
    )


def _next_earlier(frame: StereoFrame, selection: cases.Selection, earlier: EarlierImage, fault: Fault) -> EarlierImage:
    """Return the image that the next pair is compared with: the present left image, or the earlier image again."""
    if fault is Fault.TRANSFER:
        return earlier.older()
    shows_fixed = selection.motion.agreement.motion_px > COMPARED_PX
    if shows_fixed or not selection.is_main or earlier.age > COMPARED_PAIRS:
        return EarlierImage(frame.left[LEVEL].image, selection.motion.tracks.pose)
    return earlier.older()
