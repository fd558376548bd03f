"""One input in this process: the mutated file in its place, a command or reader, and what is wrong with the outcome."""

from __future__ import annotations

import contextlib
import io
import os
import re
import shutil
import time
import traceback
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from random import Random

from mutations import mutated
from target import Target, expected_error, run_command

EXIT_CODES = (0, 1, 2, 3)
MAX_NOISE = 200
"""Bytes that compiled code may write beside the error: libpng names the fault of an image in a line of its own."""
MAX_LINE = 1000
"""Characters of an error."""
CONTROL = re.compile(r"[^\n\t\x20-\x7e\u00a0-\ud7ff\ue000-\U0010ffff]|[\u202a-\u202e\u2066-\u2069]")
"""What must not reach a terminal: controls, lone surrogates, and what turns the direction of writing."""


@dataclass(frozen=True)
class Outcome:
    """What an input led to.

    Attributes:
        kind: `accepted`, `refused`, or what is wrong.
        text: The error, or the end of a traceback.
        seconds: Time of the process.
        growth_bytes: Largest memory during it over that before it.
    """

    kind: str
    text: str = ""
    seconds: float = 0.0
    growth_bytes: int = 0

    @property
    def good(self) -> bool:
        return self.kind in ("accepted", "refused")


def make_input(target: Target, world: Path, seed: int, index: int) -> bytes:
    """Return an input; the same for the same seed."""
    rng = Random(f"{seed}/{target.name}/{index}")
    return mutated(rng, (world / target.place).read_bytes(), target.mutations)


def refused_valid_inputs(target: Target, world: Path, out: Path) -> list[str]:
    """Use the valid file in all ways, so that compilation is not counted as an input's; return what is wrong."""
    content = (world / target.place).read_bytes()
    wanted = "accepted" if target.readable else "refused"
    found = [run_input(target, content, world, out, number) for number in range(len(target.uses))]
    return [f"valid input of {target.name}: {item.kind}: {item.text}" for item in found if item.kind != wanted]


def run_input(target: Target, content: bytes, world: Path, out: Path, number: int | None = None) -> Outcome:
    """Put an input in its place, use it (by its content, or by number), and put the valid file back."""
    place = world / target.place
    valid = place.read_bytes()
    use = target.uses[(zlib.crc32(content) if number is None else number) % len(target.uses)]
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    place.write_bytes(content)
    before, noise = memory(), _written_to_stderr()
    begin = time.process_time()
    try:
        kind, text = _judged_command(use, world, out) if isinstance(use, tuple) else _judged_reader(use, place)
    finally:
        place.write_bytes(valid)
    noise = _written_to_stderr() - noise
    if noise > MAX_NOISE and isinstance(use, tuple) and kind in ("accepted", "refused"):
        kind, text = "noise of a library", f"{noise} bytes on standard error"
    return Outcome(kind, text, time.process_time() - begin, max(peak_memory() - before, 0))


def _judged_reader(use: object, place: Path) -> tuple[str, str]:
    shown, errors = io.StringIO(), io.StringIO()
    try:
        with contextlib.redirect_stdout(shown), contextlib.redirect_stderr(errors):
            use(place)  # type: ignore[operator]
    except Exception as error:
        if not expected_error(error):
            return "exception", _end(traceback.format_exc())
        return "refused", str(error)[:MAX_LINE]
    return _judged_text(0, shown.getvalue(), errors.getvalue(), "accepted")


def _judged_command(use: tuple[str, ...], world: Path, out: Path) -> tuple[str, str]:
    shown, errors = io.StringIO(), io.StringIO()
    try:
        with contextlib.redirect_stdout(shown), contextlib.redirect_stderr(errors):
            code = run_command(use, world, out)
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        return "exception", _end(traceback.format_exc())
    return _judged_text(code, shown.getvalue(), errors.getvalue(), "accepted" if code != 2 else "refused")


def _judged_text(code: int, shown: str, errors: str, kind: str) -> tuple[str, str]:
    """Return what is wrong with what a command wrote, or else the kind given."""
    for sought in ("fault of the program", "Traceback"):
        if sought in errors:
            return "fault of the program", _end(errors)
    if code not in EXIT_CODES:
        return f"exit code {code}", _end(errors)
    if CONTROL.search(shown + errors):
        return "control characters", ascii(_end(shown + errors))
    said = [line for line in errors.split("\n") if line.startswith("sfr: ")]
    if code == 2 and len([line for line in said if not line.startswith("sfr: warning: ")]) != 1:
        return "not one line", _end(errors)
    if any(len(line) > MAX_LINE for line in errors.split("\n")):
        return "long line", errors[:200]
    if "Warning: " in errors and ".py:" in errors:
        return "warning of Python", _end(errors)
    return kind, _end(errors)


def _end(text: str) -> str:
    return text[-1500:]


def memory() -> int:
    """Return the memory of this process, bytes, and let the peak begin there."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
    return _status("VmRSS")


def peak_memory() -> int:
    return _status("VmHWM")


def _status(name: str) -> int:
    for line in _status_lines():
        if line.startswith(name):
            return int(line.split()[1]) * 1024
    return 0


def _status_lines() -> Iterator[str]:
    yield from Path("/proc/self/status").read_text().splitlines()


def _written_to_stderr() -> int:
    """Return the size of what compiled code has written to standard error, where that is a file (as of a worker)."""
    return os.fstat(2).st_size
