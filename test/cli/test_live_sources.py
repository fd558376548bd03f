"""`sfr live` of a recording: what cannot be played is said in one line; `--open` opens the page."""

import signal
import webbrowser
from collections.abc import Callable
from pathlib import Path

import pytest
from cli_result import Sfr
from made_scene import write_folder


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [(["nowhere"], "nowhere"), (["empty"], "empty"), (["--rate", "2"], "--rate"), (["--truth", "empty"], "--truth")],
)
def test_what_cannot_be_played_is_refused(
    arguments: list[str], expected: str, sfr: Sfr, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("empty").mkdir()
    result = sfr("live", "--terminal", *arguments)
    assert result.code == 2
    assert expected in result.err
    assert result.err.count("\n") == 1


@pytest.mark.parametrize("wanted", [True, False])
def test_open_opens_the_page_in_the_browser_once_it_is_served(
    wanted: bool, sfr: Sfr, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("aiohttp", reason="aiohttp is not installed: pip install '.[live]'")
    from sfr_loc_map.live.server import LiveServer

    opened: list[str] = []
    serve = LiveServer.serve

    async def served(server: LiveServer, ready: Callable[[str], None]) -> None:
        def seen(url: str) -> None:
            ready(url)
            signal.raise_signal(signal.SIGTERM)

        await serve(server, seen)

    monkeypatch.setattr(webbrowser, "open", opened.append)
    monkeypatch.setattr(LiveServer, "serve", served)
    source = write_folder(tmp_path / "source", 2, 0)
    result = sfr("live", source, "--port", "0", *(["--open"] if wanted else []))
    assert result.code == 0
    url = result.out.strip().removeprefix("live: ")
    assert url.startswith("http://127.0.0.1:")
    assert opened == ([url] if wanted else [])
