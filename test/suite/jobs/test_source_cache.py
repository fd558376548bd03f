"""Remote sources are fetched completely, once for all jobs, and again after a change on the server."""

from __future__ import annotations

import functools
import logging
import threading
from collections.abc import Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import ClassVar

import pytest

from sfr_loc_map.errors import InputError, MissingExtraError
from sfr_loc_map.suite.jobs.source_cache import expand, fetch, rendered
from sfr_loc_map.suite.jobs.sources import Simulation

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


def test_a_simulation_is_rendered_again_with_other_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    codes: list[str] = []

    def simulate(_: object, out: Path, **__: object) -> None:
        out.mkdir()
        (out / "images").write_text(codes[-1])

    monkeypatch.setattr("sfr_loc_map.simulation.simulate.simulate", simulate)
    monkeypatch.setattr("sfr_loc_map.suite.jobs.source_cache.code_fingerprint", lambda: codes[-1])
    sources = [
        Simulation(name="a", path="a.yaml", sha256=sha256, drive=sha256, settings={}, seed=0) for sha256 in ("0", "1")
    ]
    for code in ("first", "first", "second"):
        codes.append(code)
        assert [(rendered(source, tmp_path) / "images").read_text() for source in sources] == [code, code]
    assert len([path for path in tmp_path.iterdir() if path.is_dir()]) == 2


@pytest.mark.parametrize(
    ("url", "error", "words"),
    [
        ("http://127.0.0.1:1/a", InputError, "check the URL, the network"),
        ("memory://nothing", InputError, "check the URL, the network"),
        ("odd://a/b", InputError, "give a path, or a URL"),
        ("gs://bucket/a", MissingExtraError, "for s3:// also s3fs"),
    ],
)
def test_what_cannot_be_read_is_told_in_one_line(url: str, error: type[InputError], words: str, tmp_path: Path) -> None:
    with pytest.raises(error, match=words):
        fetch(url, tmp_path)
    assert not [path for path in tmp_path.rglob("*") if path.suffix != ".lock" and path.name != "fetched"]


def test_object_storage_is_read_as_any_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("s3fs", reason="needs s3fs")
    server = pytest.importorskip("moto.server", reason="needs moto").ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server.start()
    host, port = server.get_host_and_port()
    keys = {"ENDPOINT_URL": f"http://{host}:{port}", "ACCESS_KEY_ID": "a", "SECRET_ACCESS_KEY": "b"}
    for name, value in (keys | {"DEFAULT_REGION": "us-east-1"}).items():
        monkeypatch.setenv(f"AWS_{name}", value)
    try:
        storage = fsspec.filesystem("s3", skip_instance_cache=True)
        storage.mkdir("drives")
        storage.pipe({"drives/one.mcap": b"one", "drives/two/rig.json": b"{}", "drives/two/left/0.png": b"0"})
        assert expand("s3://drives/*") == ["s3://drives/one.mcap", "s3://drives/two"]
        assert fetch("s3://drives/one.mcap", tmp_path).read_bytes() == b"one"
        folder = fetch("s3://drives/two", tmp_path)
        assert sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*.*")) == ["left/0.png", "rig.json"]
        storage.pipe("drives/one.mcap", b"other")
        assert fetch("s3://drives/one.mcap", tmp_path).read_bytes() == b"other"
        with pytest.raises(InputError, match="cannot read 's3://none/x'"):
            fetch("s3://none/x", tmp_path)
    finally:
        server.stop()
