"""Files that the process of a method may read and write; see docs/decisions/0010-isolation.md.

The process may read programs, libraries, the interpreter with its packages, the method's own code, and the paths in the
variables SFR_METHOD_FILES and PYTHONPATH. Paths that may hold the ground truth (`Source.truth_paths`) are excluded. The
method's own code is a package, or a file or library with the other code in the same folder. Other files in this folder
and in the working directory are not readable, because they may be copies of the ground truth. The process may write
only to its scratch folder and to devices.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from glob import glob
from pathlib import Path

from sfr_loc_map.child_process import LIBRARY_PATH, child_environment, inherited_environment
from sfr_loc_map.methods.child.supervisor import Rules
from sfr_loc_map.methods.own_code import code_of
from sfr_loc_map.methods.registry import Isolation, Method
from sfr_loc_map.metrics.table.records import MethodKind

OWN_FILES = "SFR_METHOD_FILES"  #: Variable with additional readable paths, separated as in PATH.
VARIABLES = (
    "PATH",
    "HOME",
    "USER",
    "LOGNAME",
    "SHELL",
    "LANG",
    "LANGUAGE",
    "TZ",
    "TZDIR",
    "TMPDIR",
    "VIRTUAL_ENV",
    LIBRARY_PATH,
    OWN_FILES,
)
"""Variables that a method receives, beside those that begin with one of `PREFIXES`. Other variables could configure a
method without a trace in the score; the configuration of a method is a file (`--config`)."""
PREFIXES = (
    *("LC_", "XDG_", "PYTHON", "CONDA_"),
    *("NUMBA_", "OMP_", "OPENBLAS_", "MKL_", "BLIS_", "NVPL_", "CUDA_", "NVIDIA_", "OPENCV_"),
)
"""Beginnings of the names of variables of the system, of Python and of numerical libraries."""
SYSTEM = ("/usr", "/lib", "/lib32", "/lib64", "/bin", "/sbin", "/etc", "/opt", "/nix", "/snap", "/sys")
FACTS = ("cpuinfo", "meminfo", "stat", "version", "filesystems", "loadavg", "sys/kernel", "sys/vm", "driver")
DEVICES = ("null", "zero", "full", "random", "urandom", "tty", "dri", "kfd", "nvidia*")
PACKAGE = Path(__file__).parents[1]
PACKAGES = ("site-packages", "dist-packages")  #: Folder names of installed packages.
KERNELS = "sfr_loc_map.methods.child.numba_cache"


def isolation_of(restrictions: str, *, can_read_all_files: bool) -> Isolation:
    """Return the isolation of a process from the restrictions in force and the paths that the user permitted."""
    readable = os.environ.get(OWN_FILES) or None
    exception = "" if readable is None else f"; readable by {OWN_FILES}: {readable}"
    return Isolation(restrictions + exception, can_read_all_files, readable)


def rules_of(method: Method, folder: Path, hidden: Sequence[Path]) -> Rules:
    """Return the paths that a method may list, read and write, with the scratch folder and without hidden paths."""
    code = code_of(method.kind, method.adapter, method.target)
    pythons = [method.python, method.python.resolve()]
    prefixes = [Path(sys.prefix), Path(sys.base_prefix), *(path.parent.parent for path in pythons)]
    prefixes = [path for path in prefixes if path != path.parent]  # /bin/python3 does not permit the root
    variables = (os.environ.get(name, "") for name in (OWN_FILES, "PYTHONPATH", LIBRARY_PATH))
    named = [text for value in variables for text in value.split(os.pathsep) if text]
    named += [text for text in sys.path if Path(text).name in PACKAGES]
    named += [method.vocabulary] if method.vocabulary else []
    own = [PACKAGE, Path.home() / ".cache" / "numba", *code]
    wanted: list[str | Path] = [*SYSTEM, *(f"/proc/{name}" for name in FACTS), *prefixes, *named, *own]
    hidden = [path.resolve() for path in hidden]
    names = [path.resolve().parent for path in (PACKAGE, *code)]  # the interpreter lists these to find packages
    read: list[Path] = []
    for path in dict.fromkeys(Path(item).resolve() for item in wanted):
        parts = list(_without(path, hidden))
        read += parts
        if parts != [path] and path.is_dir():
            names.append(path)
    read.append(Path("/proc/self"))  # read-only, so that the process cannot reset its peak memory
    devices = [path for name in DEVICES for path in glob(f"/dev/{name}")]
    write = [folder, *(part for path in devices for part in _without(Path(path), hidden))]
    return Rules(names=list(map(str, names)), read=list(map(str, read)), write=list(map(str, write)))


def environment_of(method: Method, folder: Path) -> dict[str, str]:
    """Return the environment of a method's process, which finds code and compiled kernels where this process does.

    A method under test receives only the variables of `VARIABLES` and `PREFIXES`; a peer receives all.
    """
    if method.kind is MethodKind.PEER:
        return {**inherited_environment(), "TMPDIR": str(folder)}
    found = child_environment()
    found |= {"TMPDIR": str(folder), "NUMBA_CACHE_DIR": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    found = {name: value for name, value in found.items() if name in VARIABLES or name.startswith(PREFIXES)}
    found["NUMBA_CACHE_LOCATOR_CLASSES"] = f"{KERNELS}.BesideSources,{KERNELS}.OfUser,UserProvidedCacheLocator"
    if method.kind is MethodKind.PYTHON:  # this process's working directory is searched first
        found["PYTHONPATH"] = os.pathsep.join((str(Path.cwd()), found["PYTHONPATH"]))
    return found


def _without(path: Path, hidden: Sequence[Path]) -> Iterator[Path]:
    """Yield a path, or the parts of it that contain no hidden paths."""
    if any(path == item or item in path.parents for item in hidden):
        return
    if not any(path in item.parents for item in hidden):
        yield path
        return
    with suppress(OSError):
        for part in path.iterdir():
            if not part.is_symlink():  # a rule for a link would permit its target, which may be hidden
                yield from _without(part, hidden)
