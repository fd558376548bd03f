"""Where a localiser starts, over all events of a node; the pose kept for a restart."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sfr_loc_map.errors import InputError, LocalisationError, OutputError
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import PoseEstimate, StartPose, TrackingState
from sfr_loc_map.pipeline.localisation_session import LocalisationSession, Phase, PoseFile

RIG = StereoRig(160, 120, 150.0, 150.0, 79.5, 59.5, 0.12)
OTHER_RIG = replace(RIG, fx=151.0, fy=151.0)
EXTRINSICS = Transform.identity()
RIG_ON_ROVER = replace(RIG, T_rb_sb=EXTRINSICS)
S = 1_000_000_000
COVARIANCE = np.diag([0.1, 0.2, 0.3, 0.01, 0.02, 0.03])


def at(x: float) -> Transform:
    return Transform(np.eye(3), np.array([x, 0.0, 0.0]))


KEPT, GIVEN, LAST = at(7.0), at(3.0), at(1.5)


class FakeLocaliser:
    """Remembers where it was started or moved."""

    def __init__(self, rig: StereoRig, config: LocalisationConfig, start: StartPose) -> None:
        self.rig, self.config, self.start, self.moved = rig, config, start, False

    @property
    def pose(self) -> Transform:
        return self.start.T_ds_rb

    def set_pose(self, pose: StartPose) -> None:
        self.start, self.moved = pose, True


def estimate(stamp_ns: int, pose: Transform, state: TrackingState = TrackingState.TRACKING) -> PoseEstimate:
    return PoseEstimate(stamp_ns, pose, COVARIANCE, state)


def session_in(phase: Phase, folder: Path) -> LocalisationSession:
    """Return a session with a kept pose; a running one has tracked two pairs, 0.5 m apart."""
    file = PoseFile(folder / "pose.json", 10.0)
    file.save(StartPose(KEPT, COVARIANCE, 1 * S), RIG_ON_ROVER)
    session = LocalisationSession(LocalisationConfig(), file, make_localiser=FakeLocaliser)  # type: ignore[arg-type]
    session.set_rig(RIG)
    if phase is not Phase.NEW:
        session.restart()
    if phase is Phase.RUNNING:
        session.localiser_at(2 * S, EXTRINSICS)
        session.accept(replace(estimate(2 * S, at(1.0)), covariance=4 * COVARIANCE))
        session.accept(estimate(3 * S, LAST))
    assert session.phase is phase
    return session


def pair(session: LocalisationSession) -> None:
    session.localiser_at(4 * S, EXTRINSICS)


def set_pose(session: LocalisationSession) -> None:
    session.set_pose(StartPose(GIVEN))


EVENTS: dict[str, Callable[[LocalisationSession], object]] = {
    "pair": pair,
    "set_pose": set_pose,
    "restart": LocalisationSession.restart,
    "restart after set_pose": lambda session: (session.set_pose(StartPose(GIVEN)), session.restart()),
    "reset after set_pose": lambda session: (session.set_pose(StartPose(GIVEN)), session.reset()),
    "continue": LocalisationSession.continue_at_last_pose,
    "same rig": lambda session: session.set_rig(RIG),
    "other rig": lambda session: session.set_rig(OTHER_RIG),
    "other configuration": lambda session: session.set_config(LocalisationConfig(max_features=300)),
    "continue after set_pose": lambda session: (session.set_pose(StartPose(GIVEN)), session.continue_at_last_pose()),
}
FIRST = Transform.identity()
UNCHANGED = "the running localiser"
NEW, READY, RUNNING = Phase.NEW, Phase.READY, Phase.RUNNING
# event, phase before, phase after, pose at which the localiser of the next pair starts, how well that is known
TRANSITIONS = [
    ("pair", NEW, RUNNING, KEPT, "kept"),
    ("pair", READY, RUNNING, FIRST, "none"),
    ("pair", RUNNING, RUNNING, UNCHANGED, "none"),
    ("set_pose", NEW, READY, GIVEN, "none"),
    ("set_pose", READY, READY, GIVEN, "none"),
    ("set_pose", RUNNING, RUNNING, GIVEN, "none"),
    ("restart", NEW, READY, FIRST, "none"),
    ("restart", READY, READY, FIRST, "none"),
    ("restart", RUNNING, READY, FIRST, "none"),
    *[("restart after set_pose", phase, READY, GIVEN, "none") for phase in Phase],
    *[("reset after set_pose", phase, READY, FIRST, "none") for phase in Phase],
    *[
        (event, before, after, pose, known)
        for event in ("continue", "other rig", "other configuration")
        for before, after, pose, known in (
            (NEW, NEW, FIRST, "none") if event == "other rig" else (NEW, NEW, KEPT, "kept"),
            (READY, READY, FIRST, "none"),
            (RUNNING, READY, LAST, "last"),
        )
    ],
    ("same rig", NEW, NEW, KEPT, "kept"),
    ("same rig", READY, READY, FIRST, "none"),
    ("same rig", RUNNING, RUNNING, UNCHANGED, "none"),
    *[("continue after set_pose", phase, READY, GIVEN, "none") for phase in Phase],
]
KNOWN = {"none": (0.0, None), "kept": (COVARIANCE[0, 0], 1 * S), "last": (COVARIANCE[0, 0], 3 * S)}
"""Variance of x, and the stamp at which the pose holds; None: at the next pair."""


@pytest.mark.parametrize(("event", "before", "after", "pose", "known"), TRANSITIONS)
def test_each_transition_from_each_phase(
    tmp_path: Path, event: str, before: Phase, after: Phase, pose: Transform | str, known: str
) -> None:
    session = session_in(before, tmp_path)
    running = session.localiser_at(3 * S, EXTRINSICS) if before is RUNNING else None
    EVENTS[event](session)
    assert session.phase is after
    localiser = session.localiser_at(4 * S, EXTRINSICS)
    assert session.phase is RUNNING
    if isinstance(pose, str):
        assert localiser is running
    else:
        assert np.array_equal(localiser.pose.translation, pose.translation)  # type: ignore[attr-defined]
        start = localiser.start  # type: ignore[attr-defined]
        assert (start.covariance[0, 0], start.stamp_ns) == KNOWN[known]


def test_every_transition_is_in_the_table() -> None:
    assert {(event, before) for event, before, *_ in TRANSITIONS} == {(e, phase) for e in EVENTS for phase in Phase}


def test_a_pair_before_rig_or_extrinsics_is_refused_and_changes_nothing(tmp_path: Path) -> None:
    session = LocalisationSession(LocalisationConfig(), PoseFile(tmp_path / "pose.json", 10.0))
    with pytest.raises(InputError, match=r"T_rb_locsb\.translation_m"):
        session.localiser_at(S, EXTRINSICS)
    assert not session.set_rig(RIG)
    with pytest.raises(InputError, match=r"T_rb_locsb\.translation_m"):
        session.localiser_at(S, None)
    assert session.phase is Phase.NEW
    assert not session.set_rig(RIG)
    assert session.set_rig(OTHER_RIG)


def test_wheel_odometry_counts_from_the_last_pair_that_was_tracked(tmp_path: Path) -> None:
    session = session_in(Phase.RUNNING, tmp_path)
    assert session.tracked_ns == 3 * S
    session.accept(estimate(4 * S, LAST, TrackingState.LOST))
    assert session.tracked_ns == 3 * S
    session.set_pose(StartPose(GIVEN))
    assert session.tracked_ns == 3 * S
    session.continue_at_last_pose()
    session.localiser_at(5 * S, EXTRINSICS)
    assert session.tracked_ns is None


def test_a_lost_pose_is_not_kept_and_the_next_localiser_starts_at_the_last_known_one(tmp_path: Path) -> None:
    session = session_in(Phase.RUNNING, tmp_path)
    session.accept(estimate(4 * S, at(9.0), TrackingState.LOST))
    kept = PoseFile(tmp_path / "pose.json", 10.0).load(5 * S, RIG_ON_ROVER)
    assert kept is not None
    assert kept.stamp_ns == 3 * S
    session.continue_at_last_pose()
    start = session.localiser_at(5 * S, EXTRINSICS).start  # type: ignore[attr-defined]
    assert (start.T_ds_rb.translation[0], start.stamp_ns) == (1.5, 3 * S)


@pytest.mark.parametrize("given", [None, StartPose(GIVEN, COVARIANCE)])
def test_a_start_without_a_stamp_holds_at_its_first_pair_whatever_that_showed(
    tmp_path: Path, given: StartPose | None
) -> None:
    """A localiser that follows must not take it for the pose of a later pair."""
    session = session_in(Phase.READY, tmp_path)
    if given is not None:
        session.set_pose(given)
    session.localiser_at(4 * S, EXTRINSICS)
    session.accept(estimate(4 * S, FIRST, TrackingState.LOST))
    session.continue_at_last_pose()
    assert session.localiser_at(6 * S, EXTRINSICS).start.stamp_ns == 4 * S  # type: ignore[attr-defined]


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0])
def test_an_estimate_whose_covariance_is_none_is_neither_published_nor_kept(tmp_path: Path, value: float) -> None:
    session = session_in(Phase.RUNNING, tmp_path)
    covariance = COVARIANCE.copy()
    covariance[2, 2] = value
    with pytest.raises(LocalisationError, match="restarts at its last pose"):
        session.accept(replace(estimate(4 * S, at(2.0)), covariance=covariance))
    kept = PoseFile(tmp_path / "pose.json", 10.0).load(5 * S, RIG_ON_ROVER)
    assert kept is not None
    assert kept.stamp_ns == 3 * S
    start = session.localiser_at(5 * S, EXTRINSICS).start  # type: ignore[attr-defined]
    assert (start.T_ds_rb.translation[0], start.stamp_ns) == (1.5, 3 * S)


@pytest.mark.parametrize("extrinsics", [at(0.01), EXTRINSICS])
def test_a_kept_pose_of_another_rig_is_told_and_not_resumed_from(tmp_path: Path, extrinsics: Transform) -> None:
    session_in(Phase.NEW, tmp_path)
    warnings: list[str] = []
    file = PoseFile(tmp_path / "pose.json", 10.0)
    session = LocalisationSession(LocalisationConfig(), file, warnings.append, FakeLocaliser)  # type: ignore[arg-type]
    session.set_rig(OTHER_RIG if extrinsics is EXTRINSICS else RIG)
    localiser = session.localiser_at(2 * S, extrinsics)
    assert np.array_equal(localiser.pose.translation, FIRST.translation)  # type: ignore[attr-defined]
    assert "of another rig or calibration" in warnings[0]


def test_a_kept_pose_that_cannot_be_read_or_written_is_a_warning(tmp_path: Path) -> None:
    path = tmp_path / "pose.json"
    path.write_text("{", encoding="utf-8")
    warnings: list[str] = []
    session = LocalisationSession(LocalisationConfig(), PoseFile(path, 10.0), warnings.append, FakeLocaliser)  # type: ignore[arg-type]
    session.set_rig(RIG)
    session.localiser_at(S, EXTRINSICS)
    assert "cannot be read" in warnings[0]
    (tmp_path / ".pose.json.part").mkdir()
    session.accept(estimate(S, LAST))
    assert "cannot write" in warnings[1]


KEPT_T = Transform(matrix_from_rotvec([0.1, -0.2, 0.3]), np.array([1.0, 2.0, 3.0]))
RIG_ON_ROVER_2 = StereoRig(160, 120, 150.0, 150.0, 79.5, 59.5, 0.12, Transform.identity())
STAMP = 1_000_000_000
KEPT_POSE = StartPose(KEPT_T, np.diag([0.1, 0.2, 0.3, 0.01, 0.02, 0.03]), STAMP)


def test_a_pose_comes_back_to_the_last_digit_and_nothing_else_is_left(tmp_path: Path) -> None:
    file = PoseFile(tmp_path / "pose.json", 10.0)
    assert file.load(STAMP + 1, RIG_ON_ROVER_2) is None
    file.save(KEPT_POSE, RIG_ON_ROVER_2)
    found = file.load(STAMP + 1, RIG_ON_ROVER_2)
    assert found is not None
    assert found.stamp_ns == STAMP
    assert np.allclose(found.T_ds_rb.translation, KEPT_T.translation, rtol=0, atol=0)
    assert np.allclose(found.T_ds_rb.rotation, KEPT_T.rotation, rtol=0, atol=1e-15)
    assert np.array_equal(found.covariance, KEPT_POSE.covariance)
    assert [path.name for path in tmp_path.iterdir()] == ["pose.json"]


@pytest.mark.parametrize(
    ("age_ns", "taken"), [(-1, False), (0, False), (1, True), (10_000_000_000, True), (10_000_000_001, False)]
)
def test_only_a_young_pose_of_the_same_run_is_resumed_from(tmp_path: Path, age_ns: int, taken: bool) -> None:
    file = PoseFile(tmp_path / "pose.json", 10.0)
    file.save(KEPT_POSE, RIG_ON_ROVER_2)
    assert (file.load(STAMP + age_ns, RIG_ON_ROVER_2) is not None) == taken


def broken() -> list[str]:
    good: dict[str, object] = {
        "schema": "sfr-resume/1",
        "rig": RIG_ON_ROVER_2.fingerprint,
        "stamp_ns": 1,
        "translation_m": [0, 0, 0],
        "quat_xyzw": [0, 0, 0, 1],
        "covariance": np.eye(6).reshape(-1).tolist(),
    }
    changes: list[dict[str, object]] = [
        {"stamp_ns": None},
        {"stamp_ns": 1.5},
        {"stamp_ns": True},
        {"stamp_ns": -1},
        {"stamp_ns": 2**63},
        {"schema": "sfr-resume/2"},
        {"translation_m": [0, 0]},
        {"translation_m": ["0", 0, 0]},
        {"translation_m": [float("nan"), 0, 0]},
        {"translation_m": [1e300, 0, 0]},
        {"translation_m": {"0": 0}},
        {"quat_xyzw": [0, 0, 0, 0]},
        {"quat_xyzw": [0, 0, 0, 7]},
        {"covariance": [0.0] * 35},
        {"covariance": [float("inf")] * 36},
        {"covariance": (-np.eye(6)).reshape(-1).tolist()},
        {"covariance": np.arange(36.0).tolist()},
    ]
    digits = json.dumps(good).replace('"stamp_ns": 1', f'"stamp_ns": {"9" * 400}')
    version_0_1 = json.dumps({key: value for key, value in good.items() if key not in ("schema", "rig")})
    wrong = [json.dumps(good | change) for change in changes]
    return ["", "{", "[]", "7", "[" * 100_000, "\0" * 100, digits, version_0_1, json.dumps(good)[:-9], *wrong]


@pytest.mark.parametrize("text", broken(), ids=range(len(broken())))
def test_a_broken_file_is_reported(tmp_path: Path, text: str) -> None:
    path = tmp_path / "pose.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"cannot be read.*the file is replaced"):
        PoseFile(path, 10.0).load(2, RIG_ON_ROVER_2)


def test_damaged_poses_are_replaced_and_other_files_never(tmp_path: Path) -> None:
    path = tmp_path / "pose.json"
    PoseFile(path, 10.0).check()
    PoseFile(path, 10.0).save(KEPT_POSE, RIG_ON_ROVER_2)
    whole = path.read_bytes()
    for ours in (whole, whole[:100], whole[:5], b"", bytes(4096), b'{"stamp_ns": 1, "translation_m": [0'):
        path.write_bytes(ours)
        PoseFile(path, 10.0).check()
    for foreign in (b"{}", b'{"width": 512}', b"years of work", b"\x89PNG", b"x" * 200_000):
        path.write_bytes(foreign)
        with pytest.raises(OutputError, match=r"holds no kept pose|larger than"):
            PoseFile(path, 10.0).check()
        assert path.read_bytes() == foreign
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    for name, words in (("folder", "it is a folder"), ("pipe", "a named pipe"), ("none/x", "there is no folder")):
        with pytest.raises(OutputError, match=words):
            PoseFile(tmp_path / name, 10.0).check()
