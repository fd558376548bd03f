"""From each recording to a verdict: commands, time, error, and the result without the configuration.

python -m campaigns recordings [NAME ...] [--out FOLDER]    writes FOLDER/recordings.md and the recordings
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from campaigns.recordings.drive import Drive, load_drive
from campaigns.recordings.figures import LIMITS, error_of
from campaigns.recordings.rows import ROWS, Made, Row
from sfr_loc_map.ros import environment

SFR = str(Path(sys.executable).parent / "sfr")
HEADING = "| recording | commands | s | error | plain | allowed | verdict | by the doctor | without |\n"


class Ran(NamedTuple):
    """Result of a command."""

    code: int
    seconds: float
    said: str


def run(*words: object) -> Ran:
    began = time.monotonic()
    done = subprocess.run([SFR, *map(str, words)], capture_output=True, text=True, timeout=300)
    return Ran(done.returncode, time.monotonic() - began, done.stdout + done.stderr)


def replay(source: Path, folder: Path, out: str, *more: object) -> tuple[Ran, Path]:
    """Replay to a verdict; also return the output folder."""
    words = ("replay", source, "--limits", folder / "limits.yaml", "--out", folder / out)
    return run(*words, *more), folder / out


def init_words(folder: Path, made: Made) -> list[object]:
    given = [] if made.calibration is None else ["--calibration", made.calibration]
    for name, value in made.settings.items():
        given += ["--set", f"{name}={value if isinstance(value, str) else json.dumps(value)}"]
    return ["init", folder / "mine", "--from", made.source, *given]


@dataclass
class Outcome:
    """The result of a recording."""

    row: Row
    commands: int
    seconds: float
    error: float | None
    verdict: str
    doctor: str
    without: str
    said: str

    def fails(self, plain: dict[str, float]) -> list[str]:
        """Return the failures."""
        found = []
        if self.error is None or self.verdict != "pass":
            found.append(f"no verdict: {self.said.strip()[-400:]}")
        elif abs(self.error - plain[self.row.figure]) > self.row.loses:
            found.append(f"{self.error:.3f} in place of {plain[self.row.figure]:.3f}")
        if self.without.startswith("SILENT"):
            found.append(f"without the fix: {self.without}")
        if not self.doctor.startswith(("0", "asks")):
            found.append(f"by the doctor: {self.doctor}")
        return found

    def line(self, plain: dict[str, float]) -> str:
        unit = "m" if self.row.figure == "map" else "mm"
        error = "-" if self.error is None else f"{self.error:.3f} {unit}"
        cells = (self.row.name, str(self.commands), f"{self.seconds:.0f}", error, f"{plain[self.row.figure]:.3f}")
        ends = f"{self.row.loses:g}: {self.row.why}", self.verdict, self.doctor, self.without
        return f"| {' | '.join((*cells, *ends))} |"


def judge(row: Row, folder: Path, drive: Drive, plain: dict[str, float]) -> Outcome:
    """Make a recording and process it to a verdict: by `init`, by the doctor, and without both."""
    folder.mkdir(parents=True)
    (folder / "limits.yaml").write_text(LIMITS[row.figure])
    made = row.make(folder, drive)
    bare, out = replay(made.source, folder, "without")  # before any configuration exists beside the recording
    without = f"exit {bare.code}"
    if bare.code in (0, 1):
        error = error_of(row.figure, out)
        same = error is not None and abs(error - plain.get(row.figure, error)) <= row.loses
        without = "nothing to fix" if same else f"SILENT: {error}"
    first = run(*init_words(folder, made))
    second, out = replay(made.source, folder, "out", "--config", folder / "mine" / "sfr.yaml")
    error = error_of(row.figure, out) if second.code in (0, 1) else None
    said = first.said if first.code else second.said
    verdict = {0: "pass", 1: "fail"}.get(second.code, f"none, exit {second.code}")
    doctor = by_doctor(made, folder)
    return Outcome(row, 2, first.seconds + second.seconds, error, verdict, doctor, without, said)


def by_doctor(made: Made, folder: Path) -> str:
    """Write the configuration that the doctor proposes, with the owner's settings, and replay."""
    fixed = run("info", made.source, "--write", *init_words(folder, made)[4:])
    if fixed.code not in (0, 1):
        return f"doctor: exit {fixed.code}: {' '.join(fixed.said.split())[-200:]}"
    ran, _ = replay(made.source, folder, "by_doctor")
    return "0" if ran.code == 0 else f"exit {ran.code}: {' '.join(ran.said.split())[-200:]}"


def main(arguments: list[str]) -> int:
    """Run the campaign."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help="recordings; by default all")
    parser.add_argument("--out", type=Path, default=Path("out/recordings"))
    options = parser.parse_args(arguments)
    if unknown := sorted({*options.names} - ROWS.keys()):
        parser.error(f"no recording '{unknown[0]}': known are {', '.join(ROWS)}")
    environment.isolate()
    os.environ["SFR_HINTS"] = "0"
    shutil.rmtree(options.out, ignore_errors=True)
    drive, plain, failed = load_drive(), {}, []
    lines = [HEADING, f"|{'---|' * 9}\n"]
    for name in ["plain", *(name for name in options.names or ROWS if name != "plain")]:
        outcome = judge(ROWS[name], options.out / name, drive, plain)
        if name == "plain":
            assert outcome.error is not None, outcome.said
            plain = {figure: error_of(figure, options.out / "plain" / "out") or 0.0 for figure in LIMITS}
        lines.append(outcome.line(plain) + "\n")
        (options.out / "recordings.md").write_text("".join(lines))
        found = outcome.fails(plain)
        failed += [name] * bool(found)
        print(lines[-1].strip(), *(f"\n    {item}" for item in found), flush=True)
    print(f"not as expected: {', '.join(failed)}" if failed else "all as expected")
    return bool(failed)
