"""Semi-global matching on random-dot stereograms."""

import numpy as np
import pytest
from disparity_world import two_planes

from sfr_loc_map.mapping.disparity.semi_global_matching import semi_global_matching


@pytest.mark.parametrize(("gain", "offset"), [(1.0, 0.0), (0.5, 0.0), (0.6, 80.0), (1.0, -30.0)])
def test_a_random_dot_stereogram_of_any_exposure_is_matched(gain: float, offset: float) -> None:
    left, right, truth = two_planes((120, 200), np.s_[30:90, 80:150], 12, 4, 0.0)
    left, right = (np.asarray(64 + image / 2, np.uint8) for image in (left, right))
    other = np.clip(np.rint(gain * right + offset), 0, 255).astype(np.uint8)
    disparity = semi_global_matching(left, other, 32)
    known = np.isfinite(disparity)
    assert known[:, 4:].mean() > 0.85
    assert (np.abs(disparity - truth)[known] < 0.5).mean() > 0.97
    assert np.nanmedian(disparity[35:85, 85:145]) == pytest.approx(12.0, abs=1.0 / 16.0)
