"""Where a localiser starts, over all events of a node; the pose kept for a restart."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sfr_loc_map.errors import GeometryError, InputError, LocalisationError, OutputError
from sfr_loc_map.geometry.plausibility import LOST_VARIANCE
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import PoseEstimate, StartPose, TrackingState
from sfr_loc_map.nodes.localisation.localisation_session import LocalisationSession, completed_pose
from sfr_loc_map.nodes.localisation.pose_file import PoseFile

RIG = StereoRig(160, 120, 150.0, 150.0, 79.5, 59.5, 0.12)
OTHER_RIG = replace(RIG, fx=151.0, fy=151.0)
EXTRINSICS = Transform.identity()
RIG_ON_ROVER = replace(RIG, T_rb_sb=EXTRINSICS)
OTHER_RIG_ON_ROVER = replace(OTHER_RIG, T_rb_sb=EXTRINSICS)
S = 1_000_000_000
COVARIANCE = np.diag([0.1, 0.2, 0.3, 0.01, 0.02, 0.03])


def at(x: float) -> Transform:
    return Transform(np.eye(3), np.array([x, 0.0, 0.0]))


FIRST, KEPT, GIVEN, LAST = at(0.0), at(7.0), at(3.0), at(1.5)


class Phase(StrEnum):
    """What the next pair leads to: a localiser starts at the kept pose, at one that is known already, or goes on."""

    NEW, READY, RUNNING = "new", "ready", "running"


NEW, READY, RUNNING = Phase


def phase_of(session: LocalisationSession) -> Phase:
    return RUNNING if session._localiser is not None else NEW if session.may_resume else READY


class FakeLocaliser:
    """Remembers where it was started or moved."""

    def __init__(self, rig: StereoRig, config: LocalisationConfig, start: StartPose) -> None:
        self.start = start

    def set_pose(self, pose: StartPose) -> None:
        self.start = pose

    def pose_at(self, stamp_ns: int) -> Transform:
        """Return a pose that sinks by 1 m/s."""
        return Transform(np.eye(3), np.array([0.0, 0.0, -stamp_ns / S]))


def file_in(folder: Path) -> PoseFile:
    return PoseFile(folder / "pose.json", 10.0)


def new_session(folder: Path, warnings: list[str] | None = None) -> LocalisationSession:
    made: Any = FakeLocaliser
    warn = (warnings if warnings is not None else []).append
    return LocalisationSession(LocalisationConfig(), file_in(folder), warn, made)


def estimate(stamp_ns: int, pose: Transform, state: TrackingState = TrackingState.TRACKING) -> PoseEstimate:
    return PoseEstimate(stamp_ns, pose, COVARIANCE, state)


def session_in(phase: Phase, folder: Path) -> LocalisationSession:
    """Return a session with a kept pose; a running one has tracked two pairs, 0.5 m apart."""
    file_in(folder).save(StartPose(KEPT, COVARIANCE, 1 * S), RIG_ON_ROVER)
    session = new_session(folder)
    session.set_rig(RIG_ON_ROVER)
    if phase is not NEW:
        session.restart()
    if phase is RUNNING:
        session.localiser_at(2 * S)
        session.accept(replace(estimate(2 * S, at(1.0)), covariance=4 * COVARIANCE))
        session.accept(estimate(3 * S, LAST))
    assert phase_of(session) is phase
    return session


def start_of(session: LocalisationSession, stamp_ns: int) -> tuple[float, ...]:
    """Return x at which the localiser of a pair starts, its variance and the stamp at which it holds."""
    localiser: Any = session.localiser_at(stamp_ns)
    start = localiser.start
    return start.T_ds_rb.translation[0], start.covariance[0, 0], start.stamp_ns


Event = Callable[[LocalisationSession], object]
EVENTS: dict[str, Event] = {
    "pair": lambda session: session.localiser_at(4 * S),
    "set_pose": lambda session: session.set_pose(StartPose(GIVEN)),
    "restart": LocalisationSession.restart,
    "restart after set_pose": lambda session: (session.set_pose(StartPose(GIVEN)), session.restart()),
    "reset after set_pose": lambda session: (session.set_pose(StartPose(GIVEN)), session.reset()),
    "continue": LocalisationSession.continue_at_last_pose,
    "same rig": lambda session: session.set_rig(RIG_ON_ROVER),
    "other rig": lambda session: session.set_rig(OTHER_RIG_ON_ROVER),
    "other configuration": lambda session: session.set_config(LocalisationConfig(max_features=300)),
    "continue after set_pose": lambda session: (session.set_pose(StartPose(GIVEN)), session.continue_at_last_pose()),
}
# x, variance and stamp at which the localiser of the next pair starts; no stamp: it holds at that pair
AT_FIRST, AT_GIVEN = (READY, (0.0, 0.0, None)), (READY, (3.0, 0.0, None))
AT_LAST, AT_KEPT = (READY, (1.5, 0.1, 3 * S)), (NEW, (7.0, 0.1, 1 * S))
UNCHANGED = (RUNNING, None)
# phase after an event, and where the next localiser starts, by the phase before: new, ready, running
TRANSITIONS = {
    "pair": ((RUNNING, AT_KEPT[1]), (RUNNING, AT_FIRST[1]), UNCHANGED),
    "set_pose": (AT_GIVEN, AT_GIVEN, (RUNNING, AT_GIVEN[1])),
    "restart": (AT_FIRST, AT_FIRST, AT_FIRST),
    "restart after set_pose": (AT_GIVEN, AT_GIVEN, AT_GIVEN),
    "reset after set_pose": (AT_FIRST, AT_FIRST, AT_FIRST),
    "continue": (AT_KEPT, AT_FIRST, AT_LAST),
    "same rig": (AT_KEPT, AT_FIRST, UNCHANGED),
    "other rig": ((NEW, AT_FIRST[1]), AT_FIRST, AT_LAST),
    "other configuration": (AT_KEPT, AT_FIRST, AT_LAST),
    "continue after set_pose": (AT_GIVEN, AT_GIVEN, AT_GIVEN),
}


@pytest.mark.parametrize("before", list(Phase))
@pytest.mark.parametrize("event", EVENTS)
def test_each_transition_from_each_phase(tmp_path: Path, event: str, before: Phase) -> None:
    session = session_in(before, tmp_path)
    running = session.localiser_at(3 * S) if before is RUNNING else None
    after, start = TRANSITIONS[event][list(Phase).index(before)]
    EVENTS[event](session)
    assert phase_of(session) is after
    if start is None:
        assert session.localiser_at(4 * S) is running
    else:
        assert start_of(session, 4 * S) == start
    assert phase_of(session) is RUNNING


@pytest.mark.parametrize(
    ("set_pose", "name"),
    [(LocalisationSession.set_pose, "the external pose"), (LocalisationSession.set_first, "the start pose")],
)
@pytest.mark.parametrize("wrong", [at(1e9), Transform(2.0 * np.eye(3), np.zeros(3))])
def test_an_invalid_pose_is_refused_and_changes_nothing(
    tmp_path: Path, set_pose: Any, name: str, wrong: Transform
) -> None:
    session = session_in(READY, tmp_path)
    with pytest.raises(GeometryError, match=name):
        set_pose(session, StartPose(wrong))
    session.restart()
    assert start_of(session, 4 * S) == AT_FIRST[1]


@pytest.mark.parametrize("convert", [np.float32, np.ndarray.tolist])
def test_a_covariance_may_be_of_another_type(tmp_path: Path, convert: Callable[[np.ndarray], Any]) -> None:
    session = session_in(READY, tmp_path)
    session.set_pose(StartPose(GIVEN, convert(COVARIANCE)))
    assert start_of(session, 4 * S)[1] == pytest.approx(COVARIANCE[0, 0])


@pytest.mark.parametrize("covariance", ["x", None, [], [[1.0], [1.0, 2.0]], np.eye(5), np.full((6, 6), np.nan)])
def test_a_covariance_that_is_no_covariance_is_refused(covariance: Any) -> None:
    with pytest.raises(GeometryError, match="6 x 6"):
        StartPose.of(StartPose(GIVEN, covariance))


@pytest.mark.parametrize("variance", [None, np.nan, np.inf, -1.0])
def test_a_lost_pose_or_one_without_covariance_is_neither_kept_nor_started_from(
    tmp_path: Path, variance: float | None
) -> None:
    session = session_in(RUNNING, tmp_path)
    if variance is None:
        session.accept(estimate(4 * S, at(9.0), TrackingState.LOST))
        session.continue_at_last_pose()
    else:
        covariance = COVARIANCE.copy()
        covariance[2, 2] = variance
        with pytest.raises(LocalisationError, match="restarts at its last pose"):
            session.accept(replace(estimate(4 * S, at(2.0)), covariance=covariance))
    kept = file_in(tmp_path).load(5 * S, RIG_ON_ROVER)
    assert kept.stamp_ns == 3 * S
    assert start_of(session, 5 * S)[::2] == (1.5, 3 * S)


@pytest.mark.parametrize("rig", [replace(RIG, T_rb_sb=at(0.01)), OTHER_RIG_ON_ROVER])
def test_a_kept_pose_of_another_rig_is_told_and_not_resumed_from(tmp_path: Path, rig: StereoRig) -> None:
    session_in(NEW, tmp_path)
    warnings: list[str] = []
    session = new_session(tmp_path, warnings)
    session.set_rig(rig)
    assert start_of(session, 2 * S)[0] == 0.0
    assert "saved with another rig or calibration" in warnings[0]


def test_a_pose_comes_back_to_the_last_digit_while_it_is_young(tmp_path: Path) -> None:
    pose, file = Transform(matrix_from_rotvec([0.1, -0.2, 0.3]), np.array([1.0, 2.0, 3.0])), file_in(tmp_path)
    assert file.load(S, RIG_ON_ROVER) is None
    file.save(StartPose(pose, COVARIANCE, S), RIG_ON_ROVER)
    found = file.load(S + 1, RIG_ON_ROVER)
    assert found.stamp_ns == S
    assert np.array_equal(found.T_ds_rb.translation, pose.translation)
    assert np.allclose(found.T_ds_rb.rotation, pose.rotation, rtol=0, atol=1e-15)
    assert np.array_equal(found.covariance, COVARIANCE)
    assert [path.name for path in tmp_path.iterdir()] == ["pose.json"]
    for age_ns, taken in ((-1, False), (0, False), (10 * S, True), (10 * S + 1, False)):
        assert (file.load(S + age_ns, RIG_ON_ROVER) is not None) == taken


@pytest.mark.parametrize(
    ("pose", "is_saved"),
    [
        (StartPose(KEPT, COVARIANCE, np.int64(S)), True),  # type: ignore[arg-type]
        (StartPose(KEPT, COVARIANCE, None), False),
        (StartPose(KEPT, COVARIANCE, -1), False),
        (StartPose(KEPT, COVARIANCE, 2**63), False),
        (StartPose(at(6e8), COVARIANCE, S), False),
        (StartPose(KEPT, np.full((6, 6), np.nan), S), False),
    ],
)
def test_what_is_saved_can_be_loaded(tmp_path: Path, pose: StartPose, *, is_saved: bool) -> None:
    file = file_in(tmp_path)
    file.save(pose, RIG_ON_ROVER)
    assert (file.load(S + 1, RIG_ON_ROVER) is not None) == is_saved


def test_a_broken_file_is_reported(tmp_path: Path) -> None:
    path, file = tmp_path / "pose.json", file_in(tmp_path)
    file.save(StartPose(KEPT, COVARIANCE, S), RIG_ON_ROVER)
    good = json.loads(path.read_text())
    wrong = {"stamp_ns": -1, "schema": "sfr-resume/2", "translation_m": [1e300, 0, 0], "quat_xyzw": [0, 0, 0, 0]}
    values = [json.dumps(good | {name: value}) for name, value in (*wrong.items(), ("covariance", [float("inf")] * 36))]
    values.append(json.dumps(good | {"translation_m": [6e8, 0, 0]}))
    for text in ("", "[]", '{"x": ' + "[" * 100_000, "\0" * 100, json.dumps(good)[:-9], *values):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(InputError, match=r"cannot be read.*the file is replaced"):
            file.load(2, RIG_ON_ROVER)


def test_damaged_poses_are_replaced_and_other_files_never(tmp_path: Path) -> None:
    path, file = tmp_path / "pose.json", file_in(tmp_path)
    file.check()
    file.save(StartPose(KEPT, COVARIANCE, S), RIG_ON_ROVER)
    whole = path.read_bytes()
    for ours in (whole, whole[:100], whole[:5], b"", bytes(4096)):
        path.write_bytes(ours)
        file.check()
        file.save(StartPose(KEPT, COVARIANCE, S), RIG_ON_ROVER)
        assert path.read_bytes() == whole
    for strange in (b"{}", b'{"width": 512}', b"years of work", b"\x89PNG", b"x" * 200_000):
        path.write_bytes(strange)
        with pytest.raises(OutputError, match=r"has no saved pose|larger than"):
            file.check()
        with pytest.raises(OutputError, match=r"has no saved pose|larger than"):
            file.save(StartPose(KEPT, COVARIANCE, S), RIG_ON_ROVER)
        assert path.read_bytes() == strange
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    for name, words in (("folder", "it is a folder"), ("pipe", "a named pipe"), ("none/x", "does not exist")):
        with pytest.raises(OutputError, match=words):
            PoseFile(tmp_path / name, 10.0).check()


@pytest.mark.parametrize("unknown", [0.0, LOST_VARIANCE, 1e6])
def test_a_pose_on_a_plane_leaves_height_and_tilt_as_they_are(unknown: float) -> None:
    """RViz sends x, y and yaw with variances, zeros for the rest; a filter on a plane sends large variances.

    A covariance of zeros alone is an exact pose.
    """
    tilt = matrix_from_rotvec([0.05, 0.12, 0.0])
    known = StartPose(Transform(matrix_from_rotvec([0.0, 0.0, 0.4]) @ tilt, np.array([1.0, 2.0, 3.0])), COVARIANCE, 5)
    flat = Transform(matrix_from_rotvec([0.0, 0.0, -1.1]), np.array([7.0, 8.0, 0.0]))
    variances = np.diag([0.25, 0.25, unknown, unknown, unknown, 0.07])
    found = completed_pose(StartPose(flat, variances, 9), known)
    np.testing.assert_allclose(found.T_ds_rb.translation, [7.0, 8.0, 3.0], atol=1e-12)
    up = found.T_ds_rb.rotation.T[:, 2]  # the vertical in RB: its tilt
    np.testing.assert_allclose(up, known.T_ds_rb.rotation.T[:, 2], atol=1e-12)
    assert np.arctan2(found.T_ds_rb.rotation[1, 0], found.T_ds_rb.rotation[0, 0]) == pytest.approx(-1.1, abs=1e-12)
    assert np.diag(found.covariance)[[0, 1, 2, 5]].tolist() == [0.25, 0.25, 0.3, 0.07]
    for covariance in (np.zeros((6, 6)), COVARIANCE):
        given = StartPose(flat, covariance, 9)
        assert completed_pose(given, known) is given


@pytest.mark.parametrize(("stamp_ns", "height_m"), [(1 * S, -1.0), (2 * S + 1, -2.000000001), (None, -3.0)])
def test_unknown_components_are_those_of_the_run_at_the_stamp(
    tmp_path: Path, stamp_ns: int | None, height_m: float
) -> None:
    session = session_in(RUNNING, tmp_path)
    session.accept(estimate(3 * S, Transform(np.eye(3), np.array([0.0, 0.0, -3.0]))))
    session.set_pose(StartPose(at(7.0), np.diag([0.25, 0.25, 0.0, 0.0, 0.0, 0.07]), stamp_ns))
    start = session.localiser_at(4 * S).start  # type: ignore[attr-defined]
    np.testing.assert_allclose(start.T_ds_rb.translation, [7.0, 0.0, height_m], atol=1e-12)
    np.testing.assert_allclose(np.diag(start.covariance), [0.25, 0.25, 0.3, 0.01, 0.02, 0.07], atol=1e-12)


@pytest.mark.parametrize("before", [0.0, 0.3])
@pytest.mark.parametrize("turn", [0.0, np.pi / 4, np.pi / 2, np.pi, -np.pi / 2])
def test_the_uncertainty_of_the_tilt_turns_with_the_yaw(before: float, turn: float) -> None:
    def yawed(angle: float) -> Transform:
        return Transform(matrix_from_rotvec([0.0, 0.0, angle]), np.zeros(3))

    # yaw of RB at `before`: the sigma about the x axis of RB is 0.1, and about its y axis 0.01
    of_tilt = yawed(before).rotation[:2, :2] @ np.diag([1e-2, 1e-4]) @ yawed(before).rotation[:2, :2].T
    covariance = np.diag([0.1, 0.2, 0.3, 0.0, 0.0, 0.03])
    covariance[3:5, 3:5] = of_tilt
    known = StartPose(yawed(before), covariance)
    given = StartPose(yawed(before + turn), np.diag([0.25, 0.25, 0.0, 0.0, 0.0, 0.07]))
    found = completed_pose(given, known)
    in_body = found.T_ds_rb.rotation[:2, :2].T @ found.covariance[3:5, 3:5] @ found.T_ds_rb.rotation[:2, :2]
    np.testing.assert_allclose(in_body, np.diag([1e-2, 1e-4]), atol=1e-12)
    assert found.covariance[2, 2] == pytest.approx(0.3)


@pytest.mark.parametrize("unknown", [0.0, LOST_VARIANCE])
def test_a_pose_without_its_height_alone_keeps_that_of_the_run(unknown: float) -> None:
    known = StartPose(Transform(np.eye(3), np.array([1.0, 2.0, 3.0])), COVARIANCE, 5)
    tilted = Transform(matrix_from_rotvec([0.05, 0.12, 0.4]), np.array([7.0, 8.0, 0.0]))
    found = completed_pose(StartPose(tilted, np.diag([0.25, 0.25, unknown, 0.01, 0.01, 0.07]), 9), known)
    np.testing.assert_allclose(found.T_ds_rb.translation, [7.0, 8.0, 3.0], atol=1e-12)
    np.testing.assert_allclose(found.T_ds_rb.rotation, tilted.rotation, atol=1e-12)
