"""How many functions a score of files passes through: a stranger shall be able to read it from start to end."""

from __future__ import annotations

import sys
from pathlib import Path
from types import FrameType

import numpy as np

import sfr_loc_map
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.folder import FolderWriter
from sfr_loc_map.io.trajectory_file import save_trajectory
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.pipeline.scoring import ScoreInputs, score_files

MOST = 60
"""Functions of the package; comprehensions and lambdas do not count, a compiled kernel once."""
PACKAGE = str(Path(sfr_loc_map.__file__).parent)
FRAMES = 120


def test_the_score_of_a_csv_against_a_data_set_folder_is_a_short_read(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    stamps, count = np.arange(FRAMES) * 100_000_000, FRAMES
    positions = np.column_stack((0.1 * np.arange(count), np.sin(0.05 * np.arange(count)), np.zeros(count)))
    quats = np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
    rig = StereoRig(24, 16, 20.0, 20.0, 12.0, 8.0, 0.2, Transform(np.eye(3), np.array([0.4, 0.0, 0.3])))
    image = np.zeros((16, 24), np.uint8)
    with FolderWriter(tmp_path / "drive", loc=True, nav=False) as writer:
        writer.write_loc_rig(rig)
        for stamp, position, quat in zip(stamps.tolist(), positions, quats, strict=True):
            writer.write_loc_pair(StereoPair(stamp, image, image))
            writer.write_truth(stamp, position, quat)
    drifting = positions + np.cumsum(rng.normal(0, 0.0001, (count, 3)), axis=0)
    save_trajectory(tmp_path / "estimate.csv", Trajectory(stamps, drifting, quats))
    inputs, config = ScoreInputs.of(tmp_path / "estimate.csv", tmp_path / "drive"), ScoreConfig()
    score_files(inputs, config)  # imports what is imported late

    passed: set[str] = set()

    def note(frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(PACKAGE) and not code.co_name.startswith("<"):
            passed.add(f"{code.co_filename.removeprefix(PACKAGE)} {code.co_qualname}")

    sys.setprofile(note)
    try:
        score = score_files(inputs, config)
    finally:
        sys.setprofile(None)
    assert score.trajectory is not None
    assert score.trajectory.first.count
    assert "/metrics/trajectory_error.py sub_trajectory_errors" in passed, "kernels are seen"
    assert len(passed) <= MOST, sorted(passed)
