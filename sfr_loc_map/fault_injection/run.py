"""The campaign: one fault after the other, each with an outcome."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path

from sfr_loc_map.errors import InputError, SfrError
from sfr_loc_map.fault_injection import disk_faults, message_faults, process_faults, soak, time_faults
from sfr_loc_map.fault_injection.harness import Bench
from sfr_loc_map.fault_injection.outcome import CampaignSettings, Fault, Outcome, Row, row_not_run, row_of
from sfr_loc_map.nodes.process import environment

FAULTS: tuple[Fault, ...] = (
    *process_faults.FAULTS,
    *message_faults.FAULTS,
    *time_faults.FAULTS,
    message_faults.EMPTY,
    *disk_faults.FAULTS,
    *soak.FAULTS,
)
"""Those with the same arguments of the nodes stand together, so that they share their processes."""
NAMESPACE = ("unshare", "--mount", "--propagation", "private")
CHILD_S = 300.0


def select(names: Sequence[str], settings: CampaignSettings) -> list[Fault]:
    """Return the faults of these names, all of them for none.

    Raises:
        InputError: If there is no fault of a name.
    """
    known = {fault.name: fault for fault in FAULTS}
    unknown = [name for name in names if name not in known]
    if unknown:
        raise InputError(f"no fault '{unknown[0]}': known are {', '.join(known)}")
    chosen = [known[name] for name in names] if names else list(FAULTS)
    return [fault for fault in chosen if fault.name != "soak" or settings.soak_minutes > 0]


def run_campaign(
    faults: Sequence[Fault],
    settings: CampaignSettings,
    folder: Path,
    done: Callable[[Row], None] = lambda row: None,
    *,
    in_namespace: bool = False,
) -> list[Row]:
    """Run faults, those with the same arguments of the nodes with the same processes.

    Args:
        faults: Which.
        settings: How hard.
        folder: For logs; made if need be.
        done: Called with each row.
        in_namespace: Whether this process has a mount namespace of its own.
    """
    environment.prepare()
    environment.isolate()
    rows: list[Row] = []
    with ExitStack() as stack:
        bench: Bench | None = None
        arguments = None
        for fault in faults:
            if fault.own_mounts and not in_namespace:
                row = _run_in_namespace(fault, settings, folder)
            else:
                if bench is None or fault.arguments != arguments:
                    stack.close()
                    bench, arguments = None, fault.arguments
                outcome = Outcome()
                try:
                    if bench is None:
                        place = folder / fault.name
                        place.mkdir(parents=True, exist_ok=True)
                        if fault.prepare is not None:
                            fault.prepare(place)
                        bench = stack.enter_context(Bench(place, settings, fault.arguments))
                        bench.wait_ready()
                    fault.run(bench, outcome)
                    dead = [name for name, node in bench.nodes.items() if not node.lives]
                    outcome.expect(not dead, f"dead: {', '.join(dead)}")
                except SfrError as error:
                    outcome.failures.append(str(error))
                if outcome.failures:
                    stack.close()
                    bench = None
                row = row_of(fault, outcome)
            rows.append(row)
            done(row)
    return rows


def _run_in_namespace(fault: Fault, settings: CampaignSettings, folder: Path) -> Row:
    """Run one fault in a process that has its own view of the mounted file systems."""
    if not sys.platform.startswith("linux") or os.geteuid() != 0 or shutil.which("unshare") is None:
        return row_not_run(fault, "needs Linux, root and the command unshare")
    probe = subprocess.run([*NAMESPACE, "mount", "-t", "tmpfs", "tmpfs", "/mnt"], capture_output=True, text=True)
    if probe.returncode:
        return row_not_run(fault, f"mounting is not allowed here: {probe.stderr.strip()}")
    with tempfile.TemporaryDirectory() as place:
        answer = Path(place) / "row.json"
        order = {"fault": fault.name, "settings": asdict(settings), "folder": str(folder), "answer": str(answer)}
        command = [*NAMESPACE, sys.executable, "-m", "sfr_loc_map.fault_injection", json.dumps(order)]
        surroundings = {k: v for k, v in os.environ.items() if k != "ROS_DOMAIN_ID"}
        try:
            child = subprocess.run(command, env=surroundings, capture_output=True, text=True, timeout=CHILD_S)
        except subprocess.TimeoutExpired:
            outcome = Outcome(failures=[f"did not end within {CHILD_S:g} s"])
            return row_of(fault, outcome)
        if not answer.exists():
            last = (child.stderr.strip().splitlines() or ["it said nothing"])[-1]
            return row_of(fault, Outcome(failures=[f"its process ended with exit code {child.returncode}: {last}"]))
        return Row(**json.loads(answer.read_text(encoding="utf-8")))


def run_ordered(order: str) -> None:
    """Run what `_run_in_namespace` ordered, in the process that it started."""
    wanted = json.loads(order)
    settings = CampaignSettings(**wanted["settings"])
    faults = select([wanted["fault"]], settings)
    (row,) = run_campaign(faults, settings, Path(wanted["folder"]), in_namespace=True)
    Path(wanted["answer"]).write_text(json.dumps(asdict(row)), encoding="utf-8")


def timed(work: Callable[[], list[Row]]) -> tuple[list[Row], float]:
    """Return the rows of a campaign and how long it took, seconds."""
    begin = time.monotonic()
    return work(), time.monotonic() - begin
