"""A method under test: what it is called, and how its process is started."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

from sfr_loc_map.config import param
from sfr_loc_map.metrics.score import MethodKind, MethodRecord

WORKERS = Path(__file__).parent / "workers"
OURS = "sfr"


class MethodTask(StrEnum):
    """What a method does."""

    LOCALISE = "localise"
    MAP = "map"


@dataclass(frozen=True, slots=True)
class MethodLimits:
    """What a method may take before its process is ended."""

    call_timeout_s: float = param(120.0, unit="s", doc="Longest time of a call.", low=0.05, high=1e6)
    start_timeout_s: float = param(900.0, unit="s", doc="Longest time of start and warm-up.", low=0.05, high=1e6)
    memory_mb: int = param(4000, unit="MB", doc="Resident memory at which it is ended.", low=50, high=10**6)
    restarts: int = param(3, doc="Times that it is started again after its process was lost.", low=0, high=1000)


@dataclass(frozen=True, slots=True)
class Method:
    """A localiser or mapper that runs in a process of its own.

    Attributes:
        name: As it was chosen.
        task: What it does.
        kind: Where it comes from.
        worker: Its adapter in `workers/`; an absolute path stands for itself.
        target: What the adapter loads: `package.module:Class`, the path of a library; empty where it needs none.
        config: Text of its configuration.
        python: Interpreter that has it.
        background: Whether it continues to work between calls: in a benchmark it runs alone, at the recording's rate.
        setup: Sent to its adapter besides the rig.
        sha256: Hash of the file that it is loaded from; None where it is not one file.
    """

    name: str
    task: MethodTask
    kind: MethodKind
    worker: str
    target: str = ""
    config: str = ""
    python: Path = field(default_factory=lambda: Path(sys.executable))
    background: bool = False
    setup: Mapping[str, object] = field(default_factory=dict)
    sha256: str | None = None

    @property
    def command(self) -> list[str]:
        """Return the command that starts its process."""
        return [str(self.python), str(WORKERS / "loop.py"), str(WORKERS / self.worker)]

    def record(self, version: str | None) -> MethodRecord:
        """Return what the score says of it."""
        return MethodRecord(name=self.name, version=version, kind=self.kind, sha256=self.sha256)
