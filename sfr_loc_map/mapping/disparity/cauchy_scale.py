"""The scale at which second differences lose weight in the refinement, from the shape of the ground.

The scale is proportional to the typical second differences of the field, which are measured in each pair, around each
cell and along each axis. These differences are computed on a grid with a multiple of the spacing of the cells
(`SCALE_LEVEL`), so that they exceed the noise of the field.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import F, FloatImage, median
from sfr_loc_map.mapping.filters import box_mean, downsample_mean, second_differences, upsample_bilinear

SCALE_LEVEL = 2
"""Number of doublings of the cells' spacing at which the differences are measured: second differences at 4 cells, which
are 8 pixels, exceed the noise of the field."""
SCALE_FACTOR = 4.9
"""Ratio of the scale of the Cauchy weights to the measured second differences, both at the spacing of the
measurement. With half or twice the value the errors of rendered pairs are 7 to 14 % larger
(measurements/mapper_trials.md)."""
EDGE_FACTOR = 10.0
"""Second differences above this multiple of the median are edges, not the shape of the ground. Normally distributed
second differences do not reach this multiple. With half or twice the value, the errors of Teddy, KITTI
2015 and the sample change by about 1 %, and the ratio of squared error to variance changes by up to 26 %
(measurements/mapper_trials.md)."""
LOCAL_MAGNITUDE_WINDOW = 9
"""Side of the window over which the measured second differences are averaged, in units of their spacing, which
is 4 cells. The mean of the roots of 81 independent values has a relative standard deviation of 5 %."""
SCALE_WINDOW = 5
"""Side of the window over which the local magnitudes are then averaged, in the same units. The optimum is flat
(measurements/mapper_trials.md)."""
MIN_SCALE = 0.1
"""Minimum ratio of a local magnitude to the median of the image, so that flat regions can still bend. With half or
twice the value the mean error of the five pairs changes by less than 1 % (measurements/mapper_trials.md)."""
MIN_TYPICAL_PX = 1e-3  #: Lower bound of the median of the second differences, pixels; it must not be 0.
GRID_FACTOR = 2.8
"""Growth of the typical second difference per doubling of the spacing, `2^1.5`: between fractal ground (2 or less) and
a surface of constant curvature (4). With 2 or 4 and the same scale on the finest grid, the errors of rendered pairs are
1 to 9 % larger (measurements/mapper_trials.md)."""


class CauchyScale(NamedTuple):
    """Scale of the Cauchy weights of second differences around each cell on the finest grid, pixels."""

    along_x: FloatImage  #: `(h, w)`, along rows.
    along_y: FloatImage  #: `(h, w)`, along columns.


def cauchy_scale_of(cells: FloatImage) -> CauchyScale:
    """Return the scale of the Cauchy weights on the finest grid, from second differences on a coarser grid."""
    differences = second_differences(downsample_mean(cells, 2**SCALE_LEVEL))
    factor = F(SCALE_FACTOR / GRID_FACTOR**SCALE_LEVEL)
    return CauchyScale(
        upsample_bilinear(_local_magnitude(differences.along_x), cells.shape) * factor,
        upsample_bilinear(_local_magnitude(differences.along_y), cells.shape) * factor,
    )


def _local_magnitude(differences: FloatImage) -> FloatImage:
    """Return the typical magnitude of differences around each element: the squared mean of the roots of magnitudes.

    Single large differences, for example at edges, have little influence on this mean and are clipped to `EDGE_FACTOR`
    medians.
    """
    magnitude = np.abs(differences)
    typical = max(median(magnitude), MIN_TYPICAL_PX)
    clipped = np.minimum(magnitude, F(EDGE_FACTOR * typical))
    local = np.square(box_mean(np.sqrt(clipped), LOCAL_MAGNITUDE_WINDOW))
    return box_mean(np.maximum(local, F(MIN_SCALE * typical)), SCALE_WINDOW)
