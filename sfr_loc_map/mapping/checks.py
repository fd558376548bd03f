"""Checks of the mapper's input: unusable input is refused, and the message names the likely cause."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.plausibility import plausible_rotations
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.config import MAX_PAIRS
from sfr_loc_map.mapping.maps import MappedPair

MAX_LM_M = 1e4
"""Maximum coordinate of the cameras in LM, metres. Points are float32 numbers, which are rounded by up to 0.5 mm at
this distance from the origin. Rounding errors are not part of sigma."""
MIN_CONTRAST = 2.0
"""Minimum standard deviation of an image, grey levels. Images of a covered camera with low noise are below this
threshold. Images of a covered camera with more noise pass this check, but do not match."""


def check_index(index: int) -> None:
    """Raise MappingError if the index of a pair is not an integer, or is out of range."""
    if isinstance(index, bool) or not isinstance(index, int | np.integer) or not 0 <= index < MAX_PAIRS:
        raise MappingError(f"pair index is {index}: an integer from 0 to {MAX_PAIRS - 1} is required")


def check_pair(pair: StereoPair) -> None:
    """Raise MappingError if a pair has a wrong type."""
    if not isinstance(pair, StereoPair):
        raise MappingError(f"the pair has the type {type(pair).__name__}: a StereoPair is required")


def check_items(items: Sequence[object], kind: type, required: str) -> None:
    """Raise MappingError unless the items are a sequence of objects of one type, which `required` describes."""
    if not isinstance(items, Sequence) or not all(isinstance(item, kind) for item in items):
        raise MappingError(f"a sequence of {required} is required, for example a list")


def check_pair_count(count: int) -> None:
    """Raise MappingError if a map cannot be fused from this number of pairs."""
    if not 1 <= count <= MAX_PAIRS:
        raise MappingError(f"{count} pairs given: 1 to {MAX_PAIRS} are required for a map")


def check_maps(maps: Sequence[MappedPair], rig: StereoRig) -> None:
    """Raise MappingError unless the maps are up to three maps by `Mapper.process`, of the cameras of a rig."""
    check_items(maps, MappedPair, "maps that `Mapper.process` returned")
    check_pair_count(len(maps))
    for item in maps:
        if not item.rig.same_cameras(rig):
            raise MappingError(
                f"the map of stamp {item.stamp_ns} is from other cameras than those of this mapper: fuse maps of one "
                "rig"
            )


def check_pose(stamp_ns: int, T_lm_navsb: Transform) -> None:
    """Raise MappingError if a pose has a wrong type or an invalid rotation, or is far from the origin of LM."""
    if not isinstance(T_lm_navsb, Transform):
        raise MappingError(
            f"the pose of stamp {stamp_ns} has the type {type(T_lm_navsb).__name__}: a Transform is required"
        )
    if not plausible_rotations(T_lm_navsb.rotation):
        raise MappingError(
            f"the pose of stamp {stamp_ns} has an invalid rotation: {T_lm_navsb.rotation.tolist()}: an orthonormal "
            "matrix with determinant +1 is required"
        )
    if not (np.abs(T_lm_navsb.translation) <= MAX_LM_M).all():
        raise MappingError(
            f"the pose of stamp {stamp_ns} is at {T_lm_navsb.translation.tolist()} m in LM: at most {MAX_LM_M:g} m is "
            "allowed, because points are rounded to float32; choose an origin of LM near the rover, and subtract its "
            "position from the poses of all pairs"
        )


def check_images(pair: StereoPair, rig: StereoRig) -> None:
    """Raise MappingError if the images do not have the rig's size, one is textureless, or both are identical."""
    if fault := rig.fault_of_size(pair.left):  # the right image has the size of the left image
        raise MappingError(f"image of stamp {pair.stamp_ns} {fault}")
    for name, image in (("left", pair.left), ("right", pair.right)):
        _, deviations = cv2.meanStdDev(image)
        deviation = float(deviations[0, 0])
        if deviation < MIN_CONTRAST:
            raise MappingError(
                f"{name} image of stamp {pair.stamp_ns} is textureless (mean {image.mean():.0f}, standard "
                f"deviation {deviation:.1f} grey levels): a standard deviation of {MIN_CONTRAST} is required; check "
                "the camera, its cap and its exposure"
            )
    if np.array_equal(pair.left, pair.right):
        raise MappingError(
            f"left and right images of stamp {pair.stamp_ns} are identical: use the image of the other camera"
        )
