"""The table of the cases of the ground's motion, and the memory that its consequences change."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from helpers.made_scene import LOC_RIG
from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.config import MotionBounds
from sfr_loc_map.localisation.estimate import StartPose, StateReason
from sfr_loc_map.localisation.findings import Finding, Inflation, decide
from sfr_loc_map.localisation.ground.cases import CASE_RULES, Case, Rule, findings_of, rule_of
from sfr_loc_map.localisation.ground.evidence import Evidence, TwoMotions, evidence_of_main, weighed
from sfr_loc_map.localisation.ground.excluded_cells import Exclusion
from sfr_loc_map.localisation.ground.memory import (
    Consistency,
    EarlierImage,
    GroundMemory,
    Identification,
    ImageFaults,
    Phase,
)
from sfr_loc_map.localisation.ground.motions import Motion
from sfr_loc_map.localisation.ground.selection import Ground, learnt_from
from sfr_loc_map.localisation.ground.thresholds import CONSISTENT_PAIRS, LONG_RECOVERY_PAIRS, MAX_TRANSFERS, OLD_WEIGHT
from sfr_loc_map.localisation.keyframes import KEYFRAME_FLOW_RATIO
from sfr_loc_map.localisation.state import State
from sfr_loc_map.localisation.uncertainty.error_sources import RoverModel

IMAGE = np.zeros((16, 16), np.float32)


HERE = Pose(np.eye(3), np.zeros(3))


IDENTIFIED = replace(GroundMemory.none((32, 32)), identification=Identification(Phase.IDENTIFIED))


def evidence_without_outliers(memory: GroundMemory, *, moves_image: bool = True) -> Evidence:
    """Return the evidence of a pair that one motion explains, by default a pair with motion."""
    cells = np.ones((2, 2), np.bool_)
    agreement = SimpleNamespace(
        moves_image=moves_image,
        motion_px=0.0,
        unexplained_fraction=0.0,
        contradicting_fraction=0.0,
        unexplained=None,
        cells=lambda _: cells,
    )
    main = Motion(SimpleNamespace(is_trusted=True, inliers=None), agreement)  # type: ignore[arg-type]
    return evidence_of_main(main, memory)


def two_motions(weight_ratio: float, *, has_standstill: bool = False) -> TwoMotions:
    """Return two motions, of which the heavier one explains three quarters of the landmarks."""
    tracks = SimpleNamespace(inlier_count=9, inliers=np.ones(9, np.bool_))
    agreement = SimpleNamespace(unexplained_fraction=0.25 if weight_ratio > 1.0 else 0.75)
    motion = Motion(tracks, agreement)  # type: ignore[arg-type]
    return TwoMotions(motion, motion, weight_ratio, has_standstill)


def rule(case: Case) -> Rule:
    """Return the rule of a case."""
    return next(each for each in CASE_RULES if each.case is case)


def after(memory: GroundMemory, case: Case, *, moves_image: bool = True) -> GroundMemory:
    """Return the memory after a pair of a case that one motion explains, by default a pair with motion."""
    memory = replace(memory, earlier=EarlierImage(IMAGE, HERE))
    evidence = evidence_without_outliers(memory, moves_image=moves_image)
    nothing = Exclusion.nothing(memory.excluded.life.shape)
    selected: Any = SimpleNamespace(is_moving=moves_image, is_main=True, exclusion=nothing, motion=evidence.main)
    frame = SimpleNamespace(left=[SimpleNamespace(image=IMAGE)] * 3)
    tools = SimpleNamespace(shape=(32, 32))
    pair: Any = SimpleNamespace(frame=frame, tools=tools, change=SimpleNamespace(stationary=nothing.fixed))
    return learnt_from(pair, rule(case), evidence, selected, memory)


UNTRUSTED = Motion(SimpleNamespace(is_trusted=False), None)  # type: ignore[arg-type]


IN_A_ROW = replace(IDENTIFIED, faults=ImageFaults(transfers=MAX_TRANSFERS))


@pytest.mark.parametrize(
    ("memory", "changes", "case"),
    [
        (IDENTIFIED, {}, Case.ONE_MOTION),
        (IDENTIFIED, {"off_body": UNTRUSTED, "main": UNTRUSTED}, Case.OWN_BODY),
        (IDENTIFIED, {"main": UNTRUSTED, "is_contradicted": True}, Case.UNTRUSTED),
        (IDENTIFIED, {"follows_transfer": True, "is_unusual": True}, Case.TRANSFERRED),
        (IDENTIFIED, {"follows_transfer": True, "is_unusual": True, "is_contradicted": True}, Case.FALSE_STANDSTILL),
        (IDENTIFIED, {"is_double_exposure": True, "is_unusual": True}, Case.BLENDED),
        (IDENTIFIED, {"is_contradicted": True, "is_half_unexplained": True}, Case.FALSE_STANDSTILL),
        (IDENTIFIED, {"is_half_unexplained": True, "is_unusual": True}, Case.TRANSFERRED),
        (IN_A_ROW, {"is_half_unexplained": True, "is_unusual": True}, Case.HALF_UNEXPLAINED),
        (IDENTIFIED, {"is_unusual": True}, Case.UNUSUAL),
        (IDENTIFIED, {"is_unusual": True, "has_typical": False}, Case.ONE_MOTION),
        (IDENTIFIED, {"after_one_motion": Identification(Phase.UNCERTAIN)}, Case.UNCONFIRMED),
        (IDENTIFIED, {"two": two_motions(2.0), "is_unusual": True}, Case.DECIDED),
        (IDENTIFIED, {"two": two_motions(0.5), "is_contradicted": True}, Case.DECIDED),
        (IDENTIFIED, {"two": two_motions(1.1), "is_unusual": True}, Case.UNDECIDED),
        (GroundMemory.none((32, 32)), {"two": two_motions(2.0)}, Case.UNDECIDED),
        (IDENTIFIED, {"two": two_motions(2.0, has_standstill=True)}, Case.TRANSFERRED),
        (IN_A_ROW, {"two": two_motions(2.0, has_standstill=True)}, Case.DECIDED),
    ],
)
def test_the_case_of_a_pair_follows_from_the_evidence(
    memory: GroundMemory, changes: dict[str, Any], case: Case
) -> None:
    assert rule_of(evidence_without_outliers(memory)._replace(**changes)).case is case


def test_each_case_has_one_rule() -> None:
    assert sorted(each.case.name for each in CASE_RULES) == sorted(case.name for case in Case)


def test_each_transfer_counts_so_that_a_row_of_them_ends() -> None:
    memory = GroundMemory.none((32, 32))
    for _ in range(MAX_TRANSFERS):
        assert evidence_without_outliers(memory).may_be_transfer
        memory = after(memory, Case.TRANSFERRED)
    assert not evidence_without_outliers(memory).may_be_transfer
    assert after(memory, Case.DECIDED).faults.transfers == 0


def test_a_refused_pair_does_not_replace_the_image_at_the_last_known_pose() -> None:
    before = replace(GroundMemory.none((32, 32)), earlier=EarlierImage(IMAGE, HERE), last_image=IMAGE)
    now = np.ones((16, 16), np.float32)
    learnt = replace(before, earlier=EarlierImage(now, HERE), last_image=now, faults=ImageFaults(transfers=2))

    def memory_after(finding: Finding) -> GroundMemory:
        ground = Ground(None, frozenset({finding}), None, None, learnt)  # type: ignore[arg-type]
        return ground.memory_after(decide({finding}), before)

    assert memory_after(Finding.FEW_LANDMARKS) is before
    assert memory_after(Finding.UNEXPLAINED) is learnt
    refused = memory_after(Finding.CONTRADICTED)
    assert refused.last_image is before.last_image
    assert refused.faults.transfers == 2
    for memory in (refused, memory_after(Finding.PARTIAL_TRANSFER)):
        assert memory.earlier == before.earlier.older()


def test_a_second_motion_before_the_ground_is_identified_degrades_twelve_pairs() -> None:
    """The example in the docstring of `selection`: ten pairs of uncertainty and recovery follow, then clean pairs."""
    memory = GroundMemory.none((32, 32))
    found = []
    case = Case.UNDECIDED
    for _ in range(14):
        is_identified = memory.is_identified
        memory = after(memory, case)
        findings = findings_of(rule(case), memory.faults, is_identified=is_identified, is_trusted=True)
        found.append((case, findings))
        case = rule_of(evidence_without_outliers(memory)).case
    assert found == [
        (Case.UNDECIDED, frozenset({Finding.AMBIGUOUS})),
        *[(Case.UNCONFIRMED, frozenset({Finding.GROUND_UNCERTAIN}))] * 9,
        *[(Case.ONE_MOTION, frozenset({Finding.RECOVERING}))] * 2,
        *[(Case.ONE_MOTION, frozenset())] * 2,
    ]
    assert memory.is_identified


NO_CELLS = np.zeros((2, 3), np.bool_)


def after_consistent(identification: Identification, pairs: int) -> Phase:
    """Return the phase after some pairs that one motion explains."""
    for _ in range(pairs):
        identification = identification.after(Consistency.CONSISTENT, NO_CELLS)
    return identification.phase


def test_uncertainty_lasts_longer_for_a_ground_that_was_not_identified() -> None:
    learning = Identification()
    assert after_consistent(learning, CONSISTENT_PAIRS - 1) is Phase.LEARNING
    assert after_consistent(learning, CONSISTENT_PAIRS) is Phase.IDENTIFIED
    identified = Identification(Phase.IDENTIFIED)
    for before, pairs in ((identified, CONSISTENT_PAIRS), (learning, LONG_RECOVERY_PAIRS)):
        uncertain = before.after(Consistency.INCONSISTENT, ~NO_CELLS)
        assert after_consistent(uncertain, pairs - 1) is Phase.UNCERTAIN
        assert after_consistent(uncertain, pairs) is Phase.LEARNING
        assert uncertain.after(Consistency.PARTIAL, NO_CELLS) is uncertain
        assert uncertain.relearning() is uncertain
    assert identified.after(Consistency.PARTIAL, NO_CELLS) is identified
    assert identified.relearning().phase is Phase.LEARNING


def test_a_second_motion_may_be_the_ground_until_the_ground_is_identified() -> None:
    """The selected motion may then be wrong, so that the covariance of all later poses contains the ambiguity."""
    learning = GroundMemory.none((32, 32))
    identified = replace(learning, identification=Identification(Phase.IDENTIFIED))

    def inflation_of(case: Case, memory: GroundMemory) -> Inflation:
        findings = findings_of(rule(case), memory.faults, is_identified=memory.is_identified, is_trusted=True)
        return decide(findings).inflation

    for case in (Case.TRANSFERRED, Case.UNUSUAL):
        assert Inflation.AMBIGUITY in inflation_of(case, learning)
        assert Inflation.AMBIGUITY in inflation_of(case, identified.lost())
        assert Inflation.AMBIGUITY not in inflation_of(case, identified)
    assert inflation_of(Case.OWN_BODY, learning) is Inflation.UNOBSERVED
    assert inflation_of(Case.OWN_BODY, identified) is Inflation.NONE


def test_a_pair_at_rest_neither_ends_an_uncertainty_nor_prolongs_it() -> None:
    memory = after(GroundMemory.none((32, 32)), Case.HALF_UNEXPLAINED)
    at_rest = rule_of(evidence_without_outliers(memory, moves_image=False))
    later = after(memory, at_rest.case, moves_image=False)
    assert at_rest.finding is Finding.AT_REST_UNCERTAIN
    assert decide({at_rest.finding}).inflation is Inflation.NONE
    assert later.identification is memory.identification
    assert later.typical is None


def test_another_motion_of_old_landmarks_alone_has_the_weight_of_old_landmarks() -> None:
    def followed(hosts: list[int]) -> Motion:
        landmarks = SimpleNamespace(host=np.array(hosts), newest_host=max(hosts))
        tracks = SimpleNamespace(
            inliers=np.ones(len(hosts), np.bool_), inlier_count=len(hosts), landmarks=landmarks, pose=None
        )
        return Motion(tracks, None)  # type: ignore[arg-type]

    prediction = SimpleNamespace(repeated_motion=None, standstill=None)
    pair = SimpleNamespace(prediction=prediction, image_motion_px=lambda *_, **__: 1.0)
    motions = weighed(pair, followed([0, 1, 2, 2]), followed([0, 0, 1]))  # type: ignore[arg-type]
    assert motions.weight_ratio == pytest.approx((2.0 * OLD_WEIGHT + 2.0) / (3.0 * OLD_WEIGHT))


def test_an_uncertainty_is_reported_again_while_stale_images_are_blanked() -> None:
    """No motion can then be selected, and the covariance contains the ambiguity as in a pair with good images."""
    uncertain = after(GroundMemory.none((32, 32)), Case.HALF_UNEXPLAINED)
    ground = Ground.unselected(SimpleNamespace(is_trusted=True), uncertain)  # type: ignore[arg-type]
    assert Inflation.AMBIGUITY in decide(ground.findings).inflation
    assert ground.learnt.identification is uncertain.identification


def test_the_ground_must_be_identified_again_after_a_lost_pair() -> None:
    """The landmarks that are found again may be those of an object."""
    start = StartPose(Transform.identity())
    calibration = OnlineCalibration(LOC_RIG.camera, (LOC_RIG.height, LOC_RIG.width), 7)
    model = RoverModel.of(LOC_RIG, MotionBounds(), KEYFRAME_FLOW_RATIO)
    state = replace(State.started(start, calibration, model), ground_memory=IDENTIFIED)
    assert state.lost(StateReason.FEW_LANDMARKS).ground_memory.identification.phase is Phase.LEARNING


def test_an_adjustment_does_not_change_the_motion_since_the_image_that_pairs_are_compared_with() -> None:
    before, adjusted, compared = (
        Transform(matrix_from_rotvec(np.array([0.0, 0.1 * x, 0.2])), np.array([x, 0.0, 1.0])) for x in (1.0, 3.0, 0.5)
    )
    memory = replace(IDENTIFIED, earlier=EarlierImage(IMAGE, Pose.of(compared)))
    moved = Transform(*memory.adjusted(adjusted @ before.inverse()).earlier.pose)
    since = (before.inverse() @ compared).matrix
    np.testing.assert_allclose((adjusted.inverse() @ moved).matrix, since, atol=1e-12)
