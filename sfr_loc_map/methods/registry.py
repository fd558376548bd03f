"""Registry of the methods under test: their names, and how their processes are started.

A method is given by its registered name, or as `package.module:Class`, `file.py:Class` or `lib:PATH.so`.
"""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

from sfr_loc_map import __version__
from sfr_loc_map.configuration.parameters import param
from sfr_loc_map.errors import MethodError
from sfr_loc_map.inputs import missing, read_text, refusing
from sfr_loc_map.methods.own_code import code_sha256, has_module
from sfr_loc_map.metrics.figures.records import MethodKind, MethodRecord
from sfr_loc_map.suite_names import OURS, Task

ADAPTERS = Path(__file__).parent / "adapters"
CHILD = Path(__file__).parent / "child"
OURS_IN_TABLES = "ours"  #: Name of our method in the tables and files of a comparison.
LIBRARY_PREFIX = "lib:"
CLASS_ADAPTER, LIBRARY_ADAPTER = "python_class.py", "c_library.py"
HEADER = "sfr_candidate.h"


@dataclass(frozen=True, slots=True)
class MethodLimits:
    """Limits of a method. A process that exceeds a limit, even for a moment, is killed."""

    call_timeout_s: float = param(120.0, unit="s", doc="Timeout of a call.", low=0.05, high=1e6)
    start_timeout_s: float = param(900.0, unit="s", doc="Timeout of start and warm-up.", low=0.05, high=1e6)
    memory_mb: int = param(4000, unit="MB", doc="Resident memory at which the process is killed.", low=50, high=10**6)
    restarts: int = param(3, doc="Maximum number of restarts after the process has ended.", low=0, high=1000)


class Isolation(NamedTuple):
    """How the process of a method is isolated."""

    text: str  #: Restrictions in force, and exceptions, for display.
    can_read_all_files: bool  #: Whether the system could not isolate the process from the files of its user.
    readable_files: str | None  #: Further paths that the user permitted the method to read, separated as in PATH.
    variables: str | None  #: Environment variables with settings that the process received: `NAME=VALUE NAME=VALUE`.
    files_sha256: str | None = None  #: Hash of the content of the paths in SFR_METHOD_FILES; None without paths.


@dataclass(frozen=True, slots=True)
class Method:
    """A localiser or mapper that runs in its own process."""

    name: str  #: Name as selected by the user.
    task: Task
    kind: MethodKind
    adapter: str  #: File in `adapters/`, or an absolute path.
    target: str = ""  #: Loaded by the adapter: `package.module:Class` or the path of a library.
    config: str = ""  #: Text of the configuration.
    is_paced: bool = False  #: Whether a benchmark sends pairs at their rate, because the method works between calls.
    sha256: str | None = None  #: Hash of the method's own code (`own_code`); None for a built-in method or a peer.
    about: str = ""  #: Description in the list of methods.
    python: Path = field(default_factory=lambda: Path(sys.executable))  #: Interpreter that has the method.
    vocabulary: str = ""  #: Vocabulary file; empty if not required.

    @property
    def reads_own_files(self) -> bool:
        """Whether the paths in SFR_METHOD_FILES are inputs of the method."""
        return self.kind in (MethodKind.PYTHON, MethodKind.LIBRARY)

    def record(self, version: str | None, isolation: Isolation | None = None) -> MethodRecord:
        """Return the record of the method in the score."""
        variables = None if isolation is None or self.kind is MethodKind.PEER else isolation.variables
        files_sha256 = isolation.files_sha256 if isolation is not None and self.reads_own_files else None
        settings = "\n".join(filter(None, (self.config, variables, files_sha256)))
        config_sha256 = hashlib.sha256(settings.encode()).hexdigest() if settings else None
        return MethodRecord(
            name=self.name,
            version=version,
            kind=self.kind,
            sha256=self.sha256,
            config_sha256=config_sha256,
            isolation=None if isolation is None else isolation.text,
            can_read_all_files=isolation is not None and isolation.can_read_all_files,
            readable_files=None if isolation is None else isolation.readable_files,
            variables=variables,
        )


@dataclass(frozen=True, slots=True)
class Peer:
    """A third-party method that may be installed in another interpreter; `sfr bench` includes it in comparisons."""

    method: Method
    modules: tuple[str, ...]  #: Modules that the interpreter must have.
    install: str  #: Command that installs the method.
    needs_vocabulary: bool = False

    @property
    def name(self) -> str:
        """Name of the method."""
        return self.method.name


OUR_MODULE, ABOUT_OURS = "sfr_loc_map.methods.ours", "this suite's own, the default"
_BUILT_IN = (
    Method(
        OURS, Task.LOCALISATION, MethodKind.BUILT_IN, CLASS_ADAPTER, f"{OUR_MODULE}:localiser", is_paced=True,
        about=ABOUT_OURS,
    ),
    Method(
        "opencv", Task.LOCALISATION, MethodKind.BUILT_IN, "opencv_odometry.py",
        about="corners, optical flow, PnP from pair to pair",
    ),
    Method(OURS, Task.MAPPING, MethodKind.BUILT_IN, CLASS_ADAPTER, f"{OUR_MODULE}:mapper", about=ABOUT_OURS),
    Method(
        "sgbm", Task.MAPPING, MethodKind.BUILT_IN, "opencv_sgbm.py", about="OpenCV's semi-global matching, three-way"
    ),
)  # fmt: skip
_PEERS = (
    Peer(
        Method("orbslam3", Task.LOCALISATION, MethodKind.PEER, "peer_orbslam3.py", is_paced=True),
        modules=("pyorbslam3",),
        install="pip install pyorbslam3 opencv-python-headless",
        needs_vocabulary=True,
    ),
    Peer(
        Method("pandora", Task.MAPPING, MethodKind.PEER, "peer_pandora.py"),
        modules=("pandora", "pandora_plugin_libsgm"),
        install="pip install 'pandora[sgm]' opencv-python-headless",
    ),
)
#: Registered methods by task and name.
BUILT_IN = {task: {item.name: item for item in _BUILT_IN if item.task == task} for task in Task}
#: Third-party methods by task and name.
PEERS = {task: {item.name: item for item in _PEERS if item.method.task == task} for task in Task}


def config_text(path: Path | None) -> str:
    """Return the text of a method's configuration; empty without a path."""
    if path is None:
        return ""
    with refusing(f"cannot read '{path}'", "give the text file with the configuration of the method"):
        return read_text(path)


def find_method(spec: str, task: Task, config: str = "") -> Method:
    """Return the method of a specification; MethodError if there is no such method."""
    if spec in BUILT_IN[task]:
        return replace(BUILT_IN[task][spec], config=config)
    if "\0" in spec:
        raise MethodError(f"method {spec!r:.60} contains a NUL character: give a name or a path without it")
    try:
        return _found(spec, task, config)
    except (OSError, UnicodeError) as error:  # a path that the system refuses, for example one that is too long
        reason = error.strerror if isinstance(error, OSError) else error
        raise MethodError(f"method {spec!r:.60} is not a valid path ({reason}): give another path") from error


def _found(spec: str, task: Task, config: str) -> Method:
    """Return the method of a library, a file or a module; OSError or UnicodeError if the system refuses the path."""
    if spec.startswith(LIBRARY_PREFIX):
        path = Path(spec.removeprefix(LIBRARY_PREFIX)).resolve()
        if not path.is_file():
            problem = f"'{path}' is a folder" if path.is_dir() else missing(path)
            raise MethodError(f"method '{spec}': {problem}; build the library (docs/candidates.md)")
        library = (LIBRARY_ADAPTER, str(path), config)
        return _identified(Method(spec, task, MethodKind.LIBRARY, *library, is_paced=True))
    module, _, name = spec.rpartition(":")
    place = Path(module)
    is_file = place.suffix == ".py"
    if not module or not _is_dotted_name(name) or not (is_file or _is_dotted_name(module)):
        names = ", ".join(BUILT_IN[task])
        raise MethodError(
            f"no method '{spec}' for {task}: give one of {names}, package.module:Class, lib:PATH.so (sfr bench methods)"
        )
    if is_file and not place.is_file():
        raise MethodError(f"method '{spec}': {missing(place)}; give the file of the class")
    if not is_file and not has_module(module):
        raise MethodError(
            f"method '{spec}': there is no module '{module}' that another process could import; give a module of the "
            "working directory or of an installed package, or FILE.py:Class"
        )
    # an absolute path, because the process has another working directory
    target = f"{place.resolve()}:{name}" if is_file else spec
    return _identified(Method(spec, task, MethodKind.PYTHON, CLASS_ADAPTER, target, config, is_paced=True))


def _is_dotted_name(text: str) -> bool:
    """Return whether a text consists of one or more Python identifiers separated by dots."""
    return all(part.isidentifier() for part in text.split("."))


def _identified(method: Method) -> Method:
    """Return a method with the hash of its own code."""
    return replace(method, sha256=code_sha256(method.kind, method.adapter, method.target))


def find_peer(peer: Peer, python: Path | None, vocabulary: Path | None = None) -> tuple[Method | None, str]:
    """Return the method of a peer in an interpreter, or None and the reason why the method cannot be run."""
    if python is None:
        return None, f"no interpreter was given: name an interpreter with the method by --peer-python ({peer.install})"
    code = f"import importlib.util as u, sys; sys.exit(0 if all(map(u.find_spec, {peer.modules!r})) else 3)"
    try:
        status = subprocess.run([python, "-c", code], capture_output=True, timeout=60, check=False).returncode
    except (OSError, subprocess.TimeoutExpired) as error:
        reason = getattr(error, "strerror", None) or "it did not end within 60 s"
        raise MethodError(f"'--peer-python {python}' cannot be run: {reason}; give a Python interpreter") from error
    if status:
        return None, f"not installed in {python}: {peer.install}"
    if not peer.needs_vocabulary:
        return replace(peer.method, python=python), ""
    if vocabulary is None:
        return None, "requires a vocabulary: give --vocab FILE"
    if not vocabulary.is_file():
        return None, f"vocabulary '{vocabulary}' is not a file: give --vocab FILE"
    return replace(peer.method, python=python, vocabulary=str(vocabulary.resolve())), ""


def listed_methods() -> list[dict[str, str | None]]:
    """Return the registered methods; the version of a peer is unknown before the peer is started."""
    import cv2

    versions = {OURS: __version__, "opencv": cv2.__version__, "sgbm": cv2.__version__}
    rows: list[dict[str, str | None]] = []
    for task in Task:
        abouts = [(method, method.about) for method in BUILT_IN[task].values()]
        abouts += [(peer.method, f"sfr bench: {peer.install}") for peer in PEERS[task].values()]
        for method, about in abouts:
            version = versions.get(method.name)
            rows.append({"task": task, "name": method.name, "version": version, "kind": method.kind, "about": about})
    return rows


def record_of_ours(task: Task, settings: Mapping[str, object] = MappingProxyType({})) -> MethodRecord:
    """Return the record of the suite's own method in the score, with the settings that differ from the defaults."""
    text = json.dumps(dict(settings), sort_keys=True) if settings else ""
    return replace(BUILT_IN[task][OURS], config=text).record(__version__)


def header_folder() -> Path:
    """Return the folder of the header for C candidates, in the source tree or in the installation."""
    for parent in Path(__file__).resolve().parents[2:]:
        for place in ("include", "share/sfr_loc_map/include"):
            if (parent / place / HEADER).is_file():
                return parent / place
    raise MethodError(f"{HEADER} is not installed beside '{Path(__file__).parents[1]}': install the package again")
