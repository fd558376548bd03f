"""The monitor, the report of the replay and `sfr score` on its files give the same figures."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String
from std_srvs.srv import Trigger

from helpers.made_scene import write_folder
from helpers.score_rows import number
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.metrics.config import score_config
from sfr_loc_map.metrics.stored.score_json import to_dict
from sfr_loc_map.replay.options import ReplayOptions
from sfr_loc_map.replay.replay_peer import ReplayPeer
from sfr_loc_map.replay.replay_score import score_replay
from sfr_loc_map.replay.session import connected_replay, play_and_collect
from sfr_loc_map.runs.drive_start import start_pose
from sfr_loc_map.scoring.request import ScoreRequest

POSES, PAIRS = 12, 3
EXACT = 1e-12


def numbers(score: dict[str, Any]) -> Iterator[tuple[str, float]]:
    """Yield all numbers of the table of figures by what they are."""
    for item in score["figures"]:
        names = "/".join(str(item.get(name)) for name in ("subject", "condition", "part", "figure"))
        for column, value in item.items():
            if isinstance(value, (int, float)):
                yield f"{names}/{column}", float(value)


def final_report(peer: ReplayPeer, reports: list[str]) -> dict[str, Any]:
    """Return the monitor's report once everything that was published is in it."""

    def is_complete() -> bool:
        problem = "monitor_node did not publish its figures"
        assert peer.request(Trigger, "monitor_node/finish", Trigger.Request(), problem).success, problem
        report = json.loads(reports[-1]) if reports else {}
        posed = (report.get("association") or {}).get("matched") == POSES
        timed = posed and number(report, "localisation", "n") == POSES
        return bool(timed and number(report, "mapping_call", "n") == 1 and number(report, "coverage"))

    peer.wait_for(is_complete, 60.0, lambda: f"no complete report, the last one is {reports[-1:]}")
    return dict(json.loads(reports[-1]))


@pytest.mark.slow
def test_live_equals_offline(tmp_path: Path, own_domain: None) -> None:
    source = open_source(write_folder(tmp_path / "source", POSES, PAIRS))
    assert source.loc is not None
    config = score_config(["frames=3"], {"trajectory.spacing": 2})
    options = ReplayOptions(
        localisation=LocalisationConfig(),
        mapping=MappingConfig(),
        request=ScoreRequest(config),
        limits_file=None,
        start=start_pose(source.loc, "truth"),
        rate=None,
        offset_s=0.0,
        duration_s=math.inf,
        paused=False,
    )
    reports: list[str] = []
    with connected_replay(source, options, lambda line: None) as connected:
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        peer = connected.collector.peer
        peer.ros_node.create_subscription(String, "metrics/report", lambda m: reports.append(m.data), latched)
        play_and_collect(source, options, connected, lambda rig: None)
        live = final_report(peer, reports)
    offline = to_dict(score_replay(source, connected.result(options), config, None))
    found, expected = dict(numbers(live)), dict(numbers(offline))
    # how much of the drive has no estimate follows from the images, which the monitor does not know
    known = {name for name in expected if not name.startswith("completeness/None/None/")}
    assert known <= found.keys()
    assert len(known) > 100
    assert {name: found[name] for name in known} == pytest.approx({name: expected[name] for name in known}, abs=EXACT)
