"""What the process of a method may read and write, and what it and all that it started take.

It may read programs, libraries, the interpreter with its packages, the folder of its own code, and what the variable
SFR_METHOD_FILES names; of these no source of the run. It may write a scratch folder of its own.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from glob import glob
from pathlib import Path

import psutil

from sfr_loc_map.child_process import child_environment
from sfr_loc_map.methods.registry import Method
from sfr_loc_map.metrics.score import MethodKind

OWN_FILES = "SFR_METHOD_FILES"  #: Variable with more paths that methods may read, as of PATH.
SYSTEM = ("/usr", "/lib", "/lib32", "/lib64", "/bin", "/sbin", "/etc", "/opt", "/nix", "/snap", "/sys")
FACTS = ("cpuinfo", "meminfo", "stat", "version", "filesystems", "loadavg", "sys/kernel", "sys/vm", "driver")
DEVICES = ("null", "zero", "full", "random", "urandom", "tty", "shm", "dri", "kfd", "nvidia*")
KERNELS = "sfr_loc_map.methods.adapters.numba_cache"


def rules_of(method: Method, folder: Path, memory_bytes: int, hidden: Sequence[Path]) -> dict[str, object]:
    """Return what a method may read and write, its scratch folder given, but for what is hidden from it."""
    code = [Path(method.worker).parent] if Path(method.worker).is_absolute() else []
    if method.kind is MethodKind.LIBRARY:
        code += [Path(method.target).parent]
    elif method.kind is MethodKind.PYTHON:
        place = Path(method.target.rpartition(":")[0])
        code += [place.parent if place.suffix == ".py" else Path.cwd()]
    pythons = [method.python, method.python.resolve()]
    prefixes = [Path(sys.prefix), Path(sys.base_prefix), *(path.parent.parent for path in pythons)]
    variables = (os.environ.get(name, "") for name in (OWN_FILES, "PYTHONPATH", "LD_LIBRARY_PATH"))
    named = [text for value in (*variables, os.pathsep.join(sys.path)) for text in value.split(os.pathsep) if text]
    named += [value for value in method.setup.values() if isinstance(value, str) and os.path.isabs(value)]
    own = [Path(__file__).parents[1], Path.home() / ".cache" / "numba", *code]
    wanted: list[str | Path] = [*SYSTEM, *(f"/proc/{name}" for name in FACTS), *prefixes, *named, *own]
    gone, read, names = [path.resolve() for path in hidden], [], []
    for path in dict.fromkeys(Path(item).resolve() for item in wanted):
        parts = list(_without(path, gone))
        read += parts
        names += [path] if parts != [path] and path.is_dir() else []
    devices = [path for name in DEVICES for path in glob(f"/dev/{name}")]
    read.append(Path("/proc/self"))  # not written: it could set back the mark of its memory
    write = [folder, *(part for path in devices for part in _without(Path(path), gone))]
    more = {"shared_memory": memory_bytes, "folder": str(folder)}
    return more | {
        name: [str(path) for path in paths] for name, paths in (("names", names), ("read", read), ("write", write))
    }


def environment_of(method: Method, folder: Path) -> dict[str, str]:
    """Return the variables of a method's process, which finds code and kernels where this one does."""
    if method.kind is MethodKind.PEER:
        return {**os.environ, "TMPDIR": str(folder)}
    found = child_environment()
    found |= {"TMPDIR": str(folder), "NUMBA_CACHE_DIR": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    found["NUMBA_CACHE_LOCATOR_CLASSES"] = f"{KERNELS}.BesideSources,{KERNELS}.OfUser,UserProvidedCacheLocator"
    if method.kind is MethodKind.PYTHON:  # the current folder of this process is searched first
        found["PYTHONPATH"] = os.pathsep.join((str(Path.cwd()), found["PYTHONPATH"]))
    return {name: value for name, value in found.items() if name not in ("PWD", "OLDPWD", "_")}


def _without(path: Path, hidden: Sequence[Path]) -> Iterator[Path]:
    """Yield a path, or what is in it, but for what is hidden."""
    if any(path == item or item in path.parents for item in hidden):
        return
    if not any(path in item.parents for item in hidden):
        yield path
        return
    with suppress(OSError):
        for part in path.iterdir():
            yield from _without(part, hidden)


@dataclass(frozen=True, slots=True)
class TreeUsage:
    """What processes take at one time, all together, as the kernel tells it from outside."""

    cpu_s: float = 0.0  #: Processor time since they began, also of those that have ended.
    rss_bytes: int = 0  #: Resident memory; pages that several share count for each.
    threads: int = 0
    processes: int = 0


class ProcessTree:
    """The process of a method, and all that it has started."""

    def __init__(self, pid: int, levels: int) -> None:
        self._top = process = psutil.Process(pid)
        for _ in range(levels):
            self._top, process = process, process.children()[0]
        self.process = process
        self._strays: dict[int, str] = {}

    @property
    def _members(self) -> list[psutil.Process]:
        own = [self.process] if self._top is self.process else []
        with suppress(psutil.Error):
            return own + self._top.children(recursive=True)
        return own

    def usage(self) -> TreeUsage:
        """Return what they take now."""
        cpu_s, rss_bytes, threads, members = 0.0, 0, 0, self._members
        with suppress(psutil.Error):
            cpu_s += sum(self._top.cpu_times()[2:4]) if self._top is not self.process else 0.0  # of ended strays
        for member in members:
            with suppress(psutil.Error), member.oneshot():
                cpu_s += sum(member.cpu_times()[:4])
                rss_bytes += member.memory_info().rss
                threads += member.num_threads()
        return TreeUsage(cpu_s, rss_bytes, threads, len(members))

    def set_back_peak(self) -> int | None:
        """Set the kernel's high-water mark of the method's resident memory back; return what is resident, bytes.

        None where the system has no mark that can be set back.
        """
        try:
            with open(f"/proc/{self.process.pid}/clear_refs", "wb", buffering=0) as marks:
                marks.write(b"5")
        except OSError:
            return None
        return self._status_bytes(b"VmRSS:")

    def peak(self) -> int | None:
        """Return the high-water mark of the method's resident memory, bytes; None where it is unknown."""
        return self._status_bytes(b"VmHWM:")

    def _status_bytes(self, key: bytes) -> int | None:
        with suppress(OSError), open(f"/proc/{self.process.pid}/status", "rb", buffering=0) as status:
            found = status.read(8192).partition(b"\n" + key)[2].split(None, 1)
            return int(found[0]) * 1024 if found else None
        return None

    def new_strays(self) -> list[str]:
        """Return the names of processes that have left its session or lost their parent, each once."""
        found = {}
        for member in self._members:
            with suppress(psutil.Error, OSError):
                lost = member.ppid() == self._top.pid and self._top is not self.process
                if member != self.process and (lost or os.getsid(member.pid) != os.getsid(self.process.pid)):
                    found[member.pid] = " ".join(member.cmdline()[:4])[:60] or member.name()
        new = [name for pid, name in found.items() if pid not in self._strays]
        self._strays |= found
        return new

    def kill(self) -> None:
        """End them all."""
        for member in self._members:
            with suppress(psutil.Error):
                member.kill()
