"""Options of a replay with an external node."""

from __future__ import annotations

from dataclasses import dataclass, field

from sfr_loc_map.geometry.pose_convention import PoseConvention
from sfr_loc_map.inputs import Task

RESULT_TOPICS = {"localisation": "localisation/odometry", "mapping": "mapping/points"}
"""Topics of the suite that carry the results of a task."""
CONVERTED = "external/converted"
"""Topic of converted results, where the node itself publishes on the suite's."""


@dataclass(frozen=True, slots=True)
class ExternalOptions:
    """An external node in place of ours.

    Attributes:
        task: What it does.
        topic: What it publishes its results on.
        command: Command that starts it; empty: it runs already, or is started by the user.
        watch: Process whose CPU and memory are measured: number, or part of a command line; empty: that of the command.
        frames: What its answers name, `parent -> child` or of a cloud `parent`; empty: what the first of them names.
        timeout_s: How long the answer to a pair is waited for, in lock step; what comes later is late.
        start_timeout_s: How long it may take until it listens.
        convention: In what its poses differ from those of RB in DS; for a cloud, its points from those in LM.
    """

    task: Task
    topic: str
    command: str = ""
    watch: str = ""
    frames: str = ""
    timeout_s: float = 5.0
    start_timeout_s: float = 60.0
    convention: PoseConvention = field(default_factory=PoseConvention)

    @property
    def converted_topic(self) -> str:
        """What the converted results are published on, for the monitor."""
        own = RESULT_TOPICS[self.task]
        return CONVERTED if self.topic == own else own
