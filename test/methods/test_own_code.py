"""The hash of a method's own code differs if a file does that the method may import."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

import pytest

from helpers.made_scene import LOC_RIG, loc_pair, true_pose
from sfr_loc_map.errors import MethodError
from sfr_loc_map.methods.isolated_localiser import IsolatedLocaliser
from sfr_loc_map.methods.registry import find_method
from sfr_loc_map.suite_names import Task


def hash_of(place: object) -> str | None:
    return find_method(f"{place}:Mine", Task.LOCALISATION).sha256


def test_methods_that_differ_have_other_hashes(tmp_path: Path) -> None:
    code = tmp_path / "mine.py"
    found = []
    for text in ("left", "LEFT", "left"):
        code.write_text(f"class Mine: pass  # {text}")
        found.append(hash_of(code))
    assert found[0] == found[2]
    assert found[0] != found[1]


def test_a_package_of_the_working_directory_has_another_hash_after_a_change(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    package = tmp_path / "candidate_of_the_folder"
    package.mkdir()
    found = []
    for text in ("first", "other"):
        (package / "__init__.py").write_text(f"class Mine: pass  # {text}")
        found.append(hash_of("candidate_of_the_folder"))
    assert found[0] != found[1]


@pytest.mark.parametrize("beside", ["helper.py", "tools/__init__.py", "libfast.so"])
def test_a_method_has_another_hash_after_a_change_of_the_code_beside_its_file(beside: str, tmp_path: Path) -> None:
    """The method may import this code: isolation permits the modules, packages and libraries in its folder."""
    (tmp_path / "mine.py").write_text("class Mine: pass")
    (tmp_path / "notes.txt").write_text("first")
    (tmp_path / beside).parent.mkdir(exist_ok=True)
    found = []
    for text in ("first", "other"):
        (tmp_path / beside).write_text(text)
        found.append(hash_of(tmp_path / "mine.py"))
    assert found[0] != found[1]
    (tmp_path / "notes.txt").write_text("other")
    assert hash_of(tmp_path / "mine.py") == found[1]


def test_a_package_with_a_broken_link_is_accepted(tmp_path: Path) -> None:
    """Links to weights or data that are not installed on this host are common."""
    (tmp_path / "mine.py").write_text("class Mine: pass")
    (tmp_path / "tools").mkdir()
    (tmp_path / "tools" / "__init__.py").touch()
    before = hash_of(tmp_path / "mine.py")
    (tmp_path / "tools" / "weights.bin").symlink_to(tmp_path / "absent")
    assert hash_of(tmp_path / "mine.py") == before


LATE = """
class Late:
    def __init__(self, rig, config):
        self.rig = rig
    def process(self, pair):
        import algorithm
        return algorithm.pose()
"""
ALGORITHM = "import numpy as np\ndef pose():\n    return np.eye(4)\n"


def unchanged(folder: Path) -> None:
    """Write a file that is not code."""
    (folder / "notes.txt").write_text("1")


def restored(folder: Path) -> None:
    """Replace code that is imported late, and restore the former content and the time of its modification."""
    file = folder / "algorithm.py"
    state = file.stat()
    file.write_text(ALGORITHM.replace("eye(4)", "eye(4) * 2"))
    file.write_text(ALGORITHM)
    os.utime(file, ns=(state.st_atime_ns, state.st_mtime_ns))


def replaced(folder: Path) -> None:
    (folder / "other.py").write_text(ALGORITHM)
    (folder / "other.py").replace(folder / "algorithm.py")


def added(folder: Path) -> None:
    (folder / "helper.py").write_text(ALGORITHM)


@pytest.mark.parametrize("is_running", [False, True], ids=["before_start", "while_running"])
@pytest.mark.parametrize("change", [unchanged, restored, replaced, added])
def test_code_that_was_replaced_after_it_was_hashed_is_refused(
    tmp_path: Path, change: Callable[[Path], None], is_running: bool
) -> None:
    (tmp_path / "late.py").write_text(LATE)
    (tmp_path / "algorithm.py").write_text(ALGORITHM)
    method = find_method(f"{tmp_path / 'late.py'}:Late", Task.LOCALISATION)
    has_other_content = change is added
    is_refused = change is not unchanged and (is_running or has_other_content)
    with pytest.raises(MethodError, match="was changed or replaced") if is_refused else nullcontext():
        if not is_running:
            change(tmp_path)
        with IsolatedLocaliser(method, LOC_RIG, true_pose(0), rate_hz=10.0, hidden=()) as localiser:
            if is_running:
                change(tmp_path)
            localiser.localise(loc_pair(0))
