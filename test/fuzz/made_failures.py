"""Readers that fail in every way that the fuzzer must notice."""

from __future__ import annotations

import ctypes
import os
import sys
from pathlib import Path

from execution import Target

from sfr_loc_map.errors import InputError


def _hang() -> None:
    while True:
        pass


def _grow() -> None:
    memory = bytearray(600_000_000)
    memory[:: os.sysconf("SC_PAGE_SIZE")] = b"x" * len(memory[:: os.sysconf("SC_PAGE_SIZE")])


def _stumble() -> None:
    raise KeyError("nobody expects it")


def _refuse() -> None:
    raise InputError("it is not valid")


FAILURES = {
    "SIGSEGV": lambda: ctypes.string_at(0),
    "hang": _hang,
    "memory": _grow,
    "exception": _stumble,
    "control characters": lambda: print("\x1b[31m", file=sys.stderr),
}


def made_targets() -> dict[str, Target]:
    """Return targets that are named after what is wrong with them, and one that behaves."""

    def reader(fail):  # noqa: ANN001, ANN202
        def read(path: Path) -> None:
            if path.read_bytes() != b"valid":
                fail()

        return read

    readers = {**FAILURES, "refused": _refuse}
    return {
        name: Target(name, "file", (lambda _rng, _data: b"spoilt",), (reader(fail),)) for name, fail in readers.items()
    }
