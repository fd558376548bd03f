"""Noise of tracked positions, from the residuals of their patches."""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.jit import jit
from sfr_loc_map.localisation.small_linalg import median_without_nan

PIXEL_FLOOR = 0.05
"""Standard deviation added in quadrature to that of each observation, px. Values from 0.01 to 0.03 were tried
(measurements/localiser_trials.md, "What limits it, and what was tried")."""
RESIDUAL_GAIN = 1.2  #: Ratio of the noise variance to the squared residual of a patch. Chosen on rendered drives.
EDGE_FOCAL_PX = (500.0, 700.0)
"""Focal lengths, px, between which edges of stones begin to limit the pose more than image noise. The visible edge of a
stone is a different point of the stone from each position, which biases the rotation. Landmarks with a large residual
therefore have a larger added standard deviation. The focal lengths are between those of the trials, 402 px without and
804 px with this effect."""
EDGE_RESIDUALS = (0.5, 4.0)
"""Minimum and maximum ratio of a residual to the median residual. At the larger of the focal lengths `EDGE_FOCAL_PX`,
and above it, `PIXEL_FLOOR` is multiplied by the square of this ratio, that is by 0.25 to 16
(measurements/localiser_trials.md, "Images of a megapixel: the sun and the edges of stones"). Between the two focal
lengths, the exponent of the ratio grows linearly from 0 to 2."""
MIN_RESIDUAL = 1e-6  #: Minimum of the median residual, grey levels, which prevents a division by zero.


def position_variance(covariance: FloatArray, residual: FloatArray, fx: float) -> FloatArray:
    """Return the variances `(N, 3)` uu, uv, vv of tracked positions, px^2.

    A residual below the median may be small by chance and is replaced by the median.

    Args:
        covariance: `(N, 3)` for an image noise of one grey level.
        residual: `(N,)` RMS of the patches, grey levels; NaN if a patch was not found.
        fx: Focal length, px.
    """
    typical = median_without_nan(residual)
    variance = _scaled(covariance, residual, typical)
    floor: FloatArray | float = PIXEL_FLOOR**2
    smaller_px, larger_px = EDGE_FOCAL_PX
    if fx > smaller_px:
        least, most = EDGE_RESIDUALS
        exponent = 4.0 * min((fx - smaller_px) / (larger_px - smaller_px), 1.0)
        floor = floor * np.clip(residual / max(typical, MIN_RESIDUAL), least, most) ** exponent
    variance[:, 0] += floor
    variance[:, 2] += floor
    return variance


@jit
def _scaled(covariance: FloatArray, residual: FloatArray, least: float) -> FloatArray:
    """Return covariances `(N, 3)` scaled by the noise variance from residuals `(N,)`, each at least `least`."""
    scaled = np.empty(covariance.shape)
    for n in range(len(residual)):
        noise = least if residual[n] < least else residual[n]  # NaN stays NaN
        variance = RESIDUAL_GAIN * (noise * noise)
        for i in range(3):
            scaled[n, i] = covariance[n, i] * variance
    return scaled
