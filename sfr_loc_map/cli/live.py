"""`sfr live`: a page that shows a run while it goes on."""

from __future__ import annotations

from typing import Annotated

import typer

from sfr_loc_map.cli.app import app, examples
from sfr_loc_map.cli.common import require_ros
from sfr_loc_map.cli.live_views import show_graph
from sfr_loc_map.errors import MissingExtraError

HostOption = Annotated[
    str, typer.Option("--host", metavar="H", help="Address to listen on; but for loopback it needs --token.")
]
LiveOption = Annotated[bool, typer.Option("--live", help="Show the run on a page while it goes on (see sfr live).")]
LivePortOption = Annotated[
    int, typer.Option("--live-port", metavar="P", min=0, max=65535, help="Port of that page; 0: a free one.")
]
PortOption = Annotated[int, typer.Option("--port", metavar="P", min=0, max=65535, help="Port; 0: a free one.")]
TerminalOption = Annotated[
    bool, typer.Option("--terminal", help="Show the figures on this terminal; one line a second where there is none.")
]


def require_live() -> None:
    """Check that the web server can be imported.

    Raises:
        MissingExtraError: If it cannot.
    """
    try:
        import aiohttp  # noqa: F401 - does it import?
    except ImportError as error:
        raise MissingExtraError(f"sfr live needs a web server ({error}): pip install 'sfr_loc_map[live]'") from error


def page_arguments(live: bool, port: int, namespace: str = "") -> tuple[str, ...] | None:
    """Return the command line of the page beside a run, None where it is not wanted.

    Raises:
        MissingExtraError: If it is wanted and the web server cannot be imported.
    """
    if not live:
        return None
    require_live()
    return ("--port", str(port), "--namespace", namespace)


@app.command(
    epilog=examples(
        "sfr live",
        "sfr live --namespace rover1 --port 0 --open",
        "sfr live --host 0.0.0.0 --token a-long-secret",
        "sfr live --terminal",
    )
)
def live(
    namespace: Annotated[str, typer.Option("--namespace", metavar="NS", help="Namespace of the rover.")] = "",
    host: HostOption = "127.0.0.1",
    port: PortOption = 8080,
    token: Annotated[str, typer.Option("--token", metavar="WORD", help="Word that each request must have.")] = "",
    open_browser: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False,
    terminal: TerminalOption = False,
) -> None:
    """Serve a page with figures, path, images and map of the running nodes, until Ctrl-C.

    It prints its address when it is ready, and never waits for or delays the nodes. On a terminal, q ends.
    """
    if terminal:
        require_ros("live")
        show_graph(namespace)
        return
    require_live()
    require_ros("live")
    from sfr_loc_map.config import build
    from sfr_loc_map.live.config import LiveConfig
    from sfr_loc_map.nodes.live.page import serve_graph

    config = build(LiveConfig, {"host": host, "port": port, "token": token}, origin="sfr live")
    serve_graph(config, namespace, open_browser=open_browser)
