"""Signals to every long command at random times. Finished results are kept; processes and shared memory are freed.

A run is one command on a small drive that overwrites an existing output. A signal interrupts the command at a random
time: once, twice in immediate succession (as by `timeout` and a terminal), or by SIGKILL.
"""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import time
import uuid
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from campaigns.own_domain import in_own_domain
from helpers.made_scene import write_folder
from helpers.processes import handles_signals
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.tables.trajectory_file import read_trajectory_file
from sfr_loc_map.ros.domains import hold_domain

MARK = "SFR_SIGNAL_RUN"
PATIENCE_S = 90.0
TINY = ("drive.pairs=6", "loc.width=96", "loc.height=72", "loc.focal_px=80", "nav.width=96", "nav.height=72")
SUITE = "sources: [{source}]\ntasks: [localise]\nperturb: [blurred]\nrepeats: 4\n"


def trajectory_is_whole(folder: Path, text: str) -> bool:
    """Return whether an estimate has as many poses as the command reported."""
    said = next(int(line.split()[0]) for line in text.splitlines() if " poses, " in line)
    return len(read_trajectory_file(folder / "y.csv").trajectory) == said


def cloud_is_whole(folder: Path, text: str) -> bool:
    """Return whether there is a cloud."""
    return (folder / "c.ply").stat().st_size > 99


def source_is_whole(name: str) -> Callable[[Path, str], bool]:
    """Return a check that an output is a complete drive, the old or the new one."""
    return lambda folder, text: len(open_source(folder / name).loc or ()) >= 6


@dataclass(frozen=True)
class Long:
    """A command, whether it runs until a signal, and the conditions on its output after an end and after SIGKILL."""

    words: str
    endless: bool = False
    whole: Callable[[Path, str], bool] | None = None
    keeps: Callable[[Path, str], bool] | None = None
    seconds: float = 5.0  #: Largest delay of the signal, s.


PAIRS = 200
COMMANDS = {
    "localise": Long("localise SRC -o y.csv --stats s.csv --video v.avi --overwrite", whole=trajectory_is_whole),
    "localise-method": Long("localise SRC -o y.csv --method opencv --overwrite", whole=trajectory_is_whole),
    "map": Long("map SRC -o c.ply --dem d.tif --overwrite", whole=cloud_is_whole, seconds=2.5),
    "convert": Long("convert SRC old --overwrite", keeps=source_is_whole("old"), seconds=2.5),
    "convert-bag": Long("convert SRC old.mcap --overwrite", keeps=source_is_whole("old.mcap"), seconds=2.5),
    "simulate-faults": Long(
        "simulate old --from SRC --fault blurred --overwrite", keeps=source_is_whole("old"), seconds=4.0
    ),
    "simulate": Long("simulate old --overwrite --set " + " --set ".join(TINY), keeps=source_is_whole("old")),
    "bench": Long("bench localise SRC --repeat 2 --condition frames=5 --json b.json --overwrite", seconds=20.0),
    "bench-faults": Long("bench faults SRC --condition frames=5 --json b.json --overwrite", seconds=20.0),
    "suite": Long("suite run suite.yaml --out suite --workers 2", seconds=15.0),
    "replay": Long("replay SRC --out out --overwrite --condition frames=5", seconds=20.0),
    "replay-live": Long("replay SRC --rate 1 --live --live-port 0 --condition frames=5", seconds=15.0),
    "live": Long("live --port 0", endless=True, seconds=5.0),
    "run": Long("run", endless=True, seconds=6.0),
    "record": Long("record old --all --overwrite", endless=True, seconds=5.0),
}
KINDS = (*([signal.SIGTERM, signal.SIGHUP, signal.SIGINT] * 3), signal.SIGKILL)


@dataclass(frozen=True)
class Ending:
    """How a run ended."""

    command: str
    number: signal.Signals
    twice: bool
    after_s: float
    code: int
    was_running: bool  #: Whether the command was running at the time of the signal.
    took_s: float  #: Time from the signal to the end, s.
    problem: str  #: Deviations from the expected result; empty if there are none.


def marked(mark: str) -> Iterator[int]:
    """Yield the processes that a run has started, in any session."""
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if f"{MARK}={mark}".encode() in (folder / "environ").read_bytes() and int(folder.name) != os.getpid():
                yield int(folder.name)


def segments(pids: list[int]) -> set[Path]:
    """Return the Fast DDS segments in /dev/shm that processes hold."""
    found = set()
    for pid in pids:
        with suppress(OSError):
            for entry in os.scandir(f"/proc/{pid}/fd"):
                with suppress(OSError):
                    if (name := os.readlink(entry.path)).startswith("/dev/shm/fastrtps_"):
                        found |= {Path(name), Path(name.removesuffix("_el"))}
    return {path for path in found if "_port" not in path.name}  # ports may belong to other processes


def end_at_random(name: str, source: Path, scratch: Path, rng: random.Random, within_s: float | None = None) -> Ending:
    """Run a command in a ROS domain of its own, send a signal at a random time, and check what remains."""
    with hold_domain() as domain:
        return _end_at_random(name, source, scratch, rng, within_s, domain.number)


def _end_at_random(
    name: str, source: Path, scratch: Path, rng: random.Random, within_s: float | None, domain: int
) -> Ending:
    command, mark = COMMANDS[name], uuid.uuid4().hex
    scratch.mkdir()
    shutil.copytree(source, scratch / "old")
    (scratch / "suite.yaml").write_text(SUITE.format(source=source))
    if name == "convert-bag":
        shutil.copytree(source.with_suffix(".mcap"), scratch / "old.mcap")
    words = [str(source) if word == "SRC" else word for word in command.words.split()]
    number, twice, after_s = rng.choice(KINDS), rng.random() < 0.5, rng.uniform(0.0, within_s or command.seconds)
    variables = os.environ | {MARK: mark, "ROS_DOMAIN_ID": str(domain)}
    log = scratch / "log"
    with log.open("wb") as stream:
        process = subprocess.Popen(
            [sys.executable, "-m", "sfr_loc_map", *words], cwd=scratch, stdin=subprocess.DEVNULL, stdout=stream,
            stderr=subprocess.STDOUT, env=variables, start_new_session=True,
        )  # fmt: skip
    while process.poll() is None and not handles_signals(process.pid):
        time.sleep(0.01)
    begin, held = time.monotonic(), set[Path]()
    end = begin + after_s
    while process.poll() is None and time.monotonic() < end:
        held |= segments(list(marked(mark)))
        time.sleep(min(0.2, max(0.0, end - time.monotonic())))
    held |= segments(list(marked(mark)))
    was_running = process.poll() is None
    after_s, begin = time.monotonic() - begin, time.monotonic()
    for send in (lambda: process.send_signal(number), lambda: os.killpg(process.pid, number))[: 1 + twice]:
        with suppress(ProcessLookupError):
            send()
    try:
        code = process.wait(PATIENCE_S)
    except subprocess.TimeoutExpired:
        process.kill()
        code = process.wait()
    took_s = time.monotonic() - begin
    while (left := list(marked(mark))) and time.monotonic() < begin + took_s + 12.0:
        time.sleep(0.1)
    text = log.read_text(errors="replace")
    killed = number is signal.SIGKILL
    problems = [f"process {Path(f'/proc/{pid}/cmdline').read_bytes()[:200]!r} is left" for pid in left]
    began = "nothing was finished" not in text  # otherwise the signal came before an endless command had begun
    # 0 even if the command had finished before the signal
    expected = {-number} if killed else {0} if command.endless and began else {0, 130}
    if was_running and code not in expected | ({2} if name in ("record", "run") else set()):
        problems.append(f"exit code {code}")
    if "Traceback" in text:
        problems.append("a traceback")
    if not killed and (rest := sorted(path.name for path in held if path.exists())):
        problems.append(f"segments {rest} are left")
    if command.keeps is not None and not _holds(command.keeps, scratch, text):
        problems.append("the old output is gone")
    said = code == 0 or (code == 130 and began)
    if command.whole is not None and said and not _holds(command.whole, scratch, text):
        problems.append("what was finished is not written")
    hidden = [path.name for path in scratch.glob(".*.part")]
    if hidden and not killed:
        problems.append(f"{hidden} is left")
    for pid in left:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    problem = "; ".join(problems) + (f": {text[-3000:]}" if problems else "")
    return Ending(name, number, twice, after_s, code, was_running, took_s, problem)


def _holds(check: Callable[[Path, str], bool], folder: Path, text: str) -> bool:
    try:
        return check(folder, text)
    except Exception:
        return False


def end_many(scratch: Path, count: int, seed: int = 1, names: tuple[str, ...] = tuple(COMMANDS)) -> list[str]:
    """Interrupt `count` runs, with the commands in turn; print each result, and return the failures.

    If a command ended before its signal, the next signal to this command comes sooner.
    """
    rng, failures, codes = random.Random(seed), [], Counter[str]()
    within_s = {name: COMMANDS[name].seconds for name in names}
    scratch.mkdir(exist_ok=True)
    source = write_folder(scratch / "source", PAIRS, 3)
    subprocess.run([sys.executable, "-m", "sfr_loc_map", "convert", source, source.with_suffix(".mcap")], check=True)
    for number in range(count):
        name = names[number % len(names)]
        ending = end_at_random(name, source, scratch / f"run_{number}", rng, within_s[name])
        if not ending.was_running:
            within_s[name] = min(within_s[name], ending.after_s)
        times = "twice" if ending.twice else "     "
        how = (
            f"{ending.number.name:8s} {times} after {ending.after_s:4.1f} s: {ending.code:4d} in {ending.took_s:4.1f} s"
        )
        print(f"{number + 1:3d} {name:16s} {how} {ending.problem}", flush=True)
        codes[str(ending.code) if ending.was_running else "over before"] += 1
        if ending.problem:
            failures.append(f"run {number + 1}, {name}: {ending.problem}")
        else:
            shutil.rmtree(scratch / f"run_{number}")
    print(f"exit codes: {dict(codes)}")
    return failures


def main(arguments: list[str]) -> int:
    """Send signals, with the arguments `[COUNT [COMMAND ...]]`: by default 100, to all commands in turn."""
    count, *names = arguments or ["100"]
    return in_own_domain(lambda folder: end_many(folder, int(count), names=tuple(names or COMMANDS)))
