"""The option `--live`: a page that shows the run of another command."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from typing import TYPE_CHECKING, Annotated

from typer import Context, Option

from sfr_loc_map.cli.options import refuse_given
from sfr_loc_map.errors import FailedVerdictError, InterruptedRunError, MissingExtraError, NotJudgedError, SfrError
from sfr_loc_map.message_text import one_line

if TYPE_CHECKING:
    from sfr_loc_map.live.page_process import PageProcess

LiveOption = Annotated[bool, Option("--live", help="Show the run on a page (see sfr live).")]
PortOption = Annotated[int, Option(metavar="P", min=0, max=65535, help="Port of the page; 0 selects a free port.")]


def require_live() -> None:
    """Raise MissingExtraError if the web server cannot be imported."""
    if find_spec("aiohttp") is None:
        raise MissingExtraError("sfr live requires the web server aiohttp: pip install 'sfr_loc_map[live]'")


@contextmanager
def live_page(
    context: Context, live: bool, port: int, namespace: str = "", remaps: Sequence[str] = (), *, isolated: bool = False
) -> Iterator[PageProcess | None]:
    """Show the run of the `with` block on a page; yield the page, or None without `live`.

    `live` and `port` are the values of `--live` and `--live-port`. The page subscribes to topics with the remappings
    `FROM:=TO` of the nodes. The page of a replay (`isolated`) uses the ROS domain of the run. After the run, even if it
    failed, the page is served until Ctrl-C.
    """
    if not live:
        refuse_given(context, ("live_port",), "applies to the page: give --live, or omit it")
        yield None
        return
    require_live()
    from sfr_loc_map.live.page_process import PageProcess
    from sfr_loc_map.ros import environment

    if isolated:
        environment.isolate()
    words = [word for remap in remaps for word in ("-r", remap)]
    with PageProcess(("--port", str(port), "--namespace", namespace, *words)) as page:
        try:
            yield page
        except SfrError as error:
            if isolated and page.has_run_ended and not isinstance(error, InterruptedRunError):
                is_verdict = isinstance(error, FailedVerdictError | NotJudgedError)
                page.stay("" if is_verdict else f"{one_line(str(error))}\n")
            raise
        if isolated:
            page.stay()
