"""One stereo pair as registration and fusion see it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import FloatImage
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.transform import Transform

F = np.float32

FEATHER_PX = 48.0
"""Distance from the border of an image from which on its points have full weight."""


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """Points of one stereo pair with the disparity image and the pose that they come from.

    Attributes:
        cloud: Its points in LM.
        disparity_px: `(H, W)` float32, pixels, NaN where none.
        T_lm_left: Takes points in its left optical frame to LM.
        noise_grey: Standard deviation of the difference of two images of the same ground, grey levels.
    """

    cloud: PointCloud
    disparity_px: FloatImage
    T_lm_left: Transform
    noise_grey: float

    def with_pose(self, T_lm_left: Transform) -> View:
        """Return the view at another pose, its points moved along."""
        xyz = (T_lm_left @ self.T_lm_left.inverse()).apply(self.cloud.xyz).astype(F)
        return replace(self, cloud=replace(self.cloud, xyz=xyz), T_lm_left=T_lm_left)

    def numbered(self, number: int) -> View:
        """Return the view as that of a pair of another number."""
        pair = np.full(len(self.cloud), number, np.uint8)
        return self if np.array_equal(pair, self.cloud.pair) else replace(self, cloud=replace(self.cloud, pair=pair))

    def weight_image(self) -> FloatImage:
        """Return the weight of each pixel `(H, W)`, `feather / sigma^2`, 1 / m^2; 0 where there is no point.

        Weights decrease towards the border of the image, so that no seam shows where it ends.
        """
        height, width = self.disparity_px.shape
        sigma = np.full((height, width), np.inf, F)
        sigma[self.cloud.v, self.cloud.u] = self.cloud.sigma
        y, x = np.arange(height, dtype=F), np.arange(width, dtype=F)
        edge_y, edge_x = np.minimum(y, height - 1 - y) + F(1.0), np.minimum(x, width - 1 - x) + F(1.0)
        feather = np.minimum(np.minimum(edge_y[:, None], edge_x[None]) / F(FEATHER_PX), F(1.0))
        return np.asarray(feather / np.square(sigma), F)

    def grey_image(self, blur_px: float = 0.0) -> FloatImage:
        """Return the left image `(H, W)` where there are points, smoothed over these alone; NaN elsewhere.

        Args:
            blur_px: Standard deviation of the Gaussian; 0 for none.
        """
        known = np.zeros(self.disparity_px.shape, F)
        grey = np.zeros_like(known)
        known[self.cloud.v, self.cloud.u] = 1.0
        grey[self.cloud.v, self.cloud.u] = self.cloud.intensity
        if blur_px > 0.0:
            total, share = (cv2.GaussianBlur(image, (0, 0), blur_px) for image in (grey, known))
            grey = np.asarray(total / np.maximum(share, F(1e-3)), F)
        grey[known == 0.0] = np.nan
        return grey
