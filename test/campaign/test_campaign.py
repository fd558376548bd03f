"""The campaign of injected faults: a short slice of it over real DDS, and how memory is judged."""

# ruff: noqa: E402 - ROS may be absent
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.timeout(400)]

import node_faults
from long_runs import MemoryTrend
from node_faults import Row
from node_harness import LOCALISATION, MONITOR, Harness


@pytest.mark.slow
@pytest.mark.usefixtures("own_domain")
def test_some_faults_over_dds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(node_faults, "RESTART_LIMIT_S", 60.0)
    row = Row("some", "")
    with Harness(tmp_path, nodes=(LOCALISATION, MONITOR), patience_s=60.0) as harness:
        harness.wait_ready()
        for name in ("kill-localisation", "images-localisation", "messages-monitor"):
            node_faults.FAULTS[name](harness, row)
        assert all(process.is_running for process in harness.nodes.values())
    assert row.failures == []


@pytest.mark.parametrize(
    ("minutes", "mb_h", "at_once", "fails"),
    [(60, 0.0, 0.0, False), (60, 5.0, 0.0, True), (1, 60.0, 0.0, False), (1, 0.0, 80.0, True)],
)
def test_a_slow_growth_is_judged_in_long_runs_only(minutes: float, mb_h: float, at_once: float, fails: bool) -> None:
    seconds = np.arange(0.0, 60.0 * minutes, 1.0)
    noise = np.random.default_rng(2).normal(0.0, 0.1, len(seconds))
    mb = 300.0 + noise + mb_h * seconds / 3600.0 + at_once * (seconds > 50.0)
    trend = MemoryTrend(seconds.tolist(), mb.tolist())
    assert bool(trend.failure()) == fails
    assert at_once or trend.slope()[0] == pytest.approx(mb_h, abs=0.1 if minutes == 60 else 100.0)
