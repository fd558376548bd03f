"""ORB-SLAM3 (stereo) by its Python wheel `pyorbslam3`, GPL-3: it runs in a process of its own only."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Mapping
from importlib import metadata
from typing import Any

import numpy as np
from numpy.typing import NDArray

# the settings format before 1.0: with that of 1.0 the wheel's stereo sensor ends at start-up
SETTINGS = {
    "Camera.type": '"PinHole"',
    "Camera.k1": 0.0,
    "Camera.k2": 0.0,
    "Camera.p1": 0.0,
    "Camera.p2": 0.0,
    "Camera.RGB": 1,
    "ThDepth": 40.0,
    "ORBextractor.nFeatures": 2000,
    "ORBextractor.scaleFactor": 1.2,
    "ORBextractor.nLevels": 8,
    "ORBextractor.iniThFAST": 12,
    "ORBextractor.minThFAST": 7,
    "Viewer.KeyFrameSize": 0.6,
    "Viewer.KeyFrameLineWidth": 2.0,
    "Viewer.GraphLineWidth": 1.0,
    "Viewer.PointSize": 2.0,
    "Viewer.CameraSize": 0.7,
    "Viewer.CameraLineWidth": 3.0,
    "Viewer.ViewpointX": 0.0,
    "Viewer.ViewpointY": -100.0,
    "Viewer.ViewpointZ": -0.1,
    "Viewer.ViewpointF": 2000.0,
}


def settings_text(setup: Mapping[str, Any]) -> str:
    """Return the settings file for a rig."""
    camera = {f"Camera.{name}": float(setup[name]) for name in ("fx", "fy", "cx", "cy")}
    camera |= {f"Camera.{name}": int(setup[name]) for name in ("width", "height")}
    camera["Camera.bf"] = float(setup["fx"]) * float(setup["baseline_m"])
    camera["Camera.fps"] = max(1.0, float(round(setup["rate_hz"])))
    return "%YAML:1.0\n" + "".join(f"{key}: {value}\n" for key, value in (SETTINGS | camera).items())


class OrbSlam3:
    """Pose of the left camera in its first one, as known right after each pair."""

    def __init__(self, setup: Mapping[str, Any]) -> None:
        """Load the vocabulary; the system cannot be warmed up: its first call starts the map."""
        import pyorbslam3  # type: ignore[import-not-found,unused-ignore]

        self.version = metadata.version("pyorbslam3")
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "settings.yaml")
            with open(path, "w", encoding="ascii") as stream:
                stream.write(settings_text(setup))
            self._slam = pyorbslam3.Slam(
                vocab_file=setup["vocabulary"], settings_file=path, sensor=pyorbslam3.Sensor.STEREO, use_viewer=False
            )

    def prepare(self, left: NDArray[np.uint8], right: NDArray[np.uint8], order: Mapping[str, Any]) -> Callable[[], Any]:
        """Return the call."""
        seconds = order["since_start_s"]
        return lambda: self._slam.track_stereo(left, right, seconds)

    def report(self, answer: Any, order: Mapping[str, Any]) -> dict[str, Any]:  # noqa: ANN401
        """Return the pose as 16 numbers, None when lost."""
        pose = np.asarray(answer.pose_wc, np.float64) if answer.pose_valid else None
        return {"T_first_left": None if pose is None or not np.isfinite(pose).all() else pose.ravel().tolist()}


open_method = OrbSlam3
