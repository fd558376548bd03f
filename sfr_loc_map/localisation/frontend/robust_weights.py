"""Robust least squares: the weight of an observation as a function of its squared normalised residual.

The weight belongs to the Geman-McClure loss in iteratively reweighted least squares and is scaled to 1 at a residual of
0 (Zhang 1997, Parameter estimation techniques: a tutorial with application to conic fitting, table 1). Two small fits
to data of one keyframe use the Cauchy weight `1 / (1 + (r / scale)^2)` of the same table.

| fit | weight | scale | of |
|---|---|---|---|
| pose of a pair | Geman-McClure | `pose_solver.SCALE_PER_MEDIAN` times the median | chi2 per degree of freedom |
| yaw of the right camera | Geman-McClure | `right_camera.YAW_SCALE` | chi2 per degree of freedom |
| bundle adjustment | Geman-McClure | `bundle_adjustment.ADJUSTMENT_SCALE` | chi2 of a position |
| planes of neighbours | Cauchy | `neighbour_slopes.PLANE_SCALE_PX` | residual r, px |
| pitch and roll | Cauchy | `online_calibration.VERTICAL_SCALE_PX` | residual r, px |
"""

from __future__ import annotations

from typing import TypeVar

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.jit import jit_fast_ir_inline

Squares = TypeVar("Squares", float, FloatArray)


def geman_mcclure(chi2: Squares, scale: float) -> Squares:
    """Return the Geman-McClure weight `1 / (1 + chi2 / scale)^2` of squared residuals.

    The weight is a quarter at `chi2 = scale`. For larger residuals, the weight decreases with the fourth power of the
    residual, so that the influence of an outlier vanishes.
    """
    return 1.0 / (1.0 + chi2 / scale) ** 2


geman_mcclure_weight = jit_fast_ir_inline(geman_mcclure)  #: `geman_mcclure` for use in kernels.
