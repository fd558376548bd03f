"""One file (`*.sfrp`) of stereo pairs for a target board, little-endian; `examples/c_candidate/harness.c` reads it.

The file begins with `SFRPAIRS`, uint32 version and uint32 number of sections. A section is the drive (task 1) or the
pairs of one map (task 2): uint32 task, uint32 number of pairs, int32 width and height, then float64 fx, fy, cx, cy,
baseline_m, T_rb_left (12), T_sb_left (12), and the first pose of RB in DS (position, quaternion x y z w). A pair is
int64 stamp_ns, for a map float64 T_lm_navsb (12), and the left and the right image with one byte per pixel.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np

from sfr_loc_map.atomic import atomic_path
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.sequence import Source

SUFFIX = ".sfrp"
MAGIC, VERSION = b"SFRPAIRS", 1
LOCALISATION, MAPPING = 1, 2


def write_pairs(
    path: Path, source: Source, start: Transform | None, progress: Callable[[int], None] = lambda _: None
) -> int:
    """Write the drive and the mapping pairs of a source; return the number of pairs.

    `start` is the pose of RB in DS at the first pair of the drive. OutputError if the file cannot be written.
    """
    loc, nav, count = source.loc, source.nav, 0
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        stream.write(MAGIC + struct.pack("<2I", VERSION, (loc is not None) + (nav is not None)))
        if loc is not None:
            stream.write(_head(LOCALISATION, len(loc), loc.rig, loc.rig.T_rb_left, start or Transform.identity()))
            for pair in loc.pairs():
                stream.write(struct.pack("<q", pair.stamp_ns) + pair.left.tobytes() + pair.right.tobytes())
                progress(count := count + 1)
        if nav is not None:
            stream.write(_head(MAPPING, len(nav), nav.rig, Transform.identity(), Transform.identity()))
            for posed in nav.pairs():
                pair = posed.pair
                stream.write(struct.pack("<q", pair.stamp_ns) + _rows(posed.T_lm_navsb))
                stream.write(pair.left.tobytes() + pair.right.tobytes())
                progress(count := count + 1)
    return count


def _head(task: int, pairs: int, rig: StereoRig, T_rb_left: Transform, start: Transform) -> bytes:
    camera = struct.pack("<5d", rig.fx, rig.fy, rig.cx, rig.cy, rig.baseline_m)
    pose = np.concatenate([start.translation, start.quat_xyzw]).astype("<f8").tobytes()
    sizes = struct.pack("<2I2i", task, pairs, rig.width, rig.height)
    return sizes + camera + _rows(T_rb_left) + _rows(rig.T_sb_left) + pose


def _rows(T_a_b: Transform) -> bytes:
    return T_a_b.matrix[:3].astype("<f8").tobytes()
