"""Remote sources are fetched whole, checked, once for all tasks, into a folder that does not grow beyond its limit."""

from __future__ import annotations

import functools
import hashlib
import importlib.util
import os
import threading
from collections.abc import Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import ClassVar

import pytest

from sfr_loc_map.errors import InputError, MissingExtraError
from sfr_loc_map.suite import source_cache
from sfr_loc_map.suite.remote import expand, remote_facts
from sfr_loc_map.suite.source_cache import SourceCache

fsspec = pytest.importorskip("fsspec", reason="needs the extra [suite]")
SIZE = 1000
LIMIT = 2500


class Handler(SimpleHTTPRequestHandler):
    gets: ClassVar[list[str]] = []

    def do_GET(self) -> None:
        self.gets.append(self.path)
        super().do_GET()

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, Path]]:
    folder = tmp_path_factory.mktemp("served")
    http = ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Handler, directory=str(folder)))
    thread = threading.Thread(target=http.serve_forever, args=(0.01,), daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{http.server_port}", folder
    http.shutdown()
    http.server_close()


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """No pauses; what a test has read is no longer in use after it."""
    monkeypatch.setattr(source_cache, "PAUSE_S", 0.0)
    monkeypatch.setattr(source_cache, "WAIT_S", 0.01)
    Handler.gets.clear()
    yield
    end_tasks()


def end_tasks() -> None:
    while source_cache._held:
        os.close(source_cache._held.pop())


def put(folder: Path, name: str, sign: bytes = b"a") -> str:
    """Write a file; return the hash of its content."""
    (folder / name).write_bytes(sign * SIZE)
    return hashlib.sha256(sign * SIZE).hexdigest()


def fetch(folder: Path, url: str, sha256: str = "") -> Path:
    return SourceCache(folder, LIMIT).fetch(url, remote_facts(url).version, sha256)


def copies(folder: Path) -> set[str]:
    return {path.name for path in folder.glob("fetched/*/*")}


def test_a_file_is_fetched_once_and_keeps_its_name(server: tuple[str, Path], tmp_path: Path) -> None:
    address, folder = server
    sha256 = put(folder, "drive.mcap")
    copy = fetch(tmp_path, f"{address}/drive.mcap", sha256)
    assert (copy.name, copy.read_bytes()) == ("drive.mcap", b"a" * SIZE)
    assert fetch(tmp_path, f"{address}/drive.mcap") == copy
    assert Handler.gets == ["/drive.mcap"]
    copy.write_bytes(b"b")  # by whom ever: it is not what was fetched
    end_tasks()
    assert fetch(tmp_path, f"{address}/drive.mcap").read_bytes() == b"a" * SIZE


def test_what_was_used_longest_ago_is_removed_but_nothing_in_use(server: tuple[str, Path], tmp_path: Path) -> None:
    address, folder = server
    for name in "abc":
        put(folder, name)
    for name in "ab":
        fetch(tmp_path, f"{address}/{name}")
    end_tasks()
    os.utime(fetch(tmp_path, f"{address}/a").parent.with_suffix(".lock"), (1, 1))  # longest ago, but in use
    fetch(tmp_path, f"{address}/c")
    assert copies(tmp_path) == {"a", "c"}
    end_tasks()
    fetch(tmp_path, f"{address}/b")
    assert copies(tmp_path) == {"b", "c"}
    assert [path for path in tmp_path.glob("fetched/*") if path.suffix in (".part", ".new")] == []


def test_a_wrong_hash_a_changed_file_and_one_too_large_are_told(server: tuple[str, Path], tmp_path: Path) -> None:
    address, folder = server
    sha256, url = put(folder, "x"), f"{address}/x"
    with pytest.raises(InputError, match=f"has the SHA-256 {sha256}, the suite's file says {'0' * 64}"):
        fetch(tmp_path, url, "0" * 64)
    with pytest.raises(InputError, match="has changed since the suite was planned"):
        SourceCache(tmp_path, LIMIT).fetch(url, "0" * 32)
    with pytest.raises(InputError, match=r"raise 'cache_mb'"):
        SourceCache(tmp_path, SIZE - 1).fetch(url, remote_facts(url).version)
    assert copies(tmp_path) == set()
    assert list(tmp_path.glob("fetched/*.json")) == []


def test_what_is_not_there_or_cannot_be_read_is_told_in_one_line(server: tuple[str, Path]) -> None:
    with pytest.raises(InputError, match="there is nothing at"):
        remote_facts(f"{server[0]}/missing")
    with pytest.raises(InputError, match="check the URL, the network"):
        remote_facts("http://127.0.0.1:1/a")
    with pytest.raises(InputError, match="give a path, or a URL"):
        remote_facts("odd://a/b")
    if importlib.util.find_spec("s3fs") is None:
        with pytest.raises(MissingExtraError, match="for s3:// also s3fs"):
            remote_facts("s3://bucket/a")


def test_folders_and_globs_of_other_file_systems(tmp_path: Path) -> None:
    memory = fsspec.filesystem("memory")
    for name in ("drives/a/metadata.yaml", "drives/a/a.mcap", "drives/b/b.mcap"):
        memory.pipe(f"/{name}", name.encode())
    assert expand("memory://drives/*") == ["memory:///drives/a", "memory:///drives/b"]
    copy = fetch(tmp_path, "memory:///drives/a")
    assert {path.name: path.read_text() for path in copy.iterdir()} == {
        "metadata.yaml": "drives/a/metadata.yaml",
        "a.mcap": "drives/a/a.mcap",
    }


def test_tasks_side_by_side_fetch_once(server: tuple[str, Path], tmp_path: Path) -> None:
    address, folder = server
    put(folder, "y")
    found: list[Path] = []
    tasks = [threading.Thread(target=lambda: found.append(fetch(tmp_path, f"{address}/y"))) for _ in range(4)]
    for task in tasks:
        task.start()
    for task in tasks:
        task.join()
    assert [path.read_bytes() for path in found] == [b"a" * SIZE] * 4
    assert Handler.gets == ["/y"]


def test_who_finds_no_room_waits_for_the_end_of_others(server: tuple[str, Path], tmp_path: Path) -> None:
    address, folder = server
    for name in "abc":
        put(folder, name)
    for name in "ab":
        fetch(tmp_path, f"{address}/{name}")
    waiting = threading.Thread(target=fetch, args=(tmp_path, f"{address}/c"))
    waiting.start()
    waiting.join(0.2)
    assert waiting.is_alive()
    end_tasks()
    waiting.join()
    assert "c" in copies(tmp_path)
