"""The table of the cases of the ground's motion, and the memory that its consequences change."""

from __future__ import annotations

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
from sfr_loc_map.localisation.ground.evidence import OLD_WEIGHT, Evidence, TwoMotions, evidence_of_main, weighed
from sfr_loc_map.localisation.ground.memory import (
    CONSISTENT_PAIRS,
    LONG_RECOVERY_PAIRS,
    MAX_TRANSFERS,
    EarlierImage,
    GroundMemory,
    Phase,
    Shown,
)
from sfr_loc_map.localisation.ground.rigid_motion import Exclusion, Motion
from sfr_loc_map.localisation.ground.selection import (
    AMBIGUOUS,
    CONTRADICTED,
    DECIDED,
    DOUBLE_EXPOSURE,
    GROUND_UNCERTAIN,
    HALF_UNEXPLAINED,
    ONE_MOTION,
    OWN_BODY,
    PARTIAL_TRANSFER,
    UNEXPLAINED,
    UNTRUSTED,
    Case,
    Ground,
    case_of,
    findings_of,
)
from sfr_loc_map.localisation.keyframes import KEYFRAME_FLOW_RATIO
from sfr_loc_map.localisation.state import State
from sfr_loc_map.localisation.uncertainty.error_sources import RoverModel

IMAGE = np.zeros((16, 16), np.float32)


HERE = Pose(np.eye(3), np.zeros(3))


LEARNING = GroundMemory.none((32, 32))
IDENTIFIED = LEARNING._replace(phase=Phase.IDENTIFIED)


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
    main = Motion(SimpleNamespace(is_trusted=True, inliers=None, pose=HERE), agreement)  # type: ignore[arg-type]
    return evidence_of_main(main, memory)


def two_motions(weight_ratio: float, *, has_standstill: bool = False) -> TwoMotions:
    """Return two motions, of which the heavier one explains three quarters of the landmarks."""
    tracks = SimpleNamespace(inlier_count=9, inliers=np.ones(9, np.bool_))
    agreement = SimpleNamespace(unexplained_fraction=0.25 if weight_ratio > 1.0 else 0.75)
    motion = Motion(tracks, agreement)  # type: ignore[arg-type]
    return TwoMotions(motion, motion, weight_ratio, has_standstill)


def after(memory: GroundMemory, case: Case, *, moves_image: bool = True) -> GroundMemory:
    """Return the memory after a pair of a case that one motion explains, by default a pair with motion."""
    memory = memory._replace(earlier=EarlierImage(IMAGE, HERE))
    evidence = evidence_without_outliers(memory, moves_image=moves_image)
    return after_shown(memory, case.shown or evidence.shown_by_main, evidence)


def after_shown(memory: GroundMemory, shown: Shown, evidence: Evidence) -> GroundMemory:
    """Return the memory after a pair that shows something, and in which the main motion is selected."""
    nothing = Exclusion.nothing(memory.excluded.life.shape)
    selected: Any = SimpleNamespace(is_main=True, exclusion=nothing, motion=evidence.main)
    frame = SimpleNamespace(left=[SimpleNamespace(image=IMAGE)] * 3)
    tools = SimpleNamespace(shape=(32, 32))
    pair: Any = SimpleNamespace(frame=frame, tools=tools, change=SimpleNamespace(stationary=nothing.fixed))
    return memory.after_pair(pair, evidence.main.agreement, shown, selected)


NOT_TRUSTED = Motion(SimpleNamespace(is_trusted=False), None)  # type: ignore[arg-type]


IN_A_ROW = IDENTIFIED._replace(transfers=MAX_TRANSFERS)
AFTER_TRANSFER = IDENTIFIED._replace(transfers=1)


@pytest.mark.parametrize(
    ("memory", "changes", "case"),
    [
        (IDENTIFIED, {}, ONE_MOTION),
        (IDENTIFIED, {"off_body": NOT_TRUSTED, "main": NOT_TRUSTED}, OWN_BODY),
        (IDENTIFIED, {"main": NOT_TRUSTED, "is_contradicted": True}, UNTRUSTED),
        (AFTER_TRANSFER, {"is_unusual": True}, PARTIAL_TRANSFER),
        (AFTER_TRANSFER, {"is_unusual": True, "is_contradicted": True}, CONTRADICTED),
        (IDENTIFIED, {"is_double_exposure": True, "is_unusual": True}, DOUBLE_EXPOSURE),
        (IDENTIFIED, {"is_contradicted": True, "is_half_unexplained": True}, CONTRADICTED),
        (IDENTIFIED, {"is_half_unexplained": True, "is_unusual": True}, PARTIAL_TRANSFER),
        (IN_A_ROW, {"is_half_unexplained": True, "is_unusual": True}, HALF_UNEXPLAINED),
        (IDENTIFIED, {"is_unusual": True}, UNEXPLAINED),
        (LEARNING, {"is_unusual": True}, ONE_MOTION),
        (LEARNING._replace(phase=Phase.UNCERTAIN), {}, GROUND_UNCERTAIN),
        (IDENTIFIED, {"two": two_motions(2.0), "is_unusual": True}, DECIDED),
        (IDENTIFIED, {"two": two_motions(0.5), "is_contradicted": True}, DECIDED),
        (IDENTIFIED, {"two": two_motions(1.1), "is_unusual": True}, AMBIGUOUS),
        (LEARNING, {"two": two_motions(2.0)}, AMBIGUOUS),
        (IDENTIFIED, {"two": two_motions(2.0, has_standstill=True)}, PARTIAL_TRANSFER),
        (IN_A_ROW, {"two": two_motions(2.0, has_standstill=True)}, DECIDED),
    ],
)
def test_the_case_of_a_pair_follows_from_the_evidence(
    memory: GroundMemory, changes: dict[str, Any], case: Case
) -> None:
    assert case_of(evidence_without_outliers(memory)._replace(**changes)) is case


def test_each_transfer_counts_so_that_a_row_of_them_ends() -> None:
    memory = LEARNING
    for _ in range(MAX_TRANSFERS):
        assert evidence_without_outliers(memory).memory.may_be_transfer
        memory = after(memory, PARTIAL_TRANSFER)
    assert not evidence_without_outliers(memory).memory.may_be_transfer
    assert after(memory, DECIDED).transfers == 0


def test_a_refused_pair_does_not_replace_the_image_at_the_last_known_pose() -> None:
    before = LEARNING._replace(earlier=EarlierImage(IMAGE, HERE), last_image=IMAGE)
    now = np.ones((16, 16), np.float32)
    learnt = before._replace(earlier=EarlierImage(now, HERE), last_image=now, transfers=2)

    def memory_after(finding: Finding) -> GroundMemory:
        return before.after_verdict(learnt, decide(frozenset({finding})))

    assert memory_after(Finding.FEW_LANDMARKS) is before
    assert memory_after(Finding.UNEXPLAINED) is learnt
    refused = memory_after(Finding.CONTRADICTED)
    assert refused.last_image is before.last_image
    assert refused.transfers == 2
    for memory in (refused, memory_after(Finding.PARTIAL_TRANSFER)):
        assert memory.earlier == before.earlier.older()


def test_a_second_motion_before_the_ground_is_identified_degrades_twelve_pairs() -> None:
    """The example in the docstring of `selection`: ten pairs of uncertainty and recovery follow, then clean pairs."""
    memory = LEARNING
    found = []
    case = AMBIGUOUS
    for _ in range(14):
        before = memory
        memory = after(before, case)
        found.append((case, findings_of(case, evidence_without_outliers(before), after=memory, is_trusted=True)))
        case = case_of(evidence_without_outliers(memory))
    assert found == [
        (AMBIGUOUS, frozenset({Finding.AMBIGUOUS})),
        *[(GROUND_UNCERTAIN, frozenset({Finding.GROUND_UNCERTAIN}))] * 9,
        *[(ONE_MOTION, frozenset({Finding.RECOVERING}))] * 2,
        *[(ONE_MOTION, frozenset())] * 2,
    ]
    assert memory.is_identified


def after_consistent(memory: GroundMemory, pairs: int) -> Phase:
    """Return the phase after some pairs that one motion explains."""
    for _ in range(pairs):
        memory = after(memory, ONE_MOTION)
    return memory.phase


def test_uncertainty_lasts_longer_for_a_ground_that_was_not_identified() -> None:
    assert after_consistent(LEARNING, CONSISTENT_PAIRS - 1) is Phase.LEARNING
    assert after_consistent(LEARNING, CONSISTENT_PAIRS) is Phase.IDENTIFIED
    for before, pairs in ((IDENTIFIED, CONSISTENT_PAIRS), (LEARNING, LONG_RECOVERY_PAIRS)):
        uncertain = after(before, AMBIGUOUS)
        assert after_consistent(uncertain, pairs - 1) is Phase.UNCERTAIN
        assert after_consistent(uncertain, pairs) is Phase.LEARNING
        assert uncertain.lost() is uncertain
    assert IDENTIFIED.lost().phase is Phase.LEARNING


def test_a_partly_consistent_pair_changes_only_the_phase_of_learning() -> None:
    """Learning starts again. An uncertainty neither ends nor grows, and an identified ground stays identified."""
    for before in (IDENTIFIED, after(IDENTIFIED, AMBIGUOUS), after(LEARNING, ONE_MOTION)):
        later = after_shown(before, Shown.PARTLY_CONSISTENT, evidence_without_outliers(before))
        assert later.phase is before.phase
        is_learning = before.phase is Phase.LEARNING
        assert later.pairs_left == (CONSISTENT_PAIRS if is_learning else before.pairs_left)


def test_a_second_motion_may_be_the_ground_until_the_ground_is_identified() -> None:
    """The selected motion may then be wrong, so that the covariance of all later poses contains the ambiguity."""

    def inflation_of(case: Case, memory: GroundMemory) -> Inflation:
        return decide(findings_of(case, evidence_without_outliers(memory), after=memory, is_trusted=True)).inflation

    for case in (PARTIAL_TRANSFER, UNEXPLAINED):
        assert Inflation.AMBIGUITY in inflation_of(case, LEARNING)
        assert Inflation.AMBIGUITY in inflation_of(case, IDENTIFIED.lost())
        assert Inflation.AMBIGUITY not in inflation_of(case, IDENTIFIED)
    assert inflation_of(OWN_BODY, LEARNING) is Inflation.UNOBSERVED
    assert inflation_of(OWN_BODY, IDENTIFIED) is Inflation.NONE


def test_a_pair_at_rest_neither_ends_an_uncertainty_nor_prolongs_it() -> None:
    memory = after(LEARNING, HALF_UNEXPLAINED)
    at_rest = case_of(evidence_without_outliers(memory, moves_image=False))
    later = after(memory, at_rest, moves_image=False)
    evidence = evidence_without_outliers(memory, moves_image=False)
    found = findings_of(at_rest, evidence, after=later, is_trusted=True)
    assert found == {Finding.AT_REST_UNCERTAIN}
    assert decide(found).inflation is Inflation.NONE
    assert later.phase is memory.phase
    assert later.pairs_left == memory.pairs_left
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
    uncertain = after(LEARNING, HALF_UNEXPLAINED)
    ground = Ground.unselected(SimpleNamespace(is_trusted=True), uncertain)  # type: ignore[arg-type]
    assert Inflation.AMBIGUITY in decide(ground.findings).inflation
    assert ground.learnt.phase is Phase.UNCERTAIN
    assert ground.learnt.pairs_left == uncertain.pairs_left


def test_the_ground_must_be_identified_again_after_a_lost_pair() -> None:
    """The landmarks that are found again may be those of an object."""
    start = StartPose(Transform.identity())
    calibration = OnlineCalibration(LOC_RIG.camera, (LOC_RIG.height, LOC_RIG.width), 7)
    model = RoverModel.of(LOC_RIG, MotionBounds(), KEYFRAME_FLOW_RATIO)
    state = State.started(start, calibration, model)._replace(ground_memory=IDENTIFIED)
    assert state.lost(StateReason.FEW_LANDMARKS).ground_memory.phase is Phase.LEARNING


def test_an_adjustment_does_not_change_the_motion_since_the_image_that_pairs_are_compared_with() -> None:
    before, adjusted, compared = (
        Transform(matrix_from_rotvec(np.array([0.0, 0.1 * x, 0.2])), np.array([x, 0.0, 1.0])) for x in (1.0, 3.0, 0.5)
    )
    memory = IDENTIFIED._replace(earlier=EarlierImage(IMAGE, Pose.of(compared)))
    moved = Transform(*memory.adjusted(adjusted @ before.inverse()).earlier.pose)
    since = (before.inverse() @ compared).matrix
    np.testing.assert_allclose((adjusted.inverse() @ moved).matrix, since, atol=1e-12)
