"""A method under test in its own process, which is restarted after it was lost."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Self, TypeVar

from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.methods.child.loop import Answer, OrderedPair
from sfr_loc_map.methods.method_call import MethodCall, MethodFailureError, NotStartedAgainError
from sfr_loc_map.methods.method_process import MethodProcess
from sfr_loc_map.methods.registry import Method, MethodLimits
from sfr_loc_map.metrics.table.records import CallFinding, FindingKind, MethodRecord

T = TypeVar("T")


class IsolatedMethod(AbstractContextManager["IsolatedMethod"]):
    """The process of a method; the common part of localisers and mappers."""

    def __init__(
        self,
        method: Method,
        rig: StereoRig,
        limits: MethodLimits | None,
        *,
        T_ds_rb: Transform,
        rate_hz: float = 0.0,
        disparities: int = 0,
        keeps_rate: bool = False,
        hidden: Sequence[Path],
    ) -> None:
        """Start the process, which cannot read the hidden paths; `keeps_rate` as for `MethodProcess`."""
        self._method, self._rig, self._hidden = method, rig, hidden
        self._limits = limits or MethodLimits()
        self._rate_hz, self._disparities, self._keeps_rate = rate_hz, disparities, keeps_rate
        self._starts = 0
        self._last_pose = T_ds_rb
        self._process: MethodProcess | None = None
        process = self._running_process()
        self.record: MethodRecord = method.record(process.version, process.isolation)
        self.idle_bytes: int | None = process.idle_bytes  # resident memory after warm-up, None if unknown

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def is_alive(self) -> bool:
        """Whether the process exists."""
        return self._process is not None

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.close()

    @property
    def _is_given_up(self) -> bool:
        return self._process is None and self._starts > self._limits.restarts

    def _running_process(self) -> MethodProcess:
        """Return the process, which is started if there is none; after a loss, it starts at the last known pose."""
        if self._is_given_up:
            raise NotStartedAgainError
        if self._process is None:
            self._starts += 1
            self._process = MethodProcess(
                self._method,
                self._rig,
                self._limits,
                T_ds_rb=self._last_pose,
                rate_hz=self._rate_hz,
                disparities=self._disparities,
                keeps_rate=self._keeps_rate,
                hidden=self._hidden,
            )
        return self._process

    def _checked(
        self,
        read: Callable[[Answer, Mapping[str, bytes]], T],
        kind: str,
        pairs: Sequence[StereoPair],
        about: Sequence[OrderedPair],
        since_start_s: float = 0.0,
        arrays: Mapping[str, int] = MappingProxyType({}),
    ) -> tuple[MethodCall, T | None]:
        """Make a call. Return its record, and what `read` makes of the answer and of the files of its arrays.

        If `read` rejects the answer, the result is None and the record contains the finding, the time and the memory
        of the call. `arrays` as for `MethodProcess.call`; the files of the previous call are removed.
        """
        call = MethodCall()
        try:
            process = self._running_process()
            for suffix in arrays:
                Path(f"{process.output}.{suffix}.npy").unlink(missing_ok=True)
            call, answer, contents = process.call(kind, pairs, about, since_start_s, arrays)
            _check_stamp(pairs[-1], answer)
            return call, read(answer, contents)
        except MethodFailureError as error:
            return replace(self._failed(error), usage=call.usage), None

    def _failed(self, error: MethodFailureError) -> MethodCall:
        """Return a call with the finding of an error; drop the process if it has ended.

        A call that was not made has no finding.
        """
        if isinstance(error, NotStartedAgainError):
            return MethodCall(reason=str(error))
        if error.ended:
            self._process = None
        again = f"; not started again after {self._starts} starts" if error.ended and self._is_given_up else ""
        return MethodCall(finding=str(CallFinding(error.kind, f"{error}{again}")), reason=error.kind.value)


def _check_stamp(pair: StereoPair, answer: Answer) -> None:
    """Reject an answer with the stamp of another pair; an answer without a stamp is accepted."""
    stamp_ns = answer.get("stamp_ns", pair.stamp_ns)
    if stamp_ns != pair.stamp_ns:
        text = f"answered with stamp {stamp_ns}: stamp {pair.stamp_ns} of the pair is required"
        raise MethodFailureError(FindingKind.WRONG_STAMP, text)
