"""A call of a method under test: its request, its record, and why it returned no valid result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from sfr_loc_map.errors import MethodError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.methods.child.loop import CallKind, Order, OrderedPair, Pose
from sfr_loc_map.metrics.calls.call_meter import CallUsage
from sfr_loc_map.metrics.figures.records import FINDING_SEPARATOR, CallFinding, FindingKind


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


@dataclass(frozen=True, slots=True, eq=False)
class MethodCall:
    """Resource use, result and findings of one call of a method under test."""

    usage: CallUsage = field(default_factory=CallUsage)  #: Without values if the call did not return.
    findings: tuple[CallFinding, ...] = ()  #: Faults of the method, first the fault that prevented a result.
    reason: str = ""  #: Why the pose is degraded or lost.
    statistics: Mapping[str, float] = field(default_factory=dict)
    covariance: FloatArray | None = None  #: `(6, 6)` covariance of the pose.
    step: FloatArray | None = None  #: `(48,)` uncertainty of the step.

    @property
    def finding(self) -> str:
        """The findings as one text, for the file of the calls."""
        return FINDING_SEPARATOR.join(map(str, self.findings))

    def failed(self, kind: FindingKind, text: str) -> MethodCall:
        """Return this call with the fault because of which it has no valid result."""
        return replace(self, findings=(CallFinding(kind, text), *self.findings), reason=kind.value)


class MethodFailureError(MethodError):
    """A call returned no valid result; `kind` classifies the failure."""

    def __init__(self, kind: FindingKind, text: str) -> None:
        super().__init__(text)
        self.kind = kind
