"""Writes the pairs of a source for `time_on_target.c`: `python export_pairs.py SRC pairs.raw`.

The file has the struct `sfr_rig`, then for each pair its stamp (int64) and both images, in this machine's byte order.
"""

import sys
from pathlib import Path

import numpy as np

from sfr_loc_map.io import registry
from sfr_loc_map.methods.workers.c_library import rig_struct

source, target = Path(sys.argv[1]), Path(sys.argv[2])
drive = registry.open_source(source).loc
if drive is None:
    sys.exit(f"no drive in '{source}'")
rig = drive.rig
setup = {name: getattr(rig, name) for name in ("width", "height", "fx", "fy", "cx", "cy", "baseline_m")}
with target.open("wb") as stream:
    stream.write(rig_struct(setup | {"T_rb_left": rig.T_rb_left.matrix.ravel()}).tobytes())
    for pair in drive.pairs():
        stream.write(np.int64(pair.stamp_ns).tobytes() + pair.left.tobytes() + pair.right.tobytes())
