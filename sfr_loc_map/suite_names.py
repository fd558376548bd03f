"""Names that data, nodes and methods of the suite share."""

from __future__ import annotations

from enum import StrEnum
from typing import Literal

Side = Literal["left", "right"]
SIDES: tuple[Side, Side] = ("left", "right")
"""The cameras of a stereo rig, in the order that all files and lists of topics use."""
SIDES_OF = (("left", "right"), ("cam0", "cam1"), ("infra1", "infra2"), ("image_left", "image_right"), ("l", "r"))
"""Names of the folders of left and right images, in lower case."""
IMAGE_ENDINGS = (".png", ".jpg", ".jpeg", ".pgm", ".ppm")  #: Suffixes of image files, in lower case.
OURS = "sfr"  #: Name of the suite's own localiser and mapper among the methods.
MONITOR_NODE = "monitor_node"
PLAYER_NODE = "sfr_player"  #: Name of the ROS node that publishes a recording in a replay.


class Task(StrEnum):
    """The two tasks of the suite, each with its own rig."""

    LOCALISATION = "localisation"
    MAPPING = "mapping"

    @classmethod
    def of_rig(cls, rig: str) -> Task:
        """Return the task of a rig, `loc` or `nav`."""
        return next(task for task in cls if task.rig == rig)

    @property
    def rig(self) -> str:
        """Prefix of the task's image topics and name of its part of a data set: `loc` or `nav`."""
        return "loc" if self is Task.LOCALISATION else "nav"

    @property
    def node(self) -> str:
        """Name of the task's node."""
        return f"{self}_node"


SUITE_NODES = (*(task.node for task in Task), MONITOR_NODE)
