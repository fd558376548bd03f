"""Runs inputs in worker processes with limits of time and memory, and classifies the outcomes."""

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
"""Reads the mutated file; may raise an `SfrError`."""
MAX_GROWTH = 500_000_000
"""Largest memory growth of a warm process during one input, bytes."""
MAX_CPU_S = 10.0
"""Processor time limit, which does not depend on the load of the host."""
MAX_LINE = 1000
"""Largest length of a line, characters."""
CONTROL = re.compile(r"[^\n\t\x20-\x7e\u00a0-\ud7ff\ue000-\U0010ffff]|[\u202a-\u202e\u2066-\u2069]")
"""Characters that must not reach a terminal: controls, lone surrogates, bidirectional overrides."""
MAX_WAIT_S = 6 * MAX_CPU_S
"""Wall-clock limit, s, for inputs that only wait and use no processor time."""
WORKER_INPUTS = 300
"""Inputs after which a worker is replaced, because libraries keep memory."""
ADDRESS_SPACE = 8 * 2**30
"""Address space beyond that of a warm process, bytes: protects the host, and is not part of the memory measurement."""
SPAWN = get_context("spawn")
TARGETS = "campaigns.fuzz.targets:all_targets"
"""Module and function from which a worker gets its targets."""
_targets: dict[str, Target] = {}


@dataclass(frozen=True)
class Target:
    """A format: a valid file in the world, and commands and readers, of which the content of an input selects one.

    In commands, `{w}` is the world and `{o}` the output folder.
    """

    name: str
    place: str
    mutations: tuple[Mutation, ...]
    uses: tuple[Command | Reader, ...]


@dataclass(frozen=True)
class Outcome:
    """Outcome of an input: `accepted`, `refused` or a failure, with the error or the end of a traceback."""

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
    """Return an input, which depends only on target, seed and index."""
    rng = Random(f"{seed}/{target.name}/{index}")
    return mutated(rng, (world / target.place).read_bytes(), target.mutations)


def refused_valid_inputs(target: Target, world: Path, out: Path) -> list[str]:
    """Run all uses of the valid file, so that inputs do not include compilation; return the failures."""
    content = (world / target.place).read_bytes()
    found = [run_input(target, content, world, out, number) for number in range(len(target.uses))]
    return [f"valid input of {target.name}: {item.kind}: {item.text}" for item in found if item.kind != "accepted"]


def run_input(target: Target, content: bytes, world: Path, out: Path, number: int | None = None) -> Outcome:
    """Replace the valid file by an input, run the use of its content, or of a number, and restore the valid file."""
    place = world / target.place
    valid = place.read_bytes()
    use = target.uses[(zlib.crc32(content) if number is None else number) % len(target.uses)]
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    place.write_bytes(content)
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")  # resets the peak memory
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
    if number is None and kind in ("accepted", "refused"):  # uses by number may include compilation
        kind = "memory" if growth > MAX_GROWTH else "hang" if seconds > MAX_CPU_S else kind
    return Outcome(kind, text, seconds, growth)


def _judged(code: int, shown: str, errors: str) -> tuple[str, str]:
    """Return the kind and text of an outcome from the exit code and the output of a command."""
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
    """Return the targets of a function `module:function`."""
    module, _, function = place.partition(":")
    return getattr(importlib.import_module(module), function)()


def start(world: Path, log: Path, place: str) -> None:
    """Initialise a worker process in a folder with its own copy of the world."""
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
    """Return the outcome of an input; an endless loop exceeds the time limit and kills the process."""
    resource.setrlimit(resource.RLIMIT_CPU, (int(time.process_time() + cpu_s + 1), resource.RLIM_INFINITY))
    return run_input(_targets[name], content, Path("world").resolve(), Path("out").resolve())


class Campaign:
    """Runs inputs of all targets in turn, up to a number or a time; failed inputs are stored as files."""

    def __init__(self, world: Path, out: Path, seed: int, place: str = TARGETS, cpu_s: float = MAX_CPU_S) -> None:
        self.outcomes: Counter[tuple[str, str]] = Counter()
        """Number of outcomes by target and kind."""
        self.failures: dict[Path, Outcome] = {}
        self._world, self._out, self._seed, self._place, self._cpu_s = world, out, seed, place, cpu_s
        self._targets = targets_of(place)
        out.mkdir(parents=True, exist_ok=True)

    def run(self, names: Sequence[str], inputs: int, seconds: float = 600.0, workers: int = 1) -> None:
        """Run the inputs with one thread per worker."""
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
        """Run an input; return whether the worker is alive."""
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
