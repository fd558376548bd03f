"""Limits that name their data set (`data_set_sha256`): every command refuses a score of other data."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from pathlib import Path

import pytest
import yaml

from helpers.cli_result import Sfr
from helpers.made_scene import write_folder
from sfr_loc_map.metrics.stored.score_json import hash_of_values

PAIRS, KEPT = 40, 25
OPEN_POINT = "name no data set"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_folder(tmp_path / "data", PAIRS, 0)


def cropped(folder: Path, copy: Path) -> Path:
    """Return a copy of a folder with the first pairs and true poses only."""
    shutil.copytree(folder, copy)
    for name in ("pairs.csv", "groundtruth.csv"):
        path = next(copy.rglob(name))
        path.write_text("\n".join(path.read_text().splitlines()[: KEPT + 1]) + "\n")
    return copy


def hashes_of(sfr: Sfr, folder: Path) -> dict[str, str]:
    """Return the hashes that `sfr info` shows, by role."""
    facts = json.loads(sfr("info", folder, "--json", "-").out)
    return {name.removesuffix("_sha256"): value for name, value in facts.items() if name.endswith("_sha256")}


def limits_of(path: Path, hashes: Sequence[object]) -> Path:
    limited = {"condition": "frames=1", "position_mean_m": 1.0}
    path.write_text(yaml.safe_dump({"trajectory": [limited], "data_set_sha256": list(hashes)}))
    return path


def estimate_of(folder: Path) -> Path:
    """Return a file of the true poses of a folder as an estimate."""
    return Path(shutil.copyfile(next(folder.rglob("groundtruth.csv")), folder.with_suffix(".csv")))


def test_info_shows_the_hashes_of_the_score(sfr: Sfr, folder: Path) -> None:
    made = json.loads(sfr("score", estimate_of(folder), folder, "--json", "-").out)
    inputs = made["provenance"]["inputs"]
    assert hashes_of(sfr, folder) == {role: inputs[role]["sha256"] for role in ("truth", "images")}


def test_a_score_of_other_data_than_the_limits_name_is_refused(sfr: Sfr, folder: Path, tmp_path: Path) -> None:
    part = cropped(folder, tmp_path / "crop")
    named, other = hashes_of(sfr, folder), hashes_of(sfr, part)
    assert not set(named.values()) & set(other.values())
    limits = limits_of(tmp_path / "limits.yaml", [each.upper() for each in named.values()])
    made, page = tmp_path / "made.json", tmp_path / "report.html"
    words = ("--limits", limits, "--json", made, "--overwrite")
    assert sfr("score", estimate_of(folder), folder, *words).code != 2
    assert sfr("report", made, "--test-report", page).code != 2
    assert OPEN_POINT not in page.read_text()
    refused = sfr("score", estimate_of(part), part, *words)
    assert refused.code == 2
    assert refused.err.strip().count("\n") == 0
    assert other["truth"] in refused.err
    assert named["truth"] in refused.err
    assert (
        sfr("score", estimate_of(part), part, "--limits", limits_of(limits, [*named.values(), *other.values()])).code
        != 2
    )
    only_truth = sfr("score", estimate_of(folder), folder, "--limits", limits_of(limits, [named["truth"]]))
    assert only_truth.code == 2, "the images are part of the data set"
    assert named["images"] in only_truth.err


@pytest.mark.parametrize("declared", [None, {"sigma_m": 0.02}, {"sigma_m": 0.05, "lever_arm_m": [0.0, 0.0, 1.0]}])
def test_other_settings_of_the_truth_are_another_data_set(
    sfr: Sfr, folder: Path, tmp_path: Path, declared: dict[str, object] | None
) -> None:
    """The agreed truth has a stated noise, within which no verdict is given. Without it, a limit could be met."""
    configuration = folder / "sfr.yaml"
    configuration.write_text(yaml.safe_dump({"truth": {"sigma_m": 0.05}}))
    named = hashes_of(sfr, folder)
    limits = limits_of(tmp_path / "limits.yaml", named.values())
    score = ("score", estimate_of(folder), folder, "--limits", limits)
    assert sfr(*score).code != 2
    configuration.unlink()
    if declared is not None:
        configuration.write_text(yaml.safe_dump({"truth": declared}))
    assert hashes_of(sfr, folder)["truth"] != named["truth"]
    refused = sfr(*score)
    assert refused.code == 2
    assert hashes_of(sfr, folder)["truth"] in refused.err
    assert sfr("replay", folder, "--limits", limits, "--out", tmp_path / "out").code == 2


def test_a_stored_score_of_other_data_is_refused(sfr: Sfr, folder: Path, tmp_path: Path) -> None:
    limits = limits_of(tmp_path / "limits.yaml", hashes_of(sfr, folder).values())
    made = tmp_path / "made.json"
    sfr("score", estimate_of(folder), folder, "--limits", limits, "--json", made)
    content = json.loads(made.read_text())
    content["provenance"]["inputs"]["images"]["sha256"] = "0" * 64
    del content["content_sha256"]
    made.write_text(json.dumps({**content, "content_sha256": hash_of_values(content)}))
    refused = sfr("report", made, "-o", tmp_path / "r.html")
    assert refused.code == 2
    assert "0" * 64 in refused.err


@pytest.mark.parametrize("has_other_truth", [False, True])
def test_a_suite_refuses_results_of_other_data(sfr: Sfr, folder: Path, tmp_path: Path, has_other_truth: bool) -> None:
    """The agreed ground truth of a second source with the same estimate does not replace that of the first source."""
    part = cropped(folder, tmp_path / "crop")
    hashes = [*hashes_of(sfr, folder).values()]
    truths = [part, folder] if has_other_truth else [part]
    sources = [{"estimate": str(estimate_of(part)), "truth": str(truth)} for truth in truths]
    limits_of(tmp_path / "limits.yaml", hashes)
    (tmp_path / "suite.yaml").write_text(yaml.safe_dump({"sources": sources, "limits": "limits.yaml"}))
    refused = sfr("suite", "run", tmp_path / "suite.yaml", "--out", tmp_path / "suite")
    assert refused.code == 2, refused.err
    assert hashes[0] in refused.err
    assert not (tmp_path / "suite/results").exists(), "the data are compared before the jobs run"


@pytest.mark.parametrize("task", ["localise", "replay"])
def test_a_suite_compares_a_source_before_it_runs(sfr: Sfr, folder: Path, tmp_path: Path, task: str) -> None:
    part = cropped(folder, tmp_path / "crop")
    limits_of(tmp_path / "limits.yaml", [*hashes_of(sfr, folder).values()])
    content = {"limits": "limits.yaml", "tasks": [task]}
    for source, code in ((folder, 0), (part, 2)):
        (tmp_path / "suite.yaml").write_text(yaml.safe_dump({"sources": [str(source)], **content}))
        planned = sfr("suite", "run", tmp_path / "suite.yaml", "--out", tmp_path / "suite", "--dry-run")
        assert planned.code == code, planned.err


def test_a_replay_compares_the_source_before_it_plays(sfr: Sfr, folder: Path, tmp_path: Path) -> None:
    """Without ROS, the data are refused, too."""
    hashes = hashes_of(sfr, folder)
    limits = limits_of(tmp_path / "limits.yaml", hashes.values())
    refused = sfr("replay", cropped(folder, tmp_path / "crop"), "--limits", limits, "--out", tmp_path / "out")
    assert refused.code == 2
    assert hashes["truth"] in refused.err
    assert not (tmp_path / "out").exists()


def test_a_suite_of_simulations_has_no_hashes_of_data(sfr: Sfr, tmp_path: Path) -> None:
    (tmp_path / "scenario.yaml").write_text("panorama: {enabled: false}\n")
    limits_of(tmp_path / "limits.yaml", ["0" * 64])
    content = {"sources": [{"simulate": "scenario.yaml"}], "limits": "limits.yaml"}
    (tmp_path / "suite.yaml").write_text(yaml.safe_dump(content))
    planned = sfr("suite", "run", tmp_path / "suite.yaml", "--out", tmp_path / "suite", "--dry-run")
    assert planned.code == 2
    assert "is simulated" in planned.err
