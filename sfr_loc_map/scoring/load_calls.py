"""Read the calls of a run, and give their states and covariances to the poses of its estimate."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from sfr_loc_map.calls.call_files import load_call_stats
from sfr_loc_map.calls.call_poses import estimates_of, with_stamps_of_poses
from sfr_loc_map.calls.call_stats import CallStats, united
from sfr_loc_map.calls.run_identity import RunIdentity
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import read_text, refusing
from sfr_loc_map.message_text import alternatives
from sfr_loc_map.metrics.figures.records import REPLAY_RATE, TargetRecord
from sfr_loc_map.metrics.frames.association import Estimates
from sfr_loc_map.metrics.frames.covariance import UPPER
from sfr_loc_map.scoring.call_checks import check_one_method
from sfr_loc_map.scoring.inputs import InMemory, ScoreInputs, TargetCalls
from sfr_loc_map.suite_names import Task

_log = logging.getLogger(__name__)
TARGET_SCHEMA = "sfr-target/1"


class RunCalls(NamedTuple):
    """The calls of a run, except those of a bag."""

    given: Sequence[CallStats] = ()  #: Calls read from files.
    here: Sequence[CallStats] = ()  #: Calls on this host: those from files and those in memory.
    target: TargetCalls | None = None  #: Calls on a target; None if there are none.

    @property
    def on_target(self) -> CallStats | None:
        """The calls on a target; None if there are none."""
        return None if self.target is None else self.target.calls

    @property
    def settings(self) -> dict[str, object]:
        """The settings of the run that its calls state: the rate of a replay that was not in lock step."""
        rates = [item.identity.replay_rate for item in self.given if item.identity.replay_rate is not None]
        return {REPLAY_RATE: max(rates)} if rates else {}

    @property
    def of_estimate(self) -> Sequence[CallStats]:
        """The calls that must belong to the estimate: those on this host, and those on a target during the same run."""
        if self.target is None or self.target.other_run is not None:
            return self.here
        return [*self.here, self.target.calls]


def read_calls(inputs: ScoreInputs, given: InMemory) -> RunCalls:
    """Read the calls of files, which must come from the method of the calls in memory."""
    of_files = [load_call_stats(path) for path in inputs.stats]
    here = [*of_files, *given.calls]
    on_target = None if inputs.target is None else load_call_stats(inputs.target, needed="processing_time_s")
    check_one_method(here, on_target)
    if on_target is None:
        return RunCalls(of_files, here, None)
    about = None if inputs.target_about is None else load_target(inputs.target_about)
    name = (inputs.target_name or "target") if about is None else (about.board or "an unnamed board")
    return RunCalls(of_files, here, TargetCalls(on_target, name, about, inputs.target_run))


def unbound_calls(calls: RunCalls, *, has_drive: bool, has_cloud: bool, has_images: bool) -> Iterator[str]:
    """Yield a caveat if calls that the user gave as files do not identify the scored estimate or cloud.

    `has_images` is whether the source of the truth has images, with which the images of calls can be compared.
    """
    of_drive = [item.identity for item in calls.given if len(item.localised_ns)]
    if has_drive and (missing := list(_missing(of_drive, has_images=has_images))):
        yield (
            f"the calls (--stats) have no {alternatives(missing)}: it is not verified that they belong to the "
            "run of the estimate"
        )
    if has_drive and calls.on_target is not None and calls.on_target.identity.positions is None:
        yield "the calls on the target have no positions: it is not verified that they belong to this estimate"
    of_maps = [item.identity for item in calls.given if item.has_task(Task.MAPPING)]
    if has_cloud and any(identity.cloud_sha256 is None for identity in of_maps):
        yield "the calls of a mapper (--stats) do not identify a cloud: it is not verified that they made this cloud"


def _missing(identities: Sequence[RunIdentity], *, has_images: bool) -> Iterator[str]:
    """Yield what some calls of a drive do not state."""
    if any(identity.positions is None for identity in identities):
        yield "positions"
    if any(identity.quats_xyzw is None for identity in identities):
        yield "attitudes"
    if has_images and any(identity.images_sha256 is None for identity in identities):
        yield "hashes of images"


def load_target(path: Path) -> TargetRecord:
    """Read the description of a target; raise InputError if it does not have the format of the harness."""
    with refusing(f"target '{path}' cannot be read", "give the file that the harness wrote"):
        content = msgspec.json.decode(read_text(path), type=dict[str, Any])
        if content.pop("schema", None) != TARGET_SCHEMA:
            raise ValueError(f"no schema {TARGET_SCHEMA}")
        return msgspec.convert(content, TargetRecord)


def estimates_of_calls(
    trajectory: Trajectory,
    stats: Sequence[CallStats] = (),
    target: CallStats | None = None,
    published: FloatArray | None = None,
) -> Estimates:
    """Return estimated poses with the states, covariances and steps of their calls.

    `published` `(N, 6, 6)` are the covariances of the poses in their file or bag (m^2, rad^2, ROS order). A published
    covariance takes precedence over the covariance of the call, and can report a loss (`call_poses.estimates_of`).
    """
    upper = None if published is None else published[:, *UPPER]
    return estimates_of(trajectory, calls_of_poses(trajectory, stats, target), upper)


def calls_of_poses(
    trajectory: Trajectory, stats: Sequence[CallStats] = (), target: CallStats | None = None
) -> CallStats | None:
    """Return the calls of an estimate, or None if no call has the stamp of a pose, with a warning if there are calls.

    The calls are those of all files of this host. If these contain no call of a pose, the calls of the target are used.
    """
    of_target = [] if target is None or not target.has_stamps else [target]
    for items in (stats, of_target):
        if own := [item for item in items if _has_call_of_pose(item, trajectory)]:
            return united(own)
    if any(len(item.localised_ns) for item in (*stats, *of_target)):
        _log.warning(
            "no call (--stats, --target-timing) has the stamp of a pose of the estimate, so the lost poses are "
            "unknown: give the calls of the run that produced the estimate"
        )
    return None


def _has_call_of_pose(stats: CallStats, trajectory: Trajectory) -> bool:
    localised_ns = with_stamps_of_poses(stats, trajectory.stamps_ns).localised_ns
    return bool(np.isin(localised_ns, trajectory.stamps_ns).any())
