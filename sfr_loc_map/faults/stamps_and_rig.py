"""Faults of stamps and of the calibration, as functions of the stamp or of the rig, and of the amount."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.message_stamps import NS_PER_S

LAST_STAMP_NS = 2**63 - 1  #: Largest 64-bit stamp.

StampChange = Callable[[int, float, int | None], int]
"""Returns the stamp of an affected pair, ns, from its stamp, the amount, s, and the next stamp; None after the last."""
RigChange = Callable[[StereoRig, float], StereoRig]
"""Returns the rig with a fault of the calibration, from the rig and the amount."""


def same_stamp(stamp_ns: int, amount_s: float, following_ns: int | None) -> int:
    """Return the stamp unchanged."""
    return stamp_ns


def moved_stamp(stamp_ns: int, amount_s: float, following_ns: int | None) -> int:
    """Return the stamp of a clock that is `amount_s` late."""
    return stamp_ns + round(amount_s * NS_PER_S)


def late_stamp(stamp_ns: int, amount_s: float, following_ns: int | None) -> int:
    """Return a stamp that is `amount_s` late, but before the next stamp."""
    latest_ns = LAST_STAMP_NS if following_ns is None else following_ns - 1
    return min(stamp_ns + round(amount_s * NS_PER_S), latest_ns)


def same_rig(rig: StereoRig, amount: float) -> StereoRig:
    """Return the rig unchanged."""
    return rig


def with_focal_factor(rig: StereoRig, amount: float) -> StereoRig:
    """Return the rig with its focal lengths multiplied by `amount`."""
    return replace(rig, fx=rig.fx * amount, fy=rig.fy * amount)


def with_baseline_factor(rig: StereoRig, amount: float) -> StereoRig:
    """Return the rig with its baseline multiplied by `amount`."""
    return replace(rig, baseline_m=rig.baseline_m * amount)
