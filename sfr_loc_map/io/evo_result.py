"""Results of evo as zip files: `evo_ape ... --save_results result.zip` (github.com/MichaelGrupp/evo).

    info.json      title, label, names of reference (ref_name) and estimate (est_name)
    stats.json     rmse, mean, median, std, min, max, sse
    *.npy          arrays, as `error_array`
    NAME.tum, NAME.kitti   trajectories by these names, where the setting `save_traj_in_zip` of evo is on

Only what is needed of a member is read, and no more than a file of its kind may have.
"""

from __future__ import annotations

import io
import json
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import InputError
from sfr_loc_map.inputs import MAX_TABLE_BYTES, MAX_TEXT_BYTES, check_regular, parse_json

MAGIC = b"PK\x03\x04"
POSE_SUFFIXES = (".tum", ".kitti")
MAX_MEMBERS = 1000


@dataclass(frozen=True, slots=True)
class EvoTrajectory:
    """A trajectory of a result.

    Attributes:
        name: Member of the zip file.
        data: Its text.
    """

    name: str
    data: bytes

    @property
    def is_tum(self) -> bool:
        """Whether it has stamps."""
        return self.name.endswith(".tum")


def read_evo_trajectory(path: Path, role: str = "estimate") -> EvoTrajectory:
    """Read the estimate or the reference of a result.

    Args:
        path: The zip file.
        role: `estimate` or `truth`.

    Raises:
        InputError: If it is no result of evo, or has no trajectories.
    """
    try:
        check_regular(path)
        with zipfile.ZipFile(path) as archive:
            names = [item.filename for item in archive.infolist()[:MAX_MEMBERS]]
            if not {"info.json", "stats.json"} <= set(names):
                raise InputError(f"'{path}' is no result of evo: it has no info.json and stats.json")
            info = parse_json(_member(archive, "info.json", MAX_TEXT_BYTES))
            name = _chosen(path, names, info, role)
            return EvoTrajectory(name, _member(archive, name, MAX_TABLE_BYTES))
    except (OSError, ValueError, RuntimeError, NotImplementedError, zipfile.BadZipFile, zlib.error, EOFError) as error:
        raise InputError(f"cannot read '{path}': {error}; give a zip file of evo's --save_results") from error


def _member(archive: zipfile.ZipFile, name: str, limit: int) -> bytes:
    with archive.open(name) as stream:
        data = stream.read(limit + 1)
    if len(data) > limit:
        raise ValueError(f"its member {name[:80]} is larger than {limit} bytes")
    return data


def _chosen(path: Path, names: list[str], info: object, role: str) -> str:
    """Return the member that has the estimate or the reference."""
    poses = [name for name in names if name.endswith(POSE_SUFFIXES)]
    if not poses:
        raise InputError(
            f"evo result '{path}' has no trajectories, only errors: run 'evo_config set save_traj_in_zip true' before "
            "evo, or give the files themselves"
        )
    estimates, references = (_named(poses, info, key) for key in ("est_name", "ref_name"))
    wanted, other = (estimates, references) if role == "estimate" else (references, estimates)
    rest = [name for name in poses if name not in other]
    if not wanted and len(rest) != 1:
        raise InputError(f"evo result '{path}' does not say which is the {role}: it has {', '.join(poses)[:200]}")
    return (wanted or rest)[0]


def _named(poses: list[str], info: object, key: str) -> list[str]:
    """Return the members of the trajectory that an entry of `info.json` names."""
    said = info.get(key) if isinstance(info, dict) else None
    return [name for name in poses if name in {f"{said}{suffix}" for suffix in POSE_SUFFIXES}]


def evo_result_bytes(
    info: Mapping[str, str],
    stats: Mapping[str, float],
    arrays: Mapping[str, NDArray[Any]],
    poses: Mapping[str, str],
) -> bytes:
    """Return a result as evo reads it (`evo_res`).

    Args:
        info: Title, label, `ref_name`, `est_name`.
        stats: Statistics by name.
        arrays: Arrays by name, as `error_array`.
        poses: Texts of trajectories by name with `.tum` at its end.
    """
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("info.json", json.dumps(dict(info)))
        archive.writestr("stats.json", json.dumps(dict(stats)))
        for name, array in arrays.items():
            buffer = io.BytesIO()
            np.save(buffer, array, allow_pickle=False)
            archive.writestr(f"{name}.npy", buffer.getvalue())
        for name, text in poses.items():
            archive.writestr(name, text)
    return stream.getvalue()
