"""Campaigns on the running nodes, by targets of the Makefile; exit code 1 if something is not as expected.

python test/campaign faults [NAME ...] [--out FOLDER]    one fault after the other; FOLDER/faults.json
python test/campaign soak [MINUTES]
python test/campaign signals [COUNT [COMMAND ...]]
python test/campaign drivers [ENCODING ...]
"""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import asdict
from pathlib import Path

from camera_driver import ENCODINGS
from driver_pairs import drive_pairs
from long_runs import soak
from node_faults import FAULTS, Row, inject
from signal_runs import COMMANDS, end_many

from sfr_loc_map.nodes import environment


def inject_all(names: list[str], out: Path, scratch: Path) -> list[str]:
    """Inject faults, print each and write all after each; return the names of those not as expected."""
    out.mkdir(parents=True, exist_ok=True)
    rows: list[Row] = []
    for name in names:
        rows.append(inject(name, scratch / name))
        text = json.dumps({"schema": "sfr-faults/1", "rows": [*map(asdict, rows)]}, indent=1)
        (out / "faults.json").write_text(text)
        print(json.dumps(asdict(rows[-1])), flush=True)
    return [row.name for row in rows if row.verdict == "FAIL"]


def main() -> int:
    """Run a campaign."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("campaign", choices=("faults", "soak", "signals", "drivers"))
    parser.add_argument("what", nargs="*", help="names of faults (all) or encodings (all), minutes, or a count")
    parser.add_argument("--out", type=Path, default=Path("out"))
    options = parser.parse_args()
    if options.campaign == "faults" and (unknown := sorted({*options.what} - FAULTS.keys())):
        parser.error(f"no fault '{unknown[0]}': known are {', '.join(FAULTS)}")
    environment.prepare()
    environment.isolate()
    with tempfile.TemporaryDirectory(prefix="sfr_campaign.") as folder:
        if options.campaign == "faults":
            failures = inject_all(options.what or list(FAULTS), options.out, Path(folder))
        elif options.campaign == "signals":
            count, *names = options.what or ["100"]
            failures = end_many(Path(folder), int(count), names=tuple(names or COMMANDS))
        elif options.campaign == "drivers":
            failures = drive_pairs(Path(folder), tuple(options.what or ENCODINGS))
        else:
            failures = soak(Path(folder), *map(float, options.what))
    print(f"not as expected: {'; '.join(failures)}" if failures else "all as expected")
    return int(bool(failures))


if __name__ == "__main__":
    raise SystemExit(main())
