"""A method under test in its own process. The next call starts an ended process again, up to `restarts` times."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from typing import Self, TypeVar

from sfr_loc_map.configuration.parameters import checked
from sfr_loc_map.errors import MethodError
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.hashes import FileState
from sfr_loc_map.methods.child.loop import Answer
from sfr_loc_map.methods.method_call import MethodCall, MethodFailureError, Request
from sfr_loc_map.methods.method_process import MethodProcess, ProcessSettings
from sfr_loc_map.methods.own_code import code_sha256, code_state
from sfr_loc_map.methods.registry import Method
from sfr_loc_map.metrics.figures.records import FindingKind, MethodRecord

T = TypeVar("T")
IDENTITY = Transform.identity()


class IsolatedMethod(AbstractContextManager["IsolatedMethod"]):
    """The process of a method; the common part of localisers and mappers."""

    def __init__(self, settings: ProcessSettings, T_ds_rb: Transform) -> None:
        """Start the process; `T_ds_rb` is the pose at which a localiser starts.

        ConfigError for limits out of range, MethodFailureError if the method cannot be started.
        """
        checked(settings.limits)
        self._code = _checked_code(settings.method)
        self._settings = settings
        self.rig = settings.rig
        self._starts_left = 1 + settings.limits.restarts
        self._calls = 0  # number of calls so far
        self._process: MethodProcess | None = None
        process = self._running_process(T_ds_rb)
        self.fuses = process.fuses  # whether a separate call fuses the maps of single pairs
        self.maps_sets = process.maps_sets  # whether one call maps all pairs of a map
        self.record: MethodRecord = settings.method.record(process.version, process.isolation)
        self.idle_bytes: int | None = process.idle_bytes  # resident memory after warm-up, None if unknown

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """End the process; MethodError if a file of the method's own code was written or replaced since its start."""
        self.close()
        if kind is None and _state_of(self._settings.method) != self._code:
            raise _changed(self._settings.method)

    @property
    def is_running(self) -> bool:
        """Whether the process is running. The next call starts an ended process, if a restart is left."""
        return self._process is not None

    def close(self) -> None:
        """End the process; later calls do not start it again."""
        self._starts_left = 0
        self._end_process()

    def _end_process(self) -> None:
        if self._process is not None:
            self._process.close()
            self._process = None

    def _running_process(self, T_ds_rb: Transform) -> MethodProcess:
        """Return the process, which is started at a pose if there is none."""
        if self._process is None:
            self._starts_left -= 1
            self._process = MethodProcess(self._settings, T_ds_rb)
        return self._process

    def call(
        self, request: Request, read: Callable[[Answer, Mapping[str, bytes]], T], T_ds_rb: Transform = IDENTITY
    ) -> tuple[MethodCall, T | None]:
        """Make a call. Return its record, and the result of `read` for the answer and the files of its arrays.

        If the call fails or `read` rejects the answer, the result is None, and the record has the failure in addition
        to what is known of the call. A localiser whose process has ended starts again at `T_ds_rb`. A KeyboardInterrupt
        ends the process, which is not started again. MethodError for images of another size.
        """
        for requested in request.pairs:
            if fault := self.rig.fault_of_size(requested.pair.left):  # the right image has the size of the left image
                raise MethodError(f"image of stamp {requested.pair.stamp_ns} {fault}")
        if self._process is None and not self._starts_left:  # the earlier failures are the findings
            return MethodCall(reason="not started again"), None
        try:
            process = self._running_process(T_ds_rb)
            self._calls += 1
            call, returned = process.call(request, self._calls)
        except MethodFailureError as error:  # the process did not start, or is of no further use
            self._end_process()
            text = str(error)
            if not self._starts_left:
                text += f"; not started again after {1 + self._settings.limits.restarts} starts"
            return MethodCall().failed(error.kind, text), None
        except KeyboardInterrupt:  # the answer of the process is outstanding
            self.close()
            raise
        try:
            answer, contents = returned.result()
            _check_stamp(request.pairs[-1].pair, answer)
            return call, read(answer, contents)
        except MethodFailureError as error:  # the process runs on
            return call.failed(error.kind, str(error)), None


def _state_of(method: Method) -> tuple[FileState, ...]:
    return code_state(method.kind, method.adapter, method.target) if method.sha256 is not None else ()


def _checked_code(method: Method) -> tuple[FileState, ...]:
    """Return the state of a method's own code; MethodError if the code is no longer that of the hash in its record.

    A method may import its code late, so that the state is compared again at the end.
    """
    state = _state_of(method)
    if method.sha256 is not None and code_sha256(method.kind, method.adapter, method.target) != method.sha256:
        raise _changed(method)
    return state


def _changed(method: Method) -> MethodError:
    return MethodError(f"the code of method '{method.name}' was changed or replaced while it ran: run it again")


def _check_stamp(pair: StereoPair, answer: Answer) -> None:
    """Reject an answer with the stamp of another pair; an answer without a stamp is accepted."""
    stamp_ns = answer.get("stamp_ns", pair.stamp_ns)
    if stamp_ns != pair.stamp_ns:
        text = f"answered with stamp {stamp_ns}: stamp {pair.stamp_ns} of the pair is required"
        raise MethodFailureError(FindingKind.WRONG_STAMP, text)
