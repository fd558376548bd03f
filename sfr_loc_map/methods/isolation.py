"""Files that the process of a method may read and write; see docs/decisions/0010-isolation.md.

The process may read programs, libraries, the interpreter with its packages, the method's own code, and the paths in the
variables SFR_METHOD_FILES, PYTHONPATH and LD_LIBRARY_PATH. Paths that may hold the ground truth (`Source.truth_paths`)
are excluded, and so are files in the method's own code that are not part of the hash of this code. The own code is a
package, or a file or library with the other code in the same folder. Other files in this folder and in the working
directory are not readable, because they may be copies of the ground truth. The process may write only to its scratch
folder and to devices.
"""

from __future__ import annotations

import hashlib
import os
import re
import site
import sys
from collections.abc import Iterator, Mapping, Sequence, Set
from contextlib import suppress
from glob import glob
from pathlib import Path

from sfr_loc_map.child_process import LIBRARY_PATH, child_environment, inherited_environment
from sfr_loc_map.hashes import hash_path
from sfr_loc_map.methods.child.supervisor import Rules
from sfr_loc_map.methods.own_code import code_of, unhashed_of
from sfr_loc_map.methods.registry import Isolation, Method
from sfr_loc_map.metrics.table.records import MethodKind

OWN_FILES = "SFR_METHOD_FILES"  #: Variable with additional readable paths, separated as in PATH.
PERMITTING = (OWN_FILES, "PYTHONPATH", LIBRARY_PATH)  #: Variables whose paths a method may read.
FOLDERS = ("PATH", "PYTHONHOME", "VIRTUAL_ENV", "CONDA_PREFIX", "CUDA_HOME", "CUDA_PATH", "TZDIR")
"""Variables with paths. A method receives the existing paths of the system and of the interpreter."""
MOST_PATHS = 64
"""Largest number of paths of the system and of the interpreter in a variable that a method receives, because the choice
and the order of many paths could contain data. 64 of 10,000 folders contain at most 110 bytes."""
COUNTS = (
    *("OMP_NUM_THREADS", "OMP_THREAD_LIMIT", "OMP_MAX_ACTIVE_LEVELS", "OPENBLAS_NUM_THREADS", "BLIS_NUM_THREADS"),
    *("MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENCV_FOR_THREADS_NUM", "PYTHONHASHSEED"),
)
"""Variables whose value is a number of at most five digits (`COUNT`)."""
CHOICES = {
    **dict.fromkeys(("OMP_DYNAMIC", "OMP_NESTED", "MKL_DYNAMIC"), ("true", "false", "TRUE", "FALSE")),
    "OMP_PLACES": ("threads", "cores", "ll_caches", "numa_domains", "sockets"),
    "OMP_PROC_BIND": ("true", "false", "primary", "master", "close", "spread"),
    "OMP_SCHEDULE": ("static", "dynamic", "guided", "auto"),
    "OMP_WAIT_POLICY": ("active", "passive"),
    "OPENBLAS_CORETYPE": ("Prescott", "Nehalem", "Sandybridge", "Haswell", "SkylakeX", "Zen", "ARMV8"),
    "MKL_CBWR": ("AUTO", "COMPATIBLE", "SSE2", "SSE4_2", "AVX", "AVX2", "AVX512"),
    "MKL_ENABLE_INSTRUCTIONS": ("SSE4_2", "AVX", "AVX2", "AVX512"),
    "MKL_THREADING_LAYER": ("INTEL", "SEQUENTIAL", "TBB", "GNU"),
    "NUMBA_THREADING_LAYER": ("default", "safe", "threadsafe", "forksafe", "tbb", "omp", "workqueue"),
    "NUMBA_CPU_NAME": ("generic", "host"),
    "NUMBA_OPT": ("0", "1", "2", "3", "max"),
    "CUDA_DEVICE_ORDER": ("FASTEST_FIRST", "PCI_BUS_ID"),
    "CUDA_MODULE_LOADING": ("DEFAULT", "LAZY", "EAGER"),
    "CUDA_VISIBLE_DEVICES": ("", "-1", *map(str, range(16))),
    "NVIDIA_VISIBLE_DEVICES": ("all", "none", "void", *map(str, range(16))),
    "NVIDIA_DRIVER_CAPABILITIES": ("all", "compute", "utility", "compute,utility"),
    "OPENCV_IPP": ("disabled", "sse42", "avx2", "avx512"),
    **dict.fromkeys(("OPENCV_OPENCL_DEVICE", "OPENCV_OPENCL_RUNTIME"), ("disabled",)),
    **dict.fromkeys(("CUDA_LAUNCH_BLOCKING", "NVIDIA_TF32_OVERRIDE"), ("0", "1")),
    **dict.fromkeys(("NUMBA_DISABLE_JIT", "NUMBA_LOOP_VECTORIZE", "NUMBA_SLP_VECTORIZE"), ("0", "1")),
    **dict.fromkeys(("NUMBA_ENABLE_AVX", "NUMBA_DISABLE_INTEL_SVML"), ("0", "1")),
}
"""Variables of numerical libraries with a fixed set of values, so that they carry no data."""
COUNT = re.compile("[0-9]{1,5}")
LOCALE = "C.UTF-8"  #: Locale of each method, because a result must not depend on the locale of the user.
SYSTEM = ("/usr", "/lib", "/lib32", "/lib64", "/bin", "/sbin", "/etc", "/opt", "/nix", "/snap", "/sys")
FACTS = ("cpuinfo", "meminfo", "stat", "version", "filesystems", "loadavg", "sys/kernel", "sys/vm", "driver")
DEVICES = ("null", "zero", "full", "random", "urandom", "tty", "dri", "kfd", "nvidia*")
PACKAGE = Path(__file__).parents[1]
PACKAGES = ("site-packages", "dist-packages")  #: Folder names of installed packages.
LOCATORS = "sfr_loc_map.methods.child.numba_cache"
KERNELS_OF_USER = "SFR_KERNELS"  #: Variable with the user's cache folder of numba, for `numba_cache.OfUser`.


def isolation_of(restrictions: str, *, can_read_all_files: bool) -> Isolation:
    """Return the isolation of a process from the restrictions in force and the paths that the user permitted."""
    permitted = {name: paths for name in PERMITTING if (paths := _permitted_by(name))}
    text = "".join(f"; readable by {name}: {os.pathsep.join(paths)}" for name, paths in permitted.items())
    readable = os.pathsep.join(path for paths in permitted.values() for path in paths) or None
    variables = " ".join(f"{name}={value}" for name, value in passed_settings(os.environ).items()) or None
    return Isolation(restrictions + text, can_read_all_files, readable, variables, own_files_sha256())


def own_files_sha256() -> str | None:
    """Return the hash of the content of the existing paths in SFR_METHOD_FILES; None if there are none."""
    hashes = [hash_path(path) for path in map(Path, _permitted_by(OWN_FILES)) if path.exists()]
    return hashlib.sha256("\n".join(hashes).encode()).hexdigest() if hashes else None


def passed_settings(environment: Mapping[str, str]) -> dict[str, str]:
    """Return the variables of `COUNTS` and `CHOICES` that a method receives: those with an allowed value."""
    counts = {name: environment[name] for name in COUNTS if COUNT.fullmatch(environment.get(name, ""))}
    choices = {name: environment[name] for name, allowed in CHOICES.items() if environment.get(name) in allowed}
    return counts | choices


def _permitted_by(name: str) -> list[str]:
    """Return the paths of a variable; from a search path, only those outside the system and the interpreter."""
    paths = _paths_in(os.environ.get(name, ""))
    if name == OWN_FILES:
        return paths
    return [path for path in paths if not _is_installed(path)]


def _is_installed(path: str) -> bool:
    """Return whether a path, by its name and by its target, belongs to the system or to this interpreter."""
    folders = [*map(Path, SYSTEM), *_prefixes()]
    folders += [folder.resolve() for folder in folders]
    named = (Path(os.path.normpath(path)), Path(path).resolve())
    return all(any(item.is_relative_to(folder) for folder in folders) for item in named)


def _passed_paths(name: str, value: str) -> list[str]:
    """Return the existing paths of a variable that a method receives, each once.

    Of the paths outside the system and the interpreter, the method receives only those that the score names.
    """
    existing = dict.fromkeys(os.path.normpath(path) for path in _paths_in(value) if os.path.exists(path))
    installed = [path for path in existing if _is_installed(path)]
    passed = set(installed[:MOST_PATHS])
    if name in PERMITTING:
        passed |= existing.keys() - set(installed)
    return [path for path in existing if path in passed]


def _paths_in(value: str) -> list[str]:
    return [path for path in value.split(os.pathsep) if path]


def _prefixes(*pythons: Path) -> list[Path]:
    """Return the folders of this interpreter and of others."""
    prefixes = [Path(sys.prefix), Path(sys.base_prefix), *(path.parent.parent for path in pythons)]
    return [path for path in prefixes if path != path.parent]  # so that /bin/python3 does not permit the root folder


def rules_of(method: Method, folder: Path, hidden: Sequence[Path]) -> Rules:
    """Return the paths that a method may list, read and write, with the scratch folder and without hidden paths."""
    code = code_of(method.kind, method.adapter, method.target)
    prefixes = _prefixes(method.python, method.python.resolve())
    named = [text for name in PERMITTING for text in _paths_in(os.environ.get(name, ""))]
    named += [text for text in sys.path if Path(text).name in PACKAGES]
    named += [method.vocabulary] if method.vocabulary else []
    own = [PACKAGE, *_kernels_in(_kernels_of_user()), *code]
    wanted: list[str | Path] = [*SYSTEM, *(f"/proc/{name}" for name in FACTS), *prefixes, *named, *own]
    # this package has compiled kernels
    unhashed = unhashed_of([path for path in code if path.resolve() != PACKAGE.resolve()])
    closed = frozenset(path.resolve() for path in (*hidden, *unhashed))
    above = frozenset(parent for path in closed for parent in path.parents)
    names = [path.resolve().parent for path in (PACKAGE, *code)]  # the interpreter lists these to find packages
    names.append(_kernels_of_user())  # numba lists its folders to find kernels
    read: list[Path] = []
    for path in dict.fromkeys(Path(item).resolve() for item in wanted):
        parts = list(_without(path, closed, above))
        read += parts
        if parts != [path] and path.is_dir():
            names.append(path)
    read.append(Path("/proc/self"))  # read-only, so that the process cannot reset its peak memory
    devices = [path for name in DEVICES for path in glob(f"/dev/{name}")]
    write = [folder, *(part for path in devices for part in _without(Path(path), closed, above))]
    return Rules(names=list(map(str, names)), read=list(map(str, read)), write=list(map(str, write)))


def environment_of(method: Method, folder: Path) -> dict[str, str]:
    """Return the environment of a method's process, which finds code and compiled kernels where this process does.

    The folders of `search_path_of` are added once the memory of the process without the method is measured. A method
    under test receives only the variables of `passed_settings`, and of the variables in `FOLDERS` and `PERMITTING` the
    paths of `_passed_paths`; a peer receives all.
    """
    if method.kind is MethodKind.PEER:
        return {**inherited_environment(), "TMPDIR": str(folder)}
    given = child_environment()
    found = {**passed_settings(given), "LC_ALL": LOCALE}
    for name in (*FOLDERS, *PERMITTING):
        if paths := _passed_paths(name, given.get(name, "")):
            found[name] = os.pathsep.join(paths)
    if site.ENABLE_USER_SITE:  # packages of the user are in the user's home, not in that of the method
        found["PYTHONUSERBASE"] = site.getuserbase()
    found |= dict.fromkeys(("HOME", "TMPDIR", "NUMBA_CACHE_DIR"), str(folder))
    found |= {"PYTHONDONTWRITEBYTECODE": "1", KERNELS_OF_USER: str(_kernels_of_user())}
    found["NUMBA_CACHE_LOCATOR_CLASSES"] = f"{LOCATORS}.BesideSources,{LOCATORS}.OfUser,UserProvidedCacheLocator"
    return found


def search_path_of(method: Method) -> list[str]:
    """Return the folders in which the modules of a method are searched first: the working directory for a class."""
    return [str(Path.cwd())] if method.kind is MethodKind.PYTHON else []


def _kernels_of_user() -> Path:
    return Path.home() / ".cache" / "numba"


def _kernels_in(folder: Path) -> list[Path]:
    """Return the indices and kernels of numba in a cache folder, which may contain other files."""
    return [path for kind in ("*.nbi", "*.nbc") for path in folder.rglob(kind) if not path.is_symlink()]


def _without(path: Path, hidden: Set[Path], above: Set[Path]) -> Iterator[Path]:
    """Yield a path, or the parts of it that contain no hidden paths; `above` has the parents of all hidden paths."""
    if not hidden.isdisjoint((path, *path.parents)):
        return
    if path not in above:
        yield path
        return
    with suppress(OSError):
        for part in path.iterdir():
            if not part.is_symlink():  # a rule for a link would permit its target, which may be hidden
                yield from _without(part, hidden, above)
