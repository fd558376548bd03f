"""Remote sources are fetched whole, once for all jobs."""

from __future__ import annotations

import functools
import importlib.util
import threading
from collections.abc import Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import ClassVar

import pytest

from sfr_loc_map.errors import InputError, MissingExtraError
from sfr_loc_map.suite.sources import fetch

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


def test_a_file_is_fetched_once_and_again_when_it_has_changed(url: str, tmp_path: Path) -> None:
    Handler.gets.clear()
    found: list[Path] = []
    jobs = [threading.Thread(target=lambda: found.append(fetch(url, tmp_path))) for _ in range(4)]
    for job in jobs:
        job.start()
    for job in jobs:
        job.join()
    assert [(path.name, path.read_bytes()) for path in found] == [("drive.mcap", CONTENT)] * 4
    assert Handler.gets == ["/drive.mcap"]
    memory = fsspec.filesystem("memory")
    for content in (b"first", b"other"):
        memory.pipe("/changing.mcap", content)
        assert fetch("memory://changing.mcap", tmp_path).read_bytes() == content


@pytest.mark.parametrize(
    ("url", "error", "words"),
    [
        ("http://127.0.0.1:1/a", InputError, "check the URL, the network"),
        ("memory://nothing", InputError, "check the URL, the network"),
        ("odd://a/b", InputError, "give a path, or a URL"),
        ("s3://bucket/a", MissingExtraError, "for s3:// also s3fs"),
    ],
)
def test_what_cannot_be_read_is_told_in_one_line(url: str, error: type[InputError], words: str, tmp_path: Path) -> None:
    if url.startswith("s3") and importlib.util.find_spec("s3fs") is not None:
        pytest.skip("s3fs is installed")
    with pytest.raises(error, match=words):
        fetch(url, tmp_path)
    assert not [path for path in tmp_path.rglob("*") if path.suffix != ".lock" and path.name != "fetched"]
