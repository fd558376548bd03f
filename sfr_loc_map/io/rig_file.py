"""The rig of a data set folder: `rig.json`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from sfr_loc_map.errors import GeometryError, InputError
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import parse_json, read_text
from sfr_loc_map.io.camera_info import message_baseline

KEYS = ("width", "height", "k", "baseline_m")
EXTRINSICS = "T_rb_locsb"


def load_rig(path: Path) -> StereoRig:
    """Read a rig.json.

    Raises:
        InputError: If it is missing, not JSON, or a value is missing, unknown or of the wrong type; names them.
    """
    content = _load_json(path)
    _check_keys(path, content)
    width, height = (_pixels(path, key, content[key]) for key in ("width", "height"))
    fx, skew, cx, low, fy, cy, *last = _numbers(path, "k", content["k"], 9)
    if (skew, low, *last) != (0, 0, 0, 0, 1):
        raise InputError(f"'{path}': k is {content['k']}; [fx, 0, cx, 0, fy, cy, 0, 0, 1] is needed")
    (baseline,) = _numbers(path, "baseline_m", [content["baseline_m"]], 1)
    try:
        return message_baseline(StereoRig(width, height, fx, fy, cx, cy, baseline, _extrinsics(path, content)))
    except GeometryError as error:
        raise InputError(f"'{path}': {error}; correct the file") from error


def rig_json(rig: StereoRig) -> str:
    """Return the text of the rig.json that `load_rig` reads as this rig."""
    content: dict[str, Any] = {
        "width": rig.width,
        "height": rig.height,
        "k": rig.camera_matrix.reshape(-1).tolist(),
        "baseline_m": rig.baseline_m,
    }
    if rig.T_rb_sb is not None:
        pose = rig.T_rb_sb
        content[EXTRINSICS] = {"translation_m": pose.translation.tolist(), "quat_xyzw": pose.file_quat_xyzw.tolist()}
    return json.dumps(content, indent=1) + "\n"


def _check_keys(path: Path, content: dict[str, Any]) -> None:
    missing = [key for key in KEYS if key not in content]
    unknown = [key for key in content if key not in (*KEYS, EXTRINSICS)]
    if missing or unknown:
        wrong = [f"{word} {', '.join(keys)}" for word, keys in (("misses", missing), ("has unknown", unknown)) if keys]
        raise InputError(f"'{path}' {' and '.join(wrong)}: it needs {', '.join(KEYS)} and may have {EXTRINSICS}")


def _pixels(path: Path, key: str, value: Any) -> int:  # noqa: ANN401 - any JSON value
    if not isinstance(value, int) or isinstance(value, bool):
        raise InputError(f"'{path}': {key} is {value!r}; a whole number of pixels is needed")
    return value


def _extrinsics(path: Path, content: dict[str, Any]) -> Transform | None:
    if EXTRINSICS not in content:
        return None
    extrinsics = content[EXTRINSICS]
    if not isinstance(extrinsics, dict) or sorted(extrinsics) != ["quat_xyzw", "translation_m"]:
        raise InputError(
            f"'{path}': {EXTRINSICS} is {extrinsics!r}; an object with translation_m and quat_xyzw is needed"
        )
    translation = _numbers(path, f"{EXTRINSICS}.translation_m", extrinsics["translation_m"], 3)
    quat = _numbers(path, f"{EXTRINSICS}.quat_xyzw", extrinsics["quat_xyzw"], 4)
    try:
        return Transform.from_quat(translation, quat)
    except GeometryError as error:
        raise InputError(f"'{path}': {EXTRINSICS}: {error}; correct the file") from error


def _numbers(path: Path, name: str, value: Any, count: int) -> list[float]:  # noqa: ANN401 - any JSON value
    good = isinstance(value, list) and len(value) == count
    if not good or any(isinstance(v, bool) or not isinstance(v, (int, float)) for v in value):
        raise InputError(f"'{path}': {name} is {value!r}; {count} number{'s' if count > 1 else ''} needed")
    return [float(v) for v in value]


def _load_json(path: Path) -> dict[str, Any]:
    try:
        content = parse_json(read_text(path))
    except OSError as error:
        raise InputError(f"cannot read '{path}': {error.strerror}; a data set folder needs its rig.json") from error
    except ValueError as error:
        raise InputError(f"'{path}' is not valid JSON: {error}; correct the file") from error
    if not isinstance(content, dict):
        raise InputError(f"'{path}' holds a {type(content).__name__}: an object with {', '.join(KEYS)} is needed")
    return content
