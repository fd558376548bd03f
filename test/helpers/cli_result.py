"""The result of a command in a test: exit code, output, errors."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple


class Result(NamedTuple):
    code: int
    out: str
    err: str


Sfr = Callable[..., Result]
