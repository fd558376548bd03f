"""Images that cannot give a map are refused, poor ones named."""

from typing import Any

import cv2
import numpy as np
import pytest

from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.mapping.checks import check_images, check_matches, matched_share
from sfr_loc_map.mapping.disparity.filters import local_variance
from sfr_loc_map.mapping.disparity.rectification_correction import RectificationCorrection

GOOD = RectificationCorrection(1.0, 0.0, (0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def made(world: Any, slope_field: Any) -> Any:
    return world(slope_field)


def test_good_images_pass(made: Any) -> None:
    check_images(made.pair, made.rig)
    assert check_matches(made.pair, 0.95, GOOD, 0.0, 48) == ()
    assert check_matches(made.pair, float("nan"), GOOD, 0.0, 48) == ()
    assert "30 % of the pixels are saturated" in check_matches(made.pair, 0.95, GOOD, 0.3, 48)[0]


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("grey", [0, 90, 255])
def test_textureless_images_are_refused(made: Any, side: str, grey: int) -> None:
    images = {"left": made.pair.left, "right": made.pair.right}
    images[side] = np.full_like(images[side], grey)
    with pytest.raises(MappingError, match=f"{side} image of stamp 5 is textureless"):
        check_images(StereoPair(5, **images), made.rig)


def test_identical_images_are_refused(made: Any) -> None:
    with pytest.raises(MappingError, match="identical"):
        check_images(StereoPair(0, made.pair.left, made.pair.left.copy()), made.rig)


def test_images_of_another_size_are_refused(made: Any) -> None:
    with pytest.raises(MappingError, match="320 x 255: the rig has 320 x 256"):
        check_images(StereoPair(0, made.pair.left[:-1], made.pair.right[:-1]), made.rig)


def test_only_textured_pixels_count() -> None:
    rng = np.random.default_rng(0)
    left = np.full((200, 300), 100.0) + rng.normal(0.0, 1.0, (200, 300))
    left[:, :100] += cv2.GaussianBlur(rng.normal(0.0, 100.0, (200, 100)), (0, 0), 2.0)
    valid = np.zeros(left.shape, bool)
    valid[:, :50] = True
    left = left.astype(np.float32)
    assert matched_share(left, local_variance(left), valid) == pytest.approx(0.5, abs=0.03)
    valid[:] = True
    assert matched_share(left, local_variance(left), valid) == 1.0
    assert np.isnan(matched_share(np.full((200, 300), 7.0, np.float32), np.zeros((200, 300), np.float32), valid))


@pytest.mark.parametrize(
    ("share", "correction", "words"),
    [
        (0.5, GOOD, "only 50 %"),
        (0.9, RectificationCorrection(1.0, 0.0, (0.2, 0.0, -0.2)), "vertical disparity of up to 0.40 px"),
        (0.9, RectificationCorrection(1.3, 0.0, (0.0, 0.0, 0.0)), "1.30 times the contrast"),
        (0.9, RectificationCorrection(0.8, 0.0, (0.0, 0.0, 0.0)), "0.80 times the contrast"),
    ],
)
def test_poor_pairs_are_named(made: Any, share: float, correction: RectificationCorrection, words: str) -> None:
    (line,) = check_matches(made.pair, share, correction, 0.0, 48)
    assert words in line


def test_pairs_that_do_not_match_are_refused_with_the_likely_cause(made: Any) -> None:
    with pytest.raises(MappingError, match=r"do not match: 20 % .* rectified, of the same moment"):
        check_matches(made.pair, 0.2, GOOD, 0.0, 48)
    swapped = StereoPair(0, made.pair.right, made.pair.left)
    with pytest.raises(MappingError, match="left and right seem swapped"):
        check_matches(swapped, 0.2, GOOD, 0.0, 48)
