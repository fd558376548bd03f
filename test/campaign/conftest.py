"""Makes the modules beside the tests, and the helpers of the tests of nodes, importable."""

import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "nodes")]
