"""Many inputs over several worker processes, each watched for time, memory and its life."""

from __future__ import annotations

import contextlib
import json
import os
import select
import shlex
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

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
TICK_S = 0.05


@dataclass(frozen=True)
class Limits:
    """What an input may take, and where the targets come from (`module:function`)."""

    cpu_s: float = MAX_CPU_S
    targets: str = "targets:all_targets"


@dataclass
class Failure:
    """An input that failed, kept as a file."""

    target: str
    index: int
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

    outcomes: Counter[str] = field(default_factory=Counter)
    by_target: dict[str, Counter[str]] = field(default_factory=dict)
    failures: list[Failure] = field(default_factory=list)
    largest: Outcome = field(default_factory=lambda: Outcome("accepted"))
    slowest: Outcome = field(default_factory=lambda: Outcome("accepted"))

    def add(self, target: str, outcome: Outcome) -> None:
        self.outcomes[outcome.kind] += 1
        self.by_target.setdefault(target, Counter())[outcome.kind] += 1
        self.largest = max(self.largest, outcome, key=lambda item: item.growth_bytes)
        self.slowest = max(self.slowest, outcome, key=lambda item: item.seconds)


class Worker:
    """A worker process."""

    def __init__(self, world: Path, log: Path, limits: Limits) -> None:
        self._limits = limits
        self._log = log.open("w", encoding="utf-8")
        self.process = subprocess.Popen(
            [sys.executable, str(HERE / "fuzz_worker.py"), str(world), limits.targets],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            start_new_session=True,
        )
        self.log = log
        self._received = b""
        begin = time.monotonic()
        while self._answer(1.0) is None:
            if self.process.poll() is not None or time.monotonic() - begin > MAX_START_S:
                raise RuntimeError(f"a worker does not start: {self.last_words()}")
        self.idle = self._memory()

    def run(self, order: dict[str, Any]) -> Outcome:
        """Return the outcome of an input; the process is gone after one that says so."""
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(order).encode() + b"\n")
        self.process.stdin.flush()
        begin = time.monotonic()
        while self._answer(TICK_S) is None:
            if self.process.poll() is not None or time.monotonic() - begin > MAX_WALL_S:
                self.close()
                return Outcome("no input was made", self.last_words())
        answer = self._watched()
        return Outcome(**answer) if isinstance(answer, dict) else answer

    def _watched(self) -> dict[str, Any] | Outcome:
        begin, cpu, memory = time.monotonic(), self._cpu_s(), self._memory()
        largest = 0
        while True:
            answer = self._answer(TICK_S)
            if answer is not None:
                return answer
            if self.process.poll() is not None:
                return Outcome(f"ended by {_signal(self.process.returncode)}", self.last_words(), growth_bytes=largest)
            used, waited = self._cpu_s() - cpu, time.monotonic() - begin
            largest = max(largest, self._memory() - memory)
            if largest > KILL_GROWTH:
                return self._killed("memory", f"more than {largest // 10**6} MB", used, largest)
            if used > self._limits.cpu_s or waited > MAX_WALL_S:
                return self._killed("hang", f"{used:.0f} s of the processor, {waited:.0f} s", used, largest)

    def _killed(self, kind: str, text: str, seconds: float, growth: int) -> Outcome:
        self.process.send_signal(signal.SIGABRT)  # its stack goes to the log
        time.sleep(0.3)
        self.close()
        return Outcome(kind, f"{text}\n{self.last_words()}", seconds, growth)

    def _answer(self, timeout_s: float) -> dict[str, Any] | None:
        stream = self.process.stdout
        assert stream is not None
        if b"\n" not in self._received and select.select([stream], [], [], timeout_s)[0]:
            self._received += os.read(stream.fileno(), 1 << 20)
        line, end, rest = self._received.partition(b"\n")
        if not end:
            return None
        self._received = rest
        return dict(json.loads(line))

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        for stream in (self.process.stdin, self.process.stdout, self._log):
            if stream is not None:
                with contextlib.suppress(OSError):
                    stream.close()

    @property
    def grown(self) -> bool:
        return self.process.poll() is not None or self._memory() > self.idle + WORKER_GROWTH

    def last_words(self) -> str:
        return self.log.read_text(encoding="utf-8", errors="replace")[-3000:]

    def _memory(self) -> int:
        try:
            pages = Path(f"/proc/{self.process.pid}/statm").read_text().split()[1]
        except OSError:
            return 0
        return int(pages) * os.sysconf("SC_PAGE_SIZE")

    def _cpu_s(self) -> float:
        try:
            words = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            return 0.0
        return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def _signal(code: int) -> str:
    return signal.Signals(-code).name if code < 0 else f"exit {code}"


def judged(outcome: Outcome) -> Outcome:
    """Return the outcome, a failure if it took too much."""
    if outcome.good and outcome.growth_bytes > MAX_GROWTH:
        return Outcome("memory", f"{outcome.growth_bytes // 10**6} MB", outcome.seconds, outcome.growth_bytes)
    if outcome.good and outcome.seconds > MAX_CPU_S:
        return Outcome("hang", f"{outcome.seconds:.0f} s", outcome.seconds, outcome.growth_bytes)
    return outcome


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
        try:
            self._run_all(number, orders)
        except Exception as error:
            self._broken = error

    def _run_all(self, number: int, orders: Iterator[tuple[str, int]]) -> None:
        worker: Worker | None = None
        keep = self._out / f"worker-{number}.input"
        while True:
            with self._lock:
                order = next(orders, None)
            if order is None or time.monotonic() > self._end:
                break
            if worker is None or worker.grown:
                if worker is not None:
                    worker.close()
                worker = Worker(self._world, self._out / f"worker-{number}.log", self._limits)
            target, index = order
            outcome = judged(worker.run({"target": target, "seed": self._seed, "index": index, "keep": str(keep)}))
            with self._lock:
                self.summary.add(target, outcome)
                if not outcome.good:
                    self._keep(target, index, outcome, keep)
        if worker is not None:
            worker.close()
        keep.unlink(missing_ok=True)

    def _keep(self, target: str, index: int, outcome: Outcome, content: Path) -> None:
        file = self._out / f"{target.replace(' ', '-').replace('/', '-')}-{index:05d}.input"
        if content.exists():
            content.replace(file)
        failure = Failure(target, index, outcome, file)
        self.summary.failures.append(failure)
        file.with_suffix(".txt").write_text(
            f"{outcome.kind}\n{failure.command}\n\n{outcome.text}\n", encoding="utf-8", errors="replace"
        )
        print(f"{outcome.kind}: {target} {index}\n  {failure.command}", flush=True)


def again(world: Path, target: str, file: Path, out: Path) -> Outcome:
    """Run one kept input alone."""
    out.mkdir(parents=True, exist_ok=True)
    worker = Worker(world, out / "again.log", Limits())
    try:
        return judged(
            worker.run({"target": target, "file": str(file.resolve()), "keep": str((out / "again.input").resolve())})
        )
    finally:
        worker.close()
