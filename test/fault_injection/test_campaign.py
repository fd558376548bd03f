"""The campaign of injected faults: some of its rows over real DDS, and its table."""

# ruff: noqa: E402 - ROS may be absent
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.timeout(400)]

from sfr_loc_map.errors import InputError, NodeError
from sfr_loc_map.fault_injection.fault import Fault, Outcome
from sfr_loc_map.fault_injection.report import Verdict, outcome_table, report, row_not_run, row_of
from sfr_loc_map.fault_injection.run import FAULTS, run_campaign, select
from sfr_loc_map.fault_injection.scene import Scene
from sfr_loc_map.fault_injection.settings import CampaignSettings
from sfr_loc_map.fault_injection.soak import MemoryTrend
from sfr_loc_map.report.tables import to_markdown

QUICK = ("kill-localisation", "pictures-localisation", "messages-monitor", "stamps-jump")
SETTINGS = CampaignSettings(stop_s=1.0, restart_limit_s=60.0, soak_minutes=0.0, patience_s=60.0)


@pytest.mark.slow
def test_some_rows_over_dds(tmp_path: Path) -> None:
    rows = run_campaign(select(QUICK, SETTINGS), SETTINGS, tmp_path)
    assert {row.name: row.observed for row in rows if row.verdict is not Verdict.PASS} == {}
    assert tuple(row.name for row in rows) == QUICK
    json.dumps(report(rows, SETTINGS, 1.0))


class FakeHarness:
    """No nodes: only whether they run is asked."""

    made = 0

    def __init__(self, *_: object) -> None:
        FakeHarness.made += 1
        self.nodes = {"monitor_node": SimpleNamespace(is_running=True)}

    def __enter__(self) -> "FakeHarness":
        return self

    def __exit__(self, *_: object) -> None:
        self.nodes.clear()

    def wait_ready(self) -> None:
        assert self.nodes


def test_a_fault_with_another_outcome_fails_and_the_next_gets_new_nodes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sfr_loc_map.fault_injection.run.Harness", FakeHarness)

    def dies(harness: Any, outcome: Outcome) -> None:
        harness.nodes["monitor_node"].is_running = False

    def hangs(harness: Any, outcome: Outcome) -> None:
        assert harness.nodes["monitor_node"].is_running
        raise NodeError("odometry did not come")

    def succeeds(harness: Any, outcome: Outcome) -> None:
        outcome.observed.append("done")

    others = {"monitor_node": ("-p", "x:=1")}
    works = [dies, hangs, succeeds, succeeds]
    faults = [Fault(str(n), "f", "e", work) for n, work in enumerate(works)] + [Fault("4", "f", "e", succeeds, others)]
    rows = run_campaign(faults, SETTINGS, tmp_path)
    assert [row.verdict for row in rows] == [Verdict.FAIL] * 2 + [Verdict.PASS] * 3
    assert [row.observed for row in rows[:3]] == [
        "NOT AS EXPECTED: ended: monitor_node",
        "NOT AS EXPECTED: odometry did not come",
        "done",
    ]
    assert FakeHarness.made == 4  # after each failure, and for the other arguments


def test_names_are_unique_and_unknown_ones_are_refused() -> None:
    assert len({fault.name for fault in FAULTS}) == len(FAULTS)
    assert "soak" not in [fault.name for fault in select([], SETTINGS)]
    with pytest.raises(InputError, match="no fault 'nonsense': known are kill-localisation"):
        select(["nonsense"], SETTINGS)


def test_the_table_has_a_line_for_each_row() -> None:
    fault = Fault("name", "a | b", "that", lambda harness, outcome: None)
    outcome = Outcome()
    outcome.observed.append("this")
    outcome.recovered(2.04, 3.0, "the restart")
    passed = row_of(fault, outcome)
    outcome.recovered(4.0, 3.0, "the restart")
    table = to_markdown([outcome_table([passed, row_of(fault, outcome), row_not_run(fault, "no root")])]).splitlines()
    assert table[2] == "| name: a \\| b | that | this | nothing | 2.04 | pass |"
    assert table[3].endswith("NOT AS EXPECTED: the restart took 4.0 s, the limit is 3 s | nothing | 4 | fail |")
    assert table[4] == f"| name: a \\| b | that | no root |  |  | {Verdict.NOT_RUN} |"


def test_the_slope_of_memory_is_that_after_the_warm_up() -> None:
    random = np.random.default_rng(1)
    seconds = np.arange(0.0, 3600.0, 2.0)
    growth = 100.0 * np.minimum(seconds / 900.0, 1.0) + 7.0 * seconds / 3600.0
    slope, error = MemoryTrend(seconds.tolist(), (growth + random.normal(size=len(seconds))).tolist()).slope()
    assert abs(slope - 7.0) < 3.0 * error
    assert error < 0.5


@pytest.mark.parametrize(
    ("minutes", "mb_h", "at_once", "fails"),
    [(60, 0.0, 0.0, False), (60, 5.0, 0.0, True), (1, 60.0, 0.0, False), (1, 0.0, 80.0, True)],
)
def test_a_slow_growth_is_judged_in_long_runs_only(minutes: float, mb_h: float, at_once: float, fails: bool) -> None:
    seconds = np.arange(0.0, 60.0 * minutes, 1.0)
    noise = np.random.default_rng(2).normal(0.0, 0.1, len(seconds))
    mb = 300.0 + noise + mb_h * seconds / 3600.0 + at_once * (seconds > 50.0)
    assert bool(MemoryTrend(seconds.tolist(), mb.tolist()).failure(1.0)) == fails


def test_a_slope_within_its_error_is_no_growth() -> None:
    seconds = np.arange(0.0, 600.0, 1.0)
    trend = MemoryTrend(seconds.tolist(), (300.0 + np.random.default_rng(4).normal(0.0, 2.0, len(seconds))).tolist())
    slope, error = trend.slope()
    assert slope + 2.0 * error > 1.0
    assert trend.failure(1.0) == ""


def test_the_scene_is_what_its_rig_and_poses_say() -> None:
    """A point of the wall lies at the same grey in left and right image, shifted by f b / Z."""
    scene = Scene(320, 240)
    pair = scene.nav_pair(1, 5)
    depth = 3.0 - (scene.nav_pose(1) @ scene.nav.T_sb_left).translation[0]
    shift = scene.nav.fx * scene.nav.baseline_m / depth
    row = pair.left[120].astype(float)
    found = [np.abs(row[60:300] - pair.right[120, 60 - d : 300 - d]).mean() for d in range(40)]
    assert abs(int(np.argmin(found)) - shift) <= 1.0
