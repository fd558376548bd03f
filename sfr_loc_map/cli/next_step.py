"""The last line of a command: what is useful next.

It goes to standard error behind all other lines, as the hints of git do, so that pipes and files never hold it. There
is none after bad input or an interruption, none where JSON goes to standard output (a program reads it), and none at
all with `sfr --no-hints` or `SFR_HINTS=0`.
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Mapping
from pathlib import Path

from sfr_loc_map.errors import ExitCode

SWITCH = "SFR_HINTS"
AFTER: Mapping[str, str] = {
    "localise": "sfr score T.csv SRC --stats S.csv    # against the truth",
    "map": "sfr score C.ply SRC    # against the truth",
    "convert": "sfr doctor DST    # is it complete",
    "score": "sfr score ... --limits limits.yaml --html report.html    # limits: sfr init",
    "plot": "sfr score EST TRUTH    # the figures, with limits a verdict",
    "replay": "sfr replay SRC --out DIR    # keeps report, estimate and cloud",
    "run": "sfr doctor --graph    # while the nodes run: are their inputs there",
    "record": "sfr doctor OUT    # is it complete",
    "live": "sfr replay SRC --live --out DIR    # a run that is scored while the page shows it",
    "report": "sfr compare A.json B.json    # which of two runs is better",
    "simulate": "sfr replay OUT --start truth --out DIR    # through the nodes, scored",
    "perturb": "sfr localise DST -o T.csv --stats S.csv    # then score it against the source without the fault",
    "compare": "sfr compare A.json B.json --html comparison.html    # the same as a page with figures",
    "doctor": "sfr replay SRC --start truth --out DIR    # through the nodes, scored",
    "history": "sfr suite compare A B    # two of these suites in full",
    "methods": "sfr localise SRC -o T.csv --method NAME    # the same drive by another method",
    "bench localise": "sfr localise SRC -o T.csv --stats S.csv --method NAME    # one method, to score and compare",
    "bench map": "sfr map SRC -o C.ply --stats S.csv --method NAME    # one method, to score and compare",
    "bench score": "sfr score EST TRUTH --align se3    # with the figures of other tools beside ours",
    "bench faults": "sfr perturb SRC DST --fault KIND:amount=A    # one fault alone, kept",
    "campaign faults": "sfr campaign rate    # how fast pairs may come",
    "campaign rate": "sfr bench localise SRC    # time of a call without the nodes",
    "campaign monitor": "sfr campaign faults    # one fault after the other",
    "suite run": "sfr suite report DIR    # its page again, from the results",
    "suite report": "sfr suite compare A B    # against an earlier one",
    "suite compare": "sfr history DIR...    # the first change that made it worse",
}
"""By command, where it proposes nothing better itself."""

_proposed: list[str] = []


def propose(*words: str | Path, why: str = "") -> None:
    """Set what the command shows in its last line.

    Args:
        words: A command line, quoted for the shell here; a single word with blanks is taken as it is.
        why: What it is good for.
    """
    line = str(words[0]) if len(words) == 1 else shlex.join(map(str, words))
    _proposed[:] = [f"{line}    # {why}" if why else line]


def propose_default(command: str) -> None:
    """Set what is shown after a command that proposes nothing itself."""
    _proposed[:] = [AFTER[command]] if command in AFTER else []


def propose_nothing() -> None:
    """Leave the last line out: a program reads the output."""
    _proposed.clear()


def last_line(code: int) -> str:
    """Return the last line of a command that ended with an exit code, empty for none, and forget it."""
    lines, _proposed[:] = list(_proposed), []
    wanted = os.environ.get(SWITCH, "1") != "0" and code in (ExitCode.OK, ExitCode.FAILED, ExitCode.NOT_JUDGED)
    return f"next: {lines[0]}" if lines and wanted else ""
