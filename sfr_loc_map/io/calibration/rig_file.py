"""Reading and writing of rig.json: a rectified stereo pair and its pose on the rover."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec

from sfr_loc_map.errors import GeometryError
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import MAX_TEXT_BYTES, read_bytes, refusing
from sfr_loc_map.io.calibration.projections import baseline_from_projection, check_baseline, check_centre
from sfr_loc_map.io.tables.text_table import BOM


class _PoseOfRig(msgspec.Struct, forbid_unknown_fields=True):
    translation_m: tuple[float, float, float]
    quat_xyzw: tuple[float, float, float, float]


class _RigFile(msgspec.Struct, forbid_unknown_fields=True):
    width: int
    height: int
    k: tuple[float, float, float, float, float, float, float, float, float]
    baseline_m: float
    T_rb_locsb: _PoseOfRig | None = None


def read_rig(file: Path) -> StereoRig:
    """Read a rig.json; raise InputError if the rig is invalid."""
    with refusing(f"cannot read '{file}'", "give a rig.json with width, height, k and baseline_m"):
        content = msgspec.json.decode(read_bytes(file, MAX_TEXT_BYTES).removeprefix(BOM), type=_RigFile)
    with refusing(f"'{file}'"):
        fx, skew, cx, low, fy, cy, *last = content.k
        if (skew, low, *last) != (0, 0, 0, 0, 1):
            raise GeometryError(f"k is {list(content.k)}: [fx, 0, cx, 0, fy, cy, 0, 0, 1] is required")
        pose = content.T_rb_locsb
        T_rb_sb = None if pose is None else Transform.from_quat(pose.translation_m, pose.quat_xyzw)
        # computed as from camera_info messages, so that a rig from a file and from topics is bit-identical
        baseline_m = baseline_from_projection(fx, -(fx * content.baseline_m)) if fx else content.baseline_m
        rig = StereoRig(content.width, content.height, fx, fy, cx, cy, baseline_m, T_rb_sb)
    check_centre(cx, cy, (rig.width, rig.height), f"'{file}'")
    check_baseline(baseline_m, f"'{file}'")
    return rig


def rig_json(rig: StereoRig) -> str:
    """Return the text of the rig.json of a rig."""
    content: dict[str, Any] = {
        "width": rig.width,
        "height": rig.height,
        "k": rig.camera_matrix.reshape(-1).tolist(),
        "baseline_m": rig.baseline_m,
    }
    if rig.T_rb_sb is not None:
        pose = rig.T_rb_sb
        content["T_rb_locsb"] = {"translation_m": pose.translation.tolist(), "quat_xyzw": pose.file_quat_xyzw.tolist()}
    return json.dumps(content, indent=1) + "\n"
