"""Lets the tests of this folder import their helpers and the scores made for the tests of the report."""

import sys
from pathlib import Path

for folder in (Path(__file__).parent, Path(__file__).parents[1] / "report"):
    sys.path.insert(0, str(folder))
