"""Which methods there are, and how each is named: a name, `package.module:Class`, `file.py:Class`, `lib:PATH.so`."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path

from sfr_loc_map import __version__
from sfr_loc_map.errors import MethodError
from sfr_loc_map.inputs import hash_path, parse_yaml
from sfr_loc_map.methods.method import OURS, Method, MethodTask
from sfr_loc_map.metrics.score import MethodKind, MethodRecord

GROUPS = {MethodTask.LOCALISE: "sfr_loc_map.localisers", MethodTask.MAP: "sfr_loc_map.mappers"}
"""Groups of entry points by which other packages add methods: `name = package.module:Class`."""
LIBRARY_PREFIX = "lib:"
EXTERNAL = "external"
CLASS_WORKER, LIBRARY_WORKER = "python_class.py", "c_library.py"
BUILT_IN = {
    MethodTask.LOCALISE: {
        OURS: Method(
            OURS,
            MethodTask.LOCALISE,
            MethodKind.BUILT_IN,
            CLASS_WORKER,
            "sfr_loc_map.methods.ours:localiser",
            background=True,
        ),
        "opencv": Method("opencv", MethodTask.LOCALISE, MethodKind.BUILT_IN, "opencv_odometry.py"),
    },
    MethodTask.MAP: {
        OURS: Method(OURS, MethodTask.MAP, MethodKind.BUILT_IN, CLASS_WORKER, "sfr_loc_map.methods.ours:mapper"),
        "sgbm": Method("sgbm", MethodTask.MAP, MethodKind.BUILT_IN, "opencv_sgbm.py"),
    },
}


ABOUT = {
    OURS: "this suite's own, the default",
    "opencv": "corners, optical flow, PnP from pair to pair",
    "sgbm": "OpenCV's semi-global matching, three-way",
}


@dataclass(frozen=True, slots=True)
class Peer:
    """A method that a user may have installed in an interpreter of its own.

    Attributes:
        method: The method, without its interpreter.
        modules: What that interpreter must have.
        install: Command that installs it.
        needs: Files that its configuration must name, with what they are.
    """

    method: Method
    modules: tuple[str, ...]
    install: str
    needs: tuple[tuple[str, str], ...] = ()


PEERS = {
    MethodTask.LOCALISE: {
        "orbslam3": Peer(
            Method("orbslam3", MethodTask.LOCALISE, MethodKind.PEER, "peer_orbslam3.py", background=True),
            ("pyorbslam3",),
            "pip install pyorbslam3 opencv-python-headless",
            (("vocabulary", "its vocabulary: give --vocab FILE, or 'vocabulary: FILE' in the file of --config"),),
        )
    },
    MethodTask.MAP: {
        "pandora": Peer(
            Method("pandora", MethodTask.MAP, MethodKind.PEER, "peer_pandora.py"),
            ("pandora", "pandora_plugin_libsgm"),
            "pip install 'pandora[sgm]' opencv-python-headless",
        )
    },
}


def find_method(spec: str, task: MethodTask, config: str = "") -> Method:
    """Return the method that a text names.

    Args:
        spec: Name, `package.module:Class`, `file.py:Class` or `lib:PATH.so`.
        task: What it is wanted for.
        config: Text of its configuration. That of a peer names its interpreter: `python: PATH`.

    Raises:
        MethodError: If there is none, or a peer is not installed.
    """
    if spec in BUILT_IN[task]:
        return replace(BUILT_IN[task][spec], config=config)
    if spec in PEERS[task]:
        return _configured_peer(PEERS[task][spec], config)
    if spec.startswith(LIBRARY_PREFIX):
        return _library(spec, task, config)
    target = next((entry.value for entry in _entry_points(task) if entry.name == spec), spec)
    if ":" not in target:
        names = ", ".join((*BUILT_IN[task], *PEERS[task], *(entry.name for entry in _entry_points(task))))
        raise MethodError(
            f"no method '{spec}' to {task}: give one of {names}, package.module:Class or lib:PATH.so (sfr methods)"
        )
    place = Path(target.rpartition(":")[0])
    sha256 = hash_path(place) if place.suffix == ".py" and place.is_file() else None
    if place.suffix == ".py" and sha256 is None:
        raise MethodError(f"method '{spec}': there is no file '{place}', give the file that has the class")
    return Method(spec, task, MethodKind.PYTHON, CLASS_WORKER, target, config, background=True, sha256=sha256)


def _library(spec: str, task: MethodTask, config: str) -> Method:
    path = Path(spec.removeprefix(LIBRARY_PREFIX)).resolve()
    if not path.is_file():
        raise MethodError(f"method '{spec}': there is no library '{path}', build it (docs/candidates.md)")
    return Method(
        spec, task, MethodKind.LIBRARY, LIBRARY_WORKER, str(path), config, background=True, sha256=hash_path(path)
    )


def _entry_points(task: MethodTask) -> list[metadata.EntryPoint]:
    """Return the methods that other packages add; no name of ours can be taken."""
    found = metadata.entry_points(group=GROUPS[task])
    return [entry for entry in found if entry.name not in BUILT_IN[task] and entry.name not in PEERS[task]]


def _configured_peer(peer: Peer, config: str) -> Method:
    try:
        values = parse_yaml(config) or {}
    except ValueError as error:
        raise MethodError(f"method {peer.method.name}: its configuration is no YAML ({error})") from error
    if not isinstance(values, dict):
        raise MethodError(f"method {peer.method.name}: its configuration must be a mapping, as 'python: PATH'")
    python = values.pop("python", None)
    found, reason = find_peer(peer, None if python is None else Path(str(python)), values)
    if found is None:
        raise MethodError(f"method {peer.method.name}: {reason}")
    return found


def find_peer(peer: Peer, python: Path | None, files: dict[str, object]) -> tuple[Method | None, str]:
    """Return a peer's method, or None and the reason why it cannot be run.

    Args:
        peer: The peer.
        python: Interpreter that may have it.
        files: Files that it needs, by name.

    Raises:
        MethodError: If `python` is not an interpreter.
    """
    for module in peer.modules:
        reason = lacks(python, module, peer.install)
        if reason is not None:
            return None, reason
    for name, what in peer.needs:
        if files.get(name) is None:
            return None, f"needs {what}"
        if not Path(str(files[name])).is_file():
            return None, f"there is no {name} '{files[name]}'"
    assert python is not None
    setup = {name: str(Path(str(value)).resolve()) for name, value in files.items()}
    return replace(peer.method, python=python, setup=setup), ""


def lacks(python: Path | None, module: str, install: str) -> str | None:
    """Return why an interpreter cannot import a module, None if it can; nothing is imported.

    Raises:
        MethodError: If `python` is not an interpreter.
    """
    if python is None:
        return f"not looked for: give --peer-python, an interpreter with it ({install})"
    code = f"import importlib.util as u, sys; sys.exit(0 if u.find_spec({module!r}) else 3)"
    try:
        status = subprocess.run([python, "-c", code], capture_output=True, timeout=60, check=False).returncode
    except (OSError, subprocess.TimeoutExpired) as error:
        raise MethodError(f"'--peer-python {python}' cannot be run ({error}): give a Python interpreter") from error
    if status not in (0, 3):
        raise MethodError(f"'--peer-python {python}' ended with {status}: give a Python interpreter")
    return None if status == 0 else f"not installed in {python}: {install}"


@dataclass(frozen=True, slots=True)
class ListedMethod:
    """A row of `sfr methods`.

    Attributes:
        task: What it does.
        name: What `--method` takes.
        version: Its version, None where that is not known without starting it.
        kind: Where it comes from.
        about: What it is, or why it cannot be run.
    """

    task: MethodTask
    name: str
    version: str | None
    kind: MethodKind
    about: str


def listed_methods(python: Path | None = None) -> Iterator[ListedMethod]:
    """Yield the methods that have a name.

    Args:
        python: Interpreter in which peers are looked for.
    """
    for task in MethodTask:
        for name, method in BUILT_IN[task].items():
            version = __version__ if name == OURS else _version_of("opencv-python-headless")
            yield ListedMethod(task, name, version, method.kind, ABOUT[name])
        yield from (_listed_peer(task, name, peer, python) for name, peer in PEERS[task].items())
        for entry in _entry_points(task):
            stated = None if entry.dist is None else entry.dist.version
            yield ListedMethod(task, entry.name, stated, MethodKind.PYTHON, entry.value)


def _listed_peer(task: MethodTask, name: str, peer: Peer, python: Path | None) -> ListedMethod:
    missing = next((text for module in peer.modules if (text := lacks(python, module, peer.install))), None)
    version = None if missing or python is None else _version_of(peer.modules[0], python)
    needs = "; ".join(f"needs {what}" for _, what in peer.needs)
    return ListedMethod(task, name, version, peer.method.kind, missing or needs)


def _version_of(package: str, python: Path | None = None) -> str | None:
    if python is None:
        try:
            return metadata.version(package)
        except metadata.PackageNotFoundError:
            return None
    code = f"from importlib import metadata; print(metadata.version({package!r}))"
    done = subprocess.run([python, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    return done.stdout.strip() or None


def record_of_ours(task: MethodTask) -> MethodRecord:
    """Return what the score says of the suite's own method."""
    return BUILT_IN[task][OURS].record(__version__)
