"""Image masks: PNG files that are 0 where a camera sees the rover itself."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import ConfigError, GeometryError
from sfr_loc_map.geometry.plausibility import check_image_size
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.inputs import read_bytes
from sfr_loc_map.localisation.frontend.feature_detection import BLOCK

MAX_MASK_BYTES = 64_000_000  #: Maximum size of the file of a mask.
_PNG_HEADER = re.compile(rb"\x89PNG\r\n\x1a\n.{4}IHDR(.{4})(.{4})", re.DOTALL)
"""PNG signature, and the first chunk with width and height (ISO/IEC 15948, 11.2.2)."""


def load_mask(path: str, rig: StereoRig) -> NDArray[np.uint8] | None:
    """Read the mask `(H, W)` of a rig; None for an empty path.

    The masked region, where the mask is 0, is dilated by `BLOCK` px, the block size of the corner detector. Raises
    ConfigError if the file cannot be read or the size of the mask is not that of the images.
    """
    if not path:
        return None
    mask = read_mask(path)
    if mask.shape != (rig.height, rig.width):
        found = f"{mask.shape[1]} x {mask.shape[0]} pixels"
        raise ConfigError(f"mask '{path}': {found}; give a greyscale PNG of {rig.width} x {rig.height} pixels")
    return np.asarray(cv2.erode(mask, np.ones((2 * BLOCK + 1, 2 * BLOCK + 1), np.uint8)), dtype=np.uint8)


def read_mask(path: str) -> NDArray[np.uint8]:
    """Read the image `(H, W)` of a mask of any size. Raises ConfigError if the file cannot be read."""
    try:
        data = read_bytes(Path(path), MAX_MASK_BYTES)
        head = _PNG_HEADER.match(data)
        if head is None:
            raise ConfigError(f"mask '{path}': not a PNG file; give a greyscale PNG of the size of the images")
        check_image_size(int.from_bytes(head[1], "big"), int.from_bytes(head[2], "big"))
        mask = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
    except (OSError, GeometryError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(f"mask '{path}': {reason}; give a greyscale PNG of the size of the images") from error
    if mask is None:
        raise ConfigError(f"mask '{path}': the PNG cannot be decoded; give a greyscale PNG of the size of the images")
    return np.asarray(mask, dtype=np.uint8)
