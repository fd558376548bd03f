"""The proposed configuration of a recording."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers import broken_sources as broken
from helpers.cli_result import Sfr
from helpers.made_worlds import make_world
from helpers.message_bags import write_messages
from sfr_loc_map.configuration.sections import Configuration, Key
from sfr_loc_map.errors import InputError
from sfr_loc_map.io.bag import messages
from sfr_loc_map.io.source_config import SyncConfig
from sfr_loc_map.source_setup.examination import propose_config
from sfr_loc_map.source_setup.proposal import Proposal, Value


def test_a_recording_without_images_has_a_proposal(tmp_path: Path) -> None:
    """No topic is searched for the missing images, whatever the names of the topics are."""
    message = messages.odometry(1, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
    place = write_messages(tmp_path / "x", [("/loc/left/None", 1, message)])
    assert propose_config(place, Configuration()).missing


def raw_stereo(path: Path, late_ns: int = 40_000_000) -> Path:
    """Write raw images whose right header stamps are late, and camera_info without a baseline."""
    rig = make_world().loc_rig
    image = np.zeros((rig.height, rig.width), np.uint8)
    entries = []
    for recorded_ns in range(10**9, 2 * 10**9, 10**8):
        for side, offset_ns in (("left", 0), ("right", late_ns)):
            info = messages.camera_info(recorded_ns + offset_ns, rig, "loc", side)
            info.p[3] = 0.0
            entries.append((f"/loc/{side}/camera_info", recorded_ns, info))
            message = messages.image(recorded_ns + offset_ns, image, "loc", side)
            entries.append((f"/loc/{side}/image_raw", recorded_ns, message))
    return write_messages(path, entries)


def bag_of_a_drive(path: Path) -> Path:
    return broken.good_bag(path.with_suffix(".mcap"))


def only_mapping_pairs(path: Path) -> Path:
    folder = broken.good_folder(path)
    shutil.rmtree(folder / "loc")
    return folder


def test_a_given_baseline_is_not_missing(tmp_path: Path) -> None:
    place = raw_stereo(tmp_path / "x")
    assert any("calibration.baseline_m" in text for text in propose_config(place, Configuration()).missing)
    given = propose_config(place, Configuration(None, {"calibration": {"baseline_m": 0.12}})).missing
    assert given
    assert not any("calibration.baseline_m" in text for text in given)


def test_the_stamps_are_compared_as_the_source_uses_them(tmp_path: Path) -> None:
    place = raw_stereo(tmp_path / "x")
    assert propose_config(place, Configuration()).sections["sync"] == {"right_offset_s": -0.04}
    for given in ({"stamps": "record"}, {"right_offset_s": -0.039}, {"stamp_tolerance_s": 0.045}):
        assert propose_config(place, Configuration(None, {"sync": given})).sections["sync"] == given


@pytest.mark.parametrize(("spread_s", "expected_s"), [(0.3, 0.45), (0.4, 0.5), (0.5, 0.5), (0.6, None)])
def test_a_proposed_tolerance_is_in_the_range_of_its_parameter(
    tmp_path: Path, spread_s: float, expected_s: float | None
) -> None:
    """Every second right image is late; the period is 1.5 s."""
    image = np.zeros((16, 24), np.uint8)
    entries = []
    for number in range(40):
        left_ns = 10**9 + number * 1_500_000_000
        late_ns = round(spread_s * 10**9) * (number % 2)
        for side, stamp_ns in (("left", left_ns), ("right", left_ns + late_ns)):
            entries.append((f"/loc/{side}/image_raw", stamp_ns, messages.image(stamp_ns, image, "loc", side)))
    found = propose_config(write_messages(tmp_path / "x", entries), Configuration())
    assert found.config.sync.stamp_tolerance_s == pytest.approx(expected_s or SyncConfig().stamp_tolerance_s)
    assert any("stamp_tolerance_s" in text for text in found.missing) == (expected_s is None)


def test_values_that_their_parameters_cannot_have_are_reported() -> None:
    values = (
        Value(Key("calibration", "baseline_m"), 150.0, "from /tf_static"),
        Value(Key("sync", "right_offset_s"), -2e4, "late"),
        Value(Key("extrinsics", "translation_m"), [0.0, 0.0, 1.0], "from /tf_static"),
        Value(Key("conditions"), ["distance=5"], "length"),
    )
    found = Proposal(Path("x"), Configuration()).adding(*values)
    assert found.sections == {"extrinsics": {"translation_m": [0.0, 0.0, 1.0]}, "conditions": ["distance=5"]}
    assert [text.split(":")[0] for text in found.missing] == ["calibration", "sync"]


def unstamped(topic: str, number: int, message: Any) -> Any:
    """Set the stamps of all headers to 0."""
    if hasattr(message, "header"):
        message.header.stamp.sec = message.header.stamp.nanosec = 0
    return message


def without_truth(topic: str, number: int, message: Any) -> Any:
    return None if "ground_truth" in topic else unstamped(topic, number, message)


@pytest.mark.parametrize("edit", [unstamped, without_truth])
def test_stamps_of_0_are_replaced_by_the_times_of_recording(tmp_path: Path, sfr: Sfr, edit: broken.Edit) -> None:
    bag = broken.rewritten_bag(tmp_path / "x.mcap", edit)
    found = propose_config(bag, Configuration())
    assert found.sections["sync"] == {"stamps": "record"}
    assert [text for text in found.missing if "truth.stamps=record" in text] == list(found.missing)
    assert bool(found.missing) == (edit is unstamped)
    result = sfr("init", tmp_path / "rover", "--from", bag)
    assert result.code == (1 if found.missing else 0)
    assert "stamps: record" in (tmp_path / "rover" / "sfr.yaml").read_text()


def test_right_images_that_are_half_a_period_late_are_not_paired(tmp_path: Path) -> None:
    """Each right image is as near to the next left image as to its own."""
    given = Configuration(None, {"calibration": {"baseline_m": 0.12}})
    found = propose_config(raw_stereo(tmp_path / "x", late_ns=50_000_000), given)
    assert "sync" not in found.sections
    assert any("sync.right_offset_s" in text for text in found.missing)


@pytest.mark.parametrize("make", [bag_of_a_drive, broken.good_folder, raw_stereo, only_mapping_pairs])
@pytest.mark.parametrize(
    ("truth", "words"),
    [
        ("/none", "neither a file nor a topic"),
        ("missing.csv", "neither a file nor a topic"),
        ("corrupt.csv", "corrupt.csv' line 3 has 1 column"),
        ("empty.csv", "empty.csv' has no pose"),
    ],
)
def test_a_wrong_given_truth_is_refused(tmp_path: Path, make: Callable[[Path], Path], truth: str, words: str) -> None:
    (tmp_path / "corrupt.csv").write_text("stamp_ns,x,y,z\n1,2,3,4\nx\n")
    (tmp_path / "empty.csv").write_text("")
    source = truth if truth.startswith("/") else str(tmp_path / truth)
    with pytest.raises(InputError, match=words):
        propose_config(make(tmp_path / "x"), Configuration(None, {"truth": {"source": source}}))


def test_findings_keep_what_is_given() -> None:
    proposal = Proposal(Path("x"), Configuration(None, {"sync": {"stamps": "header"}}))
    values = (Value(Key("sync", "stamps"), "record", "zero"), Value(Key("limits"), "l.yaml", "new"))
    found = proposal.adding(*values).adding(Value(Key("limits"), "m.yaml", "newer"))
    assert found.sections == {"sync": {"stamps": "header"}, "limits": "l.yaml"}
    assert found.reasons == {Key("limits"): "new"}
    assert proposal.sections == {"sync": {"stamps": "header"}}
