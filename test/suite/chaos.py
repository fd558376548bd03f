"""A suite of many small sources on a real Dask cluster whose workers, scheduler and client are killed at random.

    python test/suite/chaos.py [DRIVES] [KILLS] [SEED]      (make suite-chaos)

Each figure is printed with its bound; the exit code is 1 if one is missed. Scheduling costs processor time, that of
client, scheduler, workers and fork servers themselves, and time in which a worker has no task.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import psutil

sys.path.insert(0, str(Path(__file__).parent))
from made_suites import SFR, made_suite, results

DASK_CONFIG = Path(__file__).parents[2] / "config" / "dask.yaml"
PAUSE_S = (1.5, 4.0)
IDLE_S = 30.0
"""After this time without a result a process is killed all the same."""
RESUME_S, RESUMES = 5.0, 3
COST_SHARE = 0.02
COST_DRIVES, COST_POSES = 40, 4000
"""Of the suite whose cost is measured: its tasks take about a second, real ones ten to a thousand."""
END_S = 3600.0


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Cluster:
    """A scheduler and two workers as processes, each started again once it was killed."""

    def __init__(self, folder: Path) -> None:
        self.address = f"tcp://127.0.0.1:{free_port()}"
        self._folder = folder
        self.scheduler = self._start_scheduler()
        self.workers = [self._start_worker(number) for number in range(2)]

    def _start(self, name: str, *arguments: str) -> subprocess.Popen[bytes]:
        log = (self._folder / f"{name}.log").open("ab")
        environment = {**os.environ, "DASK_CONFIG": str(DASK_CONFIG)}
        return subprocess.Popen([sys.executable, "-m", *arguments], stdout=log, stderr=log, env=environment)

    def _start_scheduler(self) -> subprocess.Popen[bytes]:
        port = self.address.rpartition(":")[2]
        return self._start(
            "scheduler", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", port, "--no-dashboard"
        )

    def _start_worker(self, number: int) -> subprocess.Popen[bytes]:
        options = ("--nthreads", "1", "--no-nanny", "--no-dashboard", "--name", str(number))
        place = ("--local-directory", str(self._folder / f"worker{number}"))
        return self._start(f"worker{number}", "distributed.cli.dask_worker", self.address, *options, *place)

    def kill_scheduler(self) -> None:
        self.scheduler.kill()
        self.scheduler.wait()
        self.scheduler = self._start_scheduler()

    def kill_worker(self, number: int) -> None:
        self.workers[number].kill()
        self.workers[number].wait()
        self.workers[number] = self._start_worker(number)

    def revive(self) -> None:
        """Start workers again that have ended with their scheduler."""
        for number, worker in enumerate(self.workers):
            if worker.poll() is not None:
                self.workers[number] = self._start_worker(number)

    def close(self) -> None:
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()


class Watch(threading.Thread):
    """Notes when each result is written; a second time is a fault."""

    def __init__(self, folder: Path) -> None:
        super().__init__(daemon=True)
        self.folder, self.seen, self.twice, self.ended = folder, {}, [], threading.Event()

    def run(self) -> None:
        while not self.ended.wait(0.05):
            for path in self.folder.glob("*.json"):
                stamp = path.stat().st_mtime_ns
                if self.seen.setdefault(path.name, stamp) != stamp:
                    self.twice.append(path.name)
                    self.seen[path.name] = stamp


@contextlib.contextmanager
def watched(folder: Path) -> Iterator[Watch]:
    watch = Watch(folder)
    watch.start()
    try:
        yield watch
    finally:
        time.sleep(0.2)
        watch.ended.set()
        watch.join()


def own_s(process: psutil.Process) -> float:
    times = process.cpu_times()
    return times.user + times.system


class Costs:
    """Processor time of the suite's own processes and of the tasks, since a moment."""

    def __init__(self, client: int, cluster: Cluster) -> None:
        workers = [psutil.Process(worker.pid) for worker in cluster.workers]
        self._servers = [child for worker in workers for child in worker.children()]
        self._own = [psutil.Process(client), psutil.Process(cluster.scheduler.pid), *workers, *self._servers]
        self._begin = self._now()
        self.own_s, self.tasks_s = [0.0] * len(self._own), 0.0

    def _now(self) -> tuple[list[float], float]:
        ended = [server.cpu_times() for server in self._servers]
        return [own_s(item) for item in self._own], sum(item.children_user + item.children_system for item in ended)

    def update(self) -> None:
        with contextlib.suppress(psutil.Error):
            own, tasks = self._now()
            self.own_s = [now - before for now, before in zip(own, self._begin[0], strict=True)]
            self.tasks_s = tasks - self._begin[1]


def measure_cost(folder: Path, cluster: Cluster) -> list[bool]:
    """Run a suite undisturbed; print what scheduling costs once all workers have begun."""
    suite, out = made_suite(folder / "cost", COST_DRIVES, poses=COST_POSES), folder / "cost-out"
    command = [*SFR, "suite", "run", str(suite), "--out", str(out), "--scheduler", cluster.address]
    with watched(out / "results") as watch, (folder / "cost.log").open("wb") as log:
        client = subprocess.Popen(command, stdout=log, stderr=log)
        while len(watch.seen) < 4:  # each worker has done one, and loaded what it needs
            assert client.poll() is None, (folder / "cost.log").read_text()
            time.sleep(0.02)
        costs, early, begin = Costs(client.pid, cluster), set(watch.seen), time.monotonic()
        while client.poll() is None and len(watch.seen) < COST_DRIVES - 1:  # at the end a worker has nothing to do
            costs.update()
            time.sleep(0.02)
        late, slots_s = set(watch.seen) - early, 2.0 * (time.monotonic() - begin)
        client.wait()
    drives = json.loads((out / "suite.json").read_text())["drives"]
    tasks_s = sum(drive["seconds"] for drive in drives if f"{drive['key']}.json" in late)
    names = ("client", "scheduler", "worker", "worker", "fork server", "fork server")
    each = zip(names, costs.own_s, strict=True)
    text = ", ".join(f"{name} {1e3 * value / len(late):.1f}" for name, value in each)
    print(f"{len(late)} tasks of {tasks_s / len(late):.2f} s, processor time {costs.tasks_s / len(late):.2f} s each")
    print(f"beside it, processor time in ms a task: {text}")
    own, idle = sum(costs.own_s) / slots_s, 1.0 - tasks_s / slots_s
    return [
        shown("processor time of scheduling, share of the slots' time", own, own < COST_SHARE, f"< {COST_SHARE}"),
        shown("slots without a task, share of their time", idle, idle < COST_SHARE, f"< {COST_SHARE}"),
    ]


def measure_resume(folder: Path, out: Path, command: list[str]) -> bool:
    """Take away a result, as if the client was killed before it; print when the same command has made it again."""
    walls, processors = [], []
    for path in sorted((out / "results").glob("*.json"))[:RESUMES]:
        path.unlink()
        begin = time.monotonic()
        with (folder / "resume.log").open("ab") as log:
            client = subprocess.Popen(command, stdout=log, stderr=log)
        process, own = psutil.Process(client.pid), 0.0
        while not path.exists() and client.poll() is None:
            own = own_s(process)
            time.sleep(0.02)
        walls.append(time.monotonic() - begin)
        processors.append(own)
        assert client.wait() == 0, (folder / "resume.log").read_text()
    wall = sorted(walls)[RESUMES // 2]
    each = ", ".join(f"{wall:.1f} ({own:.1f})" for wall, own in zip(walls, processors, strict=True))
    print(f"resumed after, s (of which processor time of the client): {each}")
    return shown("first result after a start of the client, s, median", wall, wall < RESUME_S, f"< {RESUME_S:g}")


def shown(name: str, value: object, ok: bool, bound: str) -> bool:
    text = f"{value:.4g}" if isinstance(value, float) else str(value)
    print(f"{'shown ' if ok else 'MISSED'}  {name}: {text} ({bound})", flush=True)
    return ok


class Chaos:
    """Kills one process after another while clients run, each started again until the suite is done."""

    def __init__(self, folder: Path, cluster: Cluster, kills: int, seed: int) -> None:
        self._folder, self._cluster, self._kills = folder, cluster, kills
        self._rng = random.Random(seed)
        self.done: list[str] = []
        self.clients = 0

    def run(self, command: list[str], watch: Watch) -> float:
        """Return the seconds that it took.

        Raises:
            TimeoutError: If it does not come to an end.
        """
        begin = time.monotonic()
        while time.monotonic() - begin < END_S:
            with (self._folder / "client.log").open("ab") as log:
                client = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=log)
            self.clients += 1
            self._watch_client(client, watch)
            self._cluster.revive()
            if client.returncode == 0:
                return time.monotonic() - begin
        raise TimeoutError("not done in an hour")

    def _watch_client(self, client: subprocess.Popen[bytes], watch: Watch) -> None:
        pause, counted = time.monotonic() + self._rng.uniform(*PAUSE_S), len(watch.seen)
        while client.poll() is None:
            # in the midst of work, not only while everything starts again
            late = time.monotonic() > pause and (len(watch.seen) > counted or time.monotonic() > pause + IDLE_S)
            if len(self.done) < self._kills and late:
                counted = len(watch.seen)
                self._kill(client, counted)
                pause = time.monotonic() + self._rng.uniform(*PAUSE_S)
            time.sleep(0.02)

    def _kill(self, client: subprocess.Popen[bytes], count: int) -> None:
        victim = self._rng.choice(["worker 0", "worker 1", "scheduler", "client"])
        self.done.append(victim)
        print(f"{count} results: kill {victim}", flush=True)
        if victim == "client":
            client.send_signal(signal.SIGKILL)
        elif victim == "scheduler":
            self._cluster.kill_scheduler()
        else:
            self._cluster.kill_worker(int(victim[-1]))


def serial(suite: Path, out: Path) -> None:
    begin = time.monotonic()
    subprocess.run([*SFR, "suite", "run", suite, "--out", out, "--workers", "1"], check=True, capture_output=True)
    seconds = [drive["seconds"] for drive in json.loads((out / "suite.json").read_text())["drives"]]
    print(f"serial: {time.monotonic() - begin:.1f} s, of which tasks {sum(seconds):.1f} s", flush=True)


def main(drives: int = 200, kills: int = 10, seed: int = 0) -> int:
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores", flush=True)
    with tempfile.TemporaryDirectory(prefix="sfr-chaos-") as name:
        folder = Path(name)
        suite, out = made_suite(folder / "made", drives), folder / "out"
        serial(suite, folder / "serial")
        cluster = Cluster(folder)
        try:
            cheap = measure_cost(folder, cluster)
            command = [*SFR, "suite", "run", str(suite), "--out", str(out), "--scheduler", cluster.address]
            chaos = Chaos(folder, cluster, kills, seed)
            with watched(out / "results") as watch:
                seconds = chaos.run(command, watch)
            same = results(out) == results(folder / "serial")
            quick = measure_resume(folder, out, command)
        finally:
            cluster.close()
        print(f"{len(chaos.done)} kills, {seconds:.1f} s, {chaos.clients} starts of the client")
        checks = [
            *cheap,
            quick,
            shown("kills", len(chaos.done), len(chaos.done) == kills, f"{kills}"),
            shown("results", len(watch.seen), len(watch.seen) == drives, f"{drives}"),
            shown("bit-identical to the serial run", same, same, "True"),
            shown("written twice", len(set(watch.twice)), not watch.twice, "0"),
        ]
        print(f"load {os.getloadavg()[0]:.1f}")
        return 0 if all(checks) else 1


if __name__ == "__main__":
    raise SystemExit(main(*map(int, sys.argv[1:])))
