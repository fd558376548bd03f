"""The suite from Python: the same figures as the commands, from files or from what is in memory."""

from __future__ import annotations

import inspect
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_result import Sfr

import sfr_loc_map as sfr
from sfr_loc_map.errors import ConfigError, InputError

LIMITS = {"trajectory": [{"condition": "frames=2", "position_mean_plus_3sigma_m": 0.5}]}
SIGNATURES = {
    "open": ["source", "remap"],
    "localise": ["source", "start", "live", "config", "method"],
    "map": ["source", "fuse", "refine_poses", "config", "method"],
    "score": ["estimate", "truth", "conditions", "limits", "align", "stats", "settings"],
}


def figures(text: str) -> dict[str, Any]:
    """Return a score without what it was made of."""
    content: dict[str, Any] = json.loads(text)
    del content["provenance"]
    return content


def test_the_public_names_stay() -> None:
    names = {"Localiser", "Mapper", "PointCloud", "Score", "Source", "Trajectory", *SIGNATURES}
    assert set(sfr.__all__) == names
    found = {name: list(inspect.signature(getattr(sfr, name)).parameters) for name in SIGNATURES}
    assert found == SIGNATURES
    assert not [name for name in names if not getattr(sfr, name).__doc__]


def test_a_drive_scored_in_memory_has_the_figures_of_the_command(
    folder: Path, estimate: sfr.Trajectory, tmp_path: Path, sfr: Sfr
) -> None:
    import sfr_loc_map

    files = [tmp_path / name for name in ("estimate.csv", "stats.csv", "limits.yaml")]
    estimate.to_csv(files[0])
    estimate.to_stats(files[1])
    files[2].write_text(json.dumps(LIMITS))
    conditions = ["frames=2", "distance=0.04"]
    options = [word for text in conditions for word in ("--condition", text)]
    done = sfr(
        "score", files[0], folder, "--stats", files[1], "--limits", files[2], *options, "--spacing", 1, "--json", "-"
    )
    assert done.code == 0, done.err
    source = sfr_loc_map.open(folder)
    scored = sfr_loc_map.score(estimate, source, conditions, LIMITS, spacing=1)
    assert figures(scored.to_json()) == figures(done.out)
    assert scored.verdict == "pass"
    of_files = sfr_loc_map.score(files[0], str(folder), conditions, files[2], stats=[files[1]], spacing=1)
    assert figures(of_files.to_json()) == figures(done.out)
    truths = [json.loads(item.to_json())["provenance"]["inputs"]["truth"] for item in (scored, of_files)]
    assert truths[0] == truths[1]


def test_a_map_scored_in_memory_has_the_figures_of_the_command(
    folder: Path, cloud: sfr.PointCloud, tmp_path: Path, sfr: Sfr
) -> None:
    import sfr_loc_map

    cloud.save(tmp_path / "cloud.npz")
    done = sfr("score", tmp_path / "cloud.npz", folder, "--json", "-")
    assert done.code == 0, done.err
    content = figures(sfr_loc_map.score(cloud, folder).to_json())
    assert content["map"] == figures(done.out)["map"]
    assert content["timing"]["fusion_s"]["count"] == 1
    again = sfr_loc_map.PointCloud.load(tmp_path / "cloud.npz")
    assert np.array_equal(again.xyz, cloud.xyz)


def test_two_trajectories_are_scored(estimate: sfr.Trajectory, folder: Path) -> None:
    truth = sfr.open(folder).truth
    assert truth is not None
    scored = sfr.score(estimate, truth, ["frames=2"], spacing=1)
    assert scored.verdict == "no verdict"
    assert scored.trajectory is not None
    assert scored.trajectory.matched == 6
    moved = sfr.score(replace(truth, positions=truth.positions + 1.0), truth, ["frames=2"], spacing=1).trajectory
    assert moved is not None
    assert moved.first.position_m.mean_plus_3sigma == pytest.approx(0.0, abs=1e-12)


def test_poses_come_as_they_are_estimated(estimate: sfr.Trajectory, folder: Path) -> None:
    live = sfr.localise(folder, "truth", live=True)
    first = next(live)
    assert first.stamp_ns == estimate.stamps_ns[0]
    rest = list(live)
    assert np.array_equal(sfr.Trajectory.from_estimates([first, *rest]).positions, estimate.positions)
    source = sfr.open(folder)
    assert source.loc is not None
    by_hand = sfr.Localiser(source.loc.rig, start=estimate.pose(0))
    assert [by_hand.process(pair).state for pair in source.loc.pairs()] == [item.state for item in (first, *rest)]


def test_a_score_is_shown_and_written(estimate: sfr.Trajectory, folder: Path, tmp_path: Path) -> None:
    scored = sfr.score(estimate, folder, ["frames=2"], LIMITS)
    figure = scored.plot()
    assert [trace.name for trace in figure.data][:2] == ["truth", "estimate"]
    assert figure.data[0].line.color.startswith("#")
    assert "top-view" in scored.plots
    scored.report(tmp_path / "r.html")
    assert "top-view" in (tmp_path / "r.html").read_text()
    scored.save(tmp_path / "s.json")
    assert sfr.Score.load(tmp_path / "s.json").to_json() == scored.to_json()
    with pytest.raises(ConfigError, match="no figure 'nothing': it has top-view"):
        scored.plot("nothing")


def test_objects_are_shown_in_one_line_and_as_html(
    estimate: sfr.Trajectory, cloud: sfr.PointCloud, folder: Path
) -> None:
    source = sfr.open(folder)
    scored = sfr.score(estimate, source, ["frames=2"], LIMITS, spacing=1)
    for thing in (source, estimate, cloud, scored):
        assert repr(thing).startswith(f"{type(thing).__name__}(")
        assert len(repr(thing).splitlines()) == 1
        assert "<table" in thing._repr_html_()
    assert "6 localisation pairs, with truth, 2 mapping pairs" in repr(source)
    assert repr(scored).startswith("Score(pass, position ")
    assert f"{len(cloud)} points" in repr(cloud)


def test_tables_of_pandas(estimate: sfr.Trajectory, cloud: sfr.PointCloud) -> None:
    pytest.importorskip("pandas", reason="pandas is not installed")
    frame = estimate.to_pandas()
    assert list(frame.columns) == ["x", "y", "z", "qx", "qy", "qz", "qw", "state", "reason"]
    assert frame.index.tolist() == estimate.stamps_ns.tolist()
    assert frame["state"].iloc[0] == "initialising"
    assert len(cloud.to_pandas()) == len(cloud)


def test_wrong_calls_say_what_to_do(folder: Path, cloud: sfr.PointCloud, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no"):
        sfr.open(tmp_path / "nothing")
    with pytest.raises(ConfigError, match="must be identity, truth or a pose"):
        sfr.localise(folder, "somewhere")
    with pytest.raises(ConfigError, match="unknown key 'max_featurs'"):
        sfr.localise(folder, config={"max_featurs": 3})
    with pytest.raises(ConfigError, match="no setting 'spacin'"):
        sfr.score(folder, folder, spacin=3)  # type: ignore[call-arg]
    with pytest.raises(ConfigError, match="leave them out for a cloud"):
        sfr.score(cloud, folder, apply_diagnosis=True)


def test_poses_without_stamps_get_those_of_poses_in_memory(estimate: sfr.Trajectory, tmp_path: Path) -> None:
    estimate.to_kitti(tmp_path / "poses.kitti")
    (tmp_path / "poses.times.txt").unlink()
    for pair in ((tmp_path / "poses.kitti", estimate), (estimate, tmp_path / "poses.kitti")):
        score = sfr.score(*pair, "frames=2")  # one condition may be a text
        assert score.trajectory is not None
        assert score.trajectory.matched == len(estimate)
