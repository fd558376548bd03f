"""Makes the made worlds that several folders of tests use importable; imported first."""

import sys
from pathlib import Path

sys.path += [str(Path(__file__).resolve().parents[1] / name) for name in ("scenes", "io")]
