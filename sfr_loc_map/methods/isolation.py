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
from sfr_loc_map.metrics.figures.records import MethodKind

OWN_FILES = "SFR_METHOD_FILES"  #: Variable with additional readable paths, separated as in PATH.
PERMITTING = (OWN_FILES, "PYTHONPATH", LIBRARY_PATH)  #: Variables whose paths a method may read.
FOLDERS = ("PATH", "PYTHONHOME", "VIRTUAL_ENV", "CONDA_PREFIX", "CUDA_HOME", "CUDA_PATH", "TZDIR")
"""Variables with paths. A method receives the existing paths of the system and of the interpreter."""
SETTINGS = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "OPENBLAS_CORETYPE",
    "BLIS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "OPENCV_FOR_THREADS_NUM",
    "OMP_WAIT_POLICY",
    "CUDA_VISIBLE_DEVICES",
    "NVIDIA_VISIBLE_DEVICES",
    "PYTHONHASHSEED",
)
"""Variables that a method receives if their value is a number (`NUMBER`) or one of `WORDS`: threads, processor,
devices, seed."""
NUMBER = re.compile("-1|[0-9]{0,5}")  # also the empty value, by which CUDA_VISIBLE_DEVICES hides all devices
BLAS_CORES = ("Nehalem", "Sandybridge", "Haswell", "Zen", "SkylakeX", "Cooperlake", "SapphireRapids", "ARMV8")
"""Values of OPENBLAS_CORETYPE. The last digits of a result depend on this processor type, so that a method with another
type than this process would differ from a run in this process."""
WORDS = ("active", "passive", "all", "none", "void", *BLAS_CORES)
"""Words that a value of `SETTINGS` may be: a short list, so that a value carries no data. The list lacks `PASSIVE`,
which is a setting of this package for its own process (`jit.py`)."""
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
    """Return the variables of `SETTINGS` that a method receives: those with an allowed value."""
    given = {name: environment[name] for name in SETTINGS if name in environment}
    return {name: value for name, value in given.items() if NUMBER.fullmatch(value) or value in WORDS}


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
    return [path for path in existing if name in PERMITTING or _is_installed(path)]


def _paths_in(value: str) -> list[str]:
    return [path for path in value.split(os.pathsep) if path]


def _prefixes(*pythons: Path) -> list[Path]:
    """Return the folders of this interpreter and of others."""
    prefixes = [Path(sys.prefix), Path(sys.base_prefix), *(path.parent.parent for path in pythons)]
    return [path for path in prefixes if path != path.parent]  # so that /bin/python3 does not permit the root folder


def rules_of(method: Method, folder: Path, hidden: Sequence[Path]) -> Rules:
    """Return the paths that a method may list, read and write, with the scratch folder and without hidden paths."""
    code = code_of(method.kind, method.adapter, method.target)
    permitted = _permitted_paths(method, code)
    closed = _closed_paths(code, hidden)
    above = frozenset(parent for path in closed for parent in path.parents)
    listed = [path.resolve().parent for path in (PACKAGE, *code)]  # the interpreter lists these to find packages
    listed.append(_kernels_of_user())  # numba lists its folders to find kernels
    read: list[Path] = []
    for path in permitted:
        parts = list(_readable_parts(path, closed, above))
        read += parts
        if parts != [path] and path.is_dir():
            listed.append(path)
    read.append(Path("/proc/self"))  # read-only, so that the process cannot reset its peak memory
    devices = [Path(path) for name in DEVICES for path in glob(f"/dev/{name}")]
    write = [folder, *(part for path in devices for part in _readable_parts(path, closed, above))]
    return Rules(names=list(map(str, listed)), read=list(map(str, read)), write=list(map(str, write)))


def _permitted_paths(method: Method, code: Sequence[Path]) -> list[Path]:
    """Return the paths of the system, the interpreters, the variables, the suite and the method's own code, resolved.

    The parts of these paths that are not closed are readable.
    """
    system = [*SYSTEM, *(f"/proc/{name}" for name in FACTS)]
    prefixes = _prefixes(method.python, method.python.resolve())
    variables = [text for name in PERMITTING for text in _paths_in(os.environ.get(name, ""))]
    installed = [text for text in sys.path if Path(text).name in PACKAGES]
    vocabulary = [method.vocabulary] if method.vocabulary else []
    own = [PACKAGE, *_kernels_in(_kernels_of_user()), *code]
    paths: list[str | Path] = [*system, *prefixes, *variables, *installed, *vocabulary, *own]
    return list(dict.fromkeys(Path(path).resolve() for path in paths))


def _closed_paths(code: Sequence[Path], hidden: Sequence[Path]) -> frozenset[Path]:
    """Return the hidden paths, and the files of the method's own code that its hash ignores, resolved.

    Files of this package are not closed: its compiled kernels, which the hash ignores, must be readable.
    """
    unhashed = unhashed_of([path for path in code if path.resolve() != PACKAGE.resolve()])
    return frozenset(path.resolve() for path in (*hidden, *unhashed))


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


def _readable_parts(path: Path, hidden: Set[Path], above: Set[Path]) -> Iterator[Path]:
    """Yield a path that contains no hidden path; of a folder that contains some, yield the parts that contain none.

    `above` has the parents of all hidden paths. Nothing is yielded for a hidden path and for paths below it.
    """
    if not hidden.isdisjoint((path, *path.parents)):
        return
    if path not in above:
        yield path
        return
    with suppress(OSError):
        for part in path.iterdir():
            if not part.is_symlink():  # a rule for a link would permit its target, which may be hidden
                yield from _readable_parts(part, hidden, above)
