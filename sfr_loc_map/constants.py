"""Constants that more than one package needs."""

from __future__ import annotations

from enum import StrEnum
from typing import Literal

NS_PER_S = 1_000_000_000
"""Nanoseconds in a second."""
Side = Literal["left", "right"]
SIDES: tuple[Side, Side] = ("left", "right")
"""The cameras of a stereo rig, in the order of all files and topics."""
LOST_VARIANCE = 9999.0
"""Variance on the whole diagonal of the covariance of a pose that is not known (m^2, rad^2)."""
JUMP_BACK_NS = NS_PER_S
"""A clock that goes back by more than this was set, or a bag was started again."""


class Task(StrEnum):
    """The two tasks of the suite, each with a rig of its own."""

    LOCALISATION = "localisation"
    MAPPING = "mapping"

    @property
    def rig(self) -> str:
        """Prefix of its image topics and name of its part of a data set: `loc` or `nav`."""
        return "loc" if self is Task.LOCALISATION else "nav"

    @classmethod
    def of_rig(cls, rig: str) -> Task:
        """Return the task of the rig `loc` or `nav`.

        Raises:
            ValueError: If it is neither.
        """
        for task in cls:
            if task.rig == rig:
                return task
        raise ValueError(f"'{rig}' is not a rig: loc or nav is needed")
