"""The observation of bags that are read by a configuration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from campaigns.recordings.bags import Recording
from campaigns.recordings.drive import BEGIN_NS, Drive
from campaigns.recordings.rows import add_mapping
from helpers.broken_sources import rewritten_bag
from helpers.made_scene import LOC_RIG
from helpers.made_worlds import random_pair
from sfr_loc_map.doctor.examination import examine
from sfr_loc_map.doctor.observation import SourceKind, observe
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.calibration.rig_file import rig_json
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.source_config import CalibrationConfig, FramesConfig, SourceConfig, SyncConfig
from sfr_loc_map.io.truth.config import TruthConfig
from sfr_loc_map.issues import Cause
from sfr_loc_map.simulation.config import PanoramaConfig

NAV_RIG = StereoRig(160, 120, 200.0, 200.0, 79.5, 59.5, 0.15)
ON_HEAD = FramesConfig(head_to_navsb_m=(0.06, 0.0, 0.08), head_to_navsb_quat_xyzw=(0.0, 0.0, 0.0, 1.0))


def with_calibration_file(folder: Path) -> SourceConfig:
    file = folder / "calibration.json"
    file.write_text(rig_json(replace(LOC_RIG, T_rb_sb=None)))
    return SourceConfig(calibration=CalibrationConfig(file=str(file)))


CONFIGS: dict[str, Callable[[Path], SourceConfig]] = {
    "nothing": lambda folder: SourceConfig(),
    "frames": lambda folder: SourceConfig(frames=FramesConfig(base="rover")),
    "sync": lambda folder: SourceConfig(sync=SyncConfig(stamp_tolerance_s=0.02)),
    "truth": lambda folder: SourceConfig(truth=TruthConfig(sigma_m=0.01)),
    "calibration": with_calibration_file,
}


@pytest.mark.parametrize("what", CONFIGS)
def test_a_bag_is_observed_as_a_bag_with_any_configuration(tmp_path: Path, what: str) -> None:
    """Missing extrinsics are advised for a bag, which has no rig.json."""

    def without_frames(topic: str, number: int, message: Any) -> Any:
        return replace(message, transforms=[]) if topic == "/tf_static" else message

    bag = rewritten_bag(tmp_path / "x.mcap", without_frames)
    config = CONFIGS[what](tmp_path)
    seen = observe(bag, config)
    assert seen.kind is SourceKind.BAG
    assert set(seen.topics) >= {"loc/left/image_rect", "nav/pose", "ground_truth/odometry"}
    (issue,) = examine(seen)
    assert issue.cause is Cause.FRAMES
    assert "rig.json" not in issue.text + issue.fix
    assert ("frames.base" in issue.text) == (what == "frames")


@pytest.mark.parametrize("what", ["nothing", "sync"])
def test_a_recording_that_was_not_closed_is_reported_with_any_configuration(tmp_path: Path, what: str) -> None:
    bag = rewritten_bag(tmp_path / "x.mcap", lambda topic, number, message: message)
    (storage,) = bag.glob("*.mcap")
    (bag / "metadata.yaml").unlink()
    storage.write_bytes(storage.read_bytes()[:-100])
    assert [issue.cause for issue in examine(observe(bag, CONFIGS[what](tmp_path)))] == [Cause.UNFINISHED]


@pytest.mark.parametrize("what", CONFIGS)
def test_messages_are_played_as_recorded_unless_the_configuration_changes_them(tmp_path: Path, what: str) -> None:
    bag = rewritten_bag(tmp_path / "x.mcap", lambda topic, number, message: message)
    config = CONFIGS[what](tmp_path)
    assert (open_source(bag, config).recorded is None) == config.changes_messages == (what not in ("nothing", "frames"))


@pytest.mark.parametrize(
    ("head", "frames", "is_missing"),
    [("tf", FramesConfig(), False), ("joints", ON_HEAD, False), ("joints", FramesConfig(), True)],
)
def test_mapping_poses_may_be_those_of_frames_or_joints(
    tmp_path: Path, head: str, frames: FramesConfig, is_missing: bool
) -> None:
    pair, points = random_pair(np.random.default_rng(0), BEGIN_NS, (120, 160)), np.zeros((120, 160, 3), np.float32)
    nav = [PosedStereoPair(pair, Transform.identity(), points)] * len(PanoramaConfig().pan_deg)
    recording = add_mapping(Recording(), Drive(NAV_RIG, [], points, points, NAV_RIG, nav), "/nav", head)
    bag = recording.write(tmp_path / "bag")
    config = SourceConfig(frames=frames)
    issues = examine(observe(bag, config))
    assert [(issue.cause, issue.where) for issue in issues] == ([(Cause.NO_TOPIC, "nav/pose")] if is_missing else [])
    if is_missing:
        assert "frames.head_to_navsb_m" in issues[0].fix
    else:
        assert len(open_source(bag, config).nav) == len(nav)  # type: ignore[arg-type]
