"""An issue gets the command of a proposal only if the proposal removes this very issue."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from helpers.cli_result import Sfr
from helpers.message_bags import write_messages
from sfr_loc_map.configuration.sections import Configuration
from sfr_loc_map.doctor import fixes
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.bag import messages as bag_messages
from sfr_loc_map.issues import Cause, Issue


def test_of_two_missing_topics_the_one_that_the_proposal_finds_gets_its_command(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    issues = [Issue(Cause.NO_TOPIC, topic, "there is none", "record it") for topic in ("nav/pose", "loc/left/image")]
    proposal = SimpleNamespace(config=None, sections={"topics": {"loc/left/image": "/cam0"}}, missing=())
    monkeypatch.setattr(fixes, "propose_config", lambda source, given: proposal)
    monkeypatch.setattr(fixes, "observe", lambda source, config: None)
    monkeypatch.setattr(fixes, "examine", lambda seen: issues[:1])
    pose, image = fixes.with_fix(Path("drive"), Configuration(), issues, ["sfr", "info", "drive", "--write"])
    assert pose == issues[0]
    assert image.command == "sfr info drive --write"


def test_a_bag_of_poses_alone_is_not_fixed_by_the_proposal_of_its_truth(tmp_path: Path, sfr: Sfr) -> None:
    stamped = [(k * 10**8, bag_messages.pose(k * 10**8, Transform.identity())) for k in range(1, 6)]
    bag = write_messages(tmp_path / "poses", [("/groundtruth", stamp_ns, message) for stamp_ns, message in stamped])
    result = sfr("info", bag)
    assert result.code == 1
    assert "no topic has images" in result.out
    assert "--write; still missing" not in result.out
    assert "give a bag with images of both cameras" in result.out
    result = sfr("init", tmp_path / "rover", "--from", bag)
    assert result.code == 1
    assert "sfr info" not in result.err
    assert "give a bag with images of both cameras" in result.err
