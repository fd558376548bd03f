"""The hash of a method's own code differs if a file does that the method may import."""

from __future__ import annotations

from pathlib import Path

import pytest

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
