"""Remote sources are fetched whole, checked, once for all jobs."""

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
from sfr_loc_map.suite.job import JobSource, SourceKind
from sfr_loc_map.suite.sources import expand, local_path, remote_version, trim_copies

fsspec = pytest.importorskip("fsspec", reason="needs the extra [suite]")
CONTENT = b"a" * 1000


class Handler(SimpleHTTPRequestHandler):
    gets: ClassVar[list[str]] = []

    def do_GET(self) -> None:
        self.gets.append(self.path)
        super().do_GET()

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    folder = tmp_path_factory.mktemp("served")
    (folder / "drive.mcap").write_bytes(CONTENT)
    http = ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Handler, directory=str(folder)))
    thread = threading.Thread(target=http.serve_forever, args=(0.01,), daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{http.server_port}/drive.mcap"
    http.shutdown()
    http.server_close()


def fetch(folder: Path, url: str, sha256: str = "", version: str = "") -> Path:
    version = version or remote_version(url)
    source = JobSource(name="a", kind=SourceKind.REMOTE, path=url, sha256=sha256 or version, version=version)
    return local_path(source, folder)


def test_a_file_is_fetched_once_for_all_jobs_and_keeps_its_name(url: str, tmp_path: Path) -> None:
    Handler.gets.clear()
    found: list[Path] = []
    jobs = [threading.Thread(target=lambda: found.append(fetch(tmp_path, url))) for _ in range(4)]
    for job in jobs:
        job.start()
    for job in jobs:
        job.join()
    assert [(path.name, path.read_bytes()) for path in found] == [("drive.mcap", CONTENT)] * 4
    assert Handler.gets == ["/drive.mcap"]


def test_a_wrong_hash_and_a_changed_file_are_told_and_leave_nothing(url: str, tmp_path: Path) -> None:
    sha256 = hashlib.sha256(CONTENT).hexdigest()
    with pytest.raises(InputError, match=f"has the SHA-256 {sha256}, the suite's file says {'0' * 64}"):
        fetch(tmp_path, url, "0" * 64)
    with pytest.raises(InputError, match="has changed since the suite was planned"):
        fetch(tmp_path, url, version="0" * 32)
    assert not [path for path in tmp_path.rglob("*") if path.suffix != ".lock" and path.name != "fetched"]
    assert fetch(tmp_path, url, sha256).read_bytes() == CONTENT


def test_what_is_not_there_or_cannot_be_read_is_told_in_one_line(url: str) -> None:
    with pytest.raises(InputError, match="there is nothing at"):
        remote_version(f"{url}.missing")
    with pytest.raises(InputError, match="check the URL, the network"):
        remote_version("http://127.0.0.1:1/a")
    with pytest.raises(InputError, match="give a path, or a URL"):
        remote_version("odd://a/b")
    if importlib.util.find_spec("s3fs") is None:
        with pytest.raises(MissingExtraError, match="for s3:// also s3fs"):
            remote_version("s3://bucket/a")


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


def test_copies_made_longest_ago_are_removed_beyond_the_size(tmp_path: Path) -> None:
    for number, name in enumerate("cab"):
        copy = tmp_path / "fetched" / name
        copy.mkdir(parents=True)
        (copy / "x").write_bytes(CONTENT)
        os.utime(copy, (number, number))
    trim_copies(tmp_path, 2500)
    assert {path.name for path in (tmp_path / "fetched").iterdir()} == {"a", "b"}
