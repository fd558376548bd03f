"""The process of a method: its start, its calls, and its end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.methods.call_monitor import CallFindings, CallMonitor, Measurement
from sfr_loc_map.methods.child.loop import Answer, Camera, Hello, Ready, Reply, Setup
from sfr_loc_map.methods.child.supervisor import Started
from sfr_loc_map.methods.isolation import isolation_of, rules_of, search_path_of
from sfr_loc_map.methods.method_call import MethodCall, MethodFailureError, Request, numbers_of
from sfr_loc_map.methods.registry import Method, MethodLimits
from sfr_loc_map.methods.scratch_folder import ScratchFolder
from sfr_loc_map.methods.supervised_process import SupervisedProcess
from sfr_loc_map.metrics.calls.calls import is_statistic
from sfr_loc_map.metrics.figures.records import FindingKind
from sfr_loc_map.suite_names import Task


@dataclass(frozen=True, slots=True, kw_only=True)
class ProcessSettings:
    """The settings of all processes of one method."""

    method: Method
    rig: StereoRig
    limits: MethodLimits
    rate_hz: float = 0.0  #: Rate of the pairs; not used by a mapper.
    keeps_rate: bool = False  #: Whether no pair is sent earlier than at this rate; the method may work between calls.
    disparities: int = 0  #: Number of disparities that a matcher searches; not used by a localiser.
    hidden: Sequence[Path]  #: Paths that the process cannot read.

    def setup(self, images: Path, T_ds_rb: Transform) -> Setup:
        """Return the parameters of the adapter: the file of the images, and the initial pose of RB."""
        method, rig = self.method, self.rig
        camera = Camera(
            width=rig.width, height=rig.height, fx=rig.fx, fy=rig.fy, cx=rig.cx, cy=rig.cy, baseline_m=rig.baseline_m
        )
        return Setup(
            task=method.task.value,
            target=method.target,
            search_path=search_path_of(method),
            config=method.config,
            images=str(images),
            camera=camera,
            T_rb_sb=None if rig.T_rb_sb is None else numbers_of(rig.T_rb_sb),
            T_rb_left=numbers_of(rig.T_rb_left if method.task is Task.LOCALISATION else Transform.identity()),
            T_ds_rb=numbers_of(T_ds_rb),
            rate_hz=self.rate_hz,
            disparities=self.disparities,
            vocabulary=method.vocabulary,
        )


@dataclass(frozen=True, slots=True)
class Returned:
    """What a process returned in a call: the reply, and the content of each requested file that exists."""

    reply: Reply
    contents: Mapping[str, bytes]
    unreadable: str = ""  #: Why a file cannot be read; empty if all were read.

    def result(self) -> tuple[Answer, Mapping[str, bytes]]:
        """Return the answer of the adapter and the files of its arrays; MethodFailureError without a valid result."""
        if "fault" in self.reply:
            raise MethodFailureError(FindingKind(self.reply["fault"]), self.reply.get("text", ""))
        if "result" not in self.reply or "seconds" not in self.reply:
            raise MethodFailureError(
                FindingKind.INVALID_RESULT, "the process of the method answered without a result or a time"
            )
        if self.unreadable:
            raise MethodFailureError(FindingKind.INVALID_RESULT, self.unreadable)
        return self.reply["result"], self.contents


class MethodProcess:
    """The process of a method, which is warmed up once constructed.

    `maps_sets`: a mapper maps all pairs in one call. `fuses`: a separate call fuses the maps of single pairs. Both may
    be false. `idle_bytes` is the resident memory after warm-up, None if unknown.
    """

    def __init__(self, settings: ProcessSettings, T_ds_rb: Transform) -> None:
        """Start the process, and wait for its warm-up; `T_ds_rb` is the initial pose."""
        method, rig, limits = settings.method, settings.rig, settings.limits
        self._call_timeout_s, timeout_s = limits.call_timeout_s, limits.start_timeout_s
        self._findings = CallFindings()
        self._last_call: Measurement | None = None
        with ExitStack() as resources:
            self._folder = resources.enter_context(ScratchFolder(rig.height, rig.width))
            self._supervised = resources.enter_context(SupervisedProcess(method, self._folder, limits.memory_mb))
            rules = rules_of(method, self._folder.path, settings.hidden)
            memory = self._supervised.memory
            check = memory.usage
            try:
                # after this answer, the process is restricted and has loaded neither the adapter nor the method
                started = self._supervised.exchange(rules, Started, timeout_s, check)
                pid = started["process"]
                # after this answer, the process has loaded the adapter but no code of the method
                self._supervised.exchange(None, Ready, timeout_s, check)
                base_bytes = memory.resident_bytes(pid)
                # after this answer, the method is loaded and warmed up
                setup = settings.setup(self._folder.images, T_ds_rb)
                hello = self._supervised.exchange(setup, Hello, timeout_s, check)
                self.idle_bytes = memory.resident_bytes(pid)
            except MethodFailureError as error:
                raise MethodFailureError(error.kind, f"method {method.name} {error}") from error
            self._monitor = CallMonitor(memory, pid, base_bytes, keeps_rate=settings.keeps_rate)
            self._resources = resources.pop_all()
        self.isolation = isolation_of(started["isolation"], can_read_all_files=started["can_read_all_files"])
        self.version = hello["version"]
        self.fuses = hello["fuses"]
        self.maps_sets = hello["maps_sets"]

    def call(self, request: Request, number: int) -> tuple[MethodCall, Returned]:
        """Make the call `number`. Return its record, and what the process returned.

        The call begins before its pairs are shared, and ends when the answer and the files of its arrays are read. Work
        of the method between two calls is added to the second call. MethodFailureError if the process ended, did not
        answer or exceeded its memory, or if it answered another call. The process is then of no further use.
        """
        self._folder.remove_arrays(request.largest_files)
        running = self._monitor.begin_call(self._last_call)
        self._folder.begin_call()
        self._folder.share([requested.pair for requested in request.pairs])
        order = request.order(number, self._folder.output)
        reply = self._supervised.exchange(order, Reply, self._call_timeout_s, running.check_memory)
        if reply.get("number") != number:  # the method wrote to the pipe, so later answers would be one call late
            text = (
                f"the process of the method answered call {reply.get('number')} in place of call {number}: the method "
                "must not write to the pipe of the answers"
            )
            raise MethodFailureError(FindingKind.INVALID_RESULT, text)
        contents, unreadable = self._folder.arrays(request.largest_files)
        self._last_call = running.end()
        return self._record(self._last_call, reply), Returned(reply, contents, unreadable)

    def _record(self, measured: Measurement, reply: Reply) -> MethodCall:
        """Return the record of a call; without time and memory if the method raised an error."""
        if "seconds" not in reply:
            return MethodCall()
        stated_s = reply["seconds"]
        stated = reply.get("result", {}).get("statistics", {})
        usable = {name: value for name, value in stated.items() if is_statistic(name, value)}
        statistics = {**usable, "stated_s": stated_s, **measured.figures}
        return MethodCall(measured.usage, self._findings.add(measured, stated_s), statistics=statistics)

    def close(self) -> None:
        """End the process and its descendants immediately, and remove its folder."""
        self._resources.close()
