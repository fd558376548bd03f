"""The Python interface: the same figures as the commands, from files and from values in memory."""

from __future__ import annotations

import builtins
import inspect
import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sfr_loc_map as suite
from helpers.broken_sources import renamed_bag
from helpers.cli_result import Sfr
from helpers.score_rows import number, rows_about
from sfr_loc_map import api
from sfr_loc_map.errors import ConfigError, GeometryError, InputError, OutputError
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.scoring.request import ScoreRequest

LIMITS = {"minimum_independent": 2, "trajectory": [{"condition": "frames=2", "position_mean_plus_3sigma_m": 0.5}]}
SIGNATURES = {
    "open": ["source", "remap", "config"],
    "localise": ["source", "start", "live", "config", "method"],
    "map": ["source", "fuse", "refine_poses", "config", "method"],
    "score": [
        *("estimate", "truth", "conditions", "limits", "align", "stats", "spacing", "rebase", "partial", "frames"),
        *("associate", "max_gap", "scored_range", "fused", "convention", "apply_diagnosis", "max_difference"),
        "rpe_delta",
    ],
}


def figures(text: str) -> dict[str, Any]:
    """Return a score without what it was made of."""
    content: dict[str, Any] = json.loads(text)
    del content["provenance"], content["content_sha256"]
    return content


def test_the_public_names_stay() -> None:
    names = {"Localiser", "Mapper", "PointCloud", "Score", "SfrError", "Source", "Trajectory", "Transform", *SIGNATURES}
    names |= {"LocalisationConfig", "MappingConfig", "PoseEstimate", "PosedStereoPair", "StartPose", "StereoPair"}
    names |= {"StereoRig"}
    assert set(dir(suite)) == names
    assert set(suite.__all__) == names - set(dir(builtins)), "import * must not replace builtins"
    found = {name: list(inspect.signature(getattr(suite, name)).parameters) for name in SIGNATURES}
    assert found == SIGNATURES
    assert not [name for name in names if not getattr(suite, name).__doc__]


def test_a_drive_scored_in_memory_has_the_figures_of_the_command(
    folder: Path, estimate: suite.Trajectory, tmp_path: Path, sfr: Sfr
) -> None:
    poses, stats, limits = (tmp_path / name for name in ("estimate.csv", "stats.csv", "limits.yaml"))
    estimate.save(poses)
    estimate.to_stats(stats)
    limits.write_text(json.dumps(LIMITS))
    conditions = ["frames=2", "distance=0.04"]
    options = ["--condition", conditions[0], "--condition", conditions[1], "--spacing", 1, "--json", "-"]
    done = sfr("score", poses, folder, "--stats", stats, "--limits", limits, *options)
    assert done.code == 0, done.err
    scored = suite.score(estimate, suite.open(folder), conditions, LIMITS, spacing=1)
    of_files = suite.score(poses, str(folder), conditions, limits, stats=[stats], spacing=1)
    assert figures(scored.to_json()) == figures(of_files.to_json()) == figures(done.out)
    assert scored.verdict == "pass"
    inputs = [json.loads(text)["provenance"]["inputs"] for text in (scored.to_json(), of_files.to_json(), done.out)]
    assert inputs[0]["truth"] == inputs[1]["truth"]
    assert inputs[1] == inputs[2]


def test_a_map_scored_in_memory_has_the_figures_of_the_command(
    folder: Path, cloud: suite.PointCloud, tmp_path: Path, sfr: Sfr
) -> None:
    cloud.save(tmp_path / "cloud.npz")
    done = sfr("score", tmp_path / "cloud.npz", folder, "--json", "-")
    assert done.code == 0, done.err
    content = figures(suite.score(cloud, folder).to_json())
    assert rows_about(content, "map") == rows_about(figures(done.out), "map")
    assert number(content, "fusion", "n") == 1
    assert np.array_equal(suite.PointCloud.load(tmp_path / "cloud.npz").xyz, cloud.xyz)


def test_two_trajectories_are_scored(estimate: suite.Trajectory, folder: Path, tmp_path: Path) -> None:
    truth = suite.open(folder).truth
    poses = suite.Trajectory.of(truth)
    assert type(poses) is suite.Trajectory, "the uncertainty of a truth is not part of its poses"
    assert suite.score(estimate, poses, ["frames=2"], spacing=1).verdict is None
    scored = suite.score(estimate, truth, ["frames=2"], spacing=1)
    assert scored.verdict is None
    moved = suite.score(replace(truth, positions=truth.positions + 1.0), truth, ["frames=2"], spacing=1)
    assert moved.number("position", "mean_plus_3sigma") == pytest.approx(0.0, abs=1e-12)
    half = suite.Trajectory(estimate.stamps_ns[:3], estimate.positions[:3], estimate.quats_xyzw[:3])
    options = {"rebase": "displacement", "spacing": 1}
    found, asked = (suite.score(half, folder, "frames=2,time=0.1", partial=each, **options) for each in (False, True))
    assert (found.verdict, asked.verdict) == ("incomplete", None)
    assert repr(found).startswith("Score(incomplete, ")
    assert found.incomplete.startswith("the estimate covers 50 % of the images")
    assert found.association.reading == found.figure("position").part == "displacement"
    estimate.save(tmp_path / "poses.kitti")
    (tmp_path / "poses.times.txt").unlink()  # poses without stamps get those of poses in memory
    for pair in ((tmp_path / "poses.kitti", estimate), (estimate, tmp_path / "poses.kitti"), (estimate, truth)):
        found = suite.score(*pair, "frames=2").association  # one condition may be a text
        assert found.matched == len(estimate) == 6


def test_poses_come_as_they_are_estimated(estimate: suite.Trajectory, folder: Path) -> None:
    live = suite.localise(folder, "truth", live=True)
    first = next(live)
    assert first.stamp_ns == estimate.stamps_ns[0]
    rest = list(live)
    together = suite.Trajectory.from_estimates([first, *rest])
    assert np.array_equal(together.positions, estimate.positions)
    assert [record.outcome for record in together.records] == [record.outcome for record in estimate.records]
    source = suite.open(folder)
    scores = [suite.score(poses, source, ["frames=2"], LIMITS, spacing=1) for poses in (together, estimate)]
    assert len({score.verdict for score in scores}) == 1
    assert len({score.number("nees", part="pose") for score in scores}) == 1, "covariances of the estimates"
    assert scores[0].number("localisation", "mean", part=None) is None, "times of the estimates are unknown"
    by_hand = suite.Localiser(source.loc.rig, start=estimate.pose(0))
    assert [by_hand.process(pair).state for pair in source.loc.pairs()] == [item.state for item in (first, *rest)]


def test_objects_are_shown_in_one_line_and_as_html_and_a_score_is_written(
    estimate: suite.Trajectory, cloud: suite.PointCloud, folder: Path, tmp_path: Path
) -> None:
    source = suite.open(folder)
    scored = suite.score(estimate, source, ["frames=2"], LIMITS, spacing=1)
    for thing in (source, estimate, cloud, scored):
        assert repr(thing).startswith(f"{type(thing).__name__}(")
        assert len(repr(thing).splitlines()) == 1
        assert "<table" in thing._repr_html_()
    assert "6 localisation pairs, with truth, 2 mapping pairs" in repr(source)
    assert repr(scored).startswith("Score(pass, position ")
    assert f"{len(cloud)} points" in repr(cloud)
    assert [trace.name for trace in scored.plot().data][:2] == ["truth", "estimate"]
    with pytest.raises(ConfigError, match="no plot 'nothing': give one of top-view"):
        scored.plot("nothing")
    scored.report(tmp_path / "r.html")
    assert "top-view" in (tmp_path / "r.html").read_text()
    scored.save(tmp_path / "s.json")
    assert suite.Score.load(tmp_path / "s.json") == scored
    for write, name in ((scored.report, "r.txt"), (scored.save, "s.csv")):
        with pytest.raises(OutputError, match="a name that ends in"):
            write(tmp_path / name)


def test_wrong_calls_say_what_to_do(folder: Path, cloud: suite.PointCloud) -> None:
    truth = suite.open(folder).truth
    assert truth is not None
    scored = suite.score(truth, folder, ["frames=2"])
    calls: list[tuple[Callable[[], object], str]] = [
        (lambda: suite.open(folder / "nothing"), "No such file"),
        (
            lambda: suite.localise(folder, "somewhere"),
            "'identity', 'truth' or a pose of RB in DS .Transform. is required",
        ),
        (lambda: suite.localise(folder, config={"max_featurs": 3}), "unknown key 'max_featurs'"),
        (lambda: suite.score(folder, folder, frames="odd"), "'frames' is 'odd': truth or images is required"),
        (lambda: suite.score(cloud, folder, apply_diagnosis=True), "'apply_diagnosis' .*: omit it for a cloud"),
        (lambda: suite.score(cloud, folder, [5]), "'conditions' has 5: strings are required"),  # type: ignore[list-item]
        (lambda: suite.score(cloud, folder, 5), "'conditions' has 5: strings are required"),  # type: ignore[arg-type]
        (lambda: suite.score(3, folder), "estimate has the type int: a path, a Trajectory or a PointCloud"),  # type: ignore[arg-type]
        (lambda: suite.score(cloud, [1]), "truth has the type list"),  # type: ignore[arg-type]
        (lambda: suite.score(cloud, folder, limits=[1]), "limits has the type list"),  # type: ignore[arg-type]
        (lambda: suite.open(folder, config=""), "'config' is empty: a path is required"),
        (lambda: suite.open(None), "source has the type NoneType"),  # type: ignore[arg-type]
        (lambda: suite.open(folder, config={}), "config has the type dict: a path is required"),  # type: ignore[arg-type]
        (lambda: suite.localise(folder, (1, 2, 3)), "'start' is .1, 2, 3.: 'identity', 'truth' or a pose"),  # type: ignore[call-overload]
        (lambda: suite.localise(folder, np.eye(4)), "'start' is array[^\n]*: 'identity', 'truth' or a pose"),  # type: ignore[call-overload]
        (lambda: suite.score(truth, folder, convention=None), "'convention' has None: [^\n]*'frame=left_optical'"),  # type: ignore[arg-type]
        (lambda: suite.score(truth, folder, limits={}), "^limits: no limit is given"),
        (lambda: suite.score(truth, folder, []), "'conditions' is empty: give at least one"),
        (lambda: truth.save(folder / "poses.xyz"), "a name that ends in .csv, .txt, .tum or .kitti is required"),
        (lambda: truth.plot("truth"), "truth has the type str: a Trajectory is required"),  # type: ignore[arg-type]
        (lambda: suite.Trajectory.from_estimates([1]), "an item of estimates has the type int"),  # type: ignore[list-item]
        (lambda: suite.Trajectory.load(folder / "t.csv", 3), "columns has the type int"),  # type: ignore[arg-type]
        (lambda: suite.localise(folder, None), "'start' is None"),  # type: ignore[call-overload]
        (lambda: suite.localise(folder, config=MappingConfig()), "config has the type MappingConfig"),  # type: ignore[call-overload]
        (lambda: suite.score(folder, folder, stats=5), "stats has the type int: a path is required"),  # type: ignore[arg-type]
        (lambda: suite.score(truth, folder, fused=True), "'fused' applies only to clouds"),
        (lambda: suite.score(truth, folder, scored_range=(1.0, 2.0)), "'scored_range' applies only to clouds"),
        (lambda: suite.score("x.ply", folder, partial=True), "'partial' applies only to trajectories"),
        (lambda: suite.score(cloud, folder, ["frames=2"]), "'conditions' applies only to trajectories"),
        (lambda: suite.score(cloud, folder, align="none"), "'align' applies only to trajectories"),
        (lambda: suite.score(truth, folder, apply_diagnosis="no"), "'apply_diagnosis' is 'no'"),  # type: ignore[arg-type]
        (lambda: suite.score(cloud, folder, scored_range=5), "'scored_range' is 5: two distances"),  # type: ignore[arg-type]
        (lambda: suite.score(cloud, folder, scored_range=(0, "a")), "^'scored_range' is 'a': a number"),  # type: ignore[arg-type]
        (lambda: suite.score(truth, folder, associate="x"), "^'associate' is 'x': one of auto, match"),
        (lambda: suite.score(truth, folder, max_gap=-1.0), "^'max_gap' is -1.0: 0.0 to 3600.0 s is required"),
        (lambda: suite.score(truth, folder, "far"), "^'conditions': 'far' is not a condition"),
        (lambda: suite.map(folder, fuse="no"), "'fuse' is 'no'"),  # type: ignore[arg-type]
        (lambda: suite.map(folder, method=np.zeros(2)), "method has the type ndarray"),  # type: ignore[arg-type]
        (lambda: truth.plot(align="se3"), "'align' is 'se3', but no truth is given"),
        (lambda: truth.plot(align="x"), "^'align' is 'x'"),
        (lambda: scored.plot(["x"]), "name has the type list"),  # type: ignore[arg-type]
        (lambda: scored.to_pandas(np.zeros(2)), "table has the type ndarray"),  # type: ignore[arg-type]
        (lambda: suite.Score.of(5), "value has the type int: a Score is required"),  # type: ignore[arg-type]
        (lambda: suite.PointCloud.of(replace(cloud, records=())).to_stats("s.csv"), "requires a result of sfr.map"),
        (lambda: suite.Trajectory.of(truth).to_stats("s.csv"), "requires a result of sfr.localise"),
        (lambda: suite.map(folder, method=None), "method has the type NoneType"),  # type: ignore[arg-type]
        (lambda: truth.save("a\0.csv"), "'path' is 'a.*0.csv', which contains a NUL character"),
        (lambda: suite.Trajectory.empty().save(folder / "poses.csv"), "the trajectory has no pose"),
        (lambda: suite.score(truth, folder, max_difference=0.1), "^'max_difference' is a setting of APE .* 'align'"),
        (lambda: suite.score(truth, folder, align="se3", max_difference=-1.0), "'max_difference' is -1.0"),
        (lambda: suite.Trajectory.of(3), "value has the type int"),
        (lambda: suite.PointCloud.load(3), "path has the type int"),  # type: ignore[arg-type]
        (lambda: scored.number("positio", "mean"), "no figure 'positio' .did you mean 'position'"),
        (lambda: scored.number(3), "figure has the type int"),  # type: ignore[arg-type]
        (lambda: scored.number("position", 3), "statistic has the type int"),  # type: ignore[arg-type]
        (lambda: suite.Trajectory.from_estimates(3), "estimates has the type int"),  # type: ignore[arg-type]
        (lambda: scored.number("position", "meen"), "no statistic 'meen' .did you mean 'mean'"),
        (lambda: scored.number("longest_gap"), "has no row without a part: give part=, one of distance, time"),
        (lambda: suite.map(folder, method="sgbm", refine_poses=False), "refine_poses applies only"),
    ]
    for call, words in calls:
        with pytest.raises((ConfigError, InputError, OutputError), match=words):
            call()


@pytest.mark.parametrize("wrong", [{"a": 1}, "x", None, [1.0], np.array(["x"]), np.zeros(2, object)], ids=repr)
def test_values_of_wrong_types_are_refused_by_the_types_of_the_interface(
    estimate: suite.Trajectory, cloud: suite.PointCloud, wrong: Any
) -> None:
    image = np.zeros((16, 16), np.uint8)
    arrays = (estimate.stamps_ns, estimate.positions, estimate.quats_xyzw)
    columns = (cloud.xyz, cloud.sigma, cloud.intensity, cloud.u, cloud.v, cloud.pair)
    makers: list[tuple[Callable[..., object], Sequence[Any]]] = [
        (suite.Transform, (np.eye(3), np.zeros(3))),
        (suite.Transform.from_matrix, (np.eye(4),)),
        (suite.Transform.from_quat, (np.zeros(3), (0.0, 0.0, 0.0, 1.0))),
        (suite.Transform.from_origin_and_attitude, (np.zeros(3), (0.0, 0.0, 0.0, 1.0))),
        (suite.Trajectory, arrays),
        (suite.Trajectory.from_poses, ([(0, estimate.pose(0))],)),
        (suite.PointCloud, columns),
        (lambda left, right: suite.StereoPair(0, left, right), (image, image)),
        (lambda *numbers: suite.StereoRig(32, 32, *numbers), (30.0, 30.0, 16.0, 16.0, 0.2)),
        (lambda pose: suite.StereoRig(32, 32, 30.0, 30.0, 16.0, 16.0, 0.2, pose), (suite.Transform.identity(),)),
    ]
    for make, values in makers:
        make(*values)
        for place in range(len(values)):
            if wrong is not None or len(values) > 1:  # None is a valid pose of the rig
                with pytest.raises(GeometryError):
                    make(*values[:place], wrong, *values[place + 1 :])


@pytest.mark.parametrize("count", [1, 7])
def test_a_trajectory_has_one_call_for_each_pose(estimate: suite.Trajectory, count: int) -> None:
    records = (estimate.records * 2)[:count]
    with pytest.raises(GeometryError, match="for 6 poses: a tuple with one call for each pose"):
        replace(estimate, records=records)
    assert len(estimate[:count].records) == len(estimate[:count])


def test_calls_methods_start_poses_and_indices_of_wrong_types_are_refused(
    estimate: suite.Trajectory, cloud: suite.PointCloud
) -> None:
    calls: list[tuple[Callable[[], object], str]] = [
        (lambda: replace(estimate, records=tuple(range(6))), "a tuple of CallRecord is required"),  # type: ignore[arg-type]
        (lambda: replace(estimate, method="x"), "method is 'x'"),  # type: ignore[arg-type]
        (lambda: replace(cloud, method="x"), "method is 'x'"),  # type: ignore[arg-type]
        (lambda: suite.StartPose(None), "T_ds_rb has the type NoneType"),  # type: ignore[arg-type]
        (lambda: estimate[True], "the index is True"),
    ]
    for call, words in calls:
        with pytest.raises(GeometryError, match=words):
            call()


def test_the_calls_of_a_map_are_saved_as_by_the_command(folder: Path, tmp_path: Path) -> None:
    cloud = suite.map(folder)
    cloud.save(tmp_path / "cloud.npz")
    cloud.to_stats(tmp_path / "stats.csv")
    scores = [suite.score(cloud, folder), suite.score(tmp_path / "cloud.npz", folder, stats=[tmp_path / "stats.csv"])]
    assert scores[0].number("mapping_call", "mean") is not None
    assert scores[0].number("mapping_call", "mean") == scores[1].number("mapping_call", "mean")


def test_the_defaults_of_a_score_are_those_of_the_configuration() -> None:
    parameters = inspect.signature(suite.score).parameters
    of_request = inspect.signature(ScoreRequest.of).parameters
    shared = parameters.keys() & of_request.keys() - {"conditions", "limits"}
    assert {name: parameters[name].default for name in shared} == {name: of_request[name].default for name in shared}
    assert ScoreRequest.of() == ScoreRequest()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"condition": "frames=5"}, "no condition 'frames=5' in this score: give one of frames=2, frames=3"),
        ({"condition": None}, "no condition 'None'"),
        ({"condition": 3}, "condition has the type int"),
        ({"subject": "trajctory"}, "no subject 'trajctory' in this score: give one of trajectory"),
        ({"part": "posee"}, "no part 'posee' in this score: give one of pose, "),
        ({"statistic": "value"}, "no statistic 'value': give one of mean, sigma, "),
        ({"figure": "missing", "part": None, "statistic": "mean"}, "no statistic 'mean': omit the statistic"),
    ],
)
def test_a_look_up_of_a_number_that_a_score_does_not_have_lists_those_it_has(
    folder: Path, arguments: dict[str, Any], words: str
) -> None:
    scored = suite.score(suite.open(folder).truth, folder, ["frames=2", "frames=3"], spacing=1)
    given = {"figure": "position", "statistic": "mean"} | arguments
    with pytest.raises(ConfigError, match=words):
        scored.number(**given)
    if "statistic" not in arguments:
        del given["statistic"]
        with pytest.raises(ConfigError, match=words):
            scored.figure(**given)


def test_a_figure_that_a_score_lacks_has_no_number(folder: Path) -> None:
    scored = suite.score(suite.open(folder).truth, folder, ["frames=2"], spacing=1)
    assert scored.number("position", "mean", condition="frames = 2") == 0.0
    assert scored.number("points") is None
    assert scored.figure("points", part="pair 0") is None


def test_statistics_beside_an_estimate_are_read_with_a_truth_in_memory(
    folder: Path, estimate: suite.Trajectory, tmp_path: Path
) -> None:
    estimate.save(tmp_path / "estimate.csv")
    estimate.to_stats(tmp_path / "estimate.stats.csv")
    truth = suite.open(folder).truth
    scores = [suite.score(tmp_path / "estimate.csv", known, "frames=2") for known in (folder, truth)]
    assert scores[0].number("localisation", "n") == scores[1].number("localisation", "n") == len(estimate)


def test_the_columns_of_a_table_can_be_named_and_skipped_rows_are_reported(tmp_path: Path) -> None:
    rows = [f"{number};{0.1 * number};2;3;9" for number in range(20)]
    (tmp_path / "t.csv").write_text("\n".join(["a;b;c;d;e", *rows, "20;much;2;3;9"]))
    with pytest.raises(InputError, match=r'name the columns: columns="'):
        suite.Trajectory.load(tmp_path / "t.csv")
    with pytest.warns(UserWarning, match="1 invalid line skipped"):
        found = suite.Trajectory.load(tmp_path / "t.csv", "t=a[s],x=b,y=c,z=d")
    assert len(found) == 20
    (tmp_path / "named.csv").write_text("\n".join(["t [s];x;y;z;speed", *rows]))
    with pytest.warns(UserWarning, match="columns not read: speed"):
        suite.score(replace(found, quats_xyzw=np.tile([0.0, 0, 0, 1], (20, 1))), tmp_path / "named.csv", ["frames=2"])


def test_a_trajectory_is_a_sequence(estimate: suite.Trajectory) -> None:
    stamp_ns, pose = estimate[-1]
    assert stamp_ns == estimate.stamps_ns[-1]
    np.testing.assert_array_equal(pose.translation, estimate.positions[-1])
    half = estimate[1::2]
    assert isinstance(half, suite.Trajectory)
    assert [stamp for stamp, _ in half] == estimate.stamps_ns[1::2].tolist()
    assert [record.stamp_ns for record in half.records] == half.stamps_ns.tolist()
    assert len(estimate[estimate.stamps_ns > stamp_ns]) == 0
    assert all(record.step is not None for record in estimate[:3].records[1:])
    assert [record.step is None for record in estimate[2:5].records] == [True, False, False]
    assert all(record.step is None for record in estimate[:0:-1].records)
    with pytest.raises(IndexError):
        estimate[len(estimate)]


def test_scores_are_tables_of_pandas(estimate: suite.Trajectory, cloud: suite.PointCloud, folder: Path) -> None:
    pytest.importorskip("pandas", reason="pandas is not installed")
    scored = suite.score(estimate, folder, ["frames=2", "frames=3"], spacing=1)
    table = scored.to_pandas()
    heading = scored.figure("heading", condition="frames=3")
    over = table[(table.condition == "frames=3") & (table.part == "pose")].set_index("figure")
    assert over.loc["heading", "mean_plus_3sigma"] == heading.mean_plus_3sigma
    assert over.loc["position", "n"] == heading.n
    times = table[(table.subject == "timing") & table.part.isna()].set_index("figure")
    assert times.loc["localisation", "mean"] == scored.number("localisation", "mean")
    rows = scored.to_pandas("sub_trajectories")
    assert len(rows) == sum(scored.figure("heading", condition=each).n for each in ("frames=2", "frames=3"))
    moments = rows[rows.condition == "frames=3"]["heading_deg"]
    assert moments.std() == pytest.approx(heading.sigma, rel=1e-6)
    of_map = suite.score(cloud, folder)
    assert of_map.to_pandas().set_index("figure").loc["points", "value"] == of_map.number("points") > 0
    assert len(of_map.to_pandas("sub_trajectories")) == 0
    with pytest.raises(ConfigError, match="figures or sub_trajectories is required"):
        scored.to_pandas("all")


def test_a_source_gives_its_pairs(folder: Path) -> None:
    source = suite.open(folder)
    assert [pair.stamp_ns for pair in source.pairs()] == list(source.loc.stamps_ns) == [p.stamp_ns for p in source]
    assert len(source) == 6
    maps = replace(source, loc=None)
    assert [item.T_lm_navsb is not None for item in maps.pairs()] == [True, True]
    assert list(replace(maps, nav=None)) == []


def test_parameters_are_those_of_the_file_that_configures_the_source(folder: Path, tmp_path: Path) -> None:
    """They are those of the file beside the source, or of the given file, which also configures how it is read."""
    data = tmp_path / "data"
    shutil.copytree(folder, data)
    expected = suite.localise(data, config={"max_features": 150})
    default = suite.localise(data)
    assert not np.array_equal(default.positions, expected.positions)
    text = "localisation: {max_features: 150}\nmapping: {refine_poses: true}\n"
    (data / "sfr.yaml").write_text(text)
    for source in (data, suite.open(data)):
        np.testing.assert_array_equal(suite.localise(source).positions, expected.positions)
    np.testing.assert_array_equal(suite.localise(data, config={}).positions, default.positions)

    truth = suite.open(folder).truth
    replace(truth, positions=truth.positions + 3.0).save(tmp_path / "other.csv")
    (tmp_path / "my.yaml").write_text(f"{text}truth: {{source: other.csv}}\n")
    moved = suite.localise(folder, "truth", config=tmp_path / "my.yaml")
    np.testing.assert_allclose(moved.positions[0], truth.positions[0] + 3.0)


@pytest.mark.parametrize("configured", [False, True])
@pytest.mark.parametrize("given", [None, False, True])
def test_refine_poses_has_priority_over_the_parameters(
    folder: Path, tmp_path: Path, sfr: Sfr, monkeypatch: pytest.MonkeyPatch, given: bool | None, configured: bool
) -> None:
    used: list[MappingConfig] = []

    def keep(panorama: Any, how: MappingConfig, *_: object, **__: object) -> Any:
        used.append(how)
        raise InputError("kept")

    monkeypatch.setattr(api, "run_mapper", keep)
    monkeypatch.setattr("sfr_loc_map.runs.mapper_run.run_mapper", keep)
    with pytest.raises(InputError, match="kept"):
        suite.map(folder, refine_poses=given, config={"refine_poses": configured})
    config = tmp_path / "my.yaml"
    config.write_text(f"mapping: {{refine_poses: {str(configured).lower()}}}\n")
    option = {None: (), False: ("--no-refine-poses",), True: ("--refine-poses",)}[given]
    assert "kept" in sfr("map", folder, "-o", tmp_path / "cloud.ply", "--config", config, *option).err
    assert [how.refine_poses for how in used] == 2 * [configured if given is None else given]


def test_conditions_and_limits_are_those_of_the_configuration_of_the_source_as_for_the_command(
    folder: Path, estimate: suite.Trajectory, tmp_path: Path, sfr: Sfr
) -> None:
    data = tmp_path / "data"
    shutil.copytree(folder, data)
    estimate.save(tmp_path / "estimate.csv")
    missed = {"trajectory": [{"condition": "frames=2", "position_mean_plus_3sigma_m": 1e-9}], "minimum_independent": 1}
    (data / "lim.yaml").write_text(json.dumps(missed))
    (data / "sfr.yaml").write_text("conditions: [frames=3]\nlimits: lim.yaml\n")
    done = sfr("score", tmp_path / "estimate.csv", data, "--spacing", 1, "--json", "-")
    assert done.code == 1
    for truth in (data, suite.open(data)):
        scored = suite.score(tmp_path / "estimate.csv", truth, spacing=1)
        assert figures(scored.to_json()) == figures(done.out)
        assert scored.verdict == "fail"
    given = suite.score(estimate, data, ["frames=4"], LIMITS, spacing=1)
    assert given.verdict == "pass"
    assert given.figure("position", condition="frames=4") is not None
    with pytest.raises(ConfigError, match="has no condition"):
        given.figure("position", condition="frames=3")


def test_a_condition_that_the_drive_never_meets_is_reported(folder: Path, estimate: suite.Trajectory) -> None:
    with pytest.warns(UserWarning, match="condition distance=5000: the drive is"):
        suite.score(estimate, folder, "distance=5000")


def test_a_drive_is_scored_with_the_configuration_with_which_its_source_was_opened(
    folder: Path, estimate: suite.Trajectory, tmp_path: Path
) -> None:
    truth = suite.open(folder).truth
    other = replace(truth, positions=truth.positions * 2.0)
    other.save(tmp_path / "other.csv")
    estimate.save(tmp_path / "estimate.csv")
    (tmp_path / "my.yaml").write_text("truth:\n  source: other.csv\n")
    opened = suite.open(folder, config=tmp_path / "my.yaml")
    expected = suite.score(estimate, other, ["frames=2"], spacing=1).number("position", "mean_plus_3sigma")
    for given in (estimate, tmp_path / "estimate.csv"):
        scored = suite.score(given, opened, ["frames=2"], spacing=1)
        assert scored.number("position", "mean_plus_3sigma") == pytest.approx(expected)


def test_a_bag_is_scored_with_the_topics_with_which_it_was_opened(tmp_path: Path) -> None:
    bag = renamed_bag(tmp_path / "other.mcap", "/ground_truth/odometry", "/mocap/pose")
    source = suite.open(bag, remap={"/mocap/pose": "ground_truth/odometry"})
    assert source.truth is not None
    score = suite.score(source.truth, source, ["frames=1"], spacing=1)
    assert score.number("position", "mean_plus_3sigma") == 0.0


@pytest.mark.parametrize(
    ("remap", "words"), [({"/a": 3}, "name 3"), ({"/a": "x", "/b": "/x"}, "two topics"), (5, "int")]
)
def test_a_remapping_that_maps_no_names_is_refused(tmp_path: Path, remap: Any, words: str) -> None:
    with pytest.raises(ConfigError, match=f"^remap .*{words}"):
        suite.open(tmp_path / "drive.mcap", remap)


def test_poses_without_stamps_are_not_given_any(estimate: suite.Trajectory, tmp_path: Path) -> None:
    estimate.save(tmp_path / "poses.kitti")
    assert np.array_equal(suite.Trajectory.load(tmp_path / "poses.kitti").stamps_ns, estimate.stamps_ns)
    (tmp_path / "poses.times.txt").unlink()
    with pytest.raises(InputError, match="has no stamps"):
        suite.Trajectory.load(tmp_path / "poses.kitti")


def test_an_organised_cloud_is_scored_like_its_file(folder: Path, tmp_path: Path) -> None:
    """The order of its points gives pixels, but those of smaller images than the images of the pair."""
    truth = next(suite.open(folder).nav.pairs()).truth[::2, ::2]
    height, width = truth.shape[:2]
    lines = [" ".join(map(str, point)) for point in truth.reshape(-1, 3).tolist()]
    head = f"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {width}\nHEIGHT {height}\n"
    file = tmp_path / "cloud.pcd"
    file.write_text(f"VERSION 0.7\n{head}POINTS {width * height}\nDATA ascii\n" + "\n".join(lines) + "\n")
    scores = [suite.score(cloud, folder) for cloud in (file, suite.PointCloud.load(file))]
    assert scores[0].figures == scores[1].figures


def test_a_truth_in_memory_is_checked_like_its_file(tmp_path: Path) -> None:
    """The truth turns on a plane: a tracker without height, roll and pitch has written it."""
    heading = 0.02 * np.arange(200)
    positions = np.column_stack((10.0 * np.sin(heading), 10.0 * (1.0 - np.cos(heading)), np.zeros(200)))
    quats = np.column_stack((np.zeros((200, 2)), np.sin(0.5 * heading), np.cos(0.5 * heading)))
    truth = suite.Trajectory(10**8 * np.arange(200), positions, quats)
    estimate = replace(truth, positions=1.01 * positions)
    truth.save(tmp_path / "truth.csv")
    scores = [suite.score(estimate, known) for known in (truth, tmp_path / "truth.csv")]
    assert scores[0].truth == scores[1].truth
    assert not scores[0].truth.height
