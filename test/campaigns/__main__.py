"""Run a campaign: `python -m campaigns NAME [ARGUMENT ...]`. The exit code is 1 if a result is not as expected.

The targets of the Makefile set the path; CONTRIBUTING.md lists the campaigns.
"""

from __future__ import annotations

import sys
from importlib import import_module

CAMPAIGNS = {
    "check-detection": "check_detection",
    "clean-drives": "clean_drives",
    "drivers": "drivers",
    "faults": "faults",
    "fuzz": "fuzz.command",
    "history-power": "history_power",
    "honest-drives": "honest_drives",
    "interval-coverage": "interval_coverage",
    "long-monitor": "long_monitor",
    "message-orders": "message_orders",
    "misbehaviour": "misbehaviour",
    "misclosure": "misclosure",
    "random-faults": "random_faults",
    "recordings": "recordings.command",
    "signals": "signals",
    "soak": "soak",
    "suite-overhead": "suite_overhead",
    "tolerance-coverage": "tolerance_coverage",
}
"""Names and modules; each module has a function `main(arguments)` that returns the exit code.

A new campaign is a module, a row here and a row of the table in CONTRIBUTING.md; with a target, also in the Makefile.
`drivers`, `faults`, `recordings`, `signals` and `soak` start nodes, which requires ROS.
"""


def main(words: list[str]) -> int:
    """Run the campaign that the first word names; the other words are its arguments."""
    if not words or words[0] not in CAMPAIGNS:
        print(f"usage: python -m campaigns NAME [ARGUMENT ...]; campaigns: {', '.join(CAMPAIGNS)}", file=sys.stderr)
        return 2
    name, *arguments = words
    sys.argv[0] = f"campaigns {name}"
    return int(import_module(f"campaigns.{CAMPAIGNS[name]}").main(arguments))


if __name__ == "__main__":  # spawned processes also import this module
    raise SystemExit(main(sys.argv[1:]))
