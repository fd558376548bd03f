"""What a localiser says of itself and of its last pair, beside the estimate."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map import __version__
from sfr_loc_map.localisation.frontend.tracking import TrackingResult
from sfr_loc_map.localisation.keyframe_backend import KeyframeBackend


class Reporter:
    """What a localiser says of itself and of its last pair."""

    version = __version__
    _backend: KeyframeBackend
    _last_result: TrackingResult | None = None

    @property
    def last_result(self) -> TrackingResult | None:
        """Tracking result of the last pair, trusted or not; None where no landmark was tracked."""
        return self._last_result

    @property
    def masks(self) -> tuple[NDArray[np.uint8] | None, NDArray[np.uint8] | None]:
        """Where no landmark is made in the left and the right image: `(H, W)` uint8, 0 there; None for nowhere."""
        return self._backend.masks

    @property
    def statistics(self) -> dict[str, float]:
        """Landmarks (`features`) of the last pair, and how many agree with its pose; empty where none was tracked."""
        result = self._last_result
        return {} if result is None else {"features": len(result.landmarks), "inliers": int(result.inliers.sum())}
