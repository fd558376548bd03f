"""The file of a suite: the effect of each key, and one-line errors."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from helpers import ROOT
from helpers.made_suites import JOB
from sfr_loc_map.errors import SfrError
from sfr_loc_map.suite.jobs.configurations import Configuration
from sfr_loc_map.suite.jobs.job import JobTask
from sfr_loc_map.suite.jobs.job_run import replay_options
from sfr_loc_map.suite.planning.specification import load_specification

GOOD = {
    "sources": ["a.mcap", {"simulate": "s.yaml", "seeds": [1, 2]}, {"estimate": "e.csv", "truth": "t.csv"}],
    "perturb": ["black:share=0.1", "blurred+noisy"],
    "configurations": {
        "default": {},
        "few": {"localisation": {"max_features": 400}},
        "mine": {"localisation": {"method": "mine.py:Mine", "method_config": "mine.txt"}},
    },
    "tasks": ["localise"],
    "conditions": ["distance=5", "time=60"],
    "limits": {"trajectory": [{"condition": "frames=10", "position_mean_m": 0.1}]},
    "memory_mb": 500,
}


OMITTED = "omitted"  #: Value of a key that a file lacks.


def written(folder: Path, content: Mapping[str, object]) -> Path:
    (folder / "a.mcap").touch()
    texts = {"s.yaml": "drive: {pairs: 7}", "mine.py": "class Mine: pass", "mine.txt": "fast", "empty.yaml": ""}
    for name, text in texts.items():
        (folder / name).write_text(text)
    path = folder / "suite.yaml"
    given = {name: value for name, value in content.items() if value != OMITTED}
    path.write_text(yaml.safe_dump(given))
    return path


def test_every_key_means_something(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SFR_METHOD_FILES", raising=False)
    made = load_specification(written(tmp_path, GOOD))
    assert [source.name for source in made.sources] == ["a.mcap", "s-1", "s-2", "e.csv"]
    assert all(Path(source.location).is_absolute() for source in made.sources)
    assert made.faults == ("", "black:share=0.1", "blurred+noisy")
    mine = {"localisation.method": f"{tmp_path}/mine.py:Mine", "localisation.method_config": "fast"}
    code = {"localisation.method": hashlib.sha256(b"class Mine: pass").hexdigest()}
    assert made.configurations == {
        "default": Configuration(),
        "few": Configuration({"localisation.max_features": 400}),
        "mine": Configuration(mine, code),
    }
    assert made.tasks == (JobTask.LOCALISE,)
    assert made.scoring.conditions == ("distance=5", "time=60", "frames=10")
    assert (made.settings.memory_mb, made.settings.repeats) == (500, 1)


def test_an_estimate_with_two_ground_truths_has_two_names(tmp_path: Path) -> None:
    for name in ("t1.csv", "t2.csv", "e.csv"):
        (tmp_path / name).touch()
    entries = [{"estimate": "e.csv", "truth": truth} for truth in ("t1.csv", "t2.csv")]
    made = load_specification(written(tmp_path, {"sources": entries, "conditions": ["distance=5"]}))
    assert len({source.name for source in made.sources}) == 2
    assert [source.name.endswith(f"{Path(source.truth).name})") for source in made.sources] == [True, True]


@pytest.mark.parametrize("entry", ["drive[1].mcap", "drive[[]1].mcap", "drive*.mcap"])
def test_brackets_in_a_path_are_no_pattern(tmp_path: Path, entry: str) -> None:
    folder = tmp_path / "[ab] of today"
    folder.mkdir()
    (folder / "drive[1].mcap").touch()
    made = load_specification(written(folder, GOOD | {"sources": [entry]}))
    assert [source.location for source in made.sources] == [str(folder / "drive[1].mcap")]


def test_a_source_that_is_named_twice_keeps_its_name(tmp_path: Path) -> None:
    made = load_specification(written(tmp_path, GOOD | {"sources": ["a.mcap", "a.mcap"]}))
    assert [source.name for source in made.sources] == ["a.mcap", "a.mcap"]


def test_a_mask_is_found_beside_the_suite_and_known_by_its_content(tmp_path: Path) -> None:
    masked = GOOD | {"configurations": {"masked": {"localisation": {"left_mask": "mask.png"}}}}
    with pytest.raises(SfrError, match=r"left_mask is '.*mask.png', which is not a file"):
        load_specification(written(tmp_path, masked))
    found = []
    for content in (b"mask", b"another mask"):
        (tmp_path / "mask.png").write_bytes(content)
        found.append(load_specification(written(tmp_path, masked)).configurations["masked"])
    mask = str(tmp_path.resolve() / "mask.png")
    assert [item.parameters for item in found] == [{"localisation.left_mask": mask}] * 2
    jobs = [replace(JOB, parameters=item.parameters, input_files=item.input_files) for item in found]
    assert jobs[0].key != jobs[1].key
    replay_options(jobs[0], tmp_path)
    given = yaml.safe_load((tmp_path / "config.yaml").read_text())
    assert given["localisation"] == {"left_mask": mask}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"sources": []}, "'sources' is missing or empty"),
        ({"sources": "a"}, "a list is required"),
        ({"sources": [3]}, "a path, a URL"),
        ({"sources": ["*.bag"]}, "no match in"),
        ({"sources": [{"simulate": "s", "seeds": ["x"]}]}, "list of whole numbers"),
        ({"sources": [{"estimate": "e"}]}, "truth"),
        ({"perturb": ["rain"]}, "rain"),
        ({"configurations": {"a": {"localisation": {"wheels": 6}}}}, "wheels"),
        ({"configurations": {"a": {}, "b": {"localisation": {}}}}, "configurations 'a' and 'b' are equal"),
        ({"configurations": {"a": {"radar": {}}}}, "radar"),
        ({"configurations": {"a": {"mapping": {"method": "opencv"}}}}, "no method 'opencv'"),
        ({"configurations": {"a": {"localisation": {"method": "lib:none.so"}}}}, "No such file"),
        ({"tasks": ["fly"]}, "fly"),
        ({"conditions": []}, "'conditions' is empty"),
        ({"sources": [{"simulate": "s.yaml", "seeds": [-1]}]}, "suite.yaml: source 1: 'seeds'"),
        ({"sources": [{"simulate": "s.yaml", "set": {"drive.pairs": 2, "drive": {"pairs": 3}}}]}, "given twice"),
        ({"tasks": [["localise"]]}, "'tasks' has"),
        ({"tasks": False}, "'tasks' is False: a list is required"),
        ({"conditions": 0}, "'conditions' is 0: a list is required"),
        ({"perturb": 0}, "'perturb' is 0: a list is required"),
        ({"conditions": [None]}, "suite.yaml: 'conditions'"),
        ({"perturb": [None]}, "suite.yaml: 'perturb'"),
        ({"configurations": {1: {}, "1": {"localisation": {"max_features": 400}}}}, "'1' is given twice"),
        ({"configurations": {"a": {"localisation": {"method_sha256": "0"}}}}, "method_sha256"),
        ({"conditions": ["distance=-1"]}, "distance=-1"),
        ({"limits": {"map": {"hills": 1}}}, "hills"),
        ({"limits": {}}, "no limit is given"),
        ({"limits": None}, "'limits' is None"),
        ({"limits": "empty.yaml"}, "no limit is given"),
        ({"limit": {"map": {"coverage_min": 0.8}}}, "did you mean 'limits'"),
        ({"sources": [{"estimate": None, "truth": "t.csv"}]}, "'estimate: EST' with"),
        ({"sources": [{"simulate": None}]}, "'simulate: SCENARIO'"),
        ({"repeats": 0}, "repeats"),
        ({"stop_when_decided": True}, "'stop_when_decided' has no effect"),
        ({"sources": [{"simulate": "s.yaml", "set": {"seed": 9}}]}, "'seed' in 'set' has no effect"),
        (
            {
                "sources": [{"simulate": "s.yaml"}],
                "budget": {"blur": {"fault": "blurred"}, "noise": {"fault": "noisy"}},
                "limits": OMITTED,
                "perturb": [],
                "conditions": OMITTED,
                "repeats": 5,
            },
            "'repeats' has no effect",
        ),
        (
            {
                "sources": [{"simulate": "s.yaml"}],
                "budget": {"blur": {"fault": "blurred"}, "yaw": {"fault": "yaw:amount=1", "sigma": 0.1}},
            },
            "omit 'amount'",
        ),
        ({"timeout": 3}, "did you mean 'timeout_s'"),
    ],
)
def test_what_is_wrong_is_one_line(change: dict[str, object], words: str, tmp_path: Path) -> None:
    with pytest.raises(SfrError, match=words) as raised:
        load_specification(written(tmp_path, GOOD | change))
    assert len(str(raised.value).splitlines()) == 1


def test_a_source_that_is_gone_is_named_beside_those_that_are_there(tmp_path: Path) -> None:
    made = load_specification(written(tmp_path, GOOD | {"sources": ["a.mcap", "gone*.mcap"]}))
    assert [source.name for source in made.sources] == ["a.mcap"]
    assert [(refusal.name, "no match in" in refusal.reason) for refusal in made.refusals] == [("gone*.mcap", True)]


def test_a_missing_scenario_is_skipped_like_a_missing_path(tmp_path: Path) -> None:
    made = load_specification(written(tmp_path, GOOD | {"sources": [{"simulate": "gone.yaml"}, "a.mcap"]}))
    assert [source.name for source in made.sources] == ["a.mcap"]
    assert len(made.refusals) == 1


def test_nested_settings_of_a_scenario_replace_its_values(tmp_path: Path) -> None:
    nested = {"simulate": "s.yaml", "set": {"drive": {"pairs": 9}}}
    (source,) = load_specification(written(tmp_path, GOOD | {"sources": [nested]})).sources
    assert source.settings["drive.pairs"] == 9


@pytest.mark.parametrize("inner", ["", "poses/"])
def test_the_results_of_two_methods_in_two_folders_have_the_same_names(tmp_path: Path, inner: str) -> None:
    def names(method: str) -> list[str]:
        paths = [f"out/{method}/d{number}/{inner}est.csv" for number in range(2)]
        sources = [{"estimate": path, "truth": "t.csv"} for path in paths]
        return [source.name for source in load_specification(written(tmp_path, GOOD | {"sources": sources})).sources]

    assert names("a") == names("b") == [f"d0/{inner}est.csv", f"d1/{inner}est.csv"]


@pytest.mark.parametrize("name", ["quick", "acceptance", "robustness"])
def test_the_suites_that_come_along_can_be_read(name: str) -> None:
    folder = ROOT / "config" / "suites"
    made = load_specification(folder / f"{name}.yaml")
    assert all(Path(source.location).exists() for source in made.sources)
