"""Workers of a Dask scheduler: other code gets no job, and a killed worker and a late worker change no result."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import sfr_loc_map
from helpers.cli_result import run_sfr
from helpers.made_suites import SFR, made_suite, results
from helpers.processes import wait_until

DRIVES = 12


@pytest.fixture
def address() -> Iterator[str]:
    distributed = pytest.importorskip("distributed", reason="needs the extra [suite]")
    options = {"n_workers": 0, "processes": False, "protocol": "tcp://", "dashboard_address": None}
    with distributed.LocalCluster(**options) as cluster:
        yield cluster.scheduler_address


@pytest.mark.slow
@pytest.mark.timeout(180)
def test_other_code_gets_no_task_and_the_results_are_those_of_one_worker(
    address: str, scheduler: str, tmp_path: Path
) -> None:
    suite = made_suite(tmp_path / "drives", DRIVES)
    serial, out, said = tmp_path / "serial", tmp_path / "out", tmp_path / "said"
    assert run_sfr("suite", "run", suite, "--out", serial, "--scheduler", scheduler).code == 0
    shutil.copytree(Path(sfr_loc_map.__file__).parent, tmp_path / "code" / "sfr_loc_map")
    with (tmp_path / "code" / "sfr_loc_map" / "metrics" / "formulas.py").open("a") as stream:
        stream.write("\nOTHER = True\n")

    with contextlib.ExitStack() as stack:

        def start(*command: str, **variables: str) -> subprocess.Popen[str]:
            environment, silent = os.environ | variables, subprocess.DEVNULL
            process = subprocess.Popen(
                command, cwd=tmp_path, env=environment, text=True, stdout=silent, stderr=said.open("a")
            )
            stack.callback(process.wait)
            stack.callback(process.kill)
            return process

        def worker(name: str, **variables: str) -> subprocess.Popen[str]:
            command = f"{sys.executable} -m dask worker {address} --nthreads 1 --no-nanny --no-dashboard --name {name}"
            command = f"exec {command} --local-directory {tmp_path / name} 2> {tmp_path / name}.log"
            return start("sh", "-c", command, **variables)

        begun = time.monotonic()
        run = start(*SFR, "suite", "run", str(suite), "--out", str(out), "--scheduler", address)
        wait_until(lambda: "no worker at the scheduler" in said.read_text(), "the message about no worker")
        assert time.monotonic() - begun < 40, "5 s after the start of Python and the plan, on a busy host"
        worker("other-code", PYTHONPATH=str(tmp_path / "code"))
        wait_until(lambda: "none of 1 workers is usable" in said.read_text(), "the message about other code")
        killed = worker("killed")
        wait_until(lambda: list((out / "results").glob("*.json")), "the first result")
        killed.send_signal(signal.SIGKILL)
        worker("late")
        assert run.wait(90) == 0, said.read_text()
    assert results(out) == results(serial)
    records = {record["set_aside"]: record for record in json.loads((out / "suite.json").read_text())["workers"]}
    assert {lacks.partition(":")[0] for lacks in records} == {"", "other code"}, records
    assert all(record["done"] == 0 for lacks, record in records.items() if lacks)
    assert all(record["host"] and record["code"] and record["version"] for record in records.values())
