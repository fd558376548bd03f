"""The campaign of injected faults: a few faults over DDS, and the evaluation of memory."""

# ruff: noqa: E402 - ROS may be absent
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.timeout(400)]

from campaigns import faults
from campaigns.faults import Row
from campaigns.node_harness import LOCALISATION, MONITOR, Harness
from campaigns.soak import MemoryTrend


@pytest.mark.slow
@pytest.mark.usefixtures("own_domain")
def test_some_faults_over_dds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(faults, "RESTART_LIMIT_S", 60.0)
    row = Row("some", "")
    with Harness(tmp_path, nodes=(LOCALISATION, MONITOR), patience_s=60.0) as harness:
        harness.wait_ready()
        for name in ("kill-localisation", "messages-monitor"):
            faults.FAULTS[name](harness, row)
        assert all(process.is_running for process in harness.nodes.values())
    assert row.failures == []


@pytest.mark.parametrize(("mb_h", "fails"), [(0.0, False), (5.0, True)])
def test_a_slow_growth_is_found(mb_h: float, fails: bool) -> None:
    seconds = np.arange(0.0, 3600.0)
    mb = 300.0 + np.random.default_rng(2).normal(0.0, 0.1, len(seconds)) + mb_h * seconds / 3600.0
    assert bool(MemoryTrend(seconds.tolist(), mb.tolist()).failure()) == fails
