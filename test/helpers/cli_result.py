"""What a command gave, as the tests see it."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple


class Result(NamedTuple):
    code: int
    out: str
    err: str


Sfr = Callable[..., Result]
