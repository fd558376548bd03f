"""The inputs of a score: the calls beside an estimate belong to it, whoever scores it."""

from dataclasses import replace
from pathlib import Path

import pytest

from helpers.broken_sources import renamed_bag
from helpers.cli_result import Sfr
from helpers.made_scene import write_folder
from helpers.scored_drives import POSITION, limits, straight
from sfr_loc_map import api, api_types
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.hashes import hash_path
from sfr_loc_map.io.registry import open_source, read_truth
from sfr_loc_map.io.source_config import source_config
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.replay.replay_score import files_of_source, score_replay
from sfr_loc_map.replay.result import ReplayedMap, ReplayResult
from sfr_loc_map.runs.mapper_run import run_mapper
from sfr_loc_map.scoring import input_files
from sfr_loc_map.scoring.inputs import ScoreInputs
from sfr_loc_map.scoring.load import load_run
from sfr_loc_map.scoring.score_run import score_files, score_run


def test_calls_beside_an_estimate_are_read_unless_others_are_named(tmp_path: Path) -> None:
    estimate, truth, other = (tmp_path / name for name in ("drive.csv", "truth.csv", "other.csv"))
    assert ScoreInputs.of(estimate, truth).stats == ()
    beside = tmp_path / "drive.stats.csv"
    beside.touch()
    assert ScoreInputs.of(estimate, truth).stats == (beside,)
    assert ScoreInputs.of(estimate, truth, [other]).stats == (other,)


def test_a_link_to_another_estimate_while_it_is_scored_is_refused(tmp_path: Path) -> None:
    """The provenance would otherwise have the hash of a file that nobody scored."""
    estimate, other, truth = (tmp_path / name for name in ("estimate.csv", "other.csv", "truth.csv"))
    link = tmp_path / "link.csv"
    for path, scale in ((estimate, 0.999), (other, 0.9), (truth, 1.0)):
        save_trajectory(path, straight(scale=scale))
    link.symlink_to(estimate)
    run = load_run(ScoreInputs.of(link, truth))
    assert score_files(ScoreInputs.of(link, truth), ScoreConfig()).provenance is not None
    link.unlink()
    link.symlink_to(other)
    with pytest.raises(InputError, match="changed or replaced while it was scored"):
        score_run(run, ScoreConfig())


@pytest.mark.parametrize("name", ["limits.yaml", "source/sfr.yaml", "other_truth.csv", "source/loc/groundtruth.csv"])
def test_no_file_of_a_score_may_change_while_it_is_scored(tmp_path: Path, name: str) -> None:
    """A file of a data set folder that is written in place leaves the state of the folder."""
    source, limits = write_folder(tmp_path / "source", 3, 1), tmp_path / "limits.yaml"
    estimate, other = tmp_path / "estimate.csv", tmp_path / "other_truth.csv"
    for copy in (estimate, other):
        copy.write_bytes((source / "loc" / "groundtruth.csv").read_bytes())
    limits.write_text("timing: []\n")
    about = "truth: {source: ../other_truth.csv}" if name == "other_truth.csv" else "truth: {sigma_m: 0.01}"
    (source / "sfr.yaml").write_text(f"{about}\n")
    run = load_run(replace(ScoreInputs.of(estimate, source), limits=limits))
    with (tmp_path / name).open("a") as stream:
        stream.write("\n")
    with pytest.raises(InputError, match=f"{name}' was changed or replaced while it was scored"):
        score_run(run, ScoreConfig())


@pytest.mark.parametrize("view", ["python", "replay"])
def test_the_truth_of_a_map_may_not_change_while_a_cloud_in_memory_is_scored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, view: str
) -> None:
    source = open_source(write_folder(tmp_path / "source", 0, 1))
    assert source.nav is not None
    mapped = run_mapper(source.nav, MappingConfig())
    (truth,) = source.path.rglob("*.npy")

    def change(path: Path) -> str:
        with truth.open("ab") as stream:
            stream.write(b"\0")
        return hash_path(path)

    read = files_of_source(source)
    monkeypatch.setattr(input_files, "hash_path", change)
    result = ReplayResult(
        Trajectory.empty(), ReplayedMap(mapped.fused.cloud, None, (mapped.maps[0].stamp_ns,)), mapped.records
    )
    cloud = api_types.PointCloud.of(mapped.fused.cloud, records=(), method=mapped.method)
    views = {
        "python": lambda: api.score(cloud, source),
        "replay": lambda: score_replay(source, result, ScoreConfig(), None, read=read),
    }
    with pytest.raises(InputError, match="changed or replaced while it was scored"):
        views[view]()


def test_a_bag_with_estimates_on_another_topic_names_the_command_that_reads_them(tmp_path: Path) -> None:
    bag = renamed_bag(tmp_path / "x.mcap", "ground_truth/odometry", "vio/poses")
    poses = read_truth(bag, source_config(bag, remap={"/vio/poses": "ground_truth/odometry"}))
    save_trajectory(tmp_path / "truth.csv", poses)
    with pytest.raises(InputError, match=r"sfr convert .* estimate\.tum --remap /vio/poses:=ground_truth/odometry$"):
        load_run(ScoreInputs.of(bag, tmp_path / "truth.csv"))


def test_a_truth_that_is_the_output_of_a_run_is_a_deviation(tmp_path: Path, files: tuple[Path, Path], sfr: Sfr) -> None:
    estimate, truth = files
    rules = limits(tmp_path, POSITION)
    for has_calls in (False, True):
        if has_calls:
            stamps = (line.partition(",")[0] for line in truth.read_text().splitlines()[1:])
            rows = [f"{stamp},0.1,tracking" for stamp in stamps]
            truth.with_suffix(".stats.csv").write_text("\n".join(["stamp_ns,processing_time_s,state", *rows, ""]))
        done = sfr("score", estimate, truth, "--limits", rules)
        assert (done.code, "is the output of a run" in done.err) == (0, has_calls), done.err


@pytest.mark.parametrize(
    ("content", "options", "is_stated"),
    [
        ("truth: {lever_arm_m: [0.5, 0, 0.8]}\n", (), True),
        ("truth: {lever_arm_m: [0, 0, 0]}\n", (), False),
        ("extrinsics: {}\n", (), False),
        ("truth: {lever_arm_m: [0.5, 0, 0.8]}\n", ("--config",), False),
    ],
)
def test_a_configuration_beside_a_file_of_true_poses_is_reported_if_it_changes_a_truth(
    tmp_path: Path, files: tuple[Path, Path], sfr: Sfr, content: str, options: tuple[str, ...], is_stated: bool
) -> None:
    config = tmp_path / "sfr.yaml"
    config.write_text(content)
    done = sfr("score", *files, *options, *([config] if options else []))
    assert ("was not used for a file of poses" in done.err) == is_stated, done.err
