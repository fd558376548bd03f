"""Inputs in worker processes, each bounded in time and memory, and what is wrong with what they led to."""

from __future__ import annotations

import contextlib
import faulthandler
import importlib
import io
import os
import re
import resource
import shlex
import shutil
import signal
import sys
import tempfile
import time
import traceback
import zlib
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from random import Random

import psutil

from campaigns.fuzz.mutations import Mutation, mutated
from sfr_loc_map.errors import SfrError

Command = tuple[str, ...]
Reader = Callable[[Path], None]
"""Takes the mutated file; may raise an `SfrError`."""
MAX_GROWTH = 500_000_000
"""Bytes that the memory of a warm process may grow by during one input."""
MAX_CPU_S = 10.0
"""Time of the processor, so that a busy host changes nothing."""
MAX_LINE = 1000
"""Characters of an error."""
CONTROL = re.compile(r"[^\n\t\x20-\x7e\u00a0-\ud7ff\ue000-\U0010ffff]|[\u202a-\u202e\u2066-\u2069]")
"""What must not reach a terminal: controls, lone surrogates, and what turns the direction of writing."""
MAX_WAIT_S = 6 * MAX_CPU_S
"""What only waits, and so takes no time of the processor, has so much of the clock."""
WORKER_INPUTS = 300
"""A worker is replaced after so many inputs: what libraries keep grows."""
ADDRESS_SPACE = 8 * 2**30
"""Bytes that may be reserved beyond what the warm process has: protects the host, not the measure of memory."""
SPAWN = get_context("spawn")
TARGETS = "campaigns.fuzz.targets:all_targets"
"""Module and function that a worker calls for its targets."""
_targets: dict[str, Target] = {}


@dataclass(frozen=True)
class Target:
    """A format: its valid file within the world, and the commands and readers of which the content chooses one.

    In commands `{w}` is the world, `{o}` a folder for outputs.
    """

    name: str
    place: str
    mutations: tuple[Mutation, ...]
    uses: tuple[Command | Reader, ...]


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
    found = [run_input(target, content, world, out, number) for number in range(len(target.uses))]
    return [f"valid input of {target.name}: {item.kind}: {item.text}" for item in found if item.kind != "accepted"]


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
    before, begin = _status("VmRSS"), time.process_time()
    shown, errors = io.StringIO(), io.StringIO()
    try:
        with contextlib.redirect_stdout(shown), contextlib.redirect_stderr(errors):
            code = run_command(use, world, out) if isinstance(use, tuple) else (use(place) or 0)
        kind, text = _judged(code, shown.getvalue(), errors.getvalue())
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        kind, text = "exception", traceback.format_exc()[-1500:]
        if isinstance(error, SfrError) and not isinstance(use, tuple):
            kind, text = "refused", str(error)[:MAX_LINE]
    finally:
        place.write_bytes(valid)
    seconds, growth = time.process_time() - begin, max(_status("VmHWM") - before, 0)
    if number is None and kind in ("accepted", "refused"):  # what is used by number may have to compile
        kind = "memory" if growth > MAX_GROWTH else "hang" if seconds > MAX_CPU_S else kind
    return Outcome(kind, text, seconds, growth)


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


def targets_of(place: str) -> dict[str, Target]:
    """Return the targets that a function gives, named as `module:function`."""
    module, _, function = place.partition(":")
    return getattr(importlib.import_module(module), function)()


def start(world: Path, log: Path, place: str) -> None:
    """Make this process a worker, in a folder with a world of its own."""
    file = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(file, 1)
    os.dup2(file, 2)
    faulthandler.enable()
    faulthandler.register(signal.SIGXCPU, chain=True)
    os.environ.pop("OPENCV_LOG_LEVEL", None)
    importlib.import_module("cv2").setNumThreads(1)
    _targets.update(targets_of(place))
    os.chdir(log.parent)
    own, out = Path(shutil.copytree(world, "world")).resolve(), Path("out").resolve()
    if problems := [text for target in _targets.values() for text in refused_valid_inputs(target, own, out)]:
        print("\n".join(problems), flush=True)
        raise SystemExit(1)
    resource.setrlimit(resource.RLIMIT_AS, (psutil.Process().memory_info().vms + ADDRESS_SPACE,) * 2)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def work(name: str, content: bytes, cpu_s: float) -> Outcome:
    """Return the outcome of an input; an endless loop ends the process."""
    resource.setrlimit(resource.RLIMIT_CPU, (int(time.process_time() + cpu_s + 1), resource.RLIM_INFINITY))
    return run_input(_targets[name], content, Path("world").resolve(), Path("out").resolve())


class Campaign:
    """Inputs of all targets in turn, until a number or a time is reached; what fails is kept as a file."""

    def __init__(self, world: Path, out: Path, seed: int, place: str = TARGETS, cpu_s: float = MAX_CPU_S) -> None:
        self.outcomes: Counter[tuple[str, str]] = Counter()
        """Number of each kind, by target and kind."""
        self.failures: dict[Path, Outcome] = {}
        self._world, self._out, self._seed, self._place, self._cpu_s = world, out, seed, place, cpu_s
        self._targets = targets_of(place)
        out.mkdir(parents=True, exist_ok=True)

    def run(self, names: Sequence[str], inputs: int, seconds: float = 600.0, workers: int = 1) -> None:
        """Run the inputs; each worker is driven by a thread."""
        end = time.monotonic() + seconds
        chosen = [(names[turn % len(names)], turn // len(names)) for turn in range(inputs)]

        def drive(number: int) -> None:
            turns = chosen[number::workers]
            while turns and time.monotonic() < end:
                with tempfile.TemporaryDirectory(prefix="sfr-fuzz-") as folder:
                    log = Path(folder) / "log"
                    pool = ProcessPoolExecutor(1, SPAWN, initializer=start, initargs=(self._world, log, self._place))
                    try:
                        pool.submit(os.getpid).result()
                    except BrokenProcessPool as error:
                        raise RuntimeError(f"a worker does not start: {_last_words(log)}") from error
                    for _ in range(min(WORKER_INPUTS, len(turns))):
                        if time.monotonic() > end or not self._run_one(pool, log, *turns.pop(0)):
                            break
                    pool.shutdown()

        with ThreadPoolExecutor(workers) as threads:
            list(threads.map(drive, range(workers)))

    def _run_one(self, pool: ProcessPoolExecutor, log: Path, name: str, index: int) -> bool:
        """Run an input, and tell whether the worker lives."""
        content = make_input(self._targets[name], self._world, self._seed, index)
        lives = True
        try:
            outcome = pool.submit(work, name, content, self._cpu_s).result(MAX_WAIT_S)
        except (BrokenProcessPool, TimeoutError) as error:
            for process in list((pool._processes or {}).values()):
                process.kill()
            lives, kind = False, "hang" if isinstance(error, TimeoutError) else "ended"
            outcome = Outcome(kind, _last_words(log))
        self.outcomes[name, outcome.kind] += 1
        if not outcome.good:
            file = self._out / f"{name.replace(' ', '-').replace('/', '-')}-{index:05d}.input"
            file.write_bytes(content)
            self.failures[file] = outcome
            command = f"make fuzz ARGUMENTS={shlex.quote(shlex.join(['--again', name, str(file)]))}"
            text = f"{outcome.kind}\n{command}\n\n{outcome.text}\n"
            file.with_suffix(".txt").write_text(text, encoding="utf-8", errors="replace")
            print(f"FAILED {outcome.kind}: {name} {index}\n  {command}", flush=True)
        return lives


def _last_words(log: Path) -> str:
    return log.read_text(encoding="utf-8", errors="replace")[-3000:]
