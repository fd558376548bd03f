"""Constants that more than one package needs."""

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
