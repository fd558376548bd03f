"""A warm process that runs one input after the other, as it is told on standard input (one JSON line each)."""

from __future__ import annotations

import faulthandler
import importlib
import json
import os
import resource
import shutil
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path

os.environ.pop("OPENCV_LOG_LEVEL", None)

import cv2
import execution
from target import Target

ADDRESS_SPACE = 8 * 2**30
"""Bytes that may be reserved beyond what the warm process has: protects the host, not the measure of memory."""


def _targets(place: str) -> dict[str, Target]:
    """Return the targets of a function, given as `module:function`."""
    module, _, function = place.partition(":")
    found: dict[str, Target] = getattr(importlib.import_module(module), function)()
    return found


def main() -> int:
    """Answer orders until standard input ends; arguments are the world and where the targets come from."""
    faulthandler.enable()
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # whatever a library prints must not be taken for an answer
    cv2.setNumThreads(1)
    source = Path(sys.argv[1])
    scratch = Path(tempfile.mkdtemp(prefix="sfr-fuzz-"))
    world, out = scratch / "world", scratch / "out"
    try:
        shutil.copytree(source, world)
        os.chdir(scratch)
        targets = _targets(sys.argv[2])
        problems = [text for target in targets.values() for text in execution.refused_valid_inputs(target, world, out)]
        if problems:
            raise SystemExit("\n".join(problems))
        used = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
        resource.setrlimit(resource.RLIMIT_AS, (used + ADDRESS_SPACE,) * 2)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        print(json.dumps({"ready": True}), file=answers)
        for line in sys.stdin:
            order = json.loads(line)
            target = targets[order["target"]]
            if "file" in order:
                content = Path(order["file"]).read_bytes()
            else:
                content = execution.make_input(target, source, order["seed"], order["index"])
            Path(order["keep"]).write_bytes(content)
            print(json.dumps({"begun": True}), file=answers)
            outcome = execution.run_input(target, content, world, out)
            print(json.dumps(asdict(outcome)), file=answers)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
