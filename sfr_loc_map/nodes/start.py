"""The first module of a node's process: a signal ends the process quietly while the other modules are imported.

The imports take most of a second, and an interrupt within them would print a traceback. Nothing is open yet, so that
the process may exit immediately. This module must not import large modules itself.
"""

from __future__ import annotations

import gc
import importlib
import os
import signal
import sys
from functools import partial

from sfr_loc_map.signals import END_SIGNALS


def start(module: str) -> int:
    """Import a module of this package and run its `main`; return its exit code."""
    sys.argv[0] = module.rpartition(".")[2]
    before = {number: signal.signal(number, lambda *_: os._exit(0)) for number in END_SIGNALS}
    signal.pthread_sigmask(signal.SIG_UNBLOCK, END_SIGNALS)  # delivers signals that arrived during the start of Python
    gc.disable()
    main = importlib.import_module(f"sfr_loc_map.{module}").main
    gc.freeze()  # modules live as long as the process, so that the garbage collector need not examine them
    gc.enable()
    for number, handler in before.items():
        signal.signal(number, handler)
    return int(main() or 0)


localisation_node = partial(start, "nodes.localisation_node")
mapping_node = partial(start, "nodes.mapping_node")
monitor_node = partial(start, "nodes.monitor_node")


if __name__ == "__main__":
    raise SystemExit(start(sys.argv.pop(1)))
