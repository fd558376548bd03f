"""`sfr score --convention`: estimates of another convention are declared or diagnosed, then converted and scored."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.cli_result import Sfr
from helpers.made_scene import LOC_RIG, write_folder
from helpers.score_rows import number
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.conventions.pose_convention import PoseConvention
from sfr_loc_map.metrics.frames.association import Estimates
from sfr_loc_map.scoring import conversion
from sfr_loc_map.scoring.inputs import Correction, DriveToScore

WORLD = Transform(Rotation.from_euler("xyz", [0.4, -1.0, 2.0]).as_matrix(), np.array([4.0, -5.0, 6.0]))
FIGURES = ("position", "attitude", "heading")


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_folder(tmp_path_factory.mktemp("conventions") / "source", 14, 0)


@pytest.fixture(scope="module")
def estimate(source: Path) -> Trajectory:
    """The truth with some drift."""
    loc = open_source(source).loc
    assert loc is not None
    truth = loc.ground_truth
    assert truth is not None
    drift = np.cumsum(np.random.default_rng(1).normal(0, 1e-3, (len(truth), 3)), axis=0)
    turn = Rotation.from_rotvec(0.2 * drift) * Rotation.from_quat(truth.quats_xyzw)
    return Trajectory(truth.stamps_ns, truth.positions + drift, turn.as_quat())


def figures(path: Path) -> list[float]:
    score = json.loads(path.read_text())
    return [number(score, name, key) for name in FIGURES for key in ("mean", "sigma", "mean_plus_3sigma")]


def test_poses_of_the_optical_frame_in_another_world_are_scored_as_those_of_rb(
    sfr: Sfr, tmp_path: Path, source: Path, estimate: Trajectory
) -> None:
    loc = open_source(source).loc
    assert loc is not None
    poses = [WORLD @ estimate.pose(k) @ loc.rig.T_rb_left for k in range(len(estimate))]
    save_trajectory(tmp_path / "rb.csv", estimate)
    save_trajectory(
        tmp_path / "camera.tum", Trajectory.from_poses(zip(estimate.stamps_ns.tolist(), poses, strict=True))
    )
    options = ["--condition", "frames=4", "--spacing", "1"]
    assert sfr("score", tmp_path / "rb.csv", source, *options, "--json", tmp_path / "rb.json").code == 0
    declared = ["--convention", "frame=left_optical", "--convention", "world=first_pose"]
    result = sfr("score", tmp_path / "camera.tum", source, *options, *declared, "--json", tmp_path / "camera.json")
    assert result.code == 0, result.err
    assert "declared: frame=left_optical, world=first_pose" in result.out
    np.testing.assert_allclose(figures(tmp_path / "camera.json"), figures(tmp_path / "rb.json"), rtol=0, atol=1e-9)
    score = json.loads((tmp_path / "camera.json").read_text())
    assert score["convention"]["declared"] == ["frame=left_optical", "world=first_pose"]
    assert "diagnosed" not in score["convention"]


def test_a_diagnosis_reads_columns_as_a_score_does(
    sfr: Sfr, tmp_path: Path, source: Path, estimate: Trajectory
) -> None:
    rows = np.column_stack((1e3 * estimate.positions, estimate.quats_xyzw)).tolist()
    lines = [",".join(map(repr, (*row, stamp))) for row, stamp in zip(rows, estimate.stamps_ns.tolist(), strict=True)]
    (tmp_path / "theirs.txt").write_text("\n".join(("a,b,c,d,e,f,g,h", *lines)))
    words = ["score", tmp_path / "theirs.txt", source, "--diagnose"]
    assert sfr(*words).code == 2
    found = sfr(*words, "--columns", "x=a,y=b,z=c,qx=d,qy=e,qz=f,qw=g,t=h[ns]")
    assert found.code == 1, found.err
    assert "--convention metres_per_unit=0.001 corrects it" in found.out


def test_a_diagnosis_associates_as_a_score_does_and_refuses_what_it_does_not_make(
    sfr: Sfr, tmp_path: Path, source: Path, estimate: Trajectory
) -> None:
    late = Trajectory(estimate.stamps_ns + 40_000_000, 1e3 * estimate.positions, estimate.quats_xyzw)
    save_trajectory(tmp_path / "late.csv", late)
    words = ["score", tmp_path / "late.csv", source, "--diagnose"]
    disagreements = []
    for how in ("match", "interpolate"):
        sfr(*words, "--associate", how, "--json", tmp_path / f"{how}.json")
        disagreements.append(json.loads((tmp_path / f"{how}.json").read_text())["disagreement"])
    assert disagreements[0] is None, "no stamp is that of a true pose"
    assert disagreements[1] > 1.0
    refused = sfr(*words, "--html", tmp_path / "page.html")
    assert (refused.code, (tmp_path / "page.html").exists()) == (2, False)
    assert "'--html' has no effect with --diagnose" in refused.err
    others = {"--apply-diagnosis": [], "--align": ["se3"], "--target": ["board"], "--target-run": ["first"]}
    others["--target-timing"] = [tmp_path / "late.csv"]
    for option, values in others.items():
        refused = sfr(*words, option, *values)
        assert refused.code == 2
        assert f"'{option}' has no effect with --diagnose" in refused.err


def test_the_proposed_diagnosis_compares_the_poses_of_the_score(
    sfr: Sfr, tmp_path: Path, source: Path, estimate: Trajectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("SFR_HINTS")
    wrong = Trajectory(estimate.stamps_ns, 1e3 * estimate.positions, estimate.quats_xyzw)
    save_trajectory(tmp_path / "mm.csv", wrong)
    words = ("score", tmp_path / "mm.csv", source, "--frames", "images", "--max-gap", "2.5")
    scored = sfr(*words, "--condition", "frames=4", "--spacing", "1")
    assert f"next: sfr {' '.join(map(str, words))} --diagnose" in scored.err


def test_a_diagnosis_is_applied_only_where_asked_for_and_the_score_says_so(
    sfr: Sfr, tmp_path: Path, source: Path, estimate: Trajectory
) -> None:
    wrong = Trajectory(estimate.stamps_ns, 1e3 * estimate.positions, estimate.quats_xyzw)
    save_trajectory(tmp_path / "mm.csv", wrong)
    save_trajectory(tmp_path / "m.csv", estimate)
    options = ["--condition", "frames=4", "--spacing", "1", "--json"]
    assert sfr("score", tmp_path / "m.csv", source, *options, tmp_path / "m.json").code == 0
    refused = sfr("score", tmp_path / "mm.csv", source, *options, tmp_path / "refused.json")
    assert refused.code == 3
    assert "--convention metres_per_unit=0.001 or --apply-diagnosis corrects it" in refused.err
    assert "convention" not in json.loads((tmp_path / "refused.json").read_text())
    found = sfr("score", tmp_path / "mm.csv", source, "--diagnose")
    assert "--convention metres_per_unit=0.001 corrects it" in found.out
    applied = sfr("score", tmp_path / "mm.csv", source, *options, tmp_path / "applied.json", "--apply-diagnosis")
    assert applied.code == 0, applied.err
    assert "converted the estimate by metres_per_unit=0.001 before scoring it" in applied.err
    assert "by the diagnosis: metres_per_unit=0.001" in applied.out
    np.testing.assert_allclose(figures(tmp_path / "applied.json"), figures(tmp_path / "m.json"), rtol=0, atol=1e-9)
    score = json.loads((tmp_path / "applied.json").read_text())
    assert score["convention"]["diagnosed"] == "metres_per_unit=0.001"
    assert score["warnings"]
    # what agrees is left alone
    assert sfr("score", tmp_path / "m.csv", source, *options, tmp_path / "n.json", "--apply-diagnosis").code == 0
    assert "convention" not in json.loads((tmp_path / "n.json").read_text())
    assert figures(tmp_path / "n.json") == figures(tmp_path / "m.json")


def test_a_diagnosis_after_a_fitted_factor_leaves_the_conversion_fitted(
    monkeypatch: pytest.MonkeyPatch, estimate: Trajectory
) -> None:
    found = SimpleNamespace(setting="metres_per_unit=0.001", fitted=False, sentence="in millimetres")
    monkeypatch.setattr(conversion, "diagnose", lambda *_: SimpleNamespace(found=found))
    correction = Correction(PoseConvention.parse(["metres_per_unit=1.07"]), apply_diagnosis=True)
    _, done = conversion.corrected(DriveToScore(Estimates.of(estimate), estimate, LOC_RIG), correction, ScoreConfig())
    assert done is not None
    assert (done.diagnosed, done.fitted) == (found.setting, True)
