"""Refusal of calls that belong to another estimate, or to several methods."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sfr_loc_map.calls.call_stats import CallStats
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.metrics.frames.association import nearness_ns
from sfr_loc_map.metrics.table.records import MethodRecord
from sfr_loc_map.stamp_pairing import nearest_stamps
from sfr_loc_map.suite_names import Task

Identity = tuple[str, str | None, str | None]  #: Name, version and SHA-256 of a method.
SAME_POSITION_M = 0.002  #: Tolerance, m, for equal positions that were each rounded to 1 mm.


def check_one_estimate(trajectory: Trajectory, stats: Sequence[CallStats]) -> None:
    """Raise InputError if the positions of calls are missing, or differ from the positions of their estimates.

    The call of an estimate is the call with the nearest stamp, within the tolerance for stamps of one image. Further
    calls may have no estimate. Several calls of one image are counted as duplicates by the completeness of the calls.
    Calls of files without positions are not checked.
    """
    stamps_ns, rows = np.unique(trajectory.stamps_ns, return_index=True)
    for item in stats:
        if item.positions is None or not len(stamps_ns):
            continue
        called_ns, positions = item.localised_ns, item.positions[item.calls.is_localisation]
        place, apart_ns = nearest_stamps(called_ns, stamps_ns)
        smallest_ns = np.full(len(stamps_ns), np.iinfo(np.int64).max)
        np.minimum.at(smallest_ns, place, apart_ns)
        gave_estimate = (apart_ns <= nearness_ns(stamps_ns)) & (apart_ns == smallest_ns[place])
        _check_positions(trajectory.positions[rows[place[gave_estimate]]], positions[gave_estimate])


def _check_positions(of_estimates: FloatArray, of_calls: FloatArray) -> None:
    """Raise InputError if positions `(N, 3)` of calls are missing, or differ from those of the estimates."""
    without = int(np.count_nonzero(~np.isfinite(of_calls).all(axis=1)))
    if without:
        raise InputError(
            f"the calls (--stats) have no position at {without} of {len(of_calls)} stamps of the estimate: give the "
            "statistics of the run, unchanged"
        )
    apart_m = np.abs(of_estimates - of_calls).max(axis=1, initial=0.0)
    is_other = apart_m > SAME_POSITION_M
    if is_other.any():
        raise InputError(
            f"the calls (--stats) belong to another estimate: at {np.count_nonzero(is_other)} of {len(is_other)} "
            f"stamps the two positions differ, by up to {apart_m.max():.3g} m; give the calls of the run that produced "
            "the estimate"
        )


def check_one_method(stats: Sequence[CallStats], target: CallStats | None) -> None:
    """Raise InputError if the calls of a run come from several methods, or from several configurations of a method.

    The calls on a target must come from the same method as the calls on this host.
    """
    here = {_identity(item.method) for item in stats if item.method is not None}
    names = ", ".join(_names(sorted(here, key=str)))
    if len(here) > 1:
        raise InputError(f"the calls (--stats) come from {len(here)} methods ({names}): give the calls of one method")
    for task in Task:
        methods = [item.methods[task] for item in stats if item.has_task(task) and task in item.methods]
        configurations = {method.config_sha256 for method in methods}
        if len(configurations) > 1:
            raise InputError(
                f"the {task} calls (--stats) come from {len(configurations)} configurations of the method {names}: "
                "give the calls of one configuration"
            )
    if target is not None and target.method is not None and here and _identity(target.method) not in here:
        on_target, on_host = _names([_identity(target.method), *here])
        raise InputError(
            f"the calls on the target are of the method {on_target}, but the calls on this host are of {on_host}: give "
            "the calls of one method"
        )


def _identity(method: MethodRecord) -> Identity:
    return method.name, method.version, method.sha256


def _names(methods: Sequence[Identity]) -> list[str]:
    """Return name and version of each method, with the hash of its code if two names and versions are equal."""
    names = [f"{name} {version or ''}".strip() for name, version, _ in methods]
    if len(set(names)) == len(names):
        return names
    hashes = [sha256[:8] if sha256 else "unknown" for _, _, sha256 in methods]
    return [f"{name} with the code sha256 {sha256}" for name, sha256 in zip(names, hashes, strict=True)]
