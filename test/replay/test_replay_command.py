"""A replay saves the results of its drive before an error of their conversion or of the mapper is reported."""

import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from helpers.made_scene import write_folder
from sfr_loc_map.errors import ConfigError, MetricsError, NodeError
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.metrics.figures.records import AnswerCounts, ExternalScore, MethodKind, MethodRecord
from sfr_loc_map.replay import replay_command
from sfr_loc_map.replay.files import ReplayFiles
from sfr_loc_map.replay.message_store import Received
from sfr_loc_map.replay.options import ExternalOptions, ReplayOptions
from sfr_loc_map.replay.result import ExternalResult, ReplayResult
from sfr_loc_map.scoring.request import ScoreRequest
from sfr_loc_map.suite_names import Task

OPTIONS = ReplayOptions(
    localisation=LocalisationConfig(),
    mapping=MappingConfig(),
    request=ScoreRequest.of(["frames=3"]),
    limits_file=None,
    start=None,
    rate=1.0,
    offset_s=0.0,
    duration_s=math.inf,
    paused=False,
)


def received(stamps_ns: list[int], external_task: Task | None = None) -> Received:
    """Return the identity as the pose of each stamp, and one mapping pair without a cloud."""
    found = Received.without_messages(external_task)
    found.maps.sent_ns.update(stamps_ns[:1])
    for stamp_ns in stamps_ns:
        found.drive.sent_ns.add(stamp_ns)
        found.drive.add_pose((stamp_ns, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)), np.eye(6))
    return found


def saved_stamps(files: ReplayFiles) -> list[int]:
    """Return the stamps of the saved estimate."""
    rows = files.estimate.read_text(encoding="utf-8").splitlines()[1:]
    return [int(row.split(",")[0]) for row in rows]


def replay(folder: Path, options: ReplayOptions = OPTIONS) -> None:
    """Replay the source of a folder and save the results there."""
    source = open_source(folder / "source")
    replay_command.replay_and_score(
        source, options, ReplayFiles(folder), "", progress=lambda rig: None, say=lambda line: None
    )


def test_the_estimate_is_saved_if_the_mapper_published_no_cloud(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = open_source(write_folder(tmp_path / "source", 3, 1))
    stamps_ns = list(source.loc.stamps_ns)

    replayed = received(stamps_ns).result(None)
    monkeypatch.setattr(replay_command, "replay", lambda *_, on_results, **__: on_results(replayed))
    with pytest.raises(NodeError, match=r"^mapping_node published no cloud"):
        replay(tmp_path)
    assert saved_stamps(ReplayFiles(tmp_path)) == stamps_ns


@pytest.mark.parametrize("count", [0, 3])
def test_the_results_before_an_error_are_saved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    """Without results, no file is written or removed."""
    source = open_source(write_folder(tmp_path / "source", 3, 1))
    stamps_ns = list(source.loc.stamps_ns)[:count]
    files = ReplayFiles(tmp_path)
    files.report.write_text("of an earlier replay", encoding="utf-8")

    def replay_until_error(*_: object, on_results: Callable[[ReplayResult], None], **__: object) -> None:
        on_results(received(stamps_ns).result(None))
        raise NodeError("mapping_node was killed by SIGKILL")

    monkeypatch.setattr(replay_command, "replay", replay_until_error)
    text = f"; the received results are in '{tmp_path}'" if count else ""
    with pytest.raises(NodeError, match=f"^mapping_node was killed by SIGKILL{re.escape(text)}$"):
        replay(tmp_path)
    assert files.estimate.exists() == bool(count)
    assert files.report.exists() == (not count)
    if count:
        assert saved_stamps(files) == stamps_ns


def test_poses_are_not_diagnosed_without_ground_truth(tmp_path: Path) -> None:
    (write_folder(tmp_path / "source", 3, 1) / "loc" / "groundtruth.csv").unlink()
    request = ScoreRequest.of(["frames=3"], apply_diagnosis=True)
    options = replace(OPTIONS, external=ExternalOptions(Task.LOCALISATION, "pose"), request=request)
    with pytest.raises(ConfigError, match="requires ground truth"):
        replay(tmp_path, options)


def test_poses_that_cannot_be_converted_are_saved_as_published(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = open_source(write_folder(tmp_path / "source", 3, 1))
    stamps_ns = [stamp_ns + 10**12 for stamp_ns in source.loc.stamps_ns]  # outside of the ground truth
    score = ExternalScore(task=Task.LOCALISATION.value, topic="pose", frames="", answers=AnswerCounts(), latency_s=None)
    method = MethodRecord(name="theirs", version=None, kind=MethodKind.EXTERNAL)
    found = received(stamps_ns, Task.LOCALISATION).result(ExternalResult(method, score, ()))
    monkeypatch.setattr(replay_command, "replay", lambda *_, on_results, **__: on_results(found))
    request = ScoreRequest.of(["frames=3"], convention=["world=first_pose"])
    options = replace(OPTIONS, external=ExternalOptions(Task.LOCALISATION, "pose"), request=request)
    with pytest.raises(MetricsError, match="the world frame cannot be aligned"):
        replay(tmp_path, options)
    assert saved_stamps(ReplayFiles(tmp_path)) == stamps_ns
