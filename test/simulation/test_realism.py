"""Statistics of rendered ground against those of images of real ground."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from sfr_loc_map.config import build, load_yaml
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.inputs import Task
from sfr_loc_map.simulation.config import SimulationConfig
from sfr_loc_map.simulation.drive import Plan
from sfr_loc_map.simulation.world import World

pytest.importorskip("embreex")

ROCKY = Path(__file__).parents[2] / "config" / "simulation" / "rocky.yaml"
LAGS = (1, 2, 4, 8)


def statistics(images: Sequence[np.ndarray]) -> FloatArray:
    """Means over images, of the lower half: standard deviation, absolute differences along rows and columns, and the
    autocorrelation along rows at `LAGS` without waves longer than some 50 pixels."""
    rows = []
    for image in images:
        ground = image[image.shape[0] // 2 :].astype(float)
        fine = ground - cv2.GaussianBlur(ground, (0, 0), 16)
        similar = [(fine[:, lag:] * fine[:, :-lag]).mean() / fine.var() for lag in LAGS]
        rows.append([ground.std(), *(np.abs(np.diff(ground, axis=axis)).mean() for axis in (1, 0)), *similar])
    return np.mean(rows, axis=0)


@pytest.mark.slow
@pytest.mark.shared
def test_stony_ground_is_like_desert_pavement(shared_data: Path) -> None:
    real = statistics([cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in shared_data.glob("devon-left/*.png")])
    values = load_yaml(ROCKY)
    values["drive"]["pairs"] = 2
    world = World(Plan.make(build(SimulationConfig, values)))
    made = statistics([world.image(Task.LOCALISATION, frame, 0) for frame in range(2)])
    assert np.all(np.abs(np.log(made[:3] / real[:3])) < np.log(1.5))
    assert np.abs(made[3:] - real[3:]).max() < 0.2
