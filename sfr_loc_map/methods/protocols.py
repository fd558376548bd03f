"""What a localiser and a mapper under test are; the suite's own are nothing else.

A candidate is made by `Class(rig, config)`: a `StereoRig` and the text of its configuration file, empty without one.
All but `process` may be missing; what is then done instead stands beside it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.transform import Transform


@runtime_checkable
class MethodProtocol(Protocol):
    """What both have in common."""

    @property
    def version(self) -> str:
        """Version; without it `not stated`."""
        ...

    @property
    def statistics(self) -> Mapping[str, float]:
        """Figures of the last call by name, written beside its costs; without it none."""
        ...

    def warm_up(self) -> None:
        """Load, compile, allocate: called once before the first timed call; without it the first call pays for it."""
        ...


@runtime_checkable
class LocaliserProtocol(MethodProtocol, Protocol):
    """Estimates the pose of RB in DS at each stereo pair."""

    def reset(self, start: Transform, /) -> None:
        """Forget everything; the pose of RB in DS at the next pair is `start`.

        Without it the poses of `process` are taken as relative to that of the first pair.
        """
        ...

    def process(self, pair: StereoPair, /) -> Any:  # noqa: ANN401 - PoseEstimate, Transform, matrix or None
        """Return the pose at one pair; pairs come in the order of their stamps.

        It is a `PoseEstimate`; or `T_ds_rb` alone, as a `Transform` or a matrix `(4, 4)`; or None where it is lost.
        """
        ...


@runtime_checkable
class MapperProtocol(MethodProtocol, Protocol):
    """Turns stereo pairs into point clouds in LM."""

    def process(self, pair: StereoPair, T_lm_navsb: Transform, index: int, /) -> Any:  # noqa: ANN401 - as below
        """Return what one pair, number 0, 1 or 2 of its set, sees.

        It is a `PointCloud` in LM, or an object with such a `cloud`; or a disparity image `(H, W)` of the left image,
        float32, pixels, NaN where none, of which the suite makes points outside the timed call.
        """
        ...

    def fuse(self, maps: Sequence[Any], /) -> Any:  # noqa: ANN401 - a cloud, as of `process`
        """Return one cloud of what `process` returned for the pairs; without it the points of every pair stand."""
        ...
