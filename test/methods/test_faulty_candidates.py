"""Candidates that crash, hang, leak, lie: each is named, every pair has an estimate, the run goes on."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cli_result import Sfr
from made_scene import LOC_RIG, NAV_RIG, loc_pair, nav_pair, true_pose

from sfr_loc_map.errors import MethodError
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import Task
from sfr_loc_map.localisation.estimate import PoseEstimate
from sfr_loc_map.methods.isolated_method import IsolatedMethod
from sfr_loc_map.methods.method_process import MethodCall
from sfr_loc_map.methods.registry import MethodLimits, find_method

Build = Callable[..., Path]
LIMITS = MethodLimits(call_timeout_s=3.0, memory_mb=400)
PAIRS = [loc_pair(index) for index in range(4)]


def calls(
    library: Path, config: str, count: int = 4, limits: MethodLimits = LIMITS, start: Transform | None = None
) -> list[tuple[PoseEstimate, MethodCall]]:
    method = find_method(f"lib:{library}", Task.LOCALISATION, config)
    with IsolatedMethod(method, LOC_RIG, start or true_pose(0), limits) as localiser:
        return [localiser.localise(replace(PAIRS[n % 4], stamp_ns=PAIRS[0].stamp_ns + n)) for n in range(count)]


FIRST = str(PAIRS[0].stamp_ns)[:-3]


@pytest.mark.parametrize(
    ("config", "findings"),
    [
        ("ok crash", ["", "crashed: has ended by SIGABRT", "", "crashed: has ended by SIGABRT"]),
        ("ok hang", ["", "hanging: has not answered for 3 s", ""]),
        (
            "ok nan stamp quaternion covariance beyond status fail ok",
            [
                "",
                "not finite: the pose has a number that is not finite",
                f"wrong stamp: answered for stamp {FIRST}792, asked for {FIRST}791",
                "invalid result: the quaternion has length 3: must be 1",
                "invalid result: the covariance is not symmetric, or a variance is negative",
                "invalid result: wrote beyond the pose or the covariance",
                "invalid result: status is 9: must be 0 to 3",
                "invalid result: sfr_candidate_process returned 7",
                "",
            ],
        ),
    ],
)
def test_a_faulty_call_is_named_and_the_next_pairs_have_poses(faulty: Path, config: str, findings: list[str]) -> None:
    made = calls(faulty, config, len(findings))
    for number, ((estimate, call), finding) in enumerate(zip(made, findings, strict=True)):
        assert call.finding.startswith(finding)
        assert bool(call.finding) == bool(finding)
        assert call.reason == finding.partition(":")[0]
        assert estimate.state.value == ("lost" if finding else "tracking")
        assert estimate.stamp_ns == PAIRS[0].stamp_ns + number
        assert (estimate.covariance[0, 0] == 9999.0) == bool(finding)
        # also after a new start the last known pose is kept
        np.testing.assert_allclose(estimate.T_ds_rb.matrix, true_pose(0).matrix, atol=1e-12)


def test_after_too_many_crashes_it_is_not_started_again(faulty: Path) -> None:
    made = calls(faulty, "crash", 6, replace(LIMITS, restarts=2))
    assert [estimate.state.value for estimate, _ in made] == ["lost"] * 6
    assert [call.finding.partition(":")[0] for _, call in made] == ["crashed"] * 3 + [""] * 3
    assert made[2][1].finding.endswith("not started again after 3 starts")
    assert np.isnan([call.usage.processing_time_s for _, call in made]).all()


def test_what_needs_too_much_memory_is_ended(faulty: Path) -> None:
    found = [call.finding for _, call in calls(faulty, "leak", 14) if call.finding]  # 30 MB a pair, to 400 MB
    assert [text[:16] for text in found] == ["out of memory: h"]


def test_a_lost_candidate_is_no_finding_and_its_covariance_is_that_of_ds(faulty: Path) -> None:
    turned = Transform(matrix_from_rotvec([0.0, 0.0, np.pi / 2]), np.zeros(3))
    made = calls(faulty, "ok lost", 3, start=turned)
    assert [estimate.state.value for estimate, _ in made] == ["tracking", "lost", "tracking"]
    assert not any(call.finding for _, call in made)
    variances = np.diag(made[0][0].covariance)
    np.testing.assert_allclose(variances, [0.02, 0.01, 0.03, 0.05, 0.04, 0.06])  # x is the candidate's y


def test_what_cannot_be_started_is_named(faulty: Path, build: Build, tmp_path: Path) -> None:
    options = ("-fPIC", "-shared", "-DSTATED_ABI=2")
    other = build(Path(__file__).parent / "faulty_candidate.c", name="libother.so", options=options)
    (tmp_path / "text.so").write_text("no library")
    for library, words in (
        (faulty, "sfr_candidate_create: this rig is not to my taste"),
        (other, r"libother.so .* built for version 2 of sfr_candidate.h, this suite has 1"),
        (tmp_path / "text.so", "cannot load the library"),
        (tmp_path / "none.so", "there is no library"),
    ):
        with pytest.raises(MethodError, match=words):
            calls(library, "refuse")


@pytest.mark.parametrize(
    ("config", "finding"),
    [
        ("", ""),
        ("many", "invalid result: wrote 19201 points: there is room for 19200"),
        ("pixel", "invalid result: a point names a pixel outside 160 x 120"),
        ("nan", "not finite: a point or its sigma is not finite"),
    ],
)
def test_points_are_checked(faulty: Path, config: str, finding: str) -> None:
    with IsolatedMethod(find_method(f"lib:{faulty}", Task.MAPPING, config), NAV_RIG, limits=LIMITS) as mapper:
        item = nav_pair(1)
        made, call = mapper.map_pair(item.pair, item.T_lm_navsb, 1)
        fused, fusion = mapper.fuse([made], item.pair)
    assert call.finding == finding
    assert len(made.cloud) == len(fused.cloud) == (0 if finding else 1)
    assert fusion is None
    if not finding:
        np.testing.assert_allclose(made.cloud.to_structured().tolist(), [(1, 2, 3, 0.1, item.pair.left[5, 4], 4, 5, 1)])
        assert fused.cloud.fused is False


def test_the_command_names_the_finding_and_writes_what_there_is(
    faulty: Path, drive: Path, tmp_path: Path, sfr: Sfr
) -> None:
    config, estimate, stats = tmp_path / "config.txt", tmp_path / "estimate.csv", tmp_path / "stats.csv"
    config.write_text("ok ok ok ok ok ok ok crash")
    method = ("--method", f"lib:{faulty}", "--config", config)
    done = sfr("localise", drive, "-o", estimate, "--stats", stats, "--start", "truth", *method)
    assert done.code == 1
    assert "crashed: 1 call at stamp 1700000000823456789: has ended by SIGABRT" in done.err
    assert "faulty 1: crashed; what it gave is written" in done.err
    scored = sfr("score", estimate, drive, "--stats", stats, "--condition", "frames=3", "--json", "-")
    score = json.loads(scored.out)
    assert scored.code == 0
    assert score["trajectory"]["estimate_poses"] == 12
    about = {"name": f"lib:{faulty}", "version": "faulty 1", "kind": "library"}
    assert score["method"] == about | {"sha256": hashlib.sha256(faulty.read_bytes()).hexdigest()}
    assert [(item["kind"], item["count"]) for item in score["findings"]] == [("crashed", 1)]
    assert score["timing"]["localisation_s"]["count"] == 11
