"""The last known pose, in a file: a localisation node that was killed resumes there."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sfr_loc_map.bounded_input import parse_json, read_text
from sfr_loc_map.errors import InputError, OutputError, SfrError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.start_pose import StartPose


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
    """Keeps the last known pose.

    The file is replaced by renaming, so a process that is killed leaves the one before. It is not synchronised to the
    disk: after a loss of power it may be older, or missing.
    """

    def __init__(self, path: Path, max_age_s: float) -> None:
        """Touch nothing yet.

        Args:
            path: The file.
            max_age_s: A pose older than this, by the stamps, is not loaded.
        """
        self._path, self._max_age_s = path, max_age_s

    def load(self, stamp_ns: int) -> KnownPose | None:
        """Return the pose, None where there is none or it does not belong to a run that goes on at this stamp.

        Raises:
            InputError: If the file cannot be read.
        """
        try:
            content = parse_json(read_text(self._path))
            pose = Transform.from_quat(content["translation_m"], content["quat_xyzw"])
            covariance = np.array(content["covariance"], np.float64).reshape(6, 6)
            known = KnownPose(int(content["stamp_ns"]), pose, covariance)
            if not np.isfinite(covariance).all():
                raise ValueError("its covariance is not finite")
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, TypeError, OverflowError, SfrError) as error:
            raise InputError(f"resume_file '{self._path}' cannot be read: {error}; it is replaced") from error
        age_s = (stamp_ns - known.stamp_ns) * 1e-9
        return known if 0.0 < age_s <= self._max_age_s else None

    def save(self, known: KnownPose) -> None:
        """Keep a pose.

        Raises:
            OutputError: If the file cannot be written.
        """
        content = {
            "stamp_ns": known.stamp_ns,
            "translation_m": known.T_ds_rb.translation.tolist(),
            "quat_xyzw": known.T_ds_rb.quat_xyzw.tolist(),
            "covariance": np.asarray(known.covariance).reshape(-1).tolist(),
        }
        # one name for all times: a process that is killed while it writes must not leave a new file each time
        part = self._path.with_name(f".{self._path.name}.part")
        try:
            part.write_text(json.dumps(content), encoding="utf-8")
            os.replace(part, self._path)
        except OSError as error:
            raise OutputError(
                f"cannot write resume_file '{self._path}': {error.strerror}; a restart would resume at an older pose"
            ) from error
