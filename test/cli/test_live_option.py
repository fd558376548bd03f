"""The page of a run is still served after an error has ended the run, and shows the cause."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from sfr_loc_map.cli.live_option import live_page
from sfr_loc_map.errors import (
    ConfigError,
    FailedVerdictError,
    InputError,
    InterruptedRunError,
    MetricsError,
    NodeError,
    SfrError,
)
from sfr_loc_map.live import page_process
from sfr_loc_map.ros import environment


class Page:
    """A page that notes how it is told of the end of a run, without a process."""

    def __init__(self, arguments: tuple[str, ...] = ()) -> None:
        self.has_run_ended, self.stayed, self.cause = False, False, ""

    def __enter__(self) -> Page:
        return self

    def __exit__(self, *_: object) -> None: ...

    def played(self) -> None:
        self.has_run_ended = True

    def aborted(self, cause: str) -> None:
        self.has_run_ended, self.cause = True, cause

    def stay(self, words: str = "") -> None:
        self.stayed = True


@pytest.fixture
def page(monkeypatch: pytest.MonkeyPatch) -> Page:
    found = Page()
    monkeypatch.setattr(page_process, "PageProcess", lambda arguments: found)
    monkeypatch.setattr(environment, "isolate", lambda: None)
    return found


CONTEXT = SimpleNamespace()


@pytest.mark.parametrize(
    ("error", "cause"),
    [
        (
            NodeError("monitor_node was killed by SIGKILL: its last line: x; start again"),
            "monitor_node was killed by SIGKILL",
        ),
        (
            InputError("'drive': localisation_node: the images differ:", "correct them"),
            "'drive': localisation_node: the images differ",
        ),
        (MetricsError("no frame"), "no frame"),
    ],
)
def test_a_run_that_an_error_aborts_stays_on_its_page_with_the_cause(page: Page, error: SfrError, cause: str) -> None:
    with pytest.raises(type(error)), live_page(CONTEXT, True, 0, isolated=True), page_process.shown_on(page):
        raise error
    assert (page.stayed, page.cause) == (True, cause)


@pytest.mark.parametrize(
    ("error", "has_run", "stays"),
    [
        (MetricsError("no figure"), True, True),
        (FailedVerdictError("a limit"), True, True),
        (InterruptedRunError("the user"), True, False),
        (ConfigError("an option"), False, False),
    ],
)
def test_a_page_stays_after_an_error_if_its_run_is_over(
    page: Page, error: SfrError, has_run: bool, stays: bool
) -> None:
    def run() -> None:
        if has_run:
            page.played()
        raise error

    with pytest.raises(type(error)), live_page(CONTEXT, True, 0, isolated=True):
        run()
    assert page.stayed is stays
