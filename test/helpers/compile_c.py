"""Libraries and programs in C, compiled with the command of the manual."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from helpers import ROOT

LIBRARY = ("-fPIC", "-shared")


def compile_c(*sources: Path, output: Path, options: tuple[str, ...] = LIBRARY) -> Path:
    """Compile sources, by default to a library; the test is skipped without a C compiler."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("there is no C compiler (cc)")
    strict = ("-std=c99", "-D_POSIX_C_SOURCE=200112L", "-Wall", "-Wextra", "-Werror", "-Wpedantic", "-O2")
    words = [compiler, *strict, *options, "-I", ROOT / "include", *sources, "-o", output, "-lm"]
    subprocess.run(list(map(str, words)), check=True)
    return output
