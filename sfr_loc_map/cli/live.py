"""`sfr live`: a page or a terminal that shows a run in progress."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from typer import Context, Option

from sfr_loc_map.cli.app import app, examples, propose
from sfr_loc_map.cli.former import FormerArgument, check_live
from sfr_loc_map.cli.live_option import PortOption, require_live
from sfr_loc_map.cli.options import (
    GraphConfigOption,
    NamespaceOption,
    RosRemapOption,
    option_names,
    refuse_given,
    require_ros,
)
from sfr_loc_map.configuration.parameters import build
from sfr_loc_map.configuration.sections import Configuration
from sfr_loc_map.errors import InterruptedRunError
from sfr_loc_map.live.config import DEFAULT_HOST, DEFAULT_PORT, LiveConfig

if TYPE_CHECKING:
    from sfr_loc_map.live.state import LiveState


@app.command(
    epilog=examples(
        "sfr live",
        "sfr live --namespace rover1 --port 0 --open",
        "sfr live -r loc/left/image_rect:=/eye/left",
        "sfr live --config sfr.yaml --terminal",
        "sfr live --host 0.0.0.0 --token a-long-secret",
        "sfr live --terminal",
    )
)
def live(
    context: Context,
    files: FormerArgument = None,
    namespace: NamespaceOption = "",
    rules: RosRemapOption = None,
    config: GraphConfigOption = None,
    host: Annotated[
        str, Option(metavar="H", help="Address to listen on; except for loopback, --token is required.")
    ] = DEFAULT_HOST,
    port: PortOption = DEFAULT_PORT,
    token: Annotated[str, Option(metavar="WORD", help="Token that each request must contain.")] = "",
    open_browser: Annotated[bool, Option("--open", help="Open the page in the browser.")] = False,
    terminal: Annotated[
        bool, Option("--terminal", help="Show the figures on the terminal; without a terminal, one line per second.")
    ] = False,
) -> None:
    """Serve a page with figures, path, images and map of the running nodes, until Ctrl-C.

    The command prints the address of the page when it is ready, and never delays the nodes. With --terminal, q ends it.
    """
    from sfr_loc_map.io.source_config import SourceConfig
    from sfr_loc_map.live.state import LiveState

    check_live(files)
    if terminal:
        of_page = ("host", "port", "token", "open_browser")
        refuse_given(context, of_page, "applies to the page, which is not served with --terminal: omit it")
    require_ros("live")
    propose("sfr replay SRC --live --out DIR", why="a run that is scored while the page shows it")
    from sfr_loc_map.nodes.launch.ros_arguments import remaps_of

    if not terminal:
        require_live()
    values = {"host": host, "port": port, "token": token}
    page = build(LiveConfig, values, origin="", called=option_names(context))
    remaps = list(rules or ())
    if config is not None:
        remaps += remaps_of(SourceConfig.of(Configuration.read(config)))
    state = LiveState()
    if terminal:
        _show_on_terminal(state, namespace, remaps)
    else:
        from sfr_loc_map.live.main import serve_page

        serve_page(page, state, namespace, remaps, open_browser=open_browser)


def _show_on_terminal(state: LiveState, namespace: str, remaps: list[str]) -> None:
    """Show a state on the terminal until q is pressed or a signal arrives."""
    from sfr_loc_map.live.feed import RosFeed
    from sfr_loc_map.live.terminal import Terminal

    with RosFeed(state, namespace, remaps):
        try:
            Terminal(state, namespace).show()
        except KeyboardInterrupt:
            raise InterruptedRunError("interrupted: the display was closed; the nodes continue to run") from None
