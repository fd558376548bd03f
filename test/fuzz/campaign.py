"""Many inputs over several worker processes, each watched for time, memory and its life."""

from __future__ import annotations

import faulthandler
import importlib
import os
import resource
import shlex
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Lock

import psutil
from execution import Outcome, Target, make_input, refused_valid_inputs, run_input

MAX_GROWTH = 500_000_000
"""Bytes that the memory of a warm process may grow by during one input; a worker is killed at three times as much."""
MAX_CPU_S = 10.0
"""Time of the processor, so that a busy host changes nothing; what only waits has six times as much of the clock."""
WORKER_GROWTH = 400_000_000
"""A worker that has grown by this over many inputs is replaced."""
ADDRESS_SPACE = 8 * 2**30
"""Bytes that may be reserved beyond what the warm process has: protects the host, not the measure of memory."""
SPAWN = get_context("spawn")


def targets_of(place: str) -> dict[str, Target]:
    """Return the targets that a function gives, named as `module:function`."""
    module, _, function = place.partition(":")
    return getattr(importlib.import_module(module), function)()


def serve(inputs: Connection, world: Path, log: Path, place: str) -> None:
    """Be a worker: answer each target and content with the outcome."""
    file = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(file, 1)
    os.dup2(file, 2)
    faulthandler.enable()
    os.environ.pop("OPENCV_LOG_LEVEL", None)
    importlib.import_module("cv2").setNumThreads(1)
    targets = targets_of(place)
    with tempfile.TemporaryDirectory(prefix="sfr-fuzz-") as folder:
        own, out = Path(folder) / "world", Path(folder) / "out"
        shutil.copytree(world, own)
        os.chdir(folder)
        if problems := [text for target in targets.values() for text in refused_valid_inputs(target, own, out)]:
            raise SystemExit("\n".join(problems))
        resource.setrlimit(resource.RLIMIT_AS, (psutil.Process().memory_info().vms + ADDRESS_SPACE,) * 2)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        inputs.send("warm")
        while True:
            name, content = inputs.recv()
            inputs.send(run_input(targets[name], content, own, out))


class Worker:
    """A worker process."""

    def __init__(self, world: Path, log: Path, place: str) -> None:
        self._log = log
        self._pipe, other = SPAWN.Pipe()
        self._process = SPAWN.Process(target=serve, args=(other, world, log, place), daemon=True)
        self._process.start()
        other.close()
        try:
            self._pipe.recv()
        except EOFError:
            raise RuntimeError(f"a worker does not start: {self._last_words()}") from None
        self._status = psutil.Process(self._process.pid)
        self._idle = self._status.memory_info().rss

    def run(self, name: str, content: bytes, cpu_s: float) -> Outcome:
        """Return the outcome of an input; the process is gone after one that says so."""
        begin, before, memory = time.monotonic(), self._cpu_s(), self._status.memory_info().rss
        self._pipe.send((name, content))
        growth, used = 0, 0.0
        while not self._pipe.poll(0.05):
            growth, used = max(growth, self._status.memory_info().rss - memory), self._cpu_s() - before
            if growth > 3 * MAX_GROWTH or used > cpu_s or time.monotonic() - begin > 6 * MAX_CPU_S:
                self._process.kill() if growth > 3 * MAX_GROWTH else self._status.send_signal(signal.SIGABRT)
                self._process.join()  # its stack is in the log
                return Outcome("memory" if growth > 3 * MAX_GROWTH else "hang", self._last_words(), used, growth)
        try:
            outcome: Outcome = self._pipe.recv()
        except EOFError:
            self._process.join()
            code = self._process.exitcode or 0
            kind = f"ended by {signal.Signals(-code).name if code < 0 else f'exit {code}'}"
            return Outcome(kind, self._last_words(), used, growth)
        if outcome.good and outcome.growth_bytes > MAX_GROWTH:
            return replace(outcome, kind="memory")
        return replace(outcome, kind="hang") if outcome.good and outcome.seconds > MAX_CPU_S else outcome

    @property
    def usable(self) -> bool:
        return self._process.is_alive() and self._status.memory_info().rss < self._idle + WORKER_GROWTH

    def close(self) -> None:
        self._process.kill()
        self._process.join()

    def _cpu_s(self) -> float:
        times = self._status.cpu_times()
        return times.user + times.system

    def _last_words(self) -> str:
        return self._log.read_text(encoding="utf-8", errors="replace")[-3000:]


class Campaign:
    """Inputs of all targets in turn, until a number or a time is reached; what fails is kept as a file."""

    def __init__(self, world: Path, out: Path, seed: int, place: str = "targets:all_targets") -> None:
        self.outcomes: Counter[tuple[str, str]] = Counter()
        """Number of each kind, by target and kind."""
        self.failures: dict[Path, Outcome] = {}
        self.growth_bytes, self.seconds = 0, 0.0
        self._world, self._out, self._seed, self._place = world, out, seed, place
        self._targets, self._lock = targets_of(place), Lock()
        out.mkdir(parents=True, exist_ok=True)

    def run(
        self, names: Sequence[str], inputs: int, seconds: float = 600.0, workers: int = 1, cpu_s: float = MAX_CPU_S
    ) -> None:
        """Run the inputs; each worker is driven by a thread."""
        end = time.monotonic() + seconds

        def drive(number: int) -> None:
            worker = None
            for turn in range(number, inputs, workers):
                if time.monotonic() > end:
                    break
                if worker is None or not worker.usable:
                    if worker is not None:
                        worker.close()
                    worker = Worker(self._world, self._out / f"worker-{number}.log", self._place)
                name, index = names[turn % len(names)], turn // len(names)
                content = make_input(self._targets[name], self._world, self._seed, index)
                outcome = worker.run(name, content, cpu_s)
                with self._lock:
                    self.outcomes[name, outcome.kind] += 1
                    self.growth_bytes = max(self.growth_bytes, outcome.growth_bytes)
                    self.seconds = max(self.seconds, outcome.seconds)
                if not outcome.good:
                    self._keep(name, index, outcome, content)
            if worker is not None:
                worker.close()

        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(drive, range(workers)))

    def _keep(self, name: str, index: int, outcome: Outcome, content: bytes) -> None:
        file = self._out / f"{name.replace(' ', '-').replace('/', '-')}-{index:05d}.input"
        file.write_bytes(content)
        self.failures[file] = outcome
        here = os.path.relpath(Path(__file__).parent)
        command = shlex.join([os.path.relpath(sys.executable), here, "--again", name, str(file)])
        text = f"{outcome.kind}\n{command}\n\n{outcome.text}\n"
        file.with_suffix(".txt").write_text(text, encoding="utf-8", errors="replace")
        print(f"FAILED {outcome.kind}: {name} {index}\n  {command}", flush=True)
