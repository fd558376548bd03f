"""A suite of many small sources on a real Dask cluster whose workers, scheduler and client are killed at random.

    python test/suite/chaos.py [DRIVES] [KILLS] [SEED]      (make suite-chaos)

It passes if the results are bit-identical to those of a serial run, and no result was written twice.
"""

from __future__ import annotations

import json
import random
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from made_suites import SFR, made_suite, results


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
        return subprocess.Popen([sys.executable, "-m", *arguments], stdout=log, stderr=log)

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


def main(drives: int = 200, kills: int = 10, seed: int = 0) -> int:
    rng = random.Random(seed)
    with tempfile.TemporaryDirectory(prefix="sfr-chaos-") as name:
        folder = Path(name)
        suite = made_suite(folder / "made", drives)
        begin = time.monotonic()
        subprocess.run([*SFR, "suite", "run", suite, "--out", folder / "serial", "--workers", "1"], check=True)
        serial_s = time.monotonic() - begin
        seconds = [drive["seconds"] for drive in json.loads((folder / "serial" / "suite.json").read_text())["drives"]]
        print(f"serial: {serial_s:.1f} s, of which tasks {sum(seconds):.1f} s", flush=True)
        cluster, out = Cluster(folder), folder / "out"
        watch = Watch(out / "results")
        watch.start()
        done, resumed = [], []
        command = [*SFR, "suite", "run", str(suite), "--out", str(out), "--scheduler", cluster.address]
        begin = time.monotonic()
        try:
            while True:
                started, before = time.monotonic(), len(watch.seen)
                client = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=(folder / "client.log").open("ab"))
                first = None
                pause = started + rng.uniform(3.0, 8.0)
                while client.poll() is None:
                    if first is None and len(watch.seen) > before:
                        first = time.monotonic() - started
                        resumed.append(first)
                    if len(done) < kills and time.monotonic() > pause:
                        victim = rng.choice(["worker 0", "worker 1", "scheduler", "client"])
                        done.append(victim)
                        print(f"{len(watch.seen)} results: kill {victim}", flush=True)
                        if victim == "client":
                            client.send_signal(signal.SIGKILL)
                        elif victim == "scheduler":
                            cluster.kill_scheduler()
                        else:
                            cluster.kill_worker(int(victim[-1]))
                        pause = time.monotonic() + rng.uniform(3.0, 8.0)
                    time.sleep(0.02)
                cluster.revive()
                if client.returncode == 0:
                    break
                if time.monotonic() - begin > 3600:
                    print("not done in an hour")
                    return 1
            total_s = time.monotonic() - begin
        finally:
            cluster.close()
            watch.ended.set()
            watch.join()
        same = results(out) == results(folder / "serial")
        late = max(resumed) if resumed else float("nan")
        print(f"{len(done)} kills, {total_s:.1f} s; first result {late:.1f} s after a start of the client at most")
        print(f"results: {len(watch.seen)} of {drives}, identical: {same}, written twice: {len(set(watch.twice))}")
        return 0 if same and not watch.twice and len(watch.seen) == drives else 1


if __name__ == "__main__":
    raise SystemExit(main(*map(int, sys.argv[1:])))
