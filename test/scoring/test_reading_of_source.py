"""How a recording is read decides which images an estimate must cover: images without a partner, and `sync`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from rosbags.rosbag2 import Reader, StoragePlugin, Writer

from helpers.cli_result import Sfr
from helpers.made_scene import write_bag
from sfr_loc_map import io
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.bag.encoding import TYPESTORE
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory
from sfr_loc_map.metrics.stored.score_json import load_score
from sfr_loc_map.report.deviations import deviations_of

PAIRS = 12


def bag_without(path: Path, dropped: set[int]) -> Path:
    """Write a bag of 12 pairs in which the right images of some pairs are missing."""
    good = write_bag(path.with_name(f"good_{path.name}"), PAIRS, 0)
    number = -1
    with Reader(good) as reader, Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {
            c.topic: writer.add_connection(c.topic, c.msgtype, typestore=TYPESTORE) for c in reader.connections
        }
        for connection, recorded_ns, raw in reader.messages():
            is_right = connection.topic.endswith("right/image_rect")
            number += is_right
            if not (is_right and number in dropped):
                writer.write(connections[connection.topic], recorded_ns, raw)
    return path


@pytest.mark.parametrize(
    ("dropped", "missing"), [(set(), []), ({4, 7}, [4, 7]), ({0}, []), ({PAIRS - 1}, []), ({0, 1}, [1])]
)
def test_a_left_image_without_a_right_image_is_a_missing_pair(
    tmp_path: Path, dropped: set[int], missing: list[int]
) -> None:
    """Except the first and the last image: the recording may have begun or ended between the images of a pair."""
    every = io.open_source(bag_without(tmp_path / "all.mcap", set())).loc
    source = io.open_source(bag_without(tmp_path / "some.mcap", dropped))
    assert every is not None
    assert list(source.missing_loc_ns) == [every.stamps_ns[index] for index in missing]
    assert len(source.expected_loc_ns()) == PAIRS - len(dropped) + len(missing)


@pytest.mark.parametrize(("periods", "verdict"), [(0, "pass"), (3, "incomplete")])
def test_another_offset_of_the_right_images_hides_no_image(
    tmp_path: Path, sfr: Sfr, periods: int, verdict: str
) -> None:
    """The estimate lacks the images that the offset leaves without a partner. The offset is a deviation."""
    bag = bag_without(tmp_path / "drive.mcap", set())
    loc = io.open_source(bag).loc
    assert loc is not None
    truth = loc.ground_truth
    assert truth is not None
    period_s = (loc.stamps_ns[1] - loc.stamps_ns[0]) * 1e-9
    noise = np.random.default_rng(1).normal(0.0, 1e-3, (PAIRS, 3))
    kept = slice(periods, None)
    estimate = Trajectory(truth.stamps_ns[kept], (truth.positions + noise)[kept], truth.quats_xyzw[kept])
    save_trajectory(tmp_path / "e.csv", estimate)
    condition = {"condition": "frames=2", "position_mean_m": 1.0}
    limits: dict[str, Any] = {"minimum_count": 2, "minimum_independent": 1, "trajectory": [condition]}
    (tmp_path / "limits.yaml").write_text(yaml.safe_dump(limits))
    (tmp_path / "sfr.yaml").write_text(yaml.safe_dump({"sync": {"right_offset_s": period_s * periods}}))
    files = tmp_path / "e.csv", bag, "--limits", tmp_path / "limits.yaml", "--config", tmp_path / "sfr.yaml"
    done = sfr("score", *files, "--spacing", "1", "--json", tmp_path / "s.json")
    assert done.code == (3 if periods else 0), done.out + done.err
    assert json.loads((tmp_path / "s.json").read_text())["verdict"] == verdict
    stated = [text for text in deviations_of(load_score(tmp_path / "s.json")) if "sync.right_offset_s" in text]
    assert len(stated) == bool(periods)


@pytest.mark.parametrize("is_changed", [False, True])
def test_extrinsics_of_the_source_itself_are_no_deviation(tmp_path: Path, sfr: Sfr, is_changed: bool) -> None:
    """`sfr init` copies the extrinsics of a bag into sfr.yaml. Poses of a file have no cameras."""
    bag = bag_without(tmp_path / "drive.mcap", set())
    sfr("init", tmp_path / "rover", "--from", bag)
    config = tmp_path / "rover" / "sfr.yaml"
    content = yaml.safe_load(config.read_text())
    content["extrinsics"]["translation_m"][0] += float(is_changed)
    config.write_text(yaml.safe_dump(content))
    truth = io.open_source(bag).truth
    assert truth is not None
    save_trajectory(tmp_path / "e.csv", truth)
    for place in (bag, tmp_path / "e.csv"):
        output = ("--json", tmp_path / "s.json", "--overwrite")
        sfr("score", tmp_path / "e.csv", place, "--condition", "frames=2", "--config", config, *output)
        stated = [text for text in deviations_of(load_score(tmp_path / "s.json")) if "extrinsics" in text]
        assert len(stated) == (is_changed and place == bag)
