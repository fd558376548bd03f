"""The public names of each package, which are loaded on first use."""

import importlib
import subprocess
import sys
from pathlib import Path

import pytest

import sfr_loc_map

PACKAGE = Path(sfr_loc_map.__file__).parent
FACES = sorted(path.parent.name for path in PACKAGE.glob("*/__init__.pyi"))
HEAVY = ("numba", "cv2", "scipy", "rclpy", "plotly")


def test_each_public_name_is_there_and_is_no_module() -> None:
    pytest.importorskip("rclpy")
    for name in FACES:
        package = importlib.import_module(f"sfr_loc_map.{name}")
        assert package.__all__
        for public in package.__all__:
            assert getattr(package, public) is not None
            assert not (PACKAGE / name / f"{public}.py").exists(), "a module of that name would hide it"


def test_faces_cost_nothing_until_used() -> None:
    imports = "; ".join(f"import sfr_loc_map.{name}" for name in FACES)
    code = f"import sys; {imports}; print([name for name in {HEAVY!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=PACKAGE.parent)
    assert done.stdout.strip() == "[]"
