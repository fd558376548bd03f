"""Readers that fail in every way that the fuzzer must notice."""

from __future__ import annotations

import ctypes
import os
import sys
from pathlib import Path

from target import Target

from sfr_loc_map.errors import InputError


def _crash(path: Path) -> None:
    if path.read_bytes() != b"valid":
        ctypes.string_at(0)


def _hang(path: Path) -> None:
    while path.read_bytes() != b"valid":
        pass


def _grow(path: Path) -> None:
    if path.read_bytes() != b"valid":
        _fill(bytearray(600_000_000))


def _fill(memory: bytearray) -> None:
    memory[:: os.sysconf("SC_PAGE_SIZE")] = b"x" * len(memory[:: os.sysconf("SC_PAGE_SIZE")])


def _stumble(path: Path) -> None:
    if path.read_bytes() != b"valid":
        raise KeyError("nobody expects it")


def _escape(path: Path) -> None:
    if path.read_bytes() != b"valid":
        print("\x1b[31m", file=sys.stderr)


def _refuse(path: Path) -> None:
    if path.read_bytes() != b"valid":
        raise InputError("it is not valid")


def _corrupt(_rng: object, _data: bytes) -> bytes:
    return b"spoilt"


FAILURES = {"SIGSEGV": _crash, "hang": _hang, "memory": _grow, "exception": _stumble, "control characters": _escape}


def made_targets() -> dict[str, Target]:
    """Return targets that are named after what is wrong with them, and one that behaves."""
    readers = {**FAILURES, "refused": _refuse}
    return {name: Target(name, "file", (_corrupt,), (reader,)) for name, reader in readers.items()}
