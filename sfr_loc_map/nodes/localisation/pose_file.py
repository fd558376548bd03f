"""The file in which a localisation node saves its last known pose, at which a new process resumes."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np

from sfr_loc_map.atomic import check_output
from sfr_loc_map.errors import InputError, OutputError, SfrError
from sfr_loc_map.geometry.plausibility import is_plausible_covariance
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import read_bytes
from sfr_loc_map.localisation.estimate import MAX_GIVEN_M, StartPose

SCHEMA = "sfr-resume/1"
MAX_BYTES = 100_000
MAX_STAMP_NS = 2**63 - 1  #: Maximum stamp of 64 bits, ns.
REPLACED = "the run starts at its first pose, and the file is replaced"


class _Content(msgspec.Struct):
    schema: Literal["sfr-resume/1"]
    rig: str
    stamp_ns: Annotated[int, msgspec.Meta(ge=0, le=MAX_STAMP_NS)]
    translation_m: tuple[float, float, float]
    quat_xyzw: tuple[float, float, float, float]
    covariance: Annotated[list[float], msgspec.Meta(min_length=36, max_length=36)]


class PoseFile:
    """Saves the last known pose of a rig, at which a localisation node resumes after it was killed.

    The file is replaced by renaming, so that a process that is killed leaves the previous file. The file is not
    synchronised with the disk: after a loss of power it may be old, empty or missing. A file that is corrupt or was
    saved with another rig is reported and replaced, and a pose that is too old is ignored, because a rover must
    localise without intervention. Any other file is never modified.
    """

    def __init__(self, path: Path, max_age_s: float) -> None:
        """Create the store without reading or writing; a pose whose stamp is older than `max_age_s` is not loaded."""
        self._path = Path(os.path.realpath(path))
        self._max_age_s = max_age_s

    def check(self) -> None:
        """Raise OutputError unless the file does not exist, is empty, or begins like a saved pose.

        A loss of power may have truncated the file.
        """
        check_output(self._path)
        self._check_content()

    def _check_content(self) -> None:
        """Raise OutputError if the file has other content than a saved pose, complete or truncated."""
        try:
            data = read_bytes(self._path, MAX_BYTES)
        except FileNotFoundError:
            return
        except OSError as error:
            raise OutputError(f"resume_file '{self._path}': {error.strerror}; choose another name") from error
        head = f'{{"schema": "{SCHEMA}"'.encode()
        if data.strip(b"\0") and not (data.startswith(head) or head.startswith(data)):
            raise OutputError(f"resume_file '{self._path}' has no saved pose; remove it or choose another name")

    def load(self, stamp_ns: int, rig: StereoRig) -> StartPose | None:
        """Return the saved pose; None if no pose is saved, or if it is too old or not earlier than this stamp."""
        try:
            kept = msgspec.json.decode(read_bytes(self._path, MAX_BYTES), type=_Content)
            pose = Transform.from_quat(kept.translation_m, kept.quat_xyzw)
            covariance = np.array(kept.covariance).reshape(6, 6)
            if not is_plausible_covariance(covariance):
                raise InputError("its covariance is invalid")
            saved = StartPose.of(StartPose(pose, covariance, kept.stamp_ns))
        except FileNotFoundError:
            return None
        except (OSError, ValueError, RecursionError, SfrError) as error:
            raise InputError(f"resume_file '{self._path}' cannot be read: {error}; {REPLACED}") from error
        if kept.rig != rig.fingerprint:
            raise InputError(f"resume_file '{self._path}' was saved with another rig or calibration; {REPLACED}")
        age_s = (stamp_ns - kept.stamp_ns) * 1e-9
        return saved if 0.0 < age_s <= self._max_age_s else None

    def save(self, known: StartPose, rig: StereoRig) -> None:
        """Save a pose with its stamp, unless `load` would refuse the pose, its covariance or its stamp.

        OutputError if the file cannot be written, or if the file has other content than a saved pose.
        """
        if known.stamp_ns is None or not _is_loadable(known, known.stamp_ns):
            return
        self._check_content()
        content = {
            "schema": SCHEMA,
            "rig": rig.fingerprint,
            "stamp_ns": int(known.stamp_ns),
            "translation_m": known.T_ds_rb.translation.tolist(),
            "quat_xyzw": known.T_ds_rb.quat_xyzw.tolist(),
            "covariance": np.asarray(known.covariance).reshape(-1).tolist(),
        }
        # a constant name, so that processes that are killed while writing do not accumulate files
        part = self._path.with_name(f".{self._path.name}.part")
        try:
            flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW | os.O_NONBLOCK  # a pipe must not block
            with open(os.open(part, flags, 0o666), "w", encoding="utf-8") as stream:
                stream.write(json.dumps(content))
            os.replace(part, self._path)
        except OSError as error:
            raise OutputError(
                f"cannot write resume_file '{self._path}': {error.strerror}; a restart would resume at an older pose"
            ) from error


def _is_loadable(known: StartPose, stamp_ns: int) -> bool:
    """Return whether `PoseFile.load` accepts a pose with a stamp."""
    is_near = bool((np.abs(known.T_ds_rb.translation) <= MAX_GIVEN_M).all())
    return is_near and 0 <= stamp_ns <= MAX_STAMP_NS and is_plausible_covariance(np.asarray(known.covariance))
