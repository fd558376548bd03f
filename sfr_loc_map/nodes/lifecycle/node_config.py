"""Parameters that all nodes have, and those of nodes that process stereo pairs."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, field

from sfr_loc_map.config import param
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.nodes.diagnostics.health import HealthConfig
from sfr_loc_map.nodes.lifecycle.qos import RELIABILITIES
from sfr_loc_map.nodes.lifecycle.worker import Overload


@dataclass(frozen=True, slots=True)
class NodeConfig:
    """Parameters that each node has."""

    autostart: bool = param(
        True, doc="Become active at start; false: wait for a lifecycle manager or `ros2 lifecycle set`."
    )
    output_reliability: str = param(
        "reliable", doc="Reliability offered to the subscribers of results.", choices=RELIABILITIES
    )
    health: HealthConfig = field(default_factory=HealthConfig)

    @abstractmethod
    def queue(self) -> tuple[Overload, int]:
        """Return what is dropped when the worker cannot keep up, and how many jobs may wait."""


@dataclass(frozen=True, slots=True)
class PairNodeConfig(NodeConfig):
    """Parameters that each node has that processes stereo pairs."""

    overload: str = param(
        Overload.EVERY_PAIR.value,
        doc="What is processed under overload: every_pair in order, as far as queue_size allows, or newest_first, "
        "which drops all waiting pairs when a newer one comes.",
        choices=tuple(mode.value for mode in Overload),
    )
    queue_size: int = param(
        30, doc="Most pairs that wait to be processed (every_pair); the oldest are dropped.", low=1, high=1000
    )

    frame_prefix: str = param(
        "", doc="Put before the name of each frame, as rover1/: several rovers then share one tree of frames."
    )

    def frame(self, name: str) -> str:
        """Return the name that a frame has in messages."""
        return self.frame_prefix + name

    def check_frames(self, *names: str) -> None:
        """Check names of frames that must differ, by the rules of tf2.

        Raises:
            ConfigError: If one is empty, has blanks or begins with `/`, or two are equal.
        """
        for name in names:
            full = self.frame(name)
            if not name or full.startswith("/") or full.split() != [full]:
                raise ConfigError(f"'{full}' is no name of a frame: give one without blanks and without / before it")
        if len(set(names)) < len(names):
            raise ConfigError(f"the frames {', '.join(names)} must have different names")

    def queue(self) -> tuple[Overload, int]:
        """Return the limits that the parameters set."""
        return Overload(self.overload), self.queue_size
