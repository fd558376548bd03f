"""Methods under test that misbehave, and the reaction of the suite: `make misbehaviour` prints the table.

`sfr localise` runs each method, `sfr replay` each node. A stationary estimate meets the limits on the poses, except for
methods that search for the ground truth: only the ground truth meets their limits.
"""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil

from helpers import HELPERS
from helpers.cli_result import Result, Sfr
from helpers.compile_c import compile_c
from helpers.made_scene import true_pose, write_folder

SFR = (sys.executable, "-P", "-m", "sfr_loc_map")
LIMITS = """\
minimum_independent: 1  # the drive is short
trajectory: [{{condition: frames=3, position_mean_plus_3sigma_m: {limit}}}]
"""
CALL_TIMEOUT_S, MEMORY_MB = 3, 400


@dataclass(frozen=True)
class Case:
    """A misbehaving method."""

    what: str
    kind: str  # class, library, node
    config: str
    findings: tuple[str, ...]  # kinds of findings
    verdict: str
    codes: tuple[int, ...]  # exit codes of sfr localise and sfr score, or of sfr replay
    pairs: int = 12
    says: str = ""  # text in the output besides the findings
    daily: bool = False  # whether the normal tests include the case
    limit: str = ""  # limit besides that on the poses
    least: tuple[str, float] | None = None  # a column of the statistics file, and its smallest value over all calls
    leaves: int = 0  # number of child processes after the last call, which must end with the method

    @property
    def cheats(self) -> bool:
        """Whether the method searches for the ground truth."""
        return self.config in ("parent", "guesses", "named", "memory")


def python(what: str, config: str, finding: str, **more: Any) -> Case:
    """Return the case of a Python class with one finding, whose verdict is fail."""
    return Case(what, "class", config, (finding,), "fail", (1, 1), **more)


def library(what: str, config: str, finding: str, **more: Any) -> Case:
    """Return the case of a C library with one finding, whose verdict is fail."""
    return Case(what, "library", config, (finding,), "fail", (1, 1), **more)


def slow(what: str, config: str, least_s: float, *findings: str) -> Case:
    """Return the case of a class whose measured time exceeds the limit of 0.2 s, while the stated time does not."""
    limit, least = "timing: {localisation_p50_s: 0.2}\n", ("processing_time_s", 0.99 * least_s)
    return Case(what, "class", config, findings, "fail", (len(findings), 1), 4, daily=True, limit=limit, least=least)


def large(what: str, config: str, says: str = "") -> Case:
    """Return the case of a class whose measured memory, 211 MB, exceeds the limit of 200 MB."""
    limit, least = "memory: {localisation_peak_bytes: 200000000}\n", ("above_idle_bytes", 0.99 * 211e6)
    return Case(what, "class", config, (), "fail", (0, 1), 6, says, daily=True, limit=limit, least=least)


EACH = " ".join(["ok"] * 7)
CONVENTION = "not judged"
COPIED = "incomplete"  # exact poses of the ground truth
STANDING = "incomplete"  # a stationary estimate repeats a pose although the rover moves
CASES = (
    python("raises an error", "raises", "raised"),
    python("returns NaN", "nan", "not finite"),
    python("returns a matrix of 3 x 3", "shape", "invalid result"),
    python("answers for another pair", "stamp", "wrong stamp"),
    Case("returns the true pose of the previous pair", "class", "poses before", (), COPIED, (0, 3), 40, "are offset"),
    Case("returns the inverse pose", "class", "poses inverse", (), CONVENTION, (0, 3), 40, "inverted"),
    python("writes lines of its own to the pipe", "garbage", "invalid result", daily=True),
    python("writes 30 MB to the pipe", "floods", "invalid result"),
    python("ends its process with code 0", "exits", "crashed"),
    python("aborts", "aborts", "crashed"),
    python("does not return", "hangs", "hanging"),
    python("kills its parent", "kills", "raised", daily=True),
    python("takes 480 MB with a limit of 400 MB", "takes", "out of memory"),
    python("keeps 500 MB in a child process", "child", "out of memory", daily=True),
    python("leaks 3 MB a call behind a saw-tooth of 90 MB", "sawtooth", "leaking", pairs=52, daily=True),
    Case("works on in 8 threads while its result is read", "class", "later", (), STANDING, (0, 3)),
    slow("defers its work until its result is read", "lazy", 0.35, "misstated"),
    slow("slows its clock to a tenth", "clock", 0.4, "misstated"),
    slow("works while images are written, with a lease on its log", "lease", 0.35),
    large("takes 211 MB and tries to reset the mark of its memory", "marks", says="opened 0"),
    large("keeps 211 MB in files of its scratch folder", "files"),
    Case("prints 60 MB a call", "class", "prints", (), STANDING, (0, 3), 8, daily=True),
    Case("leaves a process in a session of its own", "class", "session", (), STANDING, (0, 3), leaves=1, daily=True),
    Case("leaves an orphan", "class", "orphan", (), STANDING, (0, 3), leaves=1),
    Case("reads /proc/PPID/cmdline and the truth", "class", "parent", (), "fail", (0, 1), says="opened 0"),
    Case("guesses, searches, links to the truth", "class", "guesses", (), "fail", (0, 1), says="opened 0", daily=True),
    Case("reads the truth that sfr.yaml names", "class", "named", (), "fail", (0, 1), says="opened 0", daily=True),
    Case("reads its parents' memory", "class", "memory", (), "fail", (0, 1), says="opened 0", daily=True),
    library("aborts", f"{EACH} crash", "crashed"),
    library("does not return", f"{EACH} hang", "hanging"),
    library("leaks 30 MB a call", "leak", "out of memory", pairs=16),
    library("writes beyond its arrays", f"{EACH} beyond", "invalid result"),
    library("returns no rotation", f"{EACH} quaternion", "invalid result"),
    library("states a negative variance", f"{EACH} covariance", "invalid result"),
    library("answers for another pair", f"{EACH} stamp", "wrong stamp"),
    library("returns an error", f"{EACH} fail", "invalid result"),
    Case("dies at pair 25 of 30", "node", "dies", ("crashed", "missing answer"), "fail", (1,), 30),
    Case("stamps that are 7 ns off", "node", "other stamps", ("wrong stamp", "missing answer"), "fail", (1,), 30),
    Case("never answers", "node", "hangs", ("hanging",), "fail", (1,), 12),
    Case("leaves out every third pair", "node", "leaves out", ("missing answer",), "incomplete", (3,), 12),
    Case("answers NaN", "node", "not finite", ("not finite", "hanging"), "fail", (1,), 12),
    Case("answers twice", "node", "doubled", ("doubled answer",), "incomplete", (3,), 12),
    Case("answers each pair before its images", "node", "early", ("early answer",), "fail", (1,), 12),
    Case("answers after the time to answer", "node", "late", ("late answer", "missing answer"), "incomplete", (3,), 12),
    Case("dies at pair 8, and a script starts it again", "node", "restarts", ("crashed",), "fail", (1,), 12),
)


@dataclass(frozen=True)
class Outcome:
    """The result of a case."""

    findings: tuple[str, ...]
    verdict: str
    codes: tuple[int, ...]
    said: str  # complete output
    seconds: float
    score: dict[str, Any]
    calls: tuple[dict[str, str], ...] = ()  # rows of the statistics file


def run_case(case: Case, folder: Path, sfr: Sfr, library: Path | None = None) -> Outcome:
    """Run a case in an empty folder; the ground truth is in its subfolder `source`."""
    began = time.monotonic()
    source, truth = _source(case, folder)
    limits, report, stats = folder / "limits.yaml", folder / "report.json", folder / "s.csv"
    limits.write_text(LIMITS.format(limit=1e-3 if case.cheats else 1e3) + case.limit)
    scoring = ("--limits", limits, "--condition", "frames=3", "--spacing", 1)
    start = ("--start", "truth")
    if case.kind == "node":
        node = f"{sys.executable} {HELPERS / 'misbehaving_node.py'} '{case.config}'"
        if case.config == "restarts":
            node = f'sh -c "while true; do {node}; done"'
        under_test = ("--external", "localisation", "--command", node, "--answer-timeout", "1", "--out", folder / "out")
        under_test += ("--rate", "1") if case.config == "early" else ()
        ran, report = [sfr("replay", source, *under_test, *scoring, *start)], folder / "out" / "report.json"
    else:
        estimate, config = folder / "t.csv", folder / "config.txt"
        config.write_text(_config(case, truth))
        (folder / "candidate.py").write_text((HELPERS / "misbehaving_class.py").read_text())
        method = f"lib:{library}" if case.kind == "library" else f"{folder / 'candidate.py'}:Misbehaving"
        options = ("--call-timeout", CALL_TIMEOUT_S, "--memory-limit", MEMORY_MB, "--stats", stats, *start)
        ran = [sfr("localise", source, "-o", estimate, "--method", method, "--config", config, *options)]
        ran += [sfr("score", estimate, source, "--stats", stats, *scoring, "--json", report)]
    score: dict[str, Any] = json.loads(report.read_text()) if report.exists() else {}
    calls: list[dict[str, str]] = []
    if stats.exists():
        with stats.open(newline="") as file:
            calls = list(csv.DictReader(file))
    said = "\n".join(item.out + item.err for item in ran)
    if calls and "opened" in calls[0]:
        said += f"\nopened {sum(float(row['opened']) for row in calls):.0f}"
    found = [line.rpartition("verdict: ")[2].partition(".")[0] for line in said.splitlines() if "verdict: " in line]
    verdict = CONVENTION if score.get("contradiction") else (found or ["none"])[-1]
    kinds = tuple(item["kind"] for item in score.get("findings", []))
    codes = tuple(item.code for item in ran)
    return Outcome(kinds, verdict, codes, said, time.monotonic() - began, score, tuple(calls))


def _source(case: Case, folder: Path) -> tuple[Path, Path]:
    """Write the source of a case; return the paths of the source and of its ground truth."""
    source = write_folder(folder / "source", case.pairs, 0)
    truth = source / "groundtruth.csv"
    if case.config == "named":  # beside the candidate, in a readable folder
        truth = truth.rename(folder / "station.csv")
        (source / "sfr.yaml").write_text("truth: {source: ../station.csv}\n")
    return source, truth


def _config(case: Case, truth: Path) -> str:
    """Return the configuration of a case: the misbehaviour and, for a class, its argument on the next line."""
    if case.kind == "library":
        return case.config
    word, _, which = case.config.partition(" ")
    if word in ("session", "orphan"):
        return f"{word}\n{_sleep_s()}"
    if word in ("parent", "memory"):
        return f"{word}\n{os.getpid()}"
    if word in ("guesses", "named"):
        return f"{word}\n{truth}"
    if word == "poses":  # relative to the first pose
        poses = {"before": lambda k: true_pose(max(k - 1, 0)), "inverse": lambda k: true_pose(k).inverse()}
        first = true_pose(0).inverse()
        matrices = [(first @ poses[which](k)).matrix.ravel().tolist() for k in range(case.pairs)]
        return f"{word}\n{json.dumps(matrices)}"
    return f"{word}\n"


def _sleep_s() -> str:
    """Return a unique sleep duration, s, that identifies the processes left by a method."""
    return f"{10_000 + os.getpid()}"


def left_processes() -> list[int]:
    """Return the remaining processes of methods, identified by their unique `sleep` command."""
    sleeping = ["sleep", _sleep_s()]
    return [item.pid for item in psutil.process_iter(["cmdline"]) if item.info["cmdline"] == sleeping]


def differences(case: Case, outcome: Outcome) -> list[str]:
    """Return the differences of an outcome from the expected outcome."""
    found = [f"finding {kind} is absent" for kind in case.findings if kind not in outcome.findings]
    found += [f"finding {outcome.findings}"] if outcome.findings and not case.findings else []
    found += [f"verdict {outcome.verdict}"] if outcome.verdict != case.verdict else []
    found += [f"exit codes {outcome.codes}"] if outcome.codes != case.codes else []
    found += [f"'{case.says}' is not said"] if case.says not in outcome.said else []
    if case.least is not None:
        name, least = case.least
        values = [float(row[name]) for row in outcome.calls]
        found += [f"{name} is {values}"] if not values or min(values) < least else []
    if case.leaves and float(outcome.calls[-1]["processes"]) != 1 + case.leaves:
        found.append(f"{outcome.calls[-1]['processes']} processes after the last call")
    found += ["processes are left"] if left_processes() else []
    return found


def _sfr(*words: object) -> Result:
    environment = os.environ | {"SFR_HINTS": "0"}
    ran = subprocess.run([*SFR, *map(str, words)], capture_output=True, text=True, check=False, env=environment)
    return Result(ran.returncode, ran.stdout, ran.stderr)


def table(outcomes: Sequence[tuple[Case, Outcome]]) -> str:
    """Return the table of docs/measured_methods.md."""
    lines = ["| method | | finding | verdict | exit |", "|---|---|---|---|---|"]
    for case, outcome in outcomes:
        found, codes = ", ".join(outcome.findings) or "none", ", ".join(map(str, outcome.codes))
        told = f"; reported: {case.says}" if case.says else ""
        lines.append(f"| {case.what} | {case.kind} | {found}{told} | {outcome.verdict} | {codes} |")
    return "\n".join(lines)


def main(names: list[str]) -> int:
    """Run all cases, or those with the given configurations, and print the table; exit code 1 if a case differs."""
    from sfr_loc_map.ros import environment

    environment.prepare()
    environment.isolate()
    wrong, outcomes = [], []
    with tempfile.TemporaryDirectory(prefix="sfr-misbehaviour-") as scratch:
        built = Path(scratch) / "libfaulty.so"
        compile_c(HELPERS / "faulty_candidate.c", output=built)
        for number, case in enumerate(item for item in CASES if not names or item.config in names):
            folder = Path(scratch) / str(number)
            folder.mkdir()
            outcomes.append((case, run_case(case, folder, _sfr, built)))
            differ = differences(case, outcomes[-1][1])
            print(
                f"{outcomes[-1][1].seconds:5.1f} s  {case.kind}: {case.what}: {', '.join(differ) or 'ok'}", flush=True
            )
            wrong += [f"{case.kind} {case.what}"] if differ else []
            if differ:
                print(outcomes[-1][1].said[-1500:])
    print(table(outcomes))
    print(f"not as expected: {'; '.join(wrong)}" if wrong else "all as expected")
    return int(bool(wrong))
