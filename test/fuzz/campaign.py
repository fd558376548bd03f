"""Many inputs over several worker processes, each watched for time, memory and its life."""

from __future__ import annotations

import faulthandler
import importlib
import multiprocessing
import os
import resource
import shlex
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path

import execution
import psutil
from execution import Outcome

HERE = Path(__file__).resolve().parent
MAX_GROWTH = 500_000_000
"""Bytes that the memory of a warm process may grow by during one input."""
KILL_GROWTH = 1_500_000_000
MAX_CPU_S = 10.0
MAX_WALL_S = 60.0
"""Of one input: time of the processor, so that a busy host changes nothing, and of the clock for what only waits."""
MAX_START_S = 600.0
WORKER_GROWTH = 400_000_000
"""A worker that has grown by this over many inputs is replaced."""
ADDRESS_SPACE = 8 * 2**30
"""Bytes that may be reserved beyond what the warm process has: protects the host, not the measure of memory."""
TICK_S = 0.05
SPAWN = multiprocessing.get_context("spawn")


@dataclass(frozen=True)
class Limits:
    """What an input may take, and where the targets come from (`module:function`)."""

    cpu_s: float = MAX_CPU_S
    targets: str = "targets:all_targets"


@dataclass(frozen=True)
class Order:
    """An input: the number of one that is made, or a file; its content is kept at a place."""

    target: str
    keep: Path
    seed: int = 0
    index: int = 0
    file: Path | None = None


@dataclass
class Failure:
    """An input that failed, kept as a file."""

    target: str
    outcome: Outcome
    file: Path

    @property
    def command(self) -> str:
        """What repeats it alone."""
        call = [os.path.relpath(sys.executable), os.path.relpath(HERE), "--again", self.target, str(self.file)]
        return shlex.join(call)


@dataclass
class Summary:
    """What a campaign found."""

    by_target: dict[str, Counter[str]] = field(default_factory=lambda: defaultdict(Counter))
    failures: list[Failure] = field(default_factory=list)
    growth_bytes: int = 0
    seconds: float = 0.0

    def add(self, target: str, outcome: Outcome) -> None:
        self.by_target[target][outcome.kind] += 1
        self.growth_bytes = max(self.growth_bytes, outcome.growth_bytes)
        self.seconds = max(self.seconds, outcome.seconds)


def serve(orders: Connection, world: Path, log: Path, place: str) -> None:
    """Be a worker: answer orders with `None` once the input is there, then with the outcome."""
    file = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(file, 1)
    os.dup2(file, 2)
    faulthandler.enable()
    os.environ.pop("OPENCV_LOG_LEVEL", None)
    importlib.import_module("cv2").setNumThreads(1)
    module, _, function = place.partition(":")
    targets: dict[str, execution.Target] = getattr(importlib.import_module(module), function)()
    with tempfile.TemporaryDirectory(prefix="sfr-fuzz-") as folder:
        own, out = Path(folder) / "world", Path(folder) / "out"
        shutil.copytree(world, own)
        os.chdir(folder)
        problems = [text for target in targets.values() for text in execution.refused_valid_inputs(target, own, out)]
        if problems:
            raise SystemExit("\n".join(problems))
        resource.setrlimit(resource.RLIMIT_AS, (psutil.Process().memory_info().vms + ADDRESS_SPACE,) * 2)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        orders.send(None)
        while True:
            order: Order = orders.recv()
            target = targets[order.target]
            content = execution.make_input(target, world, order.seed, order.index)
            if order.file is not None:
                content = order.file.read_bytes()
            order.keep.write_bytes(content)
            orders.send(None)
            orders.send(execution.run_input(target, content, own, out))


class Worker:
    """A worker process."""

    def __init__(self, world: Path, log: Path, limits: Limits) -> None:
        self._limits, self._log = limits, log
        self._pipe, other = SPAWN.Pipe()
        self._process = SPAWN.Process(target=serve, args=(other, world, log, limits.targets), daemon=True)
        self._process.start()
        other.close()
        if not self._pipe.poll(MAX_START_S) or not self._alive():
            raise RuntimeError(f"a worker does not start: {self._last_words()}")
        self._pipe.recv()
        self._status = psutil.Process(self._process.pid)
        self._idle = self._status.memory_info().rss

    def run(self, order: Order) -> Outcome:
        """Return the outcome of an input; the process is gone after one that says so."""
        self._pipe.send(order)
        if not self._pipe.poll(MAX_WALL_S) or not self._alive():
            self.close()
            return Outcome("no input was made", self._last_words())
        self._pipe.recv()
        begin, cpu, memory = time.monotonic(), self._cpu_s(), self._status.memory_info().rss
        largest, used = 0, 0.0
        while not self._pipe.poll(TICK_S):
            used, waited = self._cpu_s() - cpu, time.monotonic() - begin
            largest = max(largest, self._status.memory_info().rss - memory)
            if largest > KILL_GROWTH:
                return self._killed("memory", f"more than {largest // 10**6} MB", used, largest)
            if used > self._limits.cpu_s or waited > MAX_WALL_S:
                return self._killed("hang", f"{used:.0f} s of the processor, {waited:.0f} s", used, largest)
        try:
            outcome: Outcome = self._pipe.recv()
        except EOFError:
            self._process.join()
            code = self._process.exitcode or 0
            kind = f"ended by {signal.Signals(-code).name if code < 0 else f'exit {code}'}"
            return Outcome(kind, self._last_words(), used, largest)
        if outcome.good and outcome.growth_bytes > MAX_GROWTH:
            return Outcome("memory", f"{outcome.growth_bytes // 10**6} MB", outcome.seconds, outcome.growth_bytes)
        if outcome.good and outcome.seconds > MAX_CPU_S:
            return Outcome("hang", f"{outcome.seconds:.0f} s", outcome.seconds, outcome.growth_bytes)
        return outcome

    @property
    def grown(self) -> bool:
        return not self._process.is_alive() or self._status.memory_info().rss > self._idle + WORKER_GROWTH

    def close(self) -> None:
        self._process.kill()
        self._process.join()

    def _killed(self, kind: str, text: str, seconds: float, growth: int) -> Outcome:
        self._status.send_signal(signal.SIGABRT)  # its stack goes to the log
        time.sleep(0.3)
        self.close()
        return Outcome(kind, f"{text}\n{self._last_words()}", seconds, growth)

    def _alive(self) -> bool:
        """Tell, where there is something to receive, whether it is not the end of the process."""
        self._process.join(0.0)
        return self._process.is_alive()

    def _cpu_s(self) -> float:
        times = self._status.cpu_times()
        return float(times.user + times.system)

    def _last_words(self) -> str:
        return self._log.read_text(encoding="utf-8", errors="replace")[-3000:]


class Campaign:
    """Inputs of all targets, one after the other, until a number or a time is reached."""

    def __init__(self, world: Path, out: Path, seed: int, workers: int, limits: Limits | None = None) -> None:
        self.summary, self._limits = Summary(), limits or Limits()
        self._world, self._out, self._seed, self._workers = world, out, seed, workers
        self._lock = threading.Lock()
        self._broken: Exception | None = None

    def run(self, targets: Sequence[str], inputs: int, seconds: float) -> Summary:
        """Run the inputs; each worker is driven by a thread."""
        self._out.mkdir(parents=True, exist_ok=True)
        self._end = time.monotonic() + seconds
        orders = iter([(targets[number % len(targets)], number // len(targets)) for number in range(inputs)])
        threads = [threading.Thread(target=self._drive, args=(number, orders)) for number in range(self._workers)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        if self._broken is not None:
            raise self._broken
        return self.summary

    def _drive(self, number: int, orders: Iterator[tuple[str, int]]) -> None:
        worker, keep = None, self._out / f"worker-{number}.input"
        try:
            while time.monotonic() < self._end:
                with self._lock:
                    order = next(orders, None)
                if order is None:
                    break
                if worker is None or worker.grown:
                    if worker is not None:
                        worker.close()
                    worker = Worker(self._world, self._out / f"worker-{number}.log", self._limits)
                target, index = order
                outcome = worker.run(Order(target, keep, self._seed, index))
                with self._lock:
                    self.summary.add(target, outcome)
                    if not outcome.good:
                        self._keep(target, index, outcome, keep)
        except Exception as error:
            self._broken = error
        if worker is not None:
            worker.close()
        keep.unlink(missing_ok=True)

    def _keep(self, target: str, index: int, outcome: Outcome, content: Path) -> None:
        file = self._out / f"{target.replace(' ', '-').replace('/', '-')}-{index:05d}.input"
        if content.exists():
            content.replace(file)
        failure = Failure(target, outcome, file)
        self.summary.failures.append(failure)
        text = f"{outcome.kind}\n{failure.command}\n\n{outcome.text}\n"
        file.with_suffix(".txt").write_text(text, encoding="utf-8", errors="replace")
        print(f"{outcome.kind}: {target} {index}\n  {failure.command}", flush=True)


def again(world: Path, target: str, file: Path, out: Path) -> Outcome:
    """Run one kept input alone."""
    worker = Worker(world, out / "again.log", Limits())
    try:
        return worker.run(Order(target, (out / "again.input").resolve(), file=file.resolve()))
    finally:
        worker.close()
