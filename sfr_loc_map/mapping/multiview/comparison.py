"""What a comparison of two views requires, so that its result is not due to noise."""

from __future__ import annotations

from sfr_loc_map.mapping.disparity.texture import TEXTURE_SIGMAS

MIN_TEXTURE = TEXTURE_SIGMAS
"""Standard deviation of grey levels over that of the noise that their comparison requires; noise alone has about 1."""
MIN_OVERLAP = 1000  #: Points in common that a statement about poses requires: their spreads are then known to 7 %.
