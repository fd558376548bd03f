"""`sfr live`: a page or a terminal that shows a run while it goes on."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from sfr_loc_map.cli.app import app, examples
from sfr_loc_map.cli.options import ConditionOption, JudgeOptions, NamespaceOption, require_ros
from sfr_loc_map.config import build
from sfr_loc_map.errors import (
    ConfigError,
    FailedVerdictError,
    InterruptedRunError,
    MissingExtraError,
    NodeError,
    NotJudgedError,
)
from sfr_loc_map.inputs import one_line
from sfr_loc_map.metrics.config import score_config

if TYPE_CHECKING:
    from sfr_loc_map.live.foxglove import FoxgloveView
    from sfr_loc_map.nodes.processes import LivePage

LiveOption = Annotated[bool, Option(help="Show the run on a page while it goes on (see sfr live).")]
LivePortOption = Annotated[int, Option(metavar="P", min=0, max=65535, help="Port of that page; 0: a free one.")]


def require_live() -> None:
    """Check that the web server can be imported; raises MissingExtraError if it cannot."""
    if find_spec("aiohttp") is None:
        raise MissingExtraError("sfr live needs a web server, aiohttp: pip install 'sfr_loc_map[live]'")


@contextmanager
def live_beside(wanted: bool, port: int, namespace: str = "", *, isolated: bool = False) -> Iterator[LivePage | None]:
    """Show what the `with` block runs on a page, if it is wanted; yield the page, None where none is wanted.

    The page of a replay (`isolated`) is in the domain that the run chooses, and is served after it until Ctrl-C.
    """
    if not wanted:
        yield None
        return
    require_live()
    from sfr_loc_map.nodes import environment
    from sfr_loc_map.nodes.processes import LivePage

    if isolated:
        environment.isolate()
    with LivePage(("--port", str(port), "--namespace", namespace)) as page:
        try:
            yield page
        except NodeError as error:
            page.run_is_over(aborted=one_line(str(error)).partition(": ")[0])
            if isolated:
                page.stay(f"{one_line(str(error))}\n")
            raise
        except (FailedVerdictError, NotJudgedError):
            page.stay()
            raise
        if isolated:
            page.stay()


@app.command(
    epilog=examples(
        "sfr live",
        "sfr live --namespace rover1 --port 0 --open",
        "sfr live --host 0.0.0.0 --token a-long-secret",
        "sfr live --terminal",
        "sfr live out/ --rate 4",
    ),
    hint="sfr replay SRC --live --out DIR    # a run that is scored while the page shows it",
)
def live(
    source: Annotated[
        Path | None,
        Argument(metavar="[SRC]", help="Folder of sfr replay --out, bag or data set to play; none: running nodes."),
    ] = None,
    namespace: NamespaceOption = "",
    host: Annotated[
        str, Option(metavar="H", help="Address to listen on; but for loopback it needs --token.")
    ] = "127.0.0.1",
    port: Annotated[int, Option(metavar="P", min=0, max=65535, help="Port; 0: a free one.")] = 8080,
    token: Annotated[str, Option(metavar="WORD", help="Word that each request must have.")] = "",
    open_browser: Annotated[bool, Option("--open", help="Open the page in the browser.")] = False,
    terminal: Annotated[
        bool, Option(help="Show the figures on this terminal; one line a second where there is none.")
    ] = False,
    rate: Annotated[float, Option(metavar="R", min=0.01, max=100.0, help="Multiple of the recorded speed.")] = 1.0,
    truth: Annotated[Path | None, Option(metavar="SRC", help="Source with truth and images of what is played.")] = None,
    limits: Annotated[Path | None, Option(metavar="F.yaml", help="Limits by which it is judged.")] = None,
    condition: ConditionOption = None,
    foxglove: Annotated[bool, Option(help="Serve the same over the Foxglove protocol besides, on loopback.")] = False,
    foxglove_port: Annotated[int, Option(metavar="P", min=0, max=65535, help="Its port; 0: a free one.")] = 8765,
) -> None:
    """Serve a page with figures, path, images and map of the running nodes, until Ctrl-C.

    It prints its address when it is ready, and never waits for or delays the nodes. With SRC it plays what was
    recorded, without nodes, on a time line; the figures are those of its place, at the end those of sfr score. On a
    terminal q ends, and of what is played space pauses and the arrows go 5 s back and on.
    """
    from sfr_loc_map.live.state import LiveState

    if source is None:
        options = {"rate": rate != 1.0, "truth": truth, "limits": limits, "condition": condition}
        if given := next((name for name, value in options.items() if value), ""):
            raise ConfigError(f"'--{given}' is of a recording: give SRC, or leave it out (the monitor has its own)")
        require_ros("live")
    view_of = _foxglove_view() if foxglove else None
    state, config = LiveState(), None
    if not terminal:
        require_live()
        from sfr_loc_map.live.server import LiveConfig

        config = build(LiveConfig, {"host": host, "port": port, "token": token}, origin="sfr live")
    with ExitStack() as stack:
        if source is None:
            from sfr_loc_map.nodes.live_feed import RosFeed

            title = namespace
            stack.enter_context(RosFeed(state, namespace))
        else:
            from sfr_loc_map.live.playback import Player, open_recording

            recording, (parsed, _) = open_recording(source, truth), JudgeOptions(limits, condition).read()
            title, judged = recording.title, {} if condition else recording.settings
            config_of = score_config(condition, judged)
            stack.enter_context(Player(state, recording, config_of, parsed or recording.limits, rate))
        if view_of is not None:
            view = stack.enter_context(view_of(state, foxglove_port, title))
            print(f"foxglove: {view.url}", flush=True)
        if config is not None:
            from sfr_loc_map.live.server import LiveServer, serve_until_signal

            asyncio.run(serve_until_signal(LiveServer(config, state, title), open_browser=open_browser))
            return
        from sfr_loc_map.live.terminal import Terminal

        try:
            Terminal(state, title).show()
        except KeyboardInterrupt:
            raise InterruptedRunError("interrupted: the view has ended, nothing else") from None


def _foxglove_view() -> type[FoxgloveView]:
    try:
        from sfr_loc_map.live.foxglove import FoxgloveView
    except ImportError as error:
        raise MissingExtraError(f"--foxglove needs its SDK ({error}): pip install 'sfr_loc_map[foxglove]'") from error
    return FoxgloveView
