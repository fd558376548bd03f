"""The rules of a method's process: which paths `rules_of` permits, and which hidden paths are excluded."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from sfr_loc_map.methods.isolation import PACKAGE, isolation_of, rules_of
from sfr_loc_map.methods.registry import Method
from sfr_loc_map.metrics.figures.records import MethodKind
from sfr_loc_map.suite_names import Task


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A readable folder: `images/a.png`, `images/truth.csv`, `truth/poses.csv` and `rig.json`."""
    folder = tmp_path / "data"
    for name in ("images/a.png", "images/truth.csv", "truth/poses.csv", "rig.json"):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("")
    monkeypatch.setenv("SFR_METHOD_FILES", str(folder))
    monkeypatch.delenv("PYTHONPATH", raising=False)
    return folder


def rules(tmp_path: Path, *hidden: Path, target: str = "") -> dict[str, list[str]]:
    kind = MethodKind.PYTHON if target else MethodKind.PEER
    return rules_of(Method("x", Task.LOCALISATION, kind, "peer.py", target), tmp_path / "scratch", hidden)


def readable(found: dict[str, list[str]], path: Path) -> bool:
    """Return whether a rule permits a path: Landlock permits all below a permitted folder."""
    return any(Path(text) in (path, *path.parents) for text in (*found["read"], *found["write"]))


def test_without_hidden_paths_the_complete_folder_is_readable(tmp_path: Path, data: Path) -> None:
    text = f"files; readable by SFR_METHOD_FILES: {data}"
    assert isolation_of("files", can_read_all_files=False)[:3] == (text, False, str(data))
    found = rules(tmp_path)
    assert str(data) in found["read"]
    assert readable(found, data / "truth" / "poses.csv")
    assert not readable(found, tmp_path / "other")


@pytest.mark.parametrize("name", ["PYTHONPATH", "LD_LIBRARY_PATH"])
def test_folders_that_a_search_path_makes_readable_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """Folders of the system and of the interpreter are readable for each method."""
    monkeypatch.delenv("SFR_METHOD_FILES", raising=False)
    monkeypatch.delenv("PYTHONPATH", raising=False)
    monkeypatch.setenv(name, f"{sys.prefix}/lib:/opt/ros/lib:{tmp_path}")
    assert readable(rules(tmp_path), tmp_path / "truth.csv")
    text = f"files; readable by {name}: {tmp_path}"
    assert isolation_of("files", can_read_all_files=False)[:3] == (text, False, str(tmp_path))


@pytest.mark.parametrize(
    ("hidden", "unreadable", "still_readable"),
    [
        ("truth", ["truth/poses.csv", "truth"], ["images/a.png", "images/truth.csv", "rig.json"]),
        ("truth/poses.csv", ["truth/poses.csv"], ["images/a.png", "rig.json"]),
        ("images/truth.csv", ["images/truth.csv"], ["images/a.png", "truth/poses.csv", "rig.json"]),
        ("", ["images/a.png", "truth/poses.csv", "rig.json"], []),
        ("..", ["images/a.png", "truth/poses.csv", "rig.json"], []),
    ],
    ids=["folder", "file", "file beside others", "the permitted folder", "a parent of the permitted folder"],
)
def test_a_hidden_path_is_excluded_and_the_other_files_stay_readable(
    tmp_path: Path, data: Path, hidden: str, unreadable: list[str], still_readable: list[str]
) -> None:
    found = rules(tmp_path, data / hidden)
    assert str(data) not in found["read"]
    assert [name for name in unreadable if readable(found, data / name)] == []
    assert [name for name in still_readable if not readable(found, data / name)] == []


def test_several_hidden_paths_and_links_are_excluded(tmp_path: Path, data: Path) -> None:
    link = tmp_path / "link.csv"
    link.symlink_to(data / "truth" / "poses.csv")
    found = rules(tmp_path, link, data / "images" / "truth.csv")
    assert not readable(found, data / "truth" / "poses.csv")
    assert not readable(found, data / "images" / "truth.csv")
    assert readable(found, data / "images" / "a.png")


def test_a_folder_with_a_hidden_path_may_be_listed_but_not_read(tmp_path: Path, data: Path) -> None:
    assert str(data) not in rules(tmp_path)["names"]
    found = rules(tmp_path, data / "truth")
    assert str(data) in found["names"]
    assert str(data) not in found["read"]


def test_a_link_in_a_permitted_folder_does_not_permit_its_hidden_target(tmp_path: Path, data: Path) -> None:
    truth = tmp_path / "elsewhere" / "truth.csv"
    truth.parent.mkdir()
    truth.write_text("")
    (data / "copy.csv").symlink_to(truth)
    assert not readable(rules(tmp_path, truth), truth)


def test_a_link_beside_a_hidden_path_does_not_permit_its_hidden_target(tmp_path: Path, data: Path) -> None:
    """The parts of a partly hidden folder get rules of their own."""
    truth = tmp_path / "elsewhere" / "truth.csv"
    truth.parent.mkdir()
    truth.write_text("")
    (data / "copy.csv").symlink_to(truth)
    found = rules(tmp_path, truth, data / "truth")
    assert not readable(found, data / "copy.csv")
    assert str(data / "copy.csv") not in found["read"]
    assert readable(found, data / "images" / "a.png")


def test_the_code_of_a_method_is_readable_unless_hidden(tmp_path: Path, data: Path) -> None:
    code = tmp_path / "code" / "candidate.py"
    code.parent.mkdir()
    for name in ("candidate.py", "helper.py", "poses.csv"):
        (code.parent / name).write_text("")
    found = rules(tmp_path, target=f"{code}:Candidate")
    assert readable(found, code)
    assert readable(found, code.parent / "helper.py")
    assert not readable(found, code.parent / "poses.csv")
    assert not readable(rules(tmp_path, code, target=f"{code}:Candidate"), code)


def test_only_the_scratch_folder_and_devices_are_writable(tmp_path: Path, data: Path) -> None:
    found = rules(tmp_path)
    assert found["write"][0] == str(tmp_path / "scratch")
    assert all(path.startswith("/dev/") for path in found["write"][1:])
    assert not {str(PACKAGE), str(data), os.sep, "/proc", str(Path.home())} & set(found["write"])
