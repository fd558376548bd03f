"""When stamps or clocks have jumped back."""

from __future__ import annotations

from sfr_loc_map.inputs import JUMP_BACK_NS


def jumped_back(latest_ns: int, stamp_ns: int) -> bool:
    """Tell whether a stamp lies so far behind the latest one that a new run must have begun."""
    return latest_ns - stamp_ns >= JUMP_BACK_NS
