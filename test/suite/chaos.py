"""A suite on a running Dask cluster whose workers, scheduler and client are killed at random.

    python test/suite/chaos.py [DRIVES] [KILLS] [SEED]      (make suite-chaos)

The results must be those of a serial run, bit for bit. What is missed is printed; the exit code is then 1.
"""

from __future__ import annotations

import os
import random
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil

sys.path.insert(0, str(Path(__file__).parent))
from made_suites import SFR, made_suite, results

DASK_CONFIG = Path(__file__).parents[2] / "config" / "dask.yaml"
PAUSE_S = (1.5, 4.0)
END_S = 1800.0


class Cluster:
    """A scheduler, and a process that keeps two workers; both are started again once they have ended."""

    def __init__(self, folder: Path) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        self.address, self._folder = f"tcp://127.0.0.1:{port}", folder
        place = ("--host", "127.0.0.1", "--no-dashboard")
        limits = ("--memory-limit", "2GB", "--local-directory", str(folder / "workers"), "--death-timeout", "20")
        self._commands = {
            "scheduler": ("scheduler", *place, "--port", str(port)),
            "workers": ("worker", self.address, *place, "--nworkers", "2", "--nthreads", "1", *limits),
        }
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self.revive()

    def revive(self) -> None:
        for name, command in self._commands.items():
            process = self._processes.get(name)
            if process is None or process.poll() is not None:
                log = (self._folder / f"{name}.log").open("ab")
                self._processes[name] = subprocess.Popen(
                    [sys.executable, "-m", "dask", *command],
                    stdout=log,
                    stderr=log,
                    env={**os.environ, "DASK_CONFIG": str(DASK_CONFIG)},
                )

    def kill_scheduler(self) -> None:
        self._processes["scheduler"].kill()
        self._processes["scheduler"].wait()

    def kill_worker(self, rng: random.Random) -> None:
        children = psutil.Process(self._processes["workers"].pid).children()
        workers = [child for child in children if any("spawn_main" in part for part in child.cmdline())]
        if workers:
            rng.choice(workers).kill()

    def close(self) -> None:
        for process in self._processes.values():
            process.terminate()
            process.wait()


def run_until_done(command: list[str], out: Path, cluster: Cluster, kills: int, rng: random.Random) -> int:
    """Give the same command until it succeeds, and kill meanwhile; return how often it was given."""
    end, starts = time.monotonic() + END_S, 0
    while time.monotonic() < end:
        client, starts = subprocess.Popen(command, stdout=subprocess.DEVNULL), starts + 1
        while client.poll() is None:
            time.sleep(rng.uniform(*PAUSE_S))
            if kills and list((out / "results").glob("*.json")):
                kills -= 1
                victim = rng.choice(["worker", "worker", "scheduler", "client"])
                print(f"{len(list((out / 'results').glob('*.json')))} results: kill {victim}", flush=True)
                if victim == "client":
                    client.send_signal(signal.SIGKILL)
                elif victim == "scheduler":
                    cluster.kill_scheduler()
                else:
                    cluster.kill_worker(rng)
            cluster.revive()
        if client.returncode == 0:
            return starts
    raise TimeoutError(f"not done after {END_S:g} s")


def main(drives: int = 200, kills: int = 10, seed: int = 0) -> int:
    with tempfile.TemporaryDirectory(prefix="sfr-chaos-") as name:
        folder = Path(name)
        suite, serial, out = made_suite(folder / "made", drives, poses=4000), folder / "serial", folder / "out"
        subprocess.run(
            [*SFR, "suite", "run", suite, "--out", serial, "--workers", "1"], check=True, capture_output=True
        )
        cluster = Cluster(folder)
        try:
            begin = time.monotonic()
            command = [*SFR, "suite", "run", str(suite), "--out", str(out), "--scheduler", cluster.address]
            starts = run_until_done([*command, "--retry-failed"], out, cluster, kills, random.Random(seed))
        finally:
            cluster.close()
        found = results(out)
        print(f"{len(found)} results, {time.monotonic() - begin:.1f} s, {starts} starts of the client")
        same = found == results(serial)
        print("bit-identical to the serial run" if same else "MISSED: other results than those of the serial run")
        return 0 if same and len(found) == drives else 1


if __name__ == "__main__":
    raise SystemExit(main(*map(int, sys.argv[1:])))
