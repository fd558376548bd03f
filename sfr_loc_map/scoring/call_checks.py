"""Comparison of calls with the estimate, cloud and images of their score; refusal of calls of several methods."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.calls.call_stats import CallStats
from sfr_loc_map.calls.run_identity import hash_of_cloud, hash_of_pair, hash_of_set
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.rotation import quat_angle, quat_conjugate, quat_multiply
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.message_text import counted
from sfr_loc_map.metrics.calls.calls import Calls
from sfr_loc_map.metrics.config import CallKind
from sfr_loc_map.metrics.figures.records import MethodRecord
from sfr_loc_map.metrics.frames.association import nearness_ns, unique_rows
from sfr_loc_map.stamp_pairing import nearest_stamps
from sfr_loc_map.suite_names import Task

Identity = tuple[str, str | None, str | None]  #: Name, version and SHA-256 of a method.
SAME_POSITION_M = 0.002  #: Tolerance, m, for equal positions that were each rounded to 1 mm.
SAME_ATTITUDE_DEG = 0.12  #: Tolerance, deg, for equal attitudes whose quaternions were rounded to 3 decimals.
EXACT_M = 1e-6  #: Differences of positions up to this size, m, are due to the conversion between file formats.
EXACT_DEG = 1e-6  #: Differences of attitudes up to this size, deg, are due to the conversion between file formats.
CHECKED_PAIRS = 20  #: Number of pairs of a drive, the first of the run, whose images are compared with the source.


# ---- the estimate


class Differences(NamedTuple):
    """Differences between an estimate and the poses in its calls, within the tolerances."""

    position_m: float  #: Largest difference of positions along an axis, m.
    attitude_deg: float  #: Largest angle between attitudes, deg; 0 if the calls or the estimate have no attitudes.
    removed: int  #: Number of poses in the calls that the estimate does not have.


def check_estimate(trajectory: Trajectory, stats: Sequence[CallStats]) -> list[str]:
    """Compare the poses of an estimate with those in its calls, and return caveats.

    The call of an estimate is the call with the nearest stamp, within the tolerance for stamps of one image. Several
    calls of one image are counted as duplicates by the completeness of the calls. Calls of files without poses are not
    checked. InputError if a pose has another position or attitude than its call, or if a pose has no call.
    """
    if not len(trajectory) or not any(map(_has_positions, stats)):
        return []
    poses = trajectory.at_rows(unique_rows(trajectory.stamps_ns))
    has_call = np.zeros(len(poses), np.bool_)
    found: list[Differences] = []
    for item in stats:
        row, gave_pose = _poses_of_calls(poses.stamps_ns, item.localised_ns)
        has_call[row[gave_pose]] = True
        if _has_positions(item):
            found.append(_differences(poses, item, row, gave_pose))
    _check_calls_of_poses(has_call)
    return list(_caveats(found))


def _has_positions(item: CallStats) -> bool:
    """Return whether there are calls of a localiser in a file with positions."""
    return item.identity.positions is not None and len(item.localised_ns) > 0


def _poses_of_calls(stamps_ns: IntArray, called_ns: IntArray) -> tuple[NDArray[np.intp], Mask]:
    """Return the pose nearest to each call `(N,)` as index of `stamps_ns`, and whether the call gave this pose."""
    row, apart_ns = nearest_stamps(called_ns, stamps_ns)
    smallest_ns = np.full(len(stamps_ns), np.iinfo(np.int64).max)
    np.minimum.at(smallest_ns, row, apart_ns)
    return row, (apart_ns <= nearness_ns(stamps_ns)) & (apart_ns == smallest_ns[row])


def _differences(poses: Trajectory, item: CallStats, row: NDArray[np.intp], gave_pose: Mask) -> Differences:
    """Return the differences between poses and calls; `row` and `gave_pose` are the result of `_poses_of_calls`.

    InputError if a call has no pose, or another pose.
    """
    is_localisation, compared = item.calls.is_localisation, row[gave_pose]
    assert item.identity.positions is not None  # by the caller
    positions = item.identity.positions[is_localisation]
    _check_known("position", positions[gave_pose])
    apart_m = np.abs(poses.positions[compared] - positions[gave_pose]).max(axis=1, initial=0.0)
    _check_same("positions", apart_m, SAME_POSITION_M, "m")
    apart_deg = np.zeros(1)
    if item.identity.quats_xyzw is not None and poses.has_attitude:
        quats_xyzw = item.identity.quats_xyzw[is_localisation][gave_pose]
        has_attitude = np.asarray(quats_xyzw.any(axis=1))
        quats_xyzw = np.where(has_attitude[:, None], quats_xyzw, np.nan)
        _check_known("attitude", quats_xyzw)
        apart_deg = _angles_deg(poses.quats_xyzw[compared], quats_xyzw)
        _check_same("attitudes", apart_deg, SAME_ATTITUDE_DEG, "deg")
    removed = int(np.count_nonzero(np.isfinite(positions[~gave_pose]).all(axis=1)))
    return Differences(float(apart_m.max(initial=0.0)), float(apart_deg.max(initial=0.0)), removed)


def _angles_deg(a_xyzw: FloatArray, b_xyzw: FloatArray) -> FloatArray:
    """Return the angles `(N,)`, deg, between attitudes `(N, 4)`, of which `b_xyzw` may have any length but 0."""
    turn = quat_multiply(quat_conjugate(a_xyzw), b_xyzw / np.linalg.norm(b_xyzw, axis=1)[:, None])
    return np.degrees(quat_angle(turn))


def _check_known(what: str, of_calls: FloatArray) -> None:
    """Raise InputError if values `(N, K)` of calls that gave poses are missing."""
    without = int(np.count_nonzero(~np.isfinite(of_calls).all(axis=1)))
    if without:
        raise InputError(
            f"the calls (--stats) have no {what} at {without} of {len(of_calls)} stamps of the estimate: give the "
            "statistics of the run, unchanged"
        )


def _check_same(what: str, apart: FloatArray, tolerance: float, unit: str) -> None:
    """Raise InputError if estimates and their calls are further apart than a tolerance."""
    is_other = ~(apart <= tolerance)
    if is_other.any():
        raise InputError(
            f"the calls (--stats) belong to another estimate: at {np.count_nonzero(is_other)} of {len(is_other)} "
            f"stamps the two {what} differ, by up to {apart.max():.3g} {unit}; give the calls of the run that produced "
            "the estimate"
        )


def _check_calls_of_poses(has_call: Mask) -> None:
    """Raise InputError if a pose `(N,)` of an estimate has no call."""
    without = int(np.count_nonzero(~has_call))
    if without:
        raise InputError(
            f"{without} of {len(has_call)} poses of the estimate have no call (--stats), so that the run of the calls "
            "did not produce them: give the estimate and the calls of one run, unchanged"
        )


def _caveats(found: Sequence[Differences]) -> Iterator[str]:
    """Yield a caveat about differences that rounding can cause, and about poses that the estimate does not have."""
    position_m = max(item.position_m for item in found)
    attitude_deg = max(item.attitude_deg for item in found)
    if position_m > EXACT_M or attitude_deg > EXACT_DEG:
        yield (
            "the poses of the estimate differ from those in its calls (--stats) by up to "
            f"{1e3 * position_m:.3g} mm and {attitude_deg:.3g} deg, as in a rounded file: give the estimate exactly as "
            "the run wrote it"
        )
    if removed := sum(item.removed for item in found):
        yield (
            f"the run of the calls (--stats) produced {counted(removed, 'more pose')} than the estimate has: give the "
            "estimate exactly as the run wrote it"
        )


# ---- the images and the cloud


def stamps_with_images(stats: Sequence[CallStats]) -> set[int]:
    """Return the stamps of the calls of a localiser that have a hash of their images."""
    return set(_named_images(stats, lambda calls: calls.is_localisation))


def other_images(stats: Sequence[CallStats], pairs: Sequence[StereoPair], place: Path) -> Iterator[str]:
    """Yield a caveat if calls of a localiser were made on other images than those of `pairs` from a source.

    Each of the `pairs` in the source at `place` has a call with a hash (`stamps_with_images`).
    """
    named = _named_images(stats, lambda calls: calls.is_localisation)
    if other := sum(named[pair.stamp_ns] != {hash_of_pair(pair)} for pair in pairs):
        yield _other_images(f"{other} of {len(pairs)} compared pairs", place)


def check_cloud(stats: Sequence[CallStats], cloud: PointCloud | None) -> None:
    """Raise InputError if calls of a mapper made another cloud. Calls that do not identify a cloud are not checked."""
    made = {item.identity.cloud_sha256 for item in stats} - {None}
    if made and (cloud is None or made != {hash_of_cloud(cloud)}):
        raise InputError(
            "the calls of a mapper (--stats) made another cloud: give the cloud and the calls of one run, unchanged"
        )


def other_map_images(stats: Sequence[CallStats], pairs: Sequence[StereoPair], place: Path) -> Iterator[str]:
    """Yield a caveat if calls of a mapper were made on other images than those of a source.

    `pairs` are those of the cloud in the source at `place`. Calls without a hash are not compared.
    """
    hashes = {pair.stamp_ns: hash_of_pair(pair) for pair in pairs}
    of_pairs = _named_images(stats, lambda calls: calls.kinds == CallKind.MAPPING)
    other = sum(of_pairs.get(stamp_ns, {own}) != {own} for stamp_ns, own in hashes.items())
    of_sets = _named_images(stats, lambda calls: calls.kinds == CallKind.MAPPING_CALL)
    if any(found != {hash_of_set([*hashes.values()])} for found in of_sets.values()):
        other = len(pairs)
    if other:
        yield _other_images(f"{other} of {len(pairs)} pairs", place)


def _named_images(stats: Sequence[CallStats], chosen: Callable[[Calls], Mask]) -> dict[int, set[str]]:
    """Return the hashes of the images that the chosen calls name, by stamp."""
    found: dict[int, set[str]] = {}
    for item in stats:
        if item.identity.images_sha256 is None:
            continue
        rows = zip(item.calls.stamps_ns.tolist(), item.identity.images_sha256, chosen(item.calls), strict=True)
        for stamp_ns, sha256, is_chosen in rows:
            if is_chosen and sha256:
                found.setdefault(stamp_ns, set()).add(sha256)
    return found


def _other_images(which: str, place: Path) -> str:
    return (
        f"the calls (--stats) were made on other images than those of '{place}' ({which} differ), so that the method "
        "was judged on other data: give the source of the run, and its configuration (--config)"
    )


# ---- the method


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
