"""Libraries that crash, hang, leak or give invalid results: a finding for the call, and an estimate for every pair."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from helpers import HELPERS, score_rows
from helpers.cli_result import Sfr
from helpers.made_scene import LOC_RIG, NAV_RIG, loc_pair, nav_pair, true_pose
from sfr_loc_map.errors import MethodError
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.localisation.estimate import PoseEstimate
from sfr_loc_map.methods.isolated_localiser import IsolatedLocaliser
from sfr_loc_map.methods.isolated_mapper import IsolatedMapper
from sfr_loc_map.methods.method_call import MethodCall
from sfr_loc_map.methods.registry import MethodLimits, find_method
from sfr_loc_map.runs.mapper_run import run_mapper
from sfr_loc_map.runs.under_test import UnderTest
from sfr_loc_map.suite_names import Task

Build = Callable[..., Path]
LIMITS = MethodLimits(call_timeout_s=3.0, memory_mb=400)
PAIRS = [loc_pair(index) for index in range(4)]


def calls(
    library: Path, config: str, count: int = 4, limits: MethodLimits = LIMITS, start: Transform | None = None
) -> list[tuple[PoseEstimate, MethodCall]]:
    method = find_method(f"lib:{library}", Task.LOCALISATION, config)
    with IsolatedLocaliser(method, LOC_RIG, start or true_pose(0), limits, hidden=()) as localiser:
        return [localiser.localise(replace(PAIRS[n % 4], stamp_ns=PAIRS[0].stamp_ns + n)) for n in range(count)]


FIRST = str(PAIRS[0].stamp_ns)[:-3]


@pytest.mark.parametrize(
    ("config", "findings"),
    [
        ("ok crash", ["", "crashed: was killed by SIGABRT", "", "crashed: was killed by SIGABRT"]),
        ("ok hang", ["", "hanging: has not answered for 3 s", ""]),
        (
            "ok nan stamp quaternion covariance beyond status fail ok",
            [
                "",
                "not finite: the pose contains a non-finite number",
                f"wrong stamp: answered with stamp {FIRST}792: stamp {FIRST}791 of the pair is required",
                "invalid result: the quaternion has the length 3: 1 is required",
                "invalid result: the covariance is not symmetric and positive semi-definite",
                "invalid result: the library wrote beyond the pose or the covariance",
                "invalid result: status is 9: 0 to 3 is required",
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
    assert [call.usage.processing_time_s for _, call in made] == [None] * len(made)


def test_a_process_over_the_memory_limit_is_ended(faulty: Path) -> None:
    found = [call.reason for _, call in calls(faulty, "leak", 14) if call.finding]  # 30 MB a pair, to 400 MB
    assert found == ["out of memory"]


@pytest.mark.clause("4.2.2")
def test_a_known_allocation_of_a_candidate_is_measured(faulty: Path) -> None:
    size = 200 * 1024 * 1024
    for _, call in calls(faulty, "allocate", 3):
        assert call.usage.above_idle_bytes == pytest.approx(size, rel=0.01)
        assert not call.finding


def test_a_lost_candidate_is_no_finding_and_its_covariance_is_that_of_ds(faulty: Path) -> None:
    turned = Transform(matrix_from_rotvec([0.0, 0.0, np.pi / 2]), np.zeros(3))
    made = calls(faulty, "ok lost", 3, start=turned)
    assert [estimate.state.value for estimate, _ in made] == ["tracking", "lost", "tracking"]
    assert not any(call.finding for _, call in made)
    variances = np.diag(made[0][0].covariance)
    np.testing.assert_allclose(variances, [0.02, 0.01, 0.03, 0.05, 0.04, 0.06])  # x is the candidate's y


def test_what_cannot_be_started_is_named(faulty: Path, build: Build, tmp_path: Path) -> None:
    options = ("-fPIC", "-shared", "-DSTATED_ABI=3")
    other = build(HELPERS / "faulty_candidate.c", name="libother.so", options=options)
    (tmp_path / "text.so").write_text("no library")
    for library, words in (
        (faulty, "sfr_candidate_create: this rig is not to my taste"),
        (other, r"libother.so .* built for version 3 of sfr_candidate.h: 1 to 2 is required"),
        (tmp_path / "text.so", "cannot load the library"),
        (tmp_path / "none.so", "No such file"),
    ):
        with pytest.raises(MethodError, match=words):
            calls(library, "refuse")


PAIR_BY_PAIR = ("-DPAIR_BY_PAIR",)
FIRST_ABI = (*PAIR_BY_PAIR, "-DSTATED_ABI=1")
PIXEL = "invalid result: the pixel of a point is outside of the image of 160 x 120 pixels"
NOT_FINITE = "not finite: a point or its sigma is not finite"
NEGATIVE = "invalid result: the sigma of a point is negative: -0.1 m"
OF_PAIRS = {
    "many": "invalid result: the library returned 19201 points: at most 19200 are allowed",
    "pixel": PIXEL,
    "nan": NOT_FINITE,
    "negative": NEGATIVE,
}
OF_SETS = {
    "many": "invalid result: the library returned 38401 points: at most 38400 are allowed",
    "pixel": PIXEL,
    "pair": "invalid result: a point has the pair number 2: 0 to 1 is required",
    "fused": "invalid result: fused is 5: 0 or 1 is required",
    "nan": NOT_FINITE,
    "negative": NEGATIVE,
    "fail": "invalid result: sfr_candidate_map_pairs returned 7: 0 is required",
    "beyond": "invalid result: the library wrote beyond the end of the buffer of 38400 points",
}
"""Findings by what the library returns at a call."""


@pytest.mark.parametrize("options", [(), PAIR_BY_PAIR, FIRST_ABI])
def test_points_of_pairs_are_checked(build: Build, options: tuple[str, ...]) -> None:
    method = find_method(f"lib:{mapper_library(build, *options)}", Task.MAPPING, f"ok ok {' '.join(OF_PAIRS)} ok")
    items = [nav_pair(0), nav_pair(1)]
    with IsolatedMapper(method, NAV_RIG, limits=LIMITS, hidden=()) as mapper:
        of_pairs = mapper.begin_map()
        made, calls = zip(*(of_pairs.map_pair(item.pair, item.T_lm_navsb) for item in items), strict=True)
        fused, fusion = of_pairs.fuse()
        found = [mapper.begin_map().map_pair(items[0].pair, items[0].T_lm_navsb) for _ in (*OF_PAIRS, "ok")]
    assert [call.finding for call in calls] == ["", ""]
    of_last = (1, 2, 3, 0.1, items[1].pair.left[5, 4], 4, 5, 1)
    np.testing.assert_allclose(made[1].cloud.to_structured().tolist(), [of_last])
    assert len(fused.cloud) == 2
    assert fused.cloud.fused is False
    assert fusion is None
    assert [call.finding for _, call in found] == [*OF_PAIRS.values(), ""]
    assert [len(of_pair.cloud) for of_pair, _ in found] == [0] * len(OF_PAIRS) + [1]


def mapper_library(build: Build, *options: str) -> Path:
    source, name = HELPERS / "faulty_candidate.c", f"lib{''.join(options)}.so"
    return build(source, name=name, options=("-fPIC", "-shared", *options))


def test_points_of_sets_are_checked(faulty: Path) -> None:
    items = [nav_pair(0), nav_pair(1)]
    method = find_method(f"lib:{faulty}", Task.MAPPING, f"ok {' '.join(OF_SETS)}")
    with IsolatedMapper(method, NAV_RIG, limits=LIMITS, hidden=()) as mapper:
        found = [mapper.map_set(items) for _ in ("ok", *OF_SETS)]
    assert [call.finding for _, _, call in found] == ["", *OF_SETS.values()]
    assert [len(fused.cloud) for _, fused, _ in found] == [2] + [0] * len(OF_SETS)


@pytest.mark.parametrize(
    ("config", "finding"), [("", ""), ("many", OF_SETS["many"]), ("crash", "crashed: was killed by SIGABRT")]
)
def test_a_set_is_one_call_and_a_finding_leaves_no_points(faulty: Path, drive: Path, config: str, finding: str) -> None:
    method, nav = find_method(f"lib:{faulty}", Task.MAPPING, config), open_source(drive).nav
    assert nav is not None
    run = run_mapper(nav, UnderTest(method, LIMITS, hidden=()))
    (record,) = run.records
    assert record.state == "mapped_set"
    assert record.finding.startswith(finding)
    assert bool(record.finding) == bool(finding)
    assert run.fused.cloud.pair_stamps_ns == tuple(item.pair.stamp_ns for item in nav.pairs())
    assert run.fused.cloud.pair.tolist() == run.unfused.pair.tolist() == ([] if finding else [0, 1])
    if not finding:
        assert 0.0 < record.processing_time_s < 1.0
        assert (record.peak_rss_bytes or 0) > (record.above_idle_bytes or 0)
        assert run.fused.cloud.fused is False


def test_without_the_call_of_a_set_it_is_the_sum_of_its_stages(build: Build, drive: Path) -> None:
    nav = open_source(drive).nav
    assert nav is not None
    run = run_mapper(
        nav, UnderTest(find_method(f"lib:{mapper_library(build, '-DPAIR_BY_PAIR')}", Task.MAPPING), LIMITS, hidden=())
    )
    *stages, whole = run.records
    assert [record.state for record in run.records] == ["mapped", "mapped", "mapped_set"]
    assert whole.processing_time_s == sum(record.processing_time_s for record in stages)
    assert whole.peak_rss_bytes == max(record.peak_rss_bytes or 0 for record in stages)


def test_the_command_names_the_finding_and_writes_what_there_is(
    faulty: Path, drive: Path, tmp_path: Path, sfr: Sfr
) -> None:
    config, estimate, stats = tmp_path / "config.txt", tmp_path / "estimate.csv", tmp_path / "stats.csv"
    config.write_text("ok ok ok ok ok ok ok crash")
    method = ("--method", f"lib:{faulty}", "--config", config)
    done = sfr("localise", drive, "-o", estimate, "--stats", stats, "--start", "truth", *method)
    assert done.code == 1
    assert "crashed: 1 call at stamp 1700000000823456789: was killed by SIGABRT" in done.err
    assert "faulty 1: crashed; its results are written" in done.err
    scored = sfr("score", estimate, drive, "--stats", stats, "--condition", "frames=3", "--json", "-")
    score = json.loads(scored.out)
    assert scored.code == 1  # without any limit
    assert scored.err.splitlines()[-1].endswith("the method failed: crashed")
    (verdict,) = score["verdicts"]
    assert (verdict["name"], verdict["value"], verdict["verdict"]) == ("crashed_calls", 1.0, "fail")
    assert score["association"]["estimate_poses"] == 12
    about = {"name": f"lib:{faulty}", "version": "faulty 1", "kind": "library"}
    about |= {
        "sha256": find_method(f"lib:{faulty}", Task.LOCALISATION).sha256,
        "isolation": score["method"]["isolation"],
    }
    variables = score["method"].get("variables")  # of the shell that runs the test
    about |= {"variables": variables} if variables else {}
    settings = "\n".join(filter(None, (config.read_text(), variables)))
    about["config_sha256"] = hashlib.sha256(settings.encode()).hexdigest()
    assert score["method"] == about
    assert [(item["kind"], item["count"]) for item in score["findings"]] == [("crashed", 1)]
    assert score_rows.number(score, "localisation", "n") == 11
