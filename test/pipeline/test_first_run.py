"""The first run on a machine, which compiles, gives the same bits as all later ones, which load what was compiled."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from first_run import RUNS, kept_digest

SCENES = Path(__file__).parents[1] / "scenes"
ROOT = SCENES.parents[1]


def digest(part: str, **environment: str) -> str:
    run = subprocess.run(
        [sys.executable, str(SCENES / "first_run.py"), part],
        env={**os.environ, "PYTHONPATH": str(ROOT), **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    return run.stdout.strip()


@pytest.mark.slow
@pytest.mark.timeout(400)
@pytest.mark.parametrize("part", RUNS)
def test_a_run_that_compiles_gives_the_bits_of_one_that_loads(part: str, tmp_path: Path) -> None:
    cache: dict[str, str] = {}
    first = kept_digest(part)  # of `make test`, which compiles; compiled here where the code has changed since
    if first is None:
        cache["NUMBA_CACHE_DIR"] = str(tmp_path)
        first = digest(part, **cache)
        assert any(tmp_path.rglob("*.nbi"))
    assert len(first) == 64
    assert digest(part, **cache) == first
