"""What localisers and mappers under test share: a process of their own, which is started again where it was lost."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Self

from sfr_loc_map.errors import MethodError
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.methods.method import Method, MethodLimits
from sfr_loc_map.methods.method_process import Answer, MethodFailureError, MethodProcess
from sfr_loc_map.metrics.score import FindingKind, MethodRecord


class IsolatedMethod:
    """A method under test.

    Attributes:
        record: Its name, version and kind.
        idle_bytes: Resident memory of its process after warm-up, None where that is not known.
    """

    def __init__(
        self,
        method: Method,
        rig: StereoRig,
        limits: MethodLimits | None,
        setup: Mapping[str, object] | None,
        T_ds_rb: Transform,
    ) -> None:
        """Start it.

        Args:
            method: The method.
            rig: Rig of the images.
            limits: What it may take.
            setup: Sent to its adapter besides that.
            T_ds_rb: Pose of RB in DS at the first pair.

        Raises:
            MethodError: If it does not start.
        """
        self._method, self._rig, self._setup = method, rig, dict(setup or {})
        self._limits, self._starts = limits or MethodLimits(), 0
        self._process: MethodProcess | None = self._start(T_ds_rb)
        self.record: MethodRecord = method.record(self._process.version)
        self.idle_bytes: int | None = self._process.idle_bytes

    def _start(self, T_ds_rb: Transform) -> MethodProcess:
        self._starts += 1
        return MethodProcess(self._method, self._rig, self._limits, T_ds_rb, self._setup)

    @property
    def _is_given_up(self) -> bool:
        """Whether it was lost and is not started again."""
        return self._process is None and self._starts > self._limits.restarts

    def _finding(self, error: MethodFailureError | MethodError) -> str:
        """Return what it did wrong, and forget a process that has ended."""
        if isinstance(error, MethodError) or error.ended:
            self._process = None
        return f"{finding_kind(error)}: {error}"

    @property
    def alive(self) -> bool:
        """Whether its process is there."""
        return self._process is not None

    def close(self) -> None:
        """End its process."""
        if self._process is not None:
            self._process.close()

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """End its process."""
        self.close()


def finding_kind(error: MethodFailureError | MethodError) -> FindingKind:
    """Return what a method did wrong; one that cannot be started has crashed."""
    return error.kind if isinstance(error, MethodFailureError) else FindingKind.CRASHED


def check_stamp(pair: StereoPair, answer: Answer) -> None:
    """Check that an answer is one to this pair; an answer without a stamp is.

    Raises:
        MethodFailureError: If it is that to another pair.
    """
    stamp_ns = answer.result.get("stamp_ns", pair.stamp_ns)
    if stamp_ns != pair.stamp_ns:
        text = f"answered for stamp {stamp_ns}, asked for {pair.stamp_ns}"
        raise MethodFailureError(FindingKind.WRONG_STAMP, text, ended=False)


def leak_finding(answer: Answer) -> str:
    """Return what is wrong with the memory that the method keeps, `KIND: text`; empty for nothing."""
    return f"{FindingKind.LEAKING}: {answer.leaking}" if answer.leaking else ""
