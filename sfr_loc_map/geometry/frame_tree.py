"""A tree of frames, as `/tf_static` gives it: each frame has one parent."""

from __future__ import annotations

from sfr_loc_map.geometry.transform import Transform


class FrameTree:
    """Static transforms by child frame."""

    def __init__(self) -> None:
        """Start empty."""
        self._parents: dict[str, tuple[str, Transform]] = {}

    def add(self, parent: str, child: str, T_parent_child: Transform) -> None:
        """Set the parent of a frame; a later transform replaces an earlier one."""
        self._parents[child] = (parent, T_parent_child)

    def find(self, ancestor: str, frame: str) -> Transform | None:
        """Return `T_ancestor_frame`; None where `ancestor` is not above `frame`."""
        result: Transform | None = None
        for _ in range(len(self._parents)):  # a loop of frames ends, too
            if frame not in self._parents:
                return None
            frame, step = self._parents[frame]
            result = step if result is None else step @ result
            if frame == ancestor:
                return result
        return None
