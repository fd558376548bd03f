"""Frames as series of poses, from /tf and /tf_static of a bag or of a ROS graph."""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.frame_tree import FrameTree
from sfr_loc_map.geometry.plausibility import plausible_poses
from sfr_loc_map.geometry.rotation import quat_multiply, quat_rotate
from sfr_loc_map.geometry.stamped_poses import covered, sampled
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.message_stamps import stamp_of

MAX_NAMED = 6  #: Maximum number of frames in a message.
MAX_CHAINS = 1000  #: Maximum number of frame chains that are searched at the same time.
PoseRow = tuple[int, tuple[float, ...]]  #: Stamp, ns, and x, y, z, qx, qy, qz, qw.

_log = logging.getLogger(__name__)


@dataclass(slots=True)
class Frame:
    """A frame and its poses in its parent."""

    parent: str
    is_static: bool
    rows: list[PoseRow] = field(default_factory=list)
    other_parents: tuple[str, ...] = ()  #: Further parents of the frame, if the choice of the parent is ambiguous.

    @property
    def poses(self) -> Trajectory:
        """The poses in the parent; only the last pose if the frame is static.

        Raises GeometryError for an invalid pose.
        """
        return trajectory_of(self.rows[-1 if self.is_static else 0 :])


class FrameSeries:
    """Collects frames from single transforms, separately for each parent of a frame."""

    def __init__(self) -> None:
        self._by_child: dict[str, dict[str, Frame]] = {}

    def frame_of(self, item: Any, *, is_static: bool) -> Frame:  # noqa: ANN401 - a TransformStamped of any library
        """Return the child frame of a transform in the parent of this transform.

        A frame on both /tf_static and /tf counts as moving, and its static pose is discarded.
        """
        parent = item.header.frame_id.strip("/")
        by_parent = self._by_child.setdefault(item.child_frame_id.strip("/"), {})
        frame = by_parent.setdefault(parent, Frame(parent, is_static))
        if frame.is_static and not is_static:
            frame.is_static = False
            frame.rows.clear()
        return frame

    def chosen(self, child: str = "", parent: str = "") -> dict[str, Frame]:
        """Return the frames that have a parent, by name without leading or trailing slashes.

        Transforms of a frame to several parents are never mixed. A frame on the chain from `child` up to `parent` has
        its parent in this chain. Any other frame has its first parent; `Frame.other_parents` names the others.
        """
        parent_in_chain = _parents_up_to(self._by_child, child, parent) if parent else {}
        frames = {}
        for name, by_parent in self._by_child.items():
            chosen = parent_in_chain.get(name, next(iter(by_parent)))
            others = () if name in parent_in_chain else tuple(other for other in by_parent if other != chosen)
            frames[name] = replace(by_parent[chosen], other_parents=others)
        return frames


def _parents_up_to(series: Mapping[str, Mapping[str, Frame]], child: str, parent: str) -> dict[str, str]:
    """Return the parent of each frame on the shortest chain from `child` up to `parent`; empty without a chain."""
    chains: list[dict[str, str]] = [{}]
    tips = [child]
    while tips:
        following: list[tuple[dict[str, str], str]] = []
        for chain, tip in zip(chains, tips, strict=True):
            if tip == parent and chain:
                return chain
            following += [({**chain, tip: above}, above) for above in series.get(tip, ()) if tip not in chain]
        chains, tips = [chain for chain, _ in following], [tip for _, tip in following]
        if len(tips) > MAX_CHAINS:
            return {}
    return {}


def chain_above(frames: Mapping[str, Frame], name: str, end: str = "") -> list[str]:
    """Return a frame and its ancestors; `end`, the ancestors of `end`, and the root are excluded.

    Raises ValueError if the parent of a frame in this chain is ambiguous, or if the chain leads back to one of its
    frames.
    """
    chain: list[str] = []
    while name in frames and name != end:
        if name in chain:
            loop = " in ".join((*chain[chain.index(name) :], name))
            raise ValueError(f"the frame tree has a loop at '{name}': {loop}; remove one of these transforms")
        chain.append(name)
        if others := frames[name].other_parents:
            parents = " and ".join(sorted((frames[name].parent, *others)))
            raise ValueError(f"frame '{name}' has the parents {parents}: one parent is required")
        name = frames[name].parent
    return chain


def chain_poses(frames: Mapping[str, Frame], chain: Sequence[str], stamps_of: str) -> Trajectory:
    """Return the poses of the first frame of a chain in the parent of the last frame.

    The poses are at those stamps of the moving frame `stamps_of` that all moving frames cover
    (`stamped_poses.covered`).
    """
    series = {name: frames[name].poses for name in chain}
    stamps = series[stamps_of].stamps_ns
    for name in chain:
        if not frames[name].is_static:
            stamps = stamps[covered(series[name].stamps_ns, stamps)]
    positions = np.zeros((len(stamps), 3))
    quats = np.tile([0.0, 0.0, 0.0, 1.0], (len(stamps), 1))
    for name in chain:
        position_in_parent, quat_in_parent = sampled(series[name], stamps)
        positions = position_in_parent + quat_rotate(quat_in_parent, positions)
        quats = quat_multiply(quat_in_parent, quats)
    return Trajectory(stamps, positions, quats)


def pose_of(position: Any, orientation: Any) -> Transform:  # noqa: ANN401 - of a message of any library
    """Return the transform of a position (or translation) and a quaternion of a message."""
    quat = orientation
    return Transform.from_quat((position.x, position.y, position.z), (quat.x, quat.y, quat.z, quat.w))


def add_transform(tree: FrameTree, item: Any) -> None:  # noqa: ANN401 - a TransformStamped of any library
    """Add a static transform to a tree, without slashes around frame names; raise GeometryError if it is not rigid."""
    pose = pose_of(item.transform.translation, item.transform.rotation)
    tree.add(item.header.frame_id.strip("/"), item.child_frame_id.strip("/"), pose)


def pose_row(message: Any, pose: Any) -> PoseRow:  # noqa: ANN401 - messages
    """Return the header stamp of a message, and the numbers of its pose or transform."""
    position = getattr(pose, "position", None) or pose.translation
    quat = getattr(pose, "orientation", None) or pose.rotation
    return stamp_of(message), (position.x, position.y, position.z, quat.x, quat.y, quat.z, quat.w)


def body_of(message: Any) -> tuple[str, str]:  # noqa: ANN401 - any message with a header
    """Return the frame of a pose and its body (`child_frame_id`, empty if the type has none), without slashes."""
    return message.header.frame_id.strip("/"), getattr(message, "child_frame_id", "").strip("/")


def check_one_body(bodies: Collection[tuple[str, str]], where: str) -> None:
    """Raise InputError if the messages of a topic have several bodies or frames, as given by `body_of`."""
    if len(bodies) > 1:
        found = sorted(f"'{body}' in '{frame}'" if body else f"'{frame}'" for frame, body in bodies)
        raise InputError(
            f"{where} has poses of several bodies or frames: {', '.join(found[:MAX_NAMED])}: one body in one frame is "
            "required;",
            "record each of them on its own topic, or use truth.frame for frames on /tf",
        )


def valid_indices(rows: Sequence[PoseRow], where: str) -> list[int]:
    """Return the indices of the rows that are poses; a warning reports how many rows are invalid.

    If no row is a pose, all indices are returned, so that `trajectory_of` reports the error.
    """
    values = np.array([row for _, row in rows], np.float64).reshape(-1, 7)
    valid = np.flatnonzero(plausible_poses(values[:, :3], values[:, 3:])).tolist()
    if not valid or len(valid) == len(rows):
        return list(range(len(rows)))
    _log.warning(f"{where}: {len(rows) - len(valid)} of {len(rows)} poses skipped: invalid position or quaternion")
    return valid


def trajectory_of(rows: list[PoseRow]) -> Trajectory:
    """Return the poses in rows as a trajectory; raise GeometryError if a pose is invalid."""
    values = np.array([row for _, row in rows], np.float64).reshape(-1, 7)
    return Trajectory(np.array([stamp for stamp, _ in rows], np.int64), values[:, :3].copy(), values[:, 3:].copy())
