"""How a suite scales: measured with one and two slots of this host, and on paper for a large cluster.

    python test/suite/scaling.py SOURCE [TASKS]

The same localisation tasks are run with one slot and with two. On a host that others use as well the wall time says
little, so the processor time is compared too: it shows what two slots cost each other by shared caches and memory.
Then the cost of each step that a client and a scheduler take for one task is measured, and set against the time that a
cluster takes for it.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import yaml

from sfr_loc_map.metrics.score_json import to_plain
from sfr_loc_map.suite.claim import write_result
from sfr_loc_map.suite.execution import Outcome
from sfr_loc_map.suite.plan import make_plan
from sfr_loc_map.suite.runner import plan_suite
from sfr_loc_map.suite.specification import load_specification
from sfr_loc_map.suite.store import Store
from sfr_loc_map.suite.summary import summarise

sys.path.insert(0, str(Path(__file__).parent))
from made_suites import SFR

BAGS, WORKERS, TASK_S = 10_000, 500, 60.0
"""Of the simulation on paper: a task of a minute is a bag of some two minutes at 10 Hz."""
DASK_S = 0.0163
"""Processor time of the scheduler for one task, as `chaos.py` measures it."""
FULL = 1000
"""Results of which costs that may grow with their number are measured."""


@dataclass(frozen=True, slots=True)
class Run:
    """A suite with some slots: wall time, processor time, and the sum of the tasks' wall times, seconds."""

    slots: int
    wall_s: float
    processor_s: float
    tasks_s: float


def run(suite: Path, out: Path, slots: int) -> Run:
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    command = [*SFR, "suite", "run", str(suite), "--out", str(out), "--workers", str(slots)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    wall = time.monotonic() - begin
    assert done.returncode == 0, done.stderr
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    processor = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    tasks = sum(drive["seconds"] for drive in json.loads((out / "suite.json").read_text())["drives"])
    return Run(slots, wall, processor, tasks)


def measure_slots(folder: Path, source: Path, tasks: int) -> None:
    suite = folder / "suite.yaml"
    faults = [f"noisy:share=0.1,amount={number}" for number in range(1, tasks)]
    content = {
        "sources": [str(source.absolute())],
        "perturb": faults,
        "tasks": ["localise"],
        "conditions": ["distance=2"],
    }
    suite.write_text(yaml.safe_dump(content))
    runs = [run(suite, folder / f"out{slots}", slots) for slots in (1, 2)]
    for item in runs:
        busy = item.tasks_s / (item.slots * item.wall_s)
        print(f"{item.slots} slots: {item.wall_s:.1f} s, processor {item.processor_s:.1f} s, busy {100 * busy:.1f} %")
    one, two = runs
    inflation = two.processor_s / one.processor_s
    print(f"speed-up by the clock of this host: {one.wall_s / two.wall_s:.2f}, with start and report")
    print(f"processor time with two slots over one: {inflation:.3f}, so that free cores give up to {2 / inflation:.2f}")


def timed(action: object, count: int) -> float:
    begin = time.process_time()
    action()  # type: ignore[operator]
    return (time.process_time() - begin) / count


def measure_steps(folder: Path, source: Path) -> None:
    """Print the cost of each step, and what it comes to for many bags."""
    suite = folder / "steps.yaml"
    suite.write_text(yaml.safe_dump({"sources": [str(source.absolute())], "tasks": ["localise"], "repeats": FULL}))
    specification, store = load_specification(suite), Store(folder / "steps")
    store.facts_of(source)
    plan = make_plan(specification, store.facts_of)
    text = next((folder / "out1" / "results").glob("*.json")).read_text()
    outcomes = [
        Outcome(key=task.key, result=None, failures=(), seconds=1.0, peak_bytes=1, done=True) for task in plan.tasks
    ]
    steps = {
        "plan and index, client": timed(lambda: plan_suite(specification, store), FULL),
        "task as JSON, client": timed(lambda: [json.dumps(to_plain(task)) for task in plan.tasks], FULL),
        "scheduler of Dask": DASK_S,
        "result into the index, client": timed(
            lambda: [store.save(task, outcome) for task, outcome in zip(plan.tasks, outcomes, strict=True)], FULL
        ),
        "result file, worker": timed(lambda: [write_result(store.folder, task.key, text) for task in plan.tasks], FULL),
    }
    through = timed(lambda: [replace(o, result=json.loads(json.dumps(text))) for o in outcomes], FULL)
    store.plan(plan.tasks, suite)
    steps["summary at the end, client"] = timed(lambda: summarise(store), FULL)
    ideal = BAGS * TASK_S / WORKERS
    print(f"{BAGS} bags of {TASK_S:.0f} s on {WORKERS} workers: {ideal:.0f} s if nothing else took time,")
    print(f"{WORKERS / TASK_S:.1f} tasks a second; a result has {len(text) / 1e3:.0f} kB")
    for name, seconds in steps.items():
        parallel = WORKERS if "worker" in name else 1
        share = BAGS * seconds / parallel / ideal
        total = BAGS * seconds / parallel
        print(f"{name:32} {1e3 * seconds:7.2f} ms a task, {total:6.1f} s of one core, {100 * share:5.1f} %")
    size = BAGS * len(text)
    print(
        f"results through the scheduler instead: {size / 1e9:.1f} GB, and {1e3 * through:.2f} ms a task of text alone"
    )


def main(source: str, tasks: str = "6") -> int:
    with tempfile.TemporaryDirectory(prefix="sfr-scaling-") as name:
        measure_slots(Path(name), Path(source), int(tasks))
        measure_steps(Path(name), Path(source))
    return 0


if __name__ == "__main__":
    raise SystemExit(main(*sys.argv[1:]))
