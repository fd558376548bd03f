"""Images that cannot give a map are refused, poor ones named."""

import cv2
import numpy as np
import pytest
from disparity_world import make_world, slope

from sfr_loc_map.mapping.checks import check_matches, matched_share
from sfr_loc_map.mapping.disparity.filters import local_variance
from sfr_loc_map.mapping.disparity.right_camera import RectificationCorrection

GOOD = RectificationCorrection(1.0, 0.0, (0.0, 0.0, 0.0))


def test_only_textured_pixels_count() -> None:
    rng = np.random.default_rng(0)
    left = np.full((200, 300), 100.0) + rng.normal(0.0, 1.0, (200, 300))
    left[:, :100] += cv2.GaussianBlur(rng.normal(0.0, 100.0, (200, 100)), (0, 0), 2.0)
    valid = np.zeros(left.shape, bool)
    valid[:, :50] = True
    left = left.astype(np.float32)
    assert matched_share(left, local_variance(left), valid) == pytest.approx(0.5, abs=0.03)
    assert np.isnan(matched_share(np.full((200, 300), 7.0, np.float32), np.zeros((200, 300), np.float32), valid))


@pytest.mark.parametrize(
    ("share", "correction", "saturated", "words"),
    [
        (0.95, GOOD, 0.0, None),
        (0.5, GOOD, 0.0, "only 50 %"),
        (0.9, GOOD, 0.3, "30 % of the pixels are saturated"),
        (0.9, RectificationCorrection(1.0, 0.0, (0.2, 0.0, -0.2)), 0.0, "vertical disparity of up to 0.40 px"),
        (0.9, RectificationCorrection(1.3, 0.0, (0.0, 0.0, 0.0)), 0.0, "1.30 times the contrast"),
        (0.9, RectificationCorrection(0.8, 0.0, (0.0, 0.0, 0.0)), 0.0, "0.80 times the contrast"),
    ],
)
def test_poor_pairs_are_named(
    share: float, correction: RectificationCorrection, saturated: float, words: str | None
) -> None:
    lines = check_matches(make_world(slope).pair, share, correction, saturated, 48)
    assert [words in line for line in lines] == ([True] if words else [])
