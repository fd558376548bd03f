"""The figures of the monitor over topics are those of the replay's report, which `sfr score` gives of its files."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from made_scene import write_folder
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String

from sfr_loc_map.io.registry import open_source
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.metrics.config import score_config
from sfr_loc_map.metrics.score_json import to_dict
from sfr_loc_map.nodes.replay.options import ReplayOptions
from sfr_loc_map.nodes.replay.replay import ReplaySession, running
from sfr_loc_map.pipeline.offline import start_pose
from sfr_loc_map.pipeline.replay import score_replay

POSES, PAIRS = 12, 3
EXACT = 1e-12


def numbers(content: Any, name: str = "") -> Iterator[tuple[str, float]]:
    """Yield all numbers of JSON by their dotted names."""
    if isinstance(content, dict):
        for key, value in content.items():
            yield from numbers(value, f"{name}.{key}")
    elif isinstance(content, list):
        for index, value in enumerate(content):
            yield from numbers(value, f"{name}.{index}")
    elif isinstance(content, (int, float)) and not isinstance(content, bool):
        yield name, float(content)


def final_report(session: ReplaySession, reports: list[str]) -> dict[str, Any]:
    """Return the monitor's report once everything that was published is in it."""

    def is_complete() -> bool:
        session.node.call("monitor_node/finish", "monitor_node did not publish its figures")
        report = json.loads(reports[-1]) if reports else {}
        posed = report.get("trajectory", {}).get("matched") == POSES
        timed = report.get("timing", {}).get("localisation_s", {}).get("count") == POSES
        mapped = report.get("timing", {}).get("mapping_call_s", {}).get("count") == 1
        return bool(posed and timed and mapped and "map" in report)

    session.node.wait_for(is_complete, 60.0, lambda: f"no complete report, the last one is {reports[-1:]}")
    return dict(json.loads(reports[-1]))


@pytest.mark.slow
def test_live_equals_offline(tmp_path: Path, own_domain: None) -> None:
    source = open_source(write_folder(tmp_path / "source", POSES, PAIRS))
    assert source.loc is not None
    config = score_config(["frames=3"], {"trajectory.spacing": 2})
    options = ReplayOptions(
        localisation=LocalisationConfig(),
        mapping=MappingConfig(),
        score=config,
        limits=None,
        start=start_pose(source.loc, "truth"),
        rate=0.0,
        offset_s=0.0,
        duration_s=math.inf,
        paused=False,
        parameter_file=None,
    )
    reports: list[str] = []
    with running(source, options, lambda line: None) as session:
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        session.node.node.create_subscription(String, "metrics/report", lambda m: reports.append(m.data), latched)
        session.play(lambda rig: None)
        live, received = final_report(session, reports), session.received
    offline = to_dict(score_replay(source, received.result(), config, None))
    parts = ("trajectory", "map", "timing", "memory")
    found, expected = (dict(numbers({part: score[part] for part in parts})) for score in (live, offline))
    # how much of the drive has no estimate follows from the images, which the monitor does not know
    known = {name for name in found.keys() & expected.keys() if ".completeness." not in name}
    assert {name for name in expected if ".completeness." not in name} == known
    assert len(known) > 100
    assert {name: found[name] for name in known} == pytest.approx({name: expected[name] for name in known}, abs=EXACT)
