"""Methods that ours is compared with, and how each is started."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sfr_loc_map.errors import BenchError

OURS = "ours"
WORKERS = Path(__file__).parent / "workers"


@dataclass(frozen=True, slots=True)
class ReferenceMethod:
    """A localiser or matcher that is benchmarked, ours or another.

    Attributes:
        name: Its name in tables.
        worker: Its file in `workers/`.
        python: Interpreter that has it installed.
        background: Whether it continues to work between calls: it runs alone, at the rate of the recording.
        setup: Sent to its worker besides the rig.
    """

    name: str
    worker: str
    python: Path = field(default_factory=lambda: Path(sys.executable))
    background: bool = False
    setup: Mapping[str, Any] = field(default_factory=dict)

    @property
    def command(self) -> list[str]:
        """Return the command that starts its process."""
        return [str(self.python), str(WORKERS / "loop.py"), str(WORKERS / self.worker)]


@dataclass(frozen=True, slots=True)
class ReferenceMethods:
    """Methods of a benchmark, ours first.

    Attributes:
        present: Methods that can be run.
        missing: Reason why the others cannot be run, by name.
    """

    present: tuple[ReferenceMethod, ...]
    missing: Mapping[str, str]


def localisation_methods(peer_python: Path | None, vocabulary: Path | None) -> ReferenceMethods:
    """Return ours, the plain OpenCV odometry, and ORB-SLAM3 where it is installed.

    Args:
        peer_python: Interpreter that may have the wheel `pyorbslam3`.
        vocabulary: Text file with ORB-SLAM3's vocabulary.
    """
    always = (
        ReferenceMethod(OURS, "our_localiser.py", background=True),
        ReferenceMethod("opencv", "opencv_odometry.py"),
    )
    reason = lacks(peer_python, "pyorbslam3", "pip install pyorbslam3 opencv-python-headless")
    if reason is None and vocabulary is None:
        reason = "needs its vocabulary: give --vocab FILE"
    if reason is None and vocabulary is not None and not vocabulary.is_file():
        reason = f"there is no vocabulary '{vocabulary}'"
    if reason is not None or peer_python is None or vocabulary is None:
        return ReferenceMethods(always, {"orbslam3": str(reason)})
    setup = {"vocabulary": str(vocabulary.resolve())}
    return ReferenceMethods(
        (*always, ReferenceMethod("orbslam3", "reference_orbslam3.py", peer_python, background=True, setup=setup)), {}
    )


def mapping_methods(peer_python: Path | None) -> ReferenceMethods:
    """Return ours, OpenCV's semi-global matching, and Pandora where it is installed."""
    always = (ReferenceMethod(OURS, "our_mapper.py"), ReferenceMethod("sgbm", "opencv_stereo.py"))
    packages = "pip install 'pandora[sgm]' opencv-python-headless"
    reason = lacks(peer_python, "pandora", packages) or lacks(peer_python, "pandora_plugin_libsgm", packages)
    if reason is not None or peer_python is None:
        return ReferenceMethods(always, {"pandora": str(reason)})
    return ReferenceMethods((*always, ReferenceMethod("pandora", "reference_pandora.py", peer_python)), {})


def lacks(python: Path | None, module: str, install: str) -> str | None:
    """Return why an interpreter cannot import a module, None if it can; nothing is imported.

    Raises:
        BenchError: If `python` is not an interpreter.
    """
    if python is None:
        return f"not looked for: give --peer-python, an interpreter with it ({install})"
    code = f"import importlib.util as u, sys; sys.exit(0 if u.find_spec({module!r}) else 3)"
    try:
        status = subprocess.run([python, "-c", code], capture_output=True, timeout=60, check=False).returncode
    except (OSError, subprocess.TimeoutExpired) as error:
        raise BenchError(f"'--peer-python {python}' cannot be run ({error}): give a Python interpreter") from error
    if status not in (0, 3):
        raise BenchError(f"'--peer-python {python}' ended with {status}: give a Python interpreter")
    return None if status == 0 else f"not installed in {python}: {install}"
