"""`sfr live`: a page that shows a run while it goes on."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sfr_loc_map.cli.app import app, examples
from sfr_loc_map.cli.live_views import Played, Views, show_graph, show_recording
from sfr_loc_map.cli.options import ConditionOption, JudgeOptions, LimitsOption, NamespaceOption, require_ros
from sfr_loc_map.errors import ConfigError, MissingExtraError

if TYPE_CHECKING:
    from sfr_loc_map.nodes.process.live_process import LivePage

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
PlayedArgument = Annotated[
    Path | None,
    typer.Argument(metavar="[SRC]", help="Folder of sfr replay --out, bag or data set to play; none: running nodes."),
]
PlayedRateOption = Annotated[
    float, typer.Option("--rate", metavar="R", min=0.01, max=100.0, help="Multiple of the recorded speed.")
]
TruthOption = Annotated[
    Path | None, typer.Option("--truth", metavar="SRC", help="Source with truth and images of what is played.")
]
FoxgloveOption = Annotated[
    bool, typer.Option("--foxglove", help="Serve the same over the Foxglove protocol besides, on loopback.")
]
FoxglovePortOption = Annotated[
    int, typer.Option("--foxglove-port", metavar="P", min=0, max=65535, help="Its port; 0: a free one.")
]


def require_foxglove() -> None:
    """Check that Foxglove's SDK can be imported.

    Raises:
        MissingExtraError: If it cannot.
    """
    try:
        import foxglove  # noqa: F401 - does it import?
    except ImportError as error:
        raise MissingExtraError(f"--foxglove needs its SDK ({error}): pip install 'sfr_loc_map[foxglove]'") from error


def require_live() -> None:
    """Check that the web server can be imported.

    Raises:
        MissingExtraError: If it cannot.
    """
    if find_spec("aiohttp") is None:
        raise MissingExtraError("sfr live needs a web server, aiohttp: pip install 'sfr_loc_map[live]'")


@contextmanager
def live_beside(wanted: bool, port: int, namespace: str = "", *, isolated: bool = False) -> Iterator[LivePage | None]:
    """Show what the `with` block runs on a page, if it is wanted.

    The page starts first of all: the imports of a run take longer than those of the page.

    Args:
        wanted: Whether there is a page.
        port: Its port; 0: a free one.
        namespace: Of the rover.
        isolated: Whether the run chooses a domain of its own, in which the page must be.

    Yields:
        The page, None where none is wanted.

    Raises:
        MissingExtraError: If a page is wanted and the web server or ROS cannot be imported.
    """
    if not wanted:
        yield None
        return
    require_live()
    from sfr_loc_map.nodes.process import environment
    from sfr_loc_map.nodes.process.live_process import live_page

    if isolated:
        environment.isolate()
    with live_page(("--port", str(port), "--namespace", namespace)) as page:
        yield page


@app.command(
    epilog=examples(
        "sfr live",
        "sfr live --namespace rover1 --port 0 --open",
        "sfr live --host 0.0.0.0 --token a-long-secret",
        "sfr live --terminal",
        "sfr live out/ --rate 4",
    )
)
def live(
    source: PlayedArgument = None,
    namespace: NamespaceOption = "",
    host: HostOption = "127.0.0.1",
    port: PortOption = 8080,
    token: Annotated[str, typer.Option("--token", metavar="WORD", help="Word that each request must have.")] = "",
    open_browser: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False,
    terminal: TerminalOption = False,
    rate: PlayedRateOption = 1.0,
    truth: TruthOption = None,
    limits: LimitsOption = None,
    condition: ConditionOption = None,
    foxglove: FoxgloveOption = False,
    foxglove_port: FoxglovePortOption = 8765,
) -> None:
    """Serve a page with figures, path, images and map of the running nodes, until Ctrl-C.

    It prints its address when it is ready, and never waits for or delays the nodes. With SRC it plays what was
    recorded, without nodes, on a time line; the figures are those of its place, at the end those of sfr score. On a
    terminal q ends, and of what is played space pauses and the arrows go 5 s back and on.
    """
    from sfr_loc_map.config import build
    from sfr_loc_map.metrics.config import score_config

    if not terminal:
        require_live()
    if source is None:
        refuse_without_source(rate=rate != 1.0, truth=truth, limits=limits, condition=condition)
        require_ros("live")
    page = None
    if not terminal:
        from sfr_loc_map.live.config import LiveConfig

        page = build(LiveConfig, {"host": host, "port": port, "token": token}, origin="sfr live")
    if foxglove:
        require_foxglove()
    views = Views(page, open_browser, foxglove_port if foxglove else None)
    if source is None:
        show_graph(namespace, views)
    else:
        parsed, _ = JudgeOptions(limits, condition).read()
        show_recording(Played(source, truth, rate, score_config(condition, {}), parsed), views)


def refuse_without_source(**options: object) -> None:
    """Check that nothing is said of a recording where none is played.

    Raises:
        ConfigError: If something is: names it.
    """
    given = [name for name, value in options.items() if value]
    if given:
        raise ConfigError(f"'--{given[0]}' is of a recording: give SRC, or leave it out (the monitor has its own)")
