"""A replay saves the results of its drive before an error of their conversion or of the mapper is reported."""

import math
from pathlib import Path

import numpy as np
import pytest

from helpers.made_scene import write_folder
from sfr_loc_map.errors import MetricsError, NodeError
from sfr_loc_map.inputs import Task
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.metrics.config import score_config
from sfr_loc_map.metrics.pose_convention import PoseConvention
from sfr_loc_map.metrics.records import AnswerCounts, ExternalScore, MethodKind, MethodRecord
from sfr_loc_map.nodes.replay import run
from sfr_loc_map.nodes.replay.answer_book import AnswerBook
from sfr_loc_map.nodes.replay.options import ReplayOptions
from sfr_loc_map.nodes.replay.received import ReceivedResults
from sfr_loc_map.runs.collected_run import ExternalRun
from sfr_loc_map.runs.replay_files import ReplayFiles
from sfr_loc_map.scoring.inputs import Correction

OPTIONS = ReplayOptions(
    localisation=LocalisationConfig(),
    mapping=MappingConfig(),
    score=score_config(["frames=3"], {}),
    limits_file=None,
    limits=None,
    start=None,
    rate=1.0,
    offset_s=0.0,
    duration_s=math.inf,
    paused=False,
    parameter_file=None,
)


def results_of(stamps_ns: list[int]) -> ReceivedResults:
    """Return results with the identity as the pose of each stamp, and one mapping pair without a cloud."""
    return ReceivedResults(
        rows=[(stamp_ns, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)) for stamp_ns in stamps_ns],
        covariances={stamp_ns: np.eye(6) for stamp_ns in stamps_ns},
        sent_pairs={("nav", stamps_ns[0]), *(("loc", stamp_ns) for stamp_ns in stamps_ns)},
    )


def saved_stamps(files: ReplayFiles) -> list[int]:
    """Return the stamps of the saved estimate."""
    rows = files.estimate.read_text(encoding="utf-8").splitlines()[1:]
    return [int(row.split(",")[0]) for row in rows]


def replay(folder: Path, correction: Correction) -> None:
    """Replay the source of a folder and save the results there."""
    source = open_source(folder / "source")
    run.replay_and_score(
        source, OPTIONS, correction, ReplayFiles(folder), "", progress=lambda rig: None, say=lambda line: None
    )


def test_the_estimate_is_saved_if_the_mapper_published_no_cloud(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = open_source(write_folder(tmp_path / "source", 3, 1))
    stamps_ns = list(source.loc.stamps_ns)
    monkeypatch.setattr(run, "replay", lambda *arguments: (results_of(stamps_ns), False))
    with pytest.raises(NodeError, match=r"^mapping_node published no cloud"):
        replay(tmp_path, Correction())
    assert saved_stamps(ReplayFiles(tmp_path)) == stamps_ns


def test_poses_that_cannot_be_converted_are_saved_as_published(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = open_source(write_folder(tmp_path / "source", 3, 1))
    stamps_ns = [stamp_ns + 10**12 for stamp_ns in source.loc.stamps_ns]  # outside of the ground truth
    results = results_of(stamps_ns)
    results.answers = AnswerBook(Task.LOCALISATION.rig, 1.0, "")
    score = ExternalScore(task=Task.LOCALISATION.value, topic="pose", frames="", answers=AnswerCounts(), latency_s=None)
    results.external = ExternalRun(MethodRecord(name="theirs", version=None, kind=MethodKind.EXTERNAL), score, ())
    monkeypatch.setattr(run, "replay", lambda *arguments: (results, False))
    with pytest.raises(MetricsError, match="the world frame cannot be aligned"):
        replay(tmp_path, Correction(PoseConvention(world="first_pose")))
    assert saved_stamps(ReplayFiles(tmp_path)) == stamps_ns
