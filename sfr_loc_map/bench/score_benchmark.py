"""Our trajectory score beside evo's: a long drive is read, associated and scored, each by a command of its own."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from sfr_loc_map.bench.figures import JsonObject
from sfr_loc_map.bench.results import OURS, SCHEMA, Entry, Provenance, ratios_to_others
from sfr_loc_map.errors import BenchError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.methods.registry import lacks

WORKERS = Path(__file__).parent / "workers"
CONDITIONS = tuple(f"distance={metres}" for metres in (1, 2, 5, 10, 50, 100))
ONE = "distance=5"
STEP_M, PERIOD_S = 0.05, 0.1
TUM_FORMAT = "%.1f " + "%.9f " * 6 + "%.9f"
TIMEOUT_S = 3600.0
MEMORY = "largest resident memory of the process (wait4)"


@dataclass(frozen=True, slots=True)
class Command:
    """A command that scores the drive.

    Attributes:
        name: Its name in tables.
        what: What it computes.
        words: The command.
        count: Reads the number of sub-trajectories of 5 m from its output: whether the work is the same.
    """

    name: str
    what: str
    words: Sequence[str]
    count: Callable[[str], int | None]


@dataclass(frozen=True, slots=True)
class CommandTimes:
    """Times of a command, seconds: wall clock, and processor time of all cores."""

    wall: float
    processor: float


@dataclass(frozen=True, slots=True)
class CommandMemory:
    """Largest resident memory of a command, bytes."""

    peak: float


@dataclass(frozen=True, slots=True)
class ScoreFigures:
    """Figures of one run of a command."""

    time_s: CommandTimes
    memory_bytes: CommandMemory
    sub_trajectories_of_5_m: float | None

    def to_json(self) -> JsonObject:
        """Return the JSON object."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class ScoreComparison:
    """Result of the benchmark of trajectory scores.

    Attributes:
        poses: Length of the drive.
        repeat: Runs of each command.
        entries: Figures by command.
        failed: Reason why the other commands failed, by name.
        missing: Reason why evo was not run.
        provenance: Where and when.
    """

    poses: int
    repeat: int
    entries: Mapping[str, Entry[ScoreFigures]]
    failed: Mapping[str, str]
    missing: Mapping[str, str]
    provenance: Provenance

    def to_json(self) -> JsonObject:
        """Return the JSON object."""
        return {
            "schema": SCHEMA,
            "kind": "score",
            "poses": self.poses,
            "repeat": self.repeat,
            "entries": {name: entry.to_json("what") for name, entry in self.entries.items()},
            "ratios": ratios_to_others(self.entries, f"{OURS}: {ONE}", ("time_s", "memory_bytes")),
            "failed": dict(self.failed),
            "missing": dict(self.missing),
            "provenance": asdict(self.provenance),
        }


def benchmark_score(
    poses: int,
    peer_python: Path | None,
    *,
    repeat: int = 1,
    all_pairs: bool = True,
    progress: Callable[[str], None] = lambda name: None,
) -> ScoreComparison:
    """Return time and memory of ours and of evo's relative error on one synthetic drive.

    Args:
        poses: Length of the drive.
        peer_python: Interpreter of an environment that may have evo (GPL-3; its command is called).
        repeat: Runs of each command; medians are shown.
        all_pairs: Whether evo's slow form with every start is run as well.
        progress: Called with the name of a command when it has run.

    Raises:
        BenchError: If ours does not run.
    """
    provenance = Provenance.now(MEMORY)
    evo, reason = find_evo(peer_python)
    with TemporaryDirectory(prefix="sfr_bench_") as temporary:
        folder = Path(temporary)
        truth, estimate = write_drive(folder, poses)
        warm_truth, warm_estimate = write_drive(folder, 300, "warm_")
        # compiles the kernels once for all runs
        measured(our_commands(warm_estimate, warm_truth, folder / "score.json")[-1], folder)
        commands = our_commands(estimate, truth, folder / "score.json")
        if evo is not None:
            commands += evo_commands(str(evo), estimate, truth, all_pairs=all_pairs)
        runs, failed = _run_all(commands, repeat, folder, progress)
    entries = {c.name: Entry(c.what, runs[c.name]) for c in commands if c.name in runs}
    missing = {} if reason is None else {"evo": reason}
    return ScoreComparison(poses, repeat, entries, failed, missing, provenance)


def find_evo(peer_python: Path | None) -> tuple[Path | None, str | None]:
    """Return evo's command beside an interpreter, or None and the reason why there is none.

    Raises:
        BenchError: If `peer_python` is not an interpreter.
    """
    reason = lacks(peer_python, "evo", "pip install evo")
    if reason is not None or peer_python is None:
        return None, reason
    evo = peer_python.parent / "evo_rpe"
    return (evo, None) if evo.is_file() else (None, f"there is no command '{evo}'")


def _run_all(
    commands: Sequence[Command], repeat: int, folder: Path, progress: Callable[[str], None]
) -> tuple[dict[str, list[ScoreFigures]], dict[str, str]]:
    """Return the runs by command, and the reasons of the commands that failed; ours must not fail."""
    runs: dict[str, list[ScoreFigures]] = {}
    failed: dict[str, str] = {}
    for _ in range(repeat):
        for command in commands:
            try:
                runs.setdefault(command.name, []).append(measured(command, folder))
            except BenchError as error:
                if command.name.startswith(OURS):
                    raise
                failed[command.name] = str(error)
                runs.pop(command.name, None)
            progress(command.name)
    return runs, failed


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


def _write_rows(path: Path, rows: FloatArray) -> None:
    with path.open("w", encoding="ascii") as stream:
        for first in range(0, len(rows), 10000):
            block = rows[first : first + 10000]
            stream.write("\n".join([TUM_FORMAT] * len(block)) % tuple(block.ravel().tolist()) + "\n")


def our_commands(estimate: Path, truth: Path, result: Path) -> list[Command]:
    """Return ours: one condition, and all six in one pass, each at every start."""

    def count(output: str) -> int | None:
        trajectory = json.loads(result.read_text("utf-8"))["trajectory"]
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


def measured(command: Command, folder: Path) -> ScoreFigures:
    """Run a command and return its time and memory.

    Raises:
        BenchError: If it fails; the message has its last line of output.
    """
    result = folder / "measured.txt"
    launcher = [sys.executable, "-I", "-S", str(WORKERS / "measured.py"), str(result), *command.words]
    try:
        run = subprocess.run(launcher, capture_output=True, text=True, timeout=TIMEOUT_S, check=True, cwd=folder)
    except (subprocess.SubprocessError, OSError) as error:
        raise BenchError(f"{command.name} did not run: {error}") from error
    seconds, processor, peak, code = result.read_text("ascii").split()
    if int(code):
        lines = [line.strip() for line in (run.stdout + run.stderr).splitlines() if line.strip()]
        raise BenchError(f"{command.name} ended with {code}: {lines[-1] if lines else 'it printed nothing'}")
    times = CommandTimes(float(seconds), float(processor))
    return ScoreFigures(times, CommandMemory(int(peak) * 1024), command.count(run.stdout))
