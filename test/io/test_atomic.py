"""Outputs are whole or not there; hashes tell inputs apart."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from sfr_loc_map.errors import InputError, OutputError
from sfr_loc_map.io.atomic import atomic_path
from sfr_loc_map.io.hashing import hash_path


def test_file_and_folder_take_their_names_at_the_end(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_text("old")
    with atomic_path(tmp_path / "a.ply") as temporary:
        assert temporary.suffix == ".ply"
        temporary.write_text("new")
        assert (tmp_path / "a.ply").read_text() == "old"
    assert (tmp_path / "a.ply").read_text() == "new"
    with atomic_path(tmp_path / "d") as temporary:
        temporary.mkdir()
        (temporary / "x").write_text("1")
        assert not (tmp_path / "d").exists()
    assert (tmp_path / "d" / "x").read_text() == "1"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.ply", "d"]


def test_nothing_is_left_of_an_error(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("old")

    def fail(name: str) -> None:
        with atomic_path(tmp_path / name) as temporary:
            temporary.write_text("half")
            raise RuntimeError("boom")

    for name in ("a", "b"):
        with pytest.raises(RuntimeError, match="boom"):
            fail(name)
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("a", "old")]


def test_what_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "x").write_text("")
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").write_text("")
    for name, words in (("full", "not empty"), ("none/x", "there is no folder"), ("file/x", "there is no folder")):
        with pytest.raises(OutputError, match=words), atomic_path(tmp_path / name):
            pass
    with pytest.raises(OutputError, match="cannot write"), atomic_path(tmp_path / "nothing written"):
        pass
    with atomic_path(tmp_path / "empty") as temporary:
        temporary.mkdir()
        (temporary / "y").write_text("")
    assert (tmp_path / "empty" / "y").exists()


def test_hash_of_a_file_is_its_sha256_and_a_folder_tells_names_and_content(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "x").write_bytes(b"abc")
    assert hash_path(tmp_path / "a" / "x") == hashlib.sha256(b"abc").hexdigest()
    first = hash_path(tmp_path / "a")
    (tmp_path / "a").rename(tmp_path / "b")
    assert hash_path(tmp_path / "b") == first
    (tmp_path / "b" / "x").rename(tmp_path / "b" / "y")
    second = hash_path(tmp_path / "b")
    (tmp_path / "b" / "y").write_bytes(b"abd")
    assert len({first, second, hash_path(tmp_path / "b")}) == 3
    with pytest.raises(InputError, match="there is no"):
        hash_path(tmp_path / "none")
