"""JSON input is bounded in depth, digits and length; messages that quote input are one printable line."""

import fcntl
import hashlib
import re
import signal
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfr_loc_map import inputs
from sfr_loc_map.errors import InputError
from sfr_loc_map.hashes import hash_path
from sfr_loc_map.inputs import read_bytes, read_table
from sfr_loc_map.json_yaml import MAX_DEPTH, parse_json
from sfr_loc_map.message_text import one_line


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[" * (MAX_DEPTH + 1) + "]" * (MAX_DEPTH + 1), "nested too deeply"),
        ('{"a":' * 900 + "1" + "}" * 900, "nested too deeply"),
        ('{"a":' * 100_000, "nested too deeply"),
        (f"[{'9' * 5000}]", "5000 digits"),
        ('{"\\udc80": 1}', "surrogates not allowed"),
        ('"\ud800"', "surrogates not allowed"),
    ],
    ids=["lists", "objects", "objects that end nowhere", "digits", "half of a pair, escaped", "half of a pair"],
)
def test_what_others_stumble_over_is_refused(text: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        parse_json(text)


@given(st.text(st.characters(exclude_categories=()), max_size=80))
def test_a_message_is_one_line_that_every_terminal_bears(text: str) -> None:
    line = one_line(text)
    assert line.isprintable() or not re.search(r"[\x00-\x1f\x7f-\x9f]", line)
    line.encode("utf-8")


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
    with pytest.raises(InputError, match="No such file"):
        hash_path(tmp_path / "none")


def test_a_lease_of_the_writer_does_not_delay_a_reader(tmp_path: Path) -> None:
    path = tmp_path / "result.npy"
    path.write_bytes(b"1")
    before = signal.signal(signal.SIGIO, signal.SIG_IGN)
    try:
        with path.open("r+b") as stream:
            fcntl.fcntl(stream, fcntl.F_SETLEASE, fcntl.F_WRLCK)
            begin_s = time.monotonic()
            with pytest.raises(BlockingIOError):
                read_bytes(path, 10)
            assert time.monotonic() - begin_s < 5.0
    finally:
        signal.signal(signal.SIGIO, before)
    assert read_bytes(path, 10) == b"1"


@pytest.mark.parametrize("end", ["\n", "\r", "\r\n"])
def test_a_line_of_a_table_counts_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, end: str) -> None:
    monkeypatch.setattr(inputs, "MAX_TABLE_LINES", 3)
    path = tmp_path / "t.csv"
    path.write_bytes(f"1{end}2{end}3{end}".encode())
    assert b"".join(read_table(path)) == path.read_bytes()
    path.write_bytes(f"1{end}2{end}3{end}4{end}".encode())
    with pytest.raises(InputError, match="more than 3 lines"):
        list(read_table(path))
