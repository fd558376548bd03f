"""The campaign: injects one fault after the other."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path

from sfr_loc_map.errors import InputError, SfrError
from sfr_loc_map.fault_injection import disk_faults, message_faults, process_faults, soak, time_faults
from sfr_loc_map.fault_injection.fault import Fault, Outcome
from sfr_loc_map.fault_injection.harness import Harness
from sfr_loc_map.fault_injection.report import Row, Verdict, row_not_run, row_of
from sfr_loc_map.fault_injection.settings import CampaignSettings
from sfr_loc_map.nodes import environment

FAULTS: tuple[Fault, ...] = (
    *process_faults.FAULTS,
    *message_faults.FAULTS,
    *time_faults.FAULTS,
    message_faults.EMPTY,
    *disk_faults.FAULTS,
    *soak.FAULTS,
)
"""Faults with the same arguments of the nodes are neighbours, so that they share their processes."""
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
    """Inject faults; those with the same arguments of the nodes share the node processes.

    Args:
        faults: Which.
        settings: Settings of the campaign.
        folder: For logs; made if need be.
        done: Called with each row.
        in_namespace: Whether this process has a mount namespace of its own.
    """
    environment.prepare()
    environment.isolate()
    rows: list[Row] = []
    with _SharedHarness(settings, folder) as shared:
        for fault in faults:
            if fault.own_mounts and not in_namespace:
                row = _run_in_namespace(fault, settings, folder)
            else:
                row = row_of(fault, shared.inject(fault))
            rows.append(row)
            done(row)
    return rows


class _SharedHarness:
    """The harness of the last fault, for the next one with the same arguments; a context manager."""

    def __init__(self, settings: CampaignSettings, folder: Path) -> None:
        self._settings, self._folder = settings, folder
        self._stack = ExitStack()
        self._harness: Harness | None = None
        self._arguments: object = None

    def __enter__(self) -> _SharedHarness:
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    def inject(self, fault: Fault) -> Outcome:
        """Inject a fault; after a failure the next one gets new processes."""
        outcome = Outcome()
        try:
            harness = self._harness_for(fault)
            fault.run(harness, outcome)
            ended = [name for name, node in harness.nodes.items() if not node.is_running]
            outcome.expect(not ended, f"ended: {', '.join(ended)}")
        except SfrError as error:
            outcome.failures.append(str(error))
        if outcome.failures:
            self._close()
        return outcome

    def _harness_for(self, fault: Fault) -> Harness:
        if self._harness is not None and fault.arguments == self._arguments:
            return self._harness
        self._close()
        folder = self._folder / fault.name
        folder.mkdir(parents=True, exist_ok=True)
        if fault.prepare is not None:
            fault.prepare(folder)
        harness = self._stack.enter_context(Harness(folder, self._settings, fault.arguments))
        harness.wait_ready()
        self._harness, self._arguments = harness, fault.arguments
        return harness

    def _close(self) -> None:
        self._harness = None
        self._stack.close()


def _run_in_namespace(fault: Fault, settings: CampaignSettings, folder: Path) -> Row:
    """Inject one fault in a process that has a mount namespace of its own."""
    if not sys.platform.startswith("linux") or os.geteuid() != 0 or shutil.which("unshare") is None:
        return row_not_run(fault, "needs Linux, root and the command unshare")
    probe = subprocess.run([*NAMESPACE, "mount", "-t", "tmpfs", "tmpfs", "/mnt"], capture_output=True, text=True)
    if probe.returncode:
        return row_not_run(fault, f"mounting is not allowed here: {probe.stderr.strip()}")
    with tempfile.TemporaryDirectory() as scratch:
        answer = Path(scratch) / "row.json"
        order = {"fault": fault.name, "settings": asdict(settings), "folder": str(folder), "answer": str(answer)}
        command = [*NAMESPACE, sys.executable, "-m", "sfr_loc_map.fault_injection", json.dumps(order)]
        variables = {k: v for k, v in os.environ.items() if k != "ROS_DOMAIN_ID"}
        try:
            child = subprocess.run(command, env=variables, capture_output=True, text=True, timeout=CHILD_S)
        except subprocess.TimeoutExpired:
            return row_of(fault, Outcome(failures=[f"did not end within {CHILD_S:g} s"]))
        if not answer.exists():
            last = (child.stderr.strip().splitlines() or ["no output"])[-1]
            return row_of(fault, Outcome(failures=[f"its process ended with exit code {child.returncode}: {last}"]))
        values = json.loads(answer.read_text(encoding="utf-8"))
        return Row(**values | {"verdict": Verdict(values["verdict"])})


def run_ordered(order: str) -> None:
    """Inject the fault that `_run_in_namespace` ordered, in the process that it started."""
    wanted = json.loads(order)
    settings = CampaignSettings(**wanted["settings"])
    faults = select([wanted["fault"]], settings)
    (row,) = run_campaign(faults, settings, Path(wanted["folder"]), in_namespace=True)
    Path(wanted["answer"]).write_text(json.dumps(asdict(row)), encoding="utf-8")
