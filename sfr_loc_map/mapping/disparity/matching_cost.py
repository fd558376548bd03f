"""Constants of the matching cost of a window: truncated absolute differences with adaptive support weights.

A pixel of the window has the more weight, the more similar its grey level is to that of the centre and the nearer it is
to the centre (Yoon and Kweon 2006), so that the window covers mostly the surface of its centre. The disparity is
constant over the window beside jumps (`wrong_surface.constant_cost`), and a plane in holes (`hole_filling.plane_cost`).

The mapper has three matching costs. The initial disparity has that of OpenCV's matcher (`semi_global_matching`), the
refinement has squared residuals (`photometric_residual`), and the cost of this window judges single pixels afterwards.
"""

from __future__ import annotations

import numpy as np

F = np.float32

WINDOW_RADIUS = 4
"""Half side of the window, pixels. The network beside jumps was trained with the five values here: train it again
(`tools/train_edge_network.py`) if one of them changes."""
MAX_DIFFERENCE = F(30.0)  #: Absolute differences are truncated to this, grey levels: more of them are occlusions.
MAX_COST = F(1e9)  #: Cost where no pixel of the window is inside the right image, grey levels: larger than any other.
GREY_SCALE = 8.0  #: Difference at which the weight has decreased to 1/e, grey levels: a few times the noise.
DISTANCE_SCALE_PX = 3.0  #: Distance at which the weight has decreased to 1/e, pixels; 0.26 at the window's edge.

WEIGHT_BY_GREY = np.exp(-np.arange(256.0) / GREY_SCALE).astype(F)
"""Weight of a pixel by the absolute difference of its grey level from the centre's."""
_OFFSETS = np.arange(-WINDOW_RADIUS, WINDOW_RADIUS + 1, dtype=np.float64)
WEIGHT_BY_DISTANCE = np.exp(-np.hypot(_OFFSETS[:, None], _OFFSETS[None]) / DISTANCE_SCALE_PX).astype(F)
"""Weight of a pixel by its row and column in the window."""
