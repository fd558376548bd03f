"""Readers that fail in every way that the fuzzer must notice, named after what is wrong with them."""

from __future__ import annotations

import ctypes
import sys
from pathlib import Path

from execution import Target

from sfr_loc_map.errors import InputError


def _hang() -> None:
    while True:
        pass


def _grow() -> None:
    memory = bytearray(600_000_000)
    memory[::4096] = b"x" * len(memory[::4096])


def _fail(error: Exception) -> None:
    raise error


FAILURES = {
    "SIGSEGV": lambda: ctypes.string_at(0),
    "hang": _hang,
    "memory": _grow,
    "exception": lambda: _fail(KeyError("nobody expects it")),
    "control characters": lambda: print("\x1b[31m", file=sys.stderr),
    "refused": lambda: _fail(InputError("it is not valid")),
}


def made_targets() -> dict[str, Target]:
    def reader(name: str, path: Path) -> None:
        if path.read_bytes() != b"valid":
            FAILURES[name]()

    return {
        name: Target(name, "file", (lambda _rng, _data: b"corrupted",), (lambda path, name=name: reader(name, path),))
        for name in FAILURES
    }
