"""A call that a method is asked to make."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.methods.child.loop import CallKind, Order, OrderedPair, Pose


def numbers_of(pose: Transform) -> Pose:
    """Return the matrix `(4, 4)` of a transform, row by row, for a method."""
    numbers: Pose = pose.matrix.ravel().tolist()
    return numbers


@dataclass(frozen=True, slots=True, eq=False)
class RequestedPair:
    """A stereo pair of a call."""

    pair: StereoPair
    index: int = 0  #: Index of the pair in the map, from 0; 0 for a localiser.
    T_lm_navsb: Transform | None = None  #: Pose of the mapping cameras; None for a localiser and for `fuse`.

    def ordered(self) -> OrderedPair:
        """Return the description of the pair that the message to the process of the method (`Order`) contains."""
        pose = None if self.T_lm_navsb is None else numbers_of(self.T_lm_navsb)
        return OrderedPair(stamp_ns=self.pair.stamp_ns, index=self.index, T_lm_navsb=pose)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Request:
    """A call that a method is asked to make."""

    kind: CallKind
    pairs: Sequence[RequestedPair]  #: The pairs of the call; for `fuse`, the last mapped pair.
    begins_map: bool = False  #: Whether the pair is the first of a map.
    since_start_s: float = 0.0  #: Time of the pair since the first pair, for a localiser.
    largest_files: Mapping[str, int] = field(default_factory=dict)
    """Largest sizes of the files with the arrays of the answer by their suffix, bytes."""

    def order(self, number: int, output: str) -> Order:
        """Return the order for the process of the method; `output` is the path of the arrays without the suffixes."""
        return Order(
            number=number,
            call=self.kind,
            pairs=[requested.ordered() for requested in self.pairs],
            begins_map=self.begins_map,
            since_start_s=self.since_start_s,
            output=output,
        )
