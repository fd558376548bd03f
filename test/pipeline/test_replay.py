"""The score of a replay: poses of an external node converted; live, replay and `sfr score` give one map score."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from made_scene import write_folder

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.cloud_file import save_cloud
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.mapper import Mapper
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.score_json import to_dict
from sfr_loc_map.pipeline.monitor_score import MonitorScore
from sfr_loc_map.pipeline.offline import MapRun, map_pairs
from sfr_loc_map.pipeline.replay import ReplayFiles, ReplayResult, save_replay, score_replay
from sfr_loc_map.pipeline.scoring import ScoreInputs, score_files

SAMPLE = Path(__file__).parents[2] / "sample" / "sample.mcap"


def mapped(path: Path) -> tuple[Source, MapRun]:
    source = open_source(path, {})
    return source, map_pairs(source.nav, MappingConfig())


def file_score(cloud: Path, source: Path) -> dict[str, Any]:
    return dict(to_dict(score_files(ScoreInputs.of(cloud, source), ScoreConfig()))["map"])


def live_score(source: Source, run: MapRun, cloud: PointCloud) -> dict[str, Any]:
    """Return the map's score as the monitor makes it of what is published."""
    monitor = MonitorScore(ScoreConfig(), None)
    monitor.map_inputs.rig = source.nav.rig
    for item in source.nav.pairs():
        monitor.map_inputs.add_pose(item.pair.stamp_ns, item.T_lm_navsb)
        monitor.map_inputs.add_true_points(item.pair.stamp_ns, item.truth)
    for record in run.records:
        says = {"fused": float(cloud.fused is True)} if record.state == "fused" else {}
        monitor.add_call(replace(record, statistics={**record.statistics, **says}))
    message = replace(cloud, fused=None, pair_stamps_ns=None)  # it does not say
    monitor.map_inputs.add_cloud(run.maps[-1].stamp_ns, message)
    assert monitor.score_maps()
    return dict(to_dict(monitor.result())["map"])


@pytest.mark.parametrize(
    "case", ["folder, fused", "folder, not fused", pytest.param("sample, fused", marks=pytest.mark.slow)]
)
def test_live_replay_and_score_of_every_file_format_are_equal_to_the_last_digit(tmp_path: Path, case: str) -> None:
    source, run = mapped(SAMPLE if case == "sample, fused" else write_folder(tmp_path / "source", 0, 3))
    cloud = run.unfused if case == "folder, not fused" else run.fused.cloud
    stamps = tuple(item.stamp_ns for item in run.maps)
    result, files = ReplayResult(Trajectory.empty(), cloud, run.records, "", stamps), ReplayFiles(tmp_path)
    save_replay(result, files)
    replayed = to_dict(score_replay(source, result, files, ScoreConfig(), None))["map"]
    assert replayed["cloud"] == ("single pairs" if case == "folder, not fused" else "fused")
    assert replayed == file_score(files.cloud, source.path) == live_score(source, run, cloud)
    for name in ("cloud.pcd", "cloud.npz"):
        save_cloud(tmp_path / name, cloud)
        assert file_score(tmp_path / name, source.path) == replayed


def test_a_cloud_is_judged_by_the_truth_of_its_own_pairs(tmp_path: Path) -> None:
    """Of four pairs the first two were refused: the cloud's pairs 0 and 1 are the source's 2 and 3."""
    source = open_source(write_folder(tmp_path / "source", 0, 4), {})
    mapper = Mapper(source.nav.rig, MappingConfig())
    last = list(source.nav.pairs())[2:]
    cloud = mapper.fuse([mapper.process(item.pair, item.T_lm_navsb, k) for k, item in enumerate(last)]).cloud
    save_cloud(tmp_path / "c.ply", cloud)
    score = file_score(tmp_path / "c.ply", source.path)
    assert (score["pairs"], score["coverage"] > 0.8) == (2, True)
    assert score["point_error_m"]["p50"] < 0.02
    save_cloud(tmp_path / "d.ply", replace(cloud, pair_stamps_ns=(1, 2)))
    with pytest.raises(InputError, match="give the source that it was made from"):
        file_score(tmp_path / "d.ply", source.path)
