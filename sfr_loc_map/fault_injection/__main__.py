"""Injects one fault in a process of its own; see `run.run_ordered`."""

import sys

from sfr_loc_map.fault_injection.run import run_ordered

if __name__ == "__main__":
    run_ordered(sys.argv[1])
