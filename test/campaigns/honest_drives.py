"""False diagnoses of convention mismatches on random drives without a mismatch.

python -m campaigns honest-drives [--drives 1000] [--seed 0]

The drives have noise, drift, a scale error of about 1 %, outliers and wrong last frames; some are short, straight or
stationary.
"""

from __future__ import annotations

import argparse

from helpers.honest_drives import honest_drive, positions_of
from sfr_loc_map.metrics.config import AssociationConfig
from sfr_loc_map.metrics.conventions.convention_diagnosis import diagnose


def main(arguments: list[str]) -> int:
    """Diagnose the drives and print each false diagnosis; exit code 1 if there is one."""
    parser = argparse.ArgumentParser(prog="python -m campaigns honest-drives")
    parser.add_argument("--drives", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args(arguments)
    accused = 0
    for seed in range(given.seed, given.seed + given.drives):
        kind, estimate, truth = honest_drive(seed)
        for known in (truth, positions_of(truth)):
            found = diagnose(estimate, known, AssociationConfig(), every=False).found
            if found is not None:
                accused += 1
                print(f"seed {seed}, {kind}: {found.sentence}")
    print(f"{accused} reports of {given.drives} honest drives, with complete truths and with positions alone")
    return 1 if accused else 0
