"""Trees of frames that are connected by static transforms."""

from __future__ import annotations

from collections.abc import Iterator

from sfr_loc_map.geometry.transform import Transform


class FrameTree:
    """Static transforms, stored by child frame, as in `/tf_static`; each frame has one parent."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, Transform]] = {}

    def add(self, parent: str, child: str, T_parent_child: Transform) -> None:
        """Set the parent of a frame; a later call for the same child replaces the parent."""
        self._parents[child] = (parent, T_parent_child)

    def find(self, target: str, frame: str) -> Transform | None:
        """Return `T_target_frame`; None if the frames are not connected."""
        if target == frame:
            return Transform.identity() if self.joined_to(frame) else None
        above_frame = dict(self._above(frame))
        above_target = self._above(target)
        common = next(((name, T_name_target) for name, T_name_target in above_target if name in above_frame), None)
        if common is None:
            return None
        name, T_name_target = common
        if name == target:  # a product would discard `Transform.given_quat_xyzw`
            return above_frame[name]
        return T_name_target.inverse() @ above_frame[name]

    def joined_to(self, frame: str) -> list[str]:
        """Return the frame, its ancestors from the nearest on, and all other connected frames.

        The list is empty if the frame is unknown.
        """
        above = [name for name, _ in self._above(frame)]
        known = {name for child, (parent, _) in self._parents.items() for name in (child, parent)}
        others = sorted(name for name in known - {*above} if self._root(name) == above[-1])
        return [*above, *others] if frame in known else []

    def _root(self, frame: str) -> str:
        """Return the last ancestor of a frame; the frame itself if it has no parent."""
        return [*self._above(frame)][-1][0]

    def _above(self, frame: str) -> Iterator[tuple[str, Transform]]:
        """Yield the frame and its ancestors, each with the transform `T_ancestor_frame`."""
        pose = Transform.identity()
        yield frame, pose
        for depth in range(len(self._parents)):  # bounded, because the frames may form a loop
            if frame not in self._parents:
                return
            frame, step = self._parents[frame]
            pose = step @ pose if depth else step
            yield frame, pose
