"""Change of the path by each kind of pair, and by the adjustment of a keyframe.

Each function takes an immutable `PathState` and returns the next one. The functions that lead to a published pose also
return the step to that pose.

| pair | function |
|---|---|
| every pair, before it is processed | `arrived` |
| accepted | `accepted` |
| kept: repeats the previous pair, or its image contradicts its pose | `kept` |
| a window begins at the last pose | `window_begun` |
| lost | `lost` |
| a keyframe, after it was adjusted in the background | `adjusted` |
"""

from __future__ import annotations

from dataclasses import replace

from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.backend.sliding_window import LandmarkMap, SlidingWindow
from sfr_loc_map.localisation.estimate import StepEstimate
from sfr_loc_map.localisation.motion_model import LastPose
from sfr_loc_map.localisation.motion_size import size_of
from sfr_loc_map.localisation.path import external_poses
from sfr_loc_map.localisation.path.history import PastPose
from sfr_loc_map.localisation.path.path_state import PathState
from sfr_loc_map.localisation.uncertainty.accepted_pair import AcceptedPair
from sfr_loc_map.localisation.uncertainty.inflation import inflation_of, unobserved_size
from sfr_loc_map.localisation.uncertainty.path_errors import PathErrors
from sfr_loc_map.localisation.uncertainty.published_pose import PublishedPose
from sfr_loc_map.localisation.uncertainty.rover_model import RoverModel


def arrived(path: PathState, stamp_ns: int) -> PathState:
    """Return the path after a pair arrived. The first pair decides when the start pose is valid."""
    if path.arrived_ns is None:
        return external_poses.at_first_pair(replace(path, arrived_ns=stamp_ns), stamp_ns)
    return replace(path, arrived_ns=stamp_ns, period_ns=stamp_ns - path.arrived_ns)


def accepted(path: PathState, pair: AcceptedPair, model: RoverModel) -> tuple[PathState, StepEstimate]:
    """Return the path with the pose of an accepted pair, and the step to it."""
    since = path.last.since_last(pair.stamp_ns, pair.T_world_left)
    added = inflation_of(
        pair.inflation,
        unobserved=unobserved_size(path.last.speed, since.seconds, model.bounds),
        moved=since.size,
        other_distance=pair.other_distance,
        sources=model.sources,
    )
    errors = path.errors.accepted(pair, path.last.T_world_left, added, model)
    published, step = path.published.accepted(pair, path.last.speed, added, model)
    last = path.last.accepted(
        pair.stamp_ns, pair.T_world_left, since, period_ns=path.period_ns, was_known=pair.was_known
    )
    # after a kept pair, the pose published last is newer than the last accepted pair
    was_accepted = pair.was_known and path.published.stamp_ns == path.last.accepted_ns
    follows_directly = was_accepted and path.last.is_followed_by(pair.stamp_ns)
    history = path.history.with_pose(_past_pose(last, errors, follows_directly=follows_directly))
    return replace(path, last=last, errors=errors, published=published, history=history), step


def kept(path: PathState, stamp_ns: int, model: RoverModel) -> tuple[PathState, StepEstimate]:
    """Return the path with the last pose kept at a stamp, and the step; the rover may have moved unobserved."""
    errors = path.errors.kept(path.unobserved_of_left(stamp_ns, model))
    published, step = _step_to_kept(path, stamp_ns, model)
    return replace(path, errors=errors, published=published), step


def window_begun(
    path: PathState, stamp_ns: int, landmark_map: LandmarkMap, model: RoverModel
) -> tuple[PathState, StepEstimate]:
    """Return the path with a new window that begins at the last pose, and the step to it."""
    until_now = path.errors.kept(path.unobserved_of_left(stamp_ns, model))
    errors = until_now.window_begun(
        path.last.T_world_left.translation,
        first_image=model.blur(landmark_map.landmarks.median_depth).covariance,
        in_window=model.sources.adjustment_inflation * landmark_map.window.covariance,
    )
    published, step = _step_to_kept(path, stamp_ns, model)
    published = published.window_begun()
    last = path.last.window_begun(stamp_ns)
    history = path.history.with_pose(_past_pose(last, errors, follows_directly=False))
    return replace(path, last=last, errors=errors, published=published, history=history), step


def lost(path: PathState) -> PathState:
    """Return the path after a lost pair."""
    return replace(path, last=path.last.lost())


def adjusted(path: PathState, window: SlidingWindow, model: RoverModel, *, has_yaw_step: bool) -> PathState:
    """Return the path that continues from the adjusted pose of the last pair, the newest keyframe of a window.

    An external pose for this pair applies to the adjusted pose, because later poses continue from it.
    """
    T_world_left = Transform(*window.newest_pose)
    published = path.published
    if has_yaw_step:
        published = published.adjusted(size_of(path.last.T_world_left.inverse() @ T_world_left))
    errors = path.errors.adjusted(model.sources.adjustment_inflation * window.covariance)
    last = path.last.adjusted(T_world_left)
    history = path.history
    if history.last_ns == last.accepted_ns:
        follows_directly = history.poses[-1].follows_directly
        history = history.with_last(_past_pose(last, errors, follows_directly=follows_directly))
    return replace(path, last=last, errors=errors, published=published, history=history)


def _past_pose(last: LastPose, errors: PathErrors, *, follows_directly: bool) -> PastPose:
    """Return the last pose for the history."""
    return PastPose(last.accepted_ns, last.T_world_left, follows_directly, last.T_world_left.translation, errors)


def _step_to_kept(path: PathState, stamp_ns: int, model: RoverModel) -> tuple[PublishedPose, StepEstimate]:
    """Return the last known pose, kept at a stamp, and the step to it."""
    last = path.last
    unobserved_s = last.unobserved_s(stamp_ns)
    return path.published.kept(stamp_ns, last.T_world_left, unobserved_s=unobserved_s, speed=last.speed, model=model)
