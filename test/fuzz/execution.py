"""One input in this process: the mutated file in its place, a command or reader, and what is wrong with the outcome."""

from __future__ import annotations

import contextlib
import io
import os
import re
import shutil
import sys
import time
import traceback
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from random import Random

from mutations import Mutation, mutated

from sfr_loc_map.errors import SfrError

sys.path += [str(Path(__file__).resolve().parents[1] / name) for name in ("scenes", "io")]  # the made worlds
Command = tuple[str, ...]
Reader = Callable[[Path], None]
"""Takes the mutated file; may raise an `SfrError`."""
MAX_NOISE = 200
"""Bytes that compiled code may write beside the error: libpng names the fault of an image in a line of its own."""
MAX_LINE = 1000
"""Characters of an error."""
CONTROL = re.compile(r"[^\n\t\x20-\x7e\u00a0-\ud7ff\ue000-\U0010ffff]|[\u202a-\u202e\u2066-\u2069]")
"""What must not reach a terminal: controls, lone surrogates, and what turns the direction of writing."""


@dataclass(frozen=True)
class Target:
    """A format: its valid file within the world, and the commands and readers of which the content chooses one."""

    name: str
    place: str
    mutations: tuple[Mutation, ...]
    uses: tuple[Command | Reader, ...]
    """In commands `{w}` is the world, `{o}` a folder for outputs."""
    readable: bool = True
    """Formats that are refused by name are fuzzed too."""


@dataclass(frozen=True)
class Outcome:
    """What an input led to: `accepted`, `refused`, or what is wrong, with the error or the end of a traceback."""

    kind: str
    text: str = ""
    seconds: float = 0.0
    growth_bytes: int = 0

    @property
    def good(self) -> bool:
        return self.kind in ("accepted", "refused")


def run_command(command: Command, world: Path, out: Path) -> int:
    """Run a command of `sfr` in this process; return its exit code."""
    from sfr_loc_map.cli.main import main  # not needed by readers

    sys.argv = ["sfr", *(word.replace("{w}", str(world)).replace("{o}", str(out)) for word in command)]
    return main()


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
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")  # the peak of memory begins here
    before, noise, begin = _status("VmRSS"), os.fstat(2).st_size, time.process_time()  # a worker writes to a file
    shown, errors = io.StringIO(), io.StringIO()
    try:
        with contextlib.redirect_stdout(shown), contextlib.redirect_stderr(errors):
            code = run_command(use, world, out) if isinstance(use, tuple) else (use(place) or 0)
        kind, text = _judged(code, shown.getvalue(), errors.getvalue())
        if os.fstat(2).st_size - noise > MAX_NOISE and isinstance(use, tuple) and kind in ("accepted", "refused"):
            kind, text = "noise of a library", f"{os.fstat(2).st_size - noise} bytes on standard error"
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        kind, text = "exception", traceback.format_exc()[-1500:]
        if isinstance(error, SfrError) and not isinstance(use, tuple):
            kind, text = "refused", str(error)[:MAX_LINE]
    finally:
        place.write_bytes(valid)
    return Outcome(kind, text, time.process_time() - begin, max(_status("VmHWM") - before, 0))


def _judged(code: int, shown: str, errors: str) -> tuple[str, str]:
    """Return what is wrong with what a command wrote, or whether the input was accepted."""
    lines = errors.split("\n")
    said = [line for line in lines if line.startswith("sfr: ") and not line.startswith("sfr: warning: ")]
    wrong = {
        "fault of the program": "fault of the program" in errors or "Traceback" in errors,
        f"exit code {code}": code not in (0, 1, 2, 3),
        "control characters": CONTROL.search(shown + errors) is not None,
        "not one line": code == 2 and len(said) != 1,
        "long line": any(len(line) > MAX_LINE for line in lines),
        "warning of Python": "Warning: " in errors and ".py:" in errors,
    }
    kind = next((kind for kind, found in wrong.items() if found), "refused" if code == 2 else "accepted")
    return kind, ascii((shown + errors)[-1500:]) if kind == "control characters" else errors[-1500:]


def _status(name: str) -> int:
    """Return an entry of this process's status, bytes."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next((int(line.split()[1]) * 1024 for line in lines if line.startswith(name)), 0)
