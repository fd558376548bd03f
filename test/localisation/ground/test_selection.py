"""Own body, dirt and moving objects in the view: the pose follows the ground, or says that it may not."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from helpers import ROOT
from helpers.loc_drive import drive, noisy, run
from helpers.made_scene import HEIGHT, LOC_RIG, true_pose
from sfr_loc_map.bench.fault_benchmark import ErrorReport, stated_errors
from sfr_loc_map.faults.injector import FaultInjector
from sfr_loc_map.faults.kinds import parse_fault
from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.sequence import drive_of
from sfr_loc_map.localisation.config import LocalisationConfig, MotionBounds
from sfr_loc_map.localisation.estimate import PoseEstimate, StateReason, TrackingState
from sfr_loc_map.localisation.findings import Finding, Inflation, decide
from sfr_loc_map.localisation.ground.cases import (
    Ambiguous,
    Case,
    Decided,
    MainCase,
    OwnBody,
    case_of_one,
    case_of_two,
    effect_of,
    findings_of,
)
from sfr_loc_map.localisation.ground.evidence import Evidence, evidence_of
from sfr_loc_map.localisation.ground.identification import (
    AGREEING_PAIRS,
    LONG_DOUBT_PAIRS,
    MAX_TRANSFERS,
    Identification,
    ImageFaults,
    Phase,
    Sign,
)
from sfr_loc_map.localisation.ground.memory import EarlierImage, Effect, GroundMemory, NextMemory, Support
from sfr_loc_map.localisation.ground.motion_tools import Motion
from sfr_loc_map.localisation.ground.two_motions import OLD_WEIGHT, TwoMotions, weighed
from sfr_loc_map.localisation.localiser import Localiser

SAMPLE, PAIRS = ROOT / "sample" / "sample.mcap", 14

DRIVE = drive(30)

IMAGE = np.zeros((16, 16), np.float32)
HERE = Pose(np.eye(3), np.zeros(3))
EXPLAINED = Support(
    moves_image=True,
    unexplained_fraction=0.0,
    unexplained_cells=np.zeros((2, 2), np.bool_),
    inlier_cells=np.ones((2, 2), np.bool_),
)


IDENTIFIED = replace(GroundMemory.none((32, 32)), identification=Identification(Phase.IDENTIFIED))


def with_fault(fault: str) -> list[PoseEstimate]:
    """Return the estimates of a drive with a fault."""
    injector = FaultInjector([parse_fault(fault)], 1, len(DRIVE), LOC_RIG)
    return run(pair for _, pair in injector.pairs(DRIVE))


def worst_ratio(estimates: Sequence[PoseEstimate]) -> float:
    """Return the largest position error over its stated 3 sigma, where the state is tracking."""
    tracked = [(index, item) for index, item in enumerate(estimates) if item.state is TrackingState.TRACKING]
    return max(
        float(np.linalg.norm(item.T_ds_rb.translation - true_pose(index).translation))
        / (3.0 * np.sqrt(np.trace(item.covariance[:3, :3])))
        for index, item in tracked
    )


def later_truth(truth: Trajectory | None, begin_ns: int) -> Trajectory:
    """Return the ground truth from a stamp on."""
    assert truth is not None
    later = truth.stamps_ns >= begin_ns
    return Trajectory(truth.stamps_ns[later], truth.positions[later], truth.quats_xyzw[later])


def masked(estimates: Sequence[PoseEstimate]) -> list[float]:
    return [item.statistics.masked_share or 0.0 for item in estimates]


def after(memory: GroundMemory, effect: Effect, support: Support = EXPLAINED) -> GroundMemory:
    """Return the memory after a pair that one motion explains, by default a moving pair."""
    memory = replace(memory, earlier=EarlierImage(IMAGE, HERE))
    return memory.after(effect, support, is_moving=support.moves_image, excluded=memory.excluded, image=IMAGE)


def evidence_without_outliers(memory: GroundMemory, *, moves_image: bool = True) -> Evidence:
    """Return the evidence of a pair that one motion explains, by default a moving pair."""
    cells = np.ones((2, 2), np.bool_)
    agreement = SimpleNamespace(
        moves_image=moves_image,
        unexplained_fraction=0.0,
        contradicting_fraction=0.0,
        unexplained=None,
        cells=lambda _: cells,
    )
    return evidence_of(Motion(SimpleNamespace(is_trusted=True, inliers=None), agreement), memory)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("changes", "case"),
    [
        ({}, MainCase.ONE_MOTION),
        ({"is_contradicted": True, "is_half_unexplained": True}, MainCase.CONTRADICTED),
        ({"is_half_unexplained": True, "may_be_transfer": True}, MainCase.PARTIAL_TRANSFER),
        ({"is_half_unexplained": True}, MainCase.HALF_UNEXPLAINED),
        ({"is_unusual": True}, MainCase.UNEXPLAINED),
        ({"is_unusual": True, "has_typical": False}, MainCase.ONE_MOTION),
        ({"after_one_motion": Identification(Phase.IN_DOUBT)}, MainCase.IN_DOUBT),
    ],
)
def test_the_case_of_one_motion_follows_from_the_evidence(changes: dict[str, Any], case: Case) -> None:
    evidence = evidence_without_outliers(IDENTIFIED)._replace(may_be_transfer=False)
    assert case_of_one(evidence._replace(**changes)) == case


@pytest.mark.parametrize(
    ("memory", "weight_ratio", "has_standstill", "case"),
    [
        (IDENTIFIED, 2.0, False, Decided),
        (IDENTIFIED, 0.5, False, Decided),
        (IDENTIFIED, 1.1, False, Ambiguous),
        (GroundMemory.none((32, 32)), 2.0, False, Ambiguous),
        (IDENTIFIED, 2.0, True, MainCase.PARTIAL_TRANSFER),
        (replace(IDENTIFIED, faults=ImageFaults(transfers=MAX_TRANSFERS)), 2.0, True, Decided),
    ],
)
def test_the_case_of_two_motions_follows_from_their_weights(
    memory: GroundMemory, weight_ratio: float, *, has_standstill: bool, case: type | MainCase
) -> None:
    """The heavier motion explains three quarters of the landmarks."""
    tracks = SimpleNamespace(inlier_count=9, inliers=np.ones(9, np.bool_))
    agreement = SimpleNamespace(unexplained_fraction=0.25 if weight_ratio > 1.0 else 0.75)
    motion = Motion(tracks, agreement)  # type: ignore[arg-type]
    motions = TwoMotions(motion, motion, weight_ratio, has_standstill)
    found = case_of_two(motions, evidence_without_outliers(memory))
    assert case is (found if isinstance(found, MainCase) else type(found))


def test_each_transfer_counts_so_that_a_row_of_them_ends() -> None:
    memory = GroundMemory.none((32, 32))
    for _ in range(MAX_TRANSFERS):
        assert evidence_without_outliers(memory).may_be_transfer
        memory = after(memory, effect_of(MainCase.PARTIAL_TRANSFER, evidence_without_outliers(memory)))
    assert not evidence_without_outliers(memory).may_be_transfer
    decided = Decided(motions=None)  # type: ignore[arg-type]
    assert after(memory, effect_of(decided, evidence_without_outliers(memory))).faults.transfers == 0


def test_a_refused_pair_does_not_replace_the_image_at_the_last_known_pose() -> None:
    before = replace(GroundMemory.none((32, 32)), earlier=EarlierImage(IMAGE, HERE), last_image=IMAGE)
    learnt = replace(before, last_image=np.ones((16, 16), np.float32), faults=ImageFaults(transfers=2))
    refused = decide({Finding.CONTRADICTED})
    next_earlier = EarlierImage(IMAGE, HERE)
    assert NextMemory.of_selected(before, learnt, next_earlier, outlasts_refusal=False).for_verdict(refused) is before
    memory = NextMemory.of_selected(before, learnt, next_earlier, outlasts_refusal=True).for_verdict(refused)
    assert memory.last_image is before.last_image
    assert memory.faults.transfers == 2


def test_a_second_motion_before_the_ground_is_identified_degrades_twelve_pairs() -> None:
    """The example in the docstring of `selection`: ten pairs of doubt and recovery follow, then clean pairs."""
    memory = GroundMemory.none((32, 32))
    found = []
    ambiguous = Ambiguous(motions=None)  # type: ignore[arg-type]
    case: Case = ambiguous
    for _ in range(14):
        effect = effect_of(case, evidence_without_outliers(memory))
        memory = after(memory, effect)
        found.append((case, findings_of(effect, memory.faults, is_trusted=True)))
        case = case_of_one(evidence_without_outliers(memory))
    assert found == [
        (ambiguous, frozenset({Finding.AMBIGUOUS})),
        *[(MainCase.IN_DOUBT, frozenset({Finding.GROUND_IN_DOUBT}))] * 9,
        *[(MainCase.ONE_MOTION, frozenset({Finding.RECOVERING}))] * 2,
        *[(MainCase.ONE_MOTION, frozenset())] * 2,
    ]
    assert memory.is_identified


NO_CELLS = np.zeros((2, 3), np.bool_)


def after_agreements(identification: Identification, pairs: int) -> Phase:
    """Return the phase after some pairs that one motion explains."""
    for _ in range(pairs):
        identification = identification.after(Sign.AGREES, NO_CELLS)
    return identification.phase


def test_doubt_lasts_longer_for_a_ground_that_was_not_identified() -> None:
    learning = Identification()
    assert after_agreements(learning, AGREEING_PAIRS - 1) is Phase.LEARNING
    assert after_agreements(learning, AGREEING_PAIRS) is Phase.IDENTIFIED
    identified = Identification(Phase.IDENTIFIED)
    for before, pairs in ((identified, AGREEING_PAIRS), (learning, LONG_DOUBT_PAIRS)):
        doubt = before.after(Sign.DOUBTS, ~NO_CELLS)
        assert after_agreements(doubt, pairs - 1) is Phase.IN_DOUBT
        assert after_agreements(doubt, pairs) is Phase.LEARNING
        assert doubt.after(Sign.AGREES_PARTLY, NO_CELLS) is doubt
        assert doubt.restarted() is doubt
    assert identified.after(Sign.AGREES_PARTLY, NO_CELLS) is identified
    assert identified.restarted().phase is Phase.LEARNING


def test_a_second_motion_may_be_the_ground_until_the_ground_is_identified() -> None:
    """The selected motion may then be wrong, so that the covariance of all later poses contains the ambiguity."""
    learning = GroundMemory.none((32, 32))
    identified = replace(learning, identification=Identification(Phase.IDENTIFIED))

    def inflation_of(case: Case, memory: GroundMemory) -> Inflation:
        effect = effect_of(case, evidence_without_outliers(memory))
        return decide(findings_of(effect, memory.faults, is_trusted=True)).inflation

    for case in (MainCase.PARTIAL_TRANSFER, MainCase.UNEXPLAINED):
        assert Inflation.AMBIGUITY in inflation_of(case, learning)
        assert Inflation.AMBIGUITY in inflation_of(case, identified.after_lost_pair())
        assert Inflation.AMBIGUITY not in inflation_of(case, identified)
    body = OwnBody(off_body=None)  # type: ignore[arg-type]
    assert inflation_of(body, learning) is Inflation.UNOBSERVED
    assert inflation_of(body, identified) is Inflation.NONE


def test_a_pair_at_rest_neither_ends_a_doubt_nor_prolongs_it() -> None:
    learning = GroundMemory.none((32, 32))
    memory = after(learning, effect_of(MainCase.HALF_UNEXPLAINED, evidence_without_outliers(learning)))
    evidence = evidence_without_outliers(memory, moves_image=False)
    at_rest = effect_of(case_of_one(evidence), evidence)
    later = after(memory, at_rest, EXPLAINED._replace(moves_image=False))
    assert at_rest.finding is Finding.AT_REST_IN_DOUBT
    assert later.identification is memory.identification
    assert later.typical is None


def test_the_ground_must_be_identified_again_after_a_lost_pair() -> None:
    """The landmarks that are found again may be those of an object."""

    def phase() -> Phase:
        return by._state.ground_memory.identification.phase

    by = Localiser(LOC_RIG, LocalisationConfig(), true_pose(0))
    run(DRIVE[:8], by)
    assert phase() is Phase.IDENTIFIED
    black = np.zeros_like(DRIVE[8].left)
    assert run([StereoPair(DRIVE[8].stamp_ns, black, black)], by)[0].state is TrackingState.LOST
    assert phase() is Phase.LEARNING
    assert {item.state for item in run(DRIVE[9:14], by)} == {TrackingState.TRACKING}
    assert phase() is Phase.IDENTIFIED


@pytest.mark.sample
def test_a_body_that_hides_most_of_the_first_image_is_no_silent_error() -> None:
    """The pose of the second pair follows a few landmarks beside the body, and is wrong by 12 cm."""
    sequence = drive_of(open_source(SAMPLE))
    truth = sequence.ground_truth
    assert truth is not None
    pairs = list(islice(sequence.pairs(), 5))
    by = Localiser(sequence.rig, LocalisationConfig(), truth.pose(0))
    with_body = FaultInjector([parse_fault("body:amount=0.6")], 3, len(sequence), sequence.rig)
    estimates = run((pair for _, pair in with_body.pairs(pairs)), by)
    assert stated_errors(estimates, truth).error_report is ErrorReport.REPORTED


def test_another_motion_of_old_landmarks_alone_has_the_weight_of_old_landmarks() -> None:
    def followed(hosts: list[int]) -> Motion:
        landmarks = SimpleNamespace(host=np.array(hosts), newest_host=max(hosts))
        tracks = SimpleNamespace(
            inliers=np.ones(len(hosts), np.bool_), inlier_count=len(hosts), landmarks=landmarks, pose=None
        )
        return Motion(tracks, None)  # type: ignore[arg-type]

    guesses = SimpleNamespace(repeated_motion=None, standstill=None)
    pair = SimpleNamespace(guesses=guesses, image_motion_px=lambda *_, **__: 1.0)
    motions = weighed(pair, followed([0, 1, 2, 2]), followed([0, 0, 1]))  # type: ignore[arg-type]
    assert motions.weight_ratio == pytest.approx((2.0 * OLD_WEIGHT + 2.0) / (3.0 * OLD_WEIGHT))


def test_the_own_body_is_found_by_the_first_motion_and_left_out() -> None:
    with_body = with_fault("body:amount=0.3")
    assert worst_ratio(with_body) < 1.0
    error = np.linalg.norm(with_body[-1].T_ds_rb.translation - true_pose(len(DRIVE) - 1).translation)
    assert error < 0.02
    assert np.median(masked(with_body)) == pytest.approx(0.3, abs=0.12)


def test_the_cells_of_the_own_body_are_excluded_with_its_landmarks() -> None:
    """Otherwise the next keyframes create landmarks on the body again."""
    with_body = with_fault("body:amount=0.5")
    assert worst_ratio(with_body) < 1.0
    assert max(masked(with_body)[:4]) == pytest.approx(0.5, abs=0.1)


def test_a_crossing_object_does_not_carry_the_pose_along() -> None:
    estimates = with_fault("object:amount=0.3,share=1,burst=20,start=8")
    assert worst_ratio(estimates) < 1.0
    assert max(masked(estimates)) > 0.0


@pytest.mark.parametrize("fault", ["dirt:amount=0.15", "shadow:amount=0.25"])
def test_dirt_and_own_shadow_do_not_hold_the_pose(fault: str) -> None:
    assert worst_ratio(with_fault(fault)) < 1.0


SEVERE = ("texture", "reflection", "body:amount=0.6", "ghost:share=0.3", "interlaced:share=0.3", "shear:share=0.3")

LATER = ("reflection:share=1,start=5", "ghost:amount=0.66,share=0.5,burst=4,start=5")


@pytest.mark.sample
@pytest.mark.parametrize("fault", [*SEVERE, "yaw:amount=0.3", "shift:amount=2", "ghost:share=1", *LATER])
def test_what_no_pose_explains_is_said(fault: str) -> None:
    """Most of the image does not move with the ground, or is of another moment; the right camera looks elsewhere."""
    sequence = drive_of(open_source(SAMPLE))
    truth = sequence.ground_truth
    assert truth is not None
    pairs = list(islice(sequence.pairs(), PAIRS))
    by = Localiser(sequence.rig, LocalisationConfig(), truth.pose(0))
    estimates = run((pair for _, pair in FaultInjector([parse_fault(fault)], 1, PAIRS, sequence.rig).pairs(pairs)), by)
    known = [item for item in estimates if item.state is not TrackingState.LOST]
    assert stated_errors(estimates, truth).error_report is not ErrorReport.SILENT
    assert (
        stated_errors([replace(item, state=TrackingState.TRACKING) for item in known], truth).error_report
        is not ErrorReport.SILENT
    )
    states = Counter(item.state for item in estimates[1:])
    assert "body" in fault or states[TrackingState.DEGRADED] + states[TrackingState.LOST] > 0
    if fault in ("texture", "reflection"):
        assert states[TrackingState.TRACKING] == 0
    elif fault in SEVERE:
        assert states[TrackingState.TRACKING] > PAIRS // 4


@pytest.mark.sample
@pytest.mark.parametrize("weight", [0.3, 0.6])
def test_exposures_that_are_blended_for_several_pairs_are_reported(weight: float) -> None:
    """The poses of such pairs may lag behind, and the step to the first good pair is then too long."""
    sequence = drive_of(open_source(SAMPLE))
    pairs = list(islice(sequence.pairs(), 90, 110))
    truth = later_truth(sequence.ground_truth, pairs[0].stamp_ns)
    blended = list(pairs)
    for number in range(10, 17):
        sides = {
            side: np.rint((1.0 - weight) * getattr(pairs[number], side) + weight * getattr(pairs[number - 1], side))
            for side in ("left", "right")
        }
        blended[number] = replace(pairs[number], **{side: image.astype(np.uint8) for side, image in sides.items()})
    estimates = run(blended, Localiser(sequence.rig, LocalisationConfig(), truth.pose(0)))
    assert {item.state for item in estimates[1:10]} == {TrackingState.TRACKING}
    assert {item.state for item in estimates[10:17]} == {TrackingState.DEGRADED}
    assert stated_errors(estimates, truth).error_report is ErrorReport.REPORTED


@pytest.mark.parametrize("fault", ["arm:share=1,start=5", "scratch", "reflection:amount=0.3"])
def test_arms_and_windows_do_not_carry_the_pose_along(fault: str) -> None:
    assert worst_ratio(with_fault(fault)) < 1.0


def test_a_fast_drive_on_a_bare_road_is_not_lost(shared_data: Path) -> None:
    loc = open_source(shared_data / "kitti-1").loc
    assert loc is not None
    rows = np.clip((np.arange(loc.rig.height) - 175) / 40.0, 0.0, 1.0)[:, None]  # how bare: all from the horizon down

    def bare(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        return np.asarray(image * (1.0 - rows) + cv2.GaussianBlur(image, (0, 0), 5.0) * rows, np.uint8)

    localiser = Localiser(loc.rig)
    pairs = islice(loc.pairs(), 1, None, 3)  # 36 m/s
    states = [localiser.process(replace(pair, left=bare(pair.left), right=bare(pair.right))).state for pair in pairs]
    assert TrackingState.LOST not in states
    assert states.count(TrackingState.TRACKING) > 0.6 * len(states)


@pytest.mark.parametrize("stale_from_row", [0, HEIGHT * 3 // 4])
def test_the_ground_stays_in_doubt_while_stale_images_are_blanked(stale_from_row: int) -> None:
    """No motion can then be selected, and the covariance contains the ambiguity as in a pair with good images."""
    doubt = Identification(Phase.IN_DOUBT, pairs_left=LONG_DOUBT_PAIRS)
    stale = DRIVE[12].left.copy()
    stale[stale_from_row:] = DRIVE[11].left[stale_from_row:]
    sigmas = []
    for left in (DRIVE[12].left, stale):
        by = Localiser(LOC_RIG, LocalisationConfig(), true_pose(0))
        run(DRIVE[:12], by)
        by._state = replace(by._state, ground_memory=replace(by._state.ground_memory, identification=doubt))
        estimate = by.process(replace(DRIVE[12], left=left))
        assert estimate.state is TrackingState.DEGRADED
        sigmas.append(np.sqrt(np.trace(estimate.covariance[:3, :3])))
    assert sigmas[1] > 0.9 * sigmas[0]


def test_a_standstill_in_doubt_adds_nothing_to_the_covariance() -> None:
    """The ground is in doubt when the rover stops, and the images have new noise."""
    rng = np.random.default_rng(0)
    by = Localiser(LOC_RIG, LocalisationConfig(), true_pose(0))
    run(DRIVE[:12], by)
    last = DRIVE[11]
    stop = [
        StereoPair(last.stamp_ns + k * 10**8, noisy(last.left, 1, rng), noisy(last.right, 1, rng)) for k in range(1, 40)
    ]
    run(stop[:12], by)
    doubt = Identification(Phase.IN_DOUBT, pairs_left=LONG_DOUBT_PAIRS)
    by._state = replace(by._state, ground_memory=replace(by._state.ground_memory, identification=doubt))
    stopped = run(stop[12:], by)
    assert {item.state for item in stopped} == {TrackingState.DEGRADED}
    assert np.trace(stopped[-1].covariance) < 1.1 * np.trace(stopped[0].covariance)


def beside_each_other(left_of: StereoPair, right_of: StereoPair, columns: int, stamp_ns: int, seed: int) -> StereoPair:
    """Return a pair whose left columns show one pair and whose other columns show another, with new noise."""
    rng = np.random.default_rng(seed)

    def joined(first: NDArray[np.uint8], other: NDArray[np.uint8]) -> NDArray[np.uint8]:
        return noisy(np.hstack((first[:, :columns], other[:, columns:])), 1, rng)

    return StereoPair(stamp_ns, joined(left_of.left, right_of.left), joined(left_of.right, right_of.right))


def test_an_object_that_begins_to_move_before_the_ground_is_identified_does_not_carry_a_rover_at_rest_along() -> None:
    at_rest = DRIVE[0]
    pairs = [beside_each_other(DRIVE[max(k - 3, 0)], at_rest, 40, DRIVE[k].stamp_ns, k) for k in range(16)]
    estimates = run(pairs)
    errors = [np.linalg.norm(item.T_ds_rb.translation - true_pose(0).translation) for item in estimates]
    assert max(errors) < 0.003
    assert {item.state for item in estimates[4:]} == {TrackingState.DEGRADED}


def test_a_rover_with_a_body_in_view_drives_off_before_the_ground_is_identified() -> None:
    pairs = [beside_each_other(DRIVE[0], DRIVE[max(k - 3, 0)], 40, DRIVE[k].stamp_ns, k) for k in range(10)]
    estimates = run(pairs)
    truth = [true_pose(max(k - 3, 0)) for k in range(10)]
    errors = [
        np.linalg.norm(item.T_ds_rb.translation - to.translation) for item, to in zip(estimates, truth, strict=True)
    ]
    assert max(errors) < 0.01


def test_a_lost_localiser_whose_map_contradicts_all_images_begins_a_window() -> None:
    """The left half is fixed to the camera. The ground jumps after the first pair, so that only the body is tracked."""
    config = LocalisationConfig(motion=MotionBounds(unseen_speed_m_s=1000.0, max_speed_m_s=1e4))  # lost after one pair
    at = [0, *range(16, 30)]
    pairs = [beside_each_other(DRIVE[0], DRIVE[at[k]], 80, DRIVE[k].stamp_ns, k) for k in range(len(at))]
    estimates = run(pairs, Localiser(LOC_RIG, config, true_pose(0)))
    lost, restarted = estimates[2:5], estimates[5:]
    assert {(item.state, item.reason) for item in lost} == {(TrackingState.LOST, StateReason.MOVING_REGIONS)}
    assert {(item.state, item.reason) for item in restarted} == {(TrackingState.DEGRADED, StateReason.UNSEEN_MOTION)}
    assert min(item.covariance[0, 0] for item in restarted) > 9999.0
    motion = restarted[-1].T_ds_rb.translation - restarted[5].T_ds_rb.translation
    true_motion = true_pose(at[-1]).translation - true_pose(at[10]).translation
    np.testing.assert_allclose(motion, true_motion, atol=0.01)


def test_nothing_is_left_out_of_a_fault_free_drive_or_of_one_that_stands_still() -> None:
    rng, first = np.random.default_rng(0), DRIVE[0]
    still = [StereoPair(p.stamp_ns, noisy(first.left, 1, rng), noisy(first.right, 1, rng)) for p in DRIVE[:10]]
    driven, standing = run(DRIVE[:20]), run(still)
    assert not any(masked(driven) + masked(standing))
    assert {item.state for item in (*driven[1:], *standing[1:])} == {TrackingState.TRACKING}


@pytest.mark.sample
def test_a_pair_that_is_hardly_explained_teaches_nothing_about_the_ground() -> None:
    """A scratched lens: the pose is lost among the scratches before the ground's motion is known."""
    sequence = drive_of(open_source(SAMPLE))
    pairs = list(islice(sequence.pairs(), 48, 72))
    truth = later_truth(sequence.ground_truth, pairs[0].stamp_ns)
    by = Localiser(sequence.rig, LocalisationConfig(), truth.pose(0))
    scratched = FaultInjector([parse_fault("scratch:amount=0.272")], 407223818, 100, sequence.rig)
    estimates = run((pair for _, pair in scratched.pairs(pairs)), by)
    assert stated_errors(estimates, truth).error_report is not ErrorReport.SILENT
