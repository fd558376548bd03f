"""`sfr` in the process of a test: exit code, output and errors, without the cost of a process."""

from __future__ import annotations

import io
import signal
import sys
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from typing import NamedTuple

import pytest


class Result(NamedTuple):
    code: int
    out: str
    err: str


Sfr = Callable[..., Result]


def run_sfr(*arguments: object) -> Result:
    """Run a command line as from the shell, and restore the handlers of signals, which a command ignores at its end."""
    from sfr_loc_map.cli.main import main
    from sfr_loc_map.signals import END_SIGNALS

    handlers = {number: signal.getsignal(number) for number in END_SIGNALS}
    out, err = (io.TextIOWrapper(io.BytesIO(), "utf-8", newline="", write_through=True) for _ in range(2))
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr(sys, "argv", ["sfr", *map(str, arguments)])
        try:
            code = main()
        finally:
            for number, handler in handlers.items():
                signal.signal(number, handler)
    return Result(code, *(stream.buffer.getvalue().decode() for stream in (out, err)))
