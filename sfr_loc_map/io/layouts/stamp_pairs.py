"""Pairs left and right images by their stamps, for all sources whose layout does not list the pairs."""

from __future__ import annotations

import logging
from collections.abc import Collection, Sequence
from statistics import median_low

from sfr_loc_map.errors import InputError
from sfr_loc_map.io.source_config import SyncConfig
from sfr_loc_map.message_stamps import NS_PER_MS, NS_PER_S
from sfr_loc_map.message_text import counted
from sfr_loc_map.stamp_pairing import match_stamps

_log = logging.getLogger(__name__)


def stereo_pairs(left_ns: Sequence[int], right_ns: Sequence[int], sync: SyncConfig, where: str) -> dict[int, int]:
    """Return the stamp of the right image by the stamp of the left image; both inputs must increase.

    Pairs with different stamps and images without a partner are reported. InputError if there is no pair.
    """
    offset_ns = round(sync.right_offset_s * NS_PER_S)
    matched = match_stamps(left_ns, [stamp + offset_ns for stamp in right_ns], sync.stamp_tolerance_ns)
    within = f"{sync.stamp_tolerance_ns / NS_PER_MS:g} ms"
    if not matched:
        raise InputError(
            f"{where}: none of the {len(left_ns)} left images has a stamp within {within} of any of the "
            f"{len(right_ns)} right images:",
            "trigger both cameras together, or set sync.stamp_tolerance_s or sync.right_offset_s in sfr.yaml",
        )
    if differences := [abs(right - left) for left, right in matched.items() if right != left]:
        typical, largest = (f"{value / NS_PER_MS:.3g}" for value in (median_low(differences), max(differences)))
        _log.warning(
            f"{where}: {len(differences)} of {len(matched)} pairs have stamps that differ, typically by {typical} ms, "
            f"at most by {largest} ms: matched within {within}"
        )
    if single := len(left_ns) + len(right_ns) - 2 * len(matched):
        _log.warning(f"{where}: {counted(single, 'image')} without a partner skipped")
    return {left: right - offset_ns for left, right in matched.items()}


def without_partner(left_ns: Sequence[int], pairs: Collection[int]) -> tuple[int, ...]:
    """Return the stamps of left images that are in no pair, for which an estimate is missing; `pairs` are left stamps.

    The first and the last left image do not count, because a recording may begin or end between two images of a pair.
    """
    return tuple(stamp for stamp in left_ns[1:-1] if stamp not in pairs)
