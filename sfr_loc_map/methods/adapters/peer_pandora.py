"""Pandora with libSGM, the dense stereo matcher of CNES (Apache-2.0)."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from importlib import metadata
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from sfr_loc_map.methods.child.loop import Answer, Order, Setup

PIPELINE: dict[str, dict[str, Any]] = {
    "matching_cost": {"matching_cost_method": "census", "window_size": 5},
    "optimization": {"optimization_method": "sgm"},
    "disparity": {"disparity_method": "wta", "invalid_disparity": "NaN"},
    "refinement": {"refinement_method": "vfit"},
    "filter": {"filter_method": "median", "filter_size": 3},
    "validation": {"validation_method": "cross_checking_accurate"},
}
INVALID = sum(1 << bit for bit in (0, 1, 6, 7, 8, 9))
"""Bits of the validity mask that mark pixels without a disparity: no data or border (0, left image), no data or no
disparity range (1, right image), masked (6, 7), occluded (8) and mismatched (9). Pandora 1.9.0 has the same bits as
`Criteria.PANDORA_MSK_PIXEL_INVALID`, older versions as a constant of the module `pandora.constants`."""


class Pandora:
    """Disparities of the left image, NaN where invalid."""

    def __init__(self, setup: Setup) -> None:
        import pandora  # type: ignore[import-not-found,unused-ignore]
        from pandora.state_machine import PandoraMachine  # type: ignore[import-not-found,unused-ignore]

        self.version = metadata.version("pandora")
        pandora.import_plugin()
        self._run, self._machine = pandora.run, PandoraMachine
        self._disparities = setup["disparities"]
        noise = np.random.default_rng(0).integers(0, 255, (64, 64 + self._disparities)).astype(np.uint8)
        self._call_for(noise, np.roll(noise, -4, 1))()

    def prepare(
        self, left: NDArray[np.uint8], right: NDArray[np.uint8], order: Order
    ) -> Callable[[], NDArray[np.float32]]:
        """Return the call."""
        return self._call_for(left, right)

    def _call_for(self, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> Callable[[], NDArray[np.float32]]:
        """Read the images with Pandora's reader and check the settings; return the call."""
        from pandora.check_configuration import check_conf  # type: ignore[import-not-found,unused-ignore]
        from pandora.img_tools import create_dataset_from_inputs  # type: ignore[import-not-found,unused-ignore]

        with tempfile.TemporaryDirectory() as folder:
            paths = [os.path.join(folder, f"{name}.tif") for name in ("left", "right")]
            for path, image in zip(paths, (left, right), strict=True):
                cv2.imwrite(path, image)
            # Pandora's disparity is the right column minus the left column
            sides = (
                {"img": paths[0], "nodata": -9999, "disp": [1 - self._disparities, 0]},
                {"img": paths[1], "nodata": -9999, "disp": [0, self._disparities - 1]},
            )
            machine = self._machine()
            config = check_conf(
                {"input": {"left": sides[0], "right": {**sides[1], "disp": None}}, "pipeline": PIPELINE}, machine
            )
            images = [create_dataset_from_inputs(input_config=side) for side in sides]
        return lambda: self._disparity(machine, images, config)

    def _disparity(self, machine: Any, images: list[Any], config: Any) -> NDArray[np.float32]:  # noqa: ANN401
        found, _ = self._run(machine, images[0], images[1], config)
        valid = (found["validity_mask"].data & INVALID) == 0
        return np.where(valid, -found["disparity_map"].data, np.nan).astype(np.float32)

    def report(self, answer: NDArray[np.float32], order: Order) -> Answer:
        """Save the disparities."""
        np.save(order["output"] + ".disparity.npy", answer)
        return {}


open_method = Pandora
