"""The distance of each point of a cloud to the truth of the pixel that it names."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray32, PointImage
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.plausibility import check_image_size
from sfr_loc_map.io.point_image import points_image
from sfr_loc_map.mapping.config import MAX_PAIRS


class CloudTruth:
    """Keeps the true points of the last pairs of a map."""

    def __init__(self) -> None:
        """Start without truth."""
        self._truths: deque[tuple[int, PointImage]] = deque(maxlen=MAX_PAIRS)

    def add(self, stamp_ns: int, message: Any) -> None:  # noqa: ANN401 - a PointCloud2 of any library
        """Keep the true points of a pair.

        Args:
            stamp_ns: Stamp of the pair.
            message: Organised sensor_msgs/PointCloud2 `(H, W)`.

        Raises:
            SfrError: If it is none.
        """
        width, height = int(message.width), int(message.height)
        check_image_size(width, height, "ground_truth/points")
        self.add_points(stamp_ns, points_image(message, (width, height)))

    def add_points(self, stamp_ns: int, points: PointImage) -> None:
        """Keep the true points of a pair.

        Args:
            stamp_ns: Stamp of the pair.
            points: `(H, W, 3)` metres, LM.
        """
        self._truths = deque(
            [item for item in self._truths if item[0] < stamp_ns], maxlen=MAX_PAIRS
        )  # an earlier stamp begins a new run
        self._truths.append((stamp_ns, points))

    def errors(self, cloud: PointCloud) -> FloatArray32 | None:
        """Return the distances `(N,)` float32, metres, NaN where a point has no truth; None where none has."""
        if not self._truths or not len(cloud):
            return None
        error = np.full(len(cloud), np.nan, np.float32)
        for number, (_, truth) in enumerate(self._truths):
            rows = np.flatnonzero(cloud.pair == number)
            u, v = cloud.u[rows].astype(np.intp), cloud.v[rows].astype(np.intp)
            inside = (v < truth.shape[0]) & (u < truth.shape[1])
            rows, u, v = rows[inside], u[inside], v[inside]
            error[rows] = np.linalg.norm(cloud.xyz[rows] - truth[v, u], axis=1)
        return error if np.isfinite(error).any() else None
