"""Campaigns on the running nodes, by targets of the Makefile; exit code 1 if something is not as expected.

python test/campaign faults [NAME ...] [--out FOLDER]    one fault after the other; FOLDER/faults.json, faults.md
python test/campaign soak [MINUTES]
python test/campaign rate [MINUTES [RATE_HZ [SIZE_PX]]]
python test/campaign monitor [HOURS]                     simulated hours of the monitor at 50 Hz, faster than real time
"""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import asdict
from pathlib import Path

import long_runs
from node_faults import FAULTS, Row, inject

from sfr_loc_map.nodes import environment

HEAD = "| fault | what is expected | observed | data lost | recovery s | verdict |\n|---|---|---|---|---|---|\n"


def table_line(row: Row) -> str:
    """Return a row as a line of Markdown."""
    observed = "; ".join([*row.observed, *(f"NOT AS EXPECTED: {text}" for text in row.failures)])
    recovery = "" if row.recover_s is None else f"{row.recover_s:.2f}"
    cells = (row.name, row.fault, observed, row.lost, recovery, row.verdict)
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |\n"


def inject_all(names: list[str], out: Path, scratch: Path) -> list[str]:
    """Inject faults, write the table and its JSON after each; return the names of those not as expected."""
    out.mkdir(parents=True, exist_ok=True)
    rows: list[Row] = []
    for name in names:
        rows.append(inject(name, scratch / name))
        text = json.dumps({"schema": "sfr-faults/1", "rows": [*map(asdict, rows)]}, indent=1)
        (out / "faults.json").write_text(text)
        (out / "faults.md").write_text(HEAD + "".join(map(table_line, rows)))
        print(table_line(rows[-1]), end="", flush=True)
    return [row.name for row in rows if row.verdict == "FAIL"]


def main() -> int:
    """Run a campaign."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("campaign", choices=("faults", "soak", "rate", "monitor"))
    parser.add_argument("what", nargs="*", help="names of faults (all), or numbers")
    parser.add_argument("--out", type=Path, default=Path("out"))
    options = parser.parse_args()
    if options.campaign == "faults" and (unknown := sorted({*options.what} - FAULTS.keys())):
        parser.error(f"no fault '{unknown[0]}': known are {', '.join(FAULTS)}")
    environment.prepare()
    environment.isolate()
    with tempfile.TemporaryDirectory(prefix="sfr_campaign.") as folder:
        if options.campaign == "faults":
            failures = inject_all(options.what or list(FAULTS), options.out, Path(folder))
        elif options.campaign == "monitor":
            failures = long_runs.soak_monitor(*map(float, options.what))
        else:
            run = long_runs.soak if options.campaign == "soak" else long_runs.carry_images
            failures = run(Path(folder), *map(float, options.what))
    print(f"not as expected: {'; '.join(failures)}" if failures else "all as expected")
    return int(bool(failures))


if __name__ == "__main__":
    raise SystemExit(main())
