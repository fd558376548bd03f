"""Images that contain the left and the right image side by side, or one above the other."""

from __future__ import annotations

WIDE, TALL = 1.95, 0.95  #: An image may contain both sides if its width / height is above `WIDE` or below `TALL`.
SENSOR_SHAPES = (1.0, 2448 / 2048, 5 / 4, 4 / 3, 3 / 2, 752 / 480, 8 / 5, 16 / 9)
"""Width / height of common sensors. An image contains both sides if its halves have such a shape."""
SHAPE_TOLERANCE = 0.02
"""Maximum relative difference between the shape of a half and a shape in `SENSOR_SHAPES`. The half of an image of a ZED
camera, 672 x 376, differs by 0.005 from the nearest shape. The half of a cropped KITTI image, 620 x 376, differs by
0.03."""


def may_be_joint(width: int, height: int) -> bool:
    """Return whether an image is so wide or so tall that it may contain both sides; False for an unknown size."""
    return height > 0 and not TALL <= width / height <= WIDE


def has_halves(width: int, height: int) -> bool:
    """Return whether an image divides into two equal halves with the shape of a sensor."""
    is_wide = width > height
    divided = width if is_wide else height
    shape = width / 2 / height if is_wide else width / (height / 2)
    return divided % 2 == 0 and any(abs(shape / sensor - 1.0) <= SHAPE_TOLERANCE for sensor in SENSOR_SHAPES)


def layout_of(width: int, height: int) -> str:
    """Return the value of `calibration.stereo_layout` for a joint image of this size."""
    return "side_by_side" if width > height else "top_bottom"
