"""ORB-SLAM3 (stereo) through the Python package `pyorbslam3`, in a separate process because of its licence, GPL-3."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from importlib import metadata
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from sfr_loc_map.methods.child.loop import Answer, Order, Setup

# settings format before 1.0, because the stereo sensor of the package exits at start-up with format 1.0
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


def settings_text(setup: Setup) -> str:
    """Return the settings file for a rig."""
    rig = setup["camera"]
    camera = {
        "Camera.fx": rig["fx"],
        "Camera.fy": rig["fy"],
        "Camera.cx": rig["cx"],
        "Camera.cy": rig["cy"],
        "Camera.width": rig["width"],
        "Camera.height": rig["height"],
        "Camera.bf": rig["fx"] * rig["baseline_m"],
        "Camera.fps": max(1.0, float(round(setup["rate_hz"]))),
    }
    return "%YAML:1.0\n" + "".join(f"{key}: {value}\n" for key, value in (SETTINGS | camera).items())


class OrbSlam3:
    """Poses of RB from the poses of the left camera relative to the first pair, as estimated right after each pair."""

    def __init__(self, setup: Setup) -> None:
        """Load the vocabulary. The system cannot be warmed up, because its first call starts the map."""
        import pyorbslam3  # type: ignore[import-not-found,unused-ignore]

        self.version = metadata.version("pyorbslam3")
        T_rb_left = np.reshape(setup["T_rb_left"], (4, 4))
        self._T_ds_first_left = np.reshape(setup["T_ds_rb"], (4, 4)) @ T_rb_left
        self._T_left_rb = np.linalg.inv(T_rb_left)
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "settings.yaml")
            with open(path, "w", encoding="ascii") as stream:
                stream.write(settings_text(setup))
            self._slam = pyorbslam3.Slam(
                vocab_file=setup["vocabulary"], settings_file=path, sensor=pyorbslam3.Sensor.STEREO, use_viewer=False
            )

    def prepare(self, left: NDArray[np.uint8], right: NDArray[np.uint8], order: Order) -> Callable[[], Any]:
        """Return the call."""
        seconds = order["since_start_s"]
        return lambda: self._slam.track_stereo(left, right, seconds)

    def report(self, answer: Any, order: Order) -> Answer:  # noqa: ANN401
        """Return the pose of RB in DS; None if lost."""
        T_first_left = np.asarray(answer.pose_wc, np.float64)
        if not answer.pose_valid or not np.isfinite(T_first_left).all():
            return {"T_ds_rb": None}
        return {"T_ds_rb": (self._T_ds_first_left @ T_first_left @ self._T_left_rb).ravel().tolist()}


open_method = OrbSlam3
