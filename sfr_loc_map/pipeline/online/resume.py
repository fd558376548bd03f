"""The last known pose, in a file: a localisation node that was killed resumes there."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sfr_loc_map.errors import InputError, OutputError, SfrError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.plausibility import is_plausible_covariance
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import parse_json, read_bytes, read_text
from sfr_loc_map.io.atomic import check_output
from sfr_loc_map.localisation.start_pose import StartPose

SCHEMA = "sfr-resume/1"
MAX_BYTES = 100_000


@dataclass(frozen=True, slots=True, eq=False)
class KnownPose:
    """A pose that was published.

    Attributes:
        stamp_ns: Its stamp.
        T_ds_rb: The pose.
        covariance: `(6, 6)` in ROS order, as published.
    """

    stamp_ns: int
    T_ds_rb: Transform
    covariance: FloatArray

    @property
    def start(self) -> StartPose:
        """The pose as the start of a localiser, which allows for the motion since its stamp."""
        return StartPose(self.T_ds_rb, self.covariance, self.stamp_ns)


class PoseFile:
    """Keeps the last known pose of a rig.

    The file is replaced by renaming, so a process that is killed leaves the one before. It is not synchronised to the
    disk: after a loss of power it may be older, empty or missing. What is damaged, too old or of another rig is told
    and replaced: a rover must localise again without a hand. A file that is something else is never touched.
    """

    def __init__(self, path: Path, max_age_s: float) -> None:
        """Touch nothing yet.

        Args:
            path: The file, or a link to it.
            max_age_s: A pose older than this, by the stamps, is not loaded.
        """
        self._path, self._max_age_s = Path(os.path.realpath(path)), max_age_s

    def check(self) -> None:
        """Check that poses can be kept: there is a kept pose, whole or damaged, or nothing.

        Raises:
            OutputError: If something else is there, or its folder cannot be written to.
        """
        check_output(self._path)
        try:
            ours = _is_ours(read_bytes(self._path, MAX_BYTES))
        except FileNotFoundError:
            return
        except OSError as error:
            raise OutputError(f"resume_file '{self._path}': {error.strerror}; choose another name") from error
        if not ours:
            raise OutputError(f"resume_file '{self._path}' holds no kept pose; remove it or choose another name")

    def load(self, stamp_ns: int, rig: StereoRig) -> KnownPose | None:
        """Return the pose, None where there is none or it does not belong to a run that goes on at this stamp.

        Args:
            stamp_ns: Stamp of the first pair.
            rig: The rig, with its extrinsics.

        Raises:
            InputError: If the file cannot be read, or is of another rig.
        """
        try:
            content = parse_json(read_text(self._path, MAX_BYTES))
            known = _known_pose(content)
        except FileNotFoundError:
            return None
        except (OSError, ValueError, SfrError) as error:
            raise InputError(
                f"resume_file '{self._path}' cannot be read: {error}; the run starts at its first pose, and the file "
                f"is replaced"
            ) from error
        if content.get("rig") != rig.fingerprint:
            raise InputError(
                f"resume_file '{self._path}' is of another rig or calibration: the run starts at its first pose, and "
                f"the file is replaced"
            )
        age_s = (stamp_ns - known.stamp_ns) * 1e-9
        return known if 0.0 < age_s <= self._max_age_s else None

    def save(self, known: KnownPose, rig: StereoRig) -> None:
        """Keep a pose.

        Args:
            known: The pose.
            rig: The rig that it was estimated with, with its extrinsics.

        Raises:
            OutputError: If the file cannot be written.
        """
        content = {
            "schema": SCHEMA,
            "rig": rig.fingerprint,
            "stamp_ns": known.stamp_ns,
            "translation_m": known.T_ds_rb.translation.tolist(),
            "quat_xyzw": known.T_ds_rb.quat_xyzw.tolist(),
            "covariance": np.asarray(known.covariance).reshape(-1).tolist(),
        }
        # one name for all times: a process that is killed while it writes must not leave a new file each time
        part = self._path.with_name(f".{self._path.name}.part")
        try:
            flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW | os.O_NONBLOCK  # a pipe must not wait
            with open(os.open(part, flags, 0o666), "w", encoding="utf-8") as stream:
                stream.write(json.dumps(content))
            os.replace(part, self._path)
        except OSError as error:
            raise OutputError(
                f"cannot write resume_file '{self._path}': {error.strerror}; a restart would resume at an older pose"
            ) from error


def _is_ours(data: bytes) -> bool:
    """Tell whether a file is a kept pose, also one that lost its end or its content with the power."""
    heads = (f'{{"schema": "{SCHEMA}"'.encode(), b'{"stamp_ns": ')  # the second of version 0.1
    return not data.strip(b"\0") or any(data.startswith(head) or head.startswith(data) for head in heads)


def _known_pose(content: object) -> KnownPose:
    """Return the pose of JSON values.

    Raises:
        ValueError: If it is none.
        GeometryError: The same.
    """
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise ValueError(f"it is not of the schema {SCHEMA}")
    stamp_ns = content.get("stamp_ns")
    if not isinstance(stamp_ns, int) or isinstance(stamp_ns, bool) or not 0 <= stamp_ns < 2**63:
        raise ValueError("its stamp is not whole nanoseconds")
    pose = Transform.from_quat(_numbers(content, "translation_m", 3), _numbers(content, "quat_xyzw", 4))
    covariance = np.array(_numbers(content, "covariance", 36)).reshape(6, 6)
    if not is_plausible_covariance(covariance):
        raise ValueError("its covariance is none")
    return KnownPose(stamp_ns, pose, covariance)


def _numbers(content: dict[str, Any], key: str, count: int) -> list[float]:
    values = content.get(key)
    if not isinstance(values, list) or len(values) != count:
        raise ValueError(f"its {key} is not {count} numbers")
    if any(isinstance(value, bool) or not isinstance(value, (int, float)) for value in values):
        raise ValueError(f"its {key} is not {count} numbers")
    return [float(value) for value in values]
