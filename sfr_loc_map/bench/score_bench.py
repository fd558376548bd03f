"""Trajectory scores side by side: reading, association and errors of a long drive, each as a command of its own."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.bench.figures import SCHEMA, Figures, compared, median, provenance
from sfr_loc_map.bench.peers import OURS, WORKERS, lacks
from sfr_loc_map.errors import BenchError

CONDITIONS = tuple(f"distance={metres}" for metres in (1, 2, 5, 10, 50, 100))
ONE = "distance=5"
STEP_M, PERIOD_S = 0.05, 0.1
TUM_FORMAT = "%.1f " + "%.9f " * 6 + "%.9f"
PATIENCE_S = 3600.0


@dataclass(frozen=True, slots=True)
class Command:
    """A command that scores the drive.

    Attributes:
        name: Its name in tables.
        what: What it computes.
        words: The command.
        count: Gets the number of sub-trajectories of 5 m from its output: whether the work is the same.
    """

    name: str
    what: str
    words: Sequence[str]
    count: Callable[[str], int | None]


def bench_score(
    poses: int,
    peer_python: Path | None,
    *,
    repeat: int = 1,
    all_pairs: bool = True,
    progress: Callable[[str], None] = lambda name: None,
) -> Figures:
    """Return time and memory of ours and of evo's relative error on one made drive.

    Args:
        poses: Length of the drive.
        peer_python: Interpreter of an environment that may have evo (GPL-3; its command is called).
        repeat: Runs of each command; medians are shown.
        all_pairs: Whether evo's slow form with every start is run as well.
        progress: Told the name of a command when it has run.

    Raises:
        BenchError: If ours does not run.
    """
    facts = provenance()
    missing = lacks(peer_python, "evo", "pip install evo")
    evo = None if peer_python is None else peer_python.parent / "evo_rpe"
    if missing is None and (evo is None or not evo.is_file()):
        missing = f"there is no command '{evo}'"
    with TemporaryDirectory(prefix="sfr_bench_") as folder:
        place = Path(folder)
        truth, estimate = write_drive(place, poses)
        commands = our_commands(estimate, truth, place / "score.json")
        warm_truth, warm_estimate = write_drive(place, 300, "warm_")
        # machine code is made ready once for all
        measured(our_commands(warm_estimate, warm_truth, place / "score.json")[-1], place)
        if missing is None:
            commands += evo_commands(str(evo), estimate, truth, all_pairs=all_pairs)
        runs: dict[str, list[Figures]] = {}
        failed: dict[str, str] = {}
        for _ in range(repeat):
            for command in commands:
                try:
                    runs.setdefault(command.name, []).append(measured(command, place))
                except BenchError as error:
                    if command.name.startswith(OURS):
                        raise
                    failed[command.name] = str(error)
                    runs.pop(command.name, None)
                progress(command.name)
    entries = {
        c.name: {"what": c.what, **median(runs[c.name]), "runs": runs[c.name]} for c in commands if c.name in runs
    }
    return {
        "schema": SCHEMA,
        "kind": "score",
        "poses": poses,
        "repeat": repeat,
        "entries": entries,
        "ratios": compared(entries, f"{OURS}: {ONE}", ("time_s", "memory_bytes")),
        "failed": failed,
        "missing": {} if missing is None else {"evo": missing},
        "provenance": facts | {"memory_method": "largest resident memory of the process (wait4)"},
    }


def write_drive(folder: Path, poses: int, prefix: str = "") -> tuple[Path, Path]:
    """Write the truth and an estimate of a drive (TUM): 5 cm steps, winding, the estimate with a random drift."""
    rng = np.random.default_rng(1)
    heading = np.cumsum(rng.normal(0.0, 0.004, poses))
    drift = np.cumsum(rng.normal(0.0, 0.00005, poses))
    paths = []
    for name, angle, scale in (("truth", heading, 1.0), ("estimate", heading + drift, 1.002)):
        steps = STEP_M * scale * np.column_stack((np.cos(angle), np.sin(angle), np.full(poses, 0.001)))
        rows = np.zeros((poses, 8))
        rows[:, 0] = PERIOD_S * np.arange(poses)
        rows[1:, 1:4] = np.cumsum(steps[:-1], axis=0)
        rows[:, 6], rows[:, 7] = np.sin(angle / 2), np.cos(angle / 2)
        paths.append(folder / f"{prefix}{name}.tum")
        _write_rows(paths[-1], rows)
    return paths[0], paths[1]


def _write_rows(path: Path, rows: NDArray[np.float64]) -> None:
    with path.open("w", encoding="ascii") as stream:
        for first in range(0, len(rows), 10000):
            block = rows[first : first + 10000]
            stream.write("\n".join([TUM_FORMAT] * len(block)) % tuple(block.ravel().tolist()) + "\n")


def our_commands(estimate: Path, truth: Path, result: Path) -> list[Command]:
    """Return ours: one condition, and all six in one pass, each at every start."""

    def count(output: str) -> int | None:
        trajectory: dict[str, Any] = json.loads(result.read_text("utf-8"))["trajectory"]
        parts = trajectory.get("conditions", [trajectory])
        return next(int(part["count"]) for part in parts if part["condition"] == {"distance_m": 5.0})

    words = [sys.executable, str(WORKERS / "our_score.py"), str(estimate), str(truth), str(result), "1"]
    return [
        Command(f"{OURS}: {ONE}", "every start, one condition", [*words, ONE], count),
        Command(f"{OURS}: six", "every start, six conditions: 1, 2, 5, 10, 50, 100 m", [*words, *CONDITIONS], count),
    ]


def evo_commands(evo: str, estimate: Path, truth: Path, *, all_pairs: bool) -> list[Command]:
    """Return evo's relative error over 5 m: of consecutive pieces, and from every start."""

    def count(output: str) -> int | None:
        found = re.search(r"Compared (\d+) relative pose pairs", output)
        return int(found[1]) if found else None

    # evo writes its settings to the home folder
    words = ["env", f"HOME={truth.parent}", evo, "tum", str(truth), str(estimate), "--verbose"]
    words += ["--delta", "5", "--delta_unit", "m", "--pose_relation", "trans_part"]
    commands = [Command("evo_rpe", "consecutive pieces of 5 m", words, count)]
    if all_pairs:
        commands.append(Command("evo_rpe --all_pairs", "every start, 5 m", [*words, "--all_pairs"], count))
    return commands


def measured(command: Command, folder: Path) -> Figures:
    """Run a command and return its time and memory.

    Raises:
        BenchError: If it fails; names its last words.
    """
    result = folder / "measured.txt"
    launcher = [sys.executable, "-I", "-S", str(WORKERS / "measured.py"), str(result), *command.words]
    try:
        run = subprocess.run(launcher, capture_output=True, text=True, timeout=PATIENCE_S, check=True, cwd=folder)
    except (subprocess.SubprocessError, OSError) as error:
        raise BenchError(f"{command.name} did not run: {error}") from error
    seconds, processor, peak, code = result.read_text("ascii").split()
    if int(code):
        words = [line.strip() for line in (run.stdout + run.stderr).splitlines() if line.strip()]
        raise BenchError(f"{command.name} ended with {code}: {words[-1] if words else 'it said nothing'}")
    return {
        "time_s": {"wall": float(seconds), "processor": float(processor)},
        "memory_bytes": {"peak": int(peak) * 1024},
        "sub_trajectories_of_5_m": command.count(run.stdout),
    }
