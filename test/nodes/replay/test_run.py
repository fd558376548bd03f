"""A replay saves its results before an error of the mapper is reported."""

import math
from pathlib import Path

import pytest

from helpers.made_scene import write_folder
from sfr_loc_map.errors import NodeError
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.metrics.config import score_config
from sfr_loc_map.nodes.replay import run
from sfr_loc_map.nodes.replay.options import ReplayOptions
from sfr_loc_map.nodes.replay.received import ReceivedResults
from sfr_loc_map.runs.replay_files import ReplayFiles
from sfr_loc_map.scoring.inputs import Correction


def test_the_estimate_is_saved_although_the_mapper_has_published_no_cloud(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = open_source(write_folder(tmp_path / "source", 3, 1))
    stamps_ns = list(source.loc.stamps_ns)
    results = ReceivedResults(
        rows=[(stamp_ns, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)) for stamp_ns in stamps_ns],
        sent_pairs={("nav", stamps_ns[0]), *(("loc", stamp_ns) for stamp_ns in stamps_ns)},
    )
    monkeypatch.setattr(run, "replay", lambda *arguments: (results, False))
    options = ReplayOptions(
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
    files = ReplayFiles(tmp_path)
    with pytest.raises(NodeError, match=r"^mapping_node published no cloud"):
        run.replay_and_score(source, options, Correction(), files, "", progress=lambda rig: None, say=lambda line: None)
    saved = files.estimate.read_text(encoding="utf-8").splitlines()
    assert len(saved) == 1 + len(stamps_ns)
