"""Faults of the view: regions that do not move with the ground: own body, dirt, own shadow, a crossing object."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import FloatImage, GreyImage
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.simulation.faults import Fault, FaultKind
from sfr_loc_map.simulation.image_faults import READ_NOISE, Moment, with_noise

BODY_DEPTH, OBJECT_DEPTH, SHADOW_DEPTH = 6.0, 8.0, 12.0
"""Depth of the own body, of a crossing object and of the ground in the own shadow, baselines."""
TEXTURE_CONTRAST = 30.0
"""Standard deviation of the texture of body and object, grey levels."""
SHADOW_BRIGHTNESS, DIRT_BRIGHTNESS = 0.35, 0.4
SPOT_RADIUS = 0.04
"""Typical radius of a spot of dirt, as a share of the image's width."""


def faulty_view(pair: StereoPair, fault: Fault, moment: Moment, rig: StereoRig, seed: list[int]) -> StereoPair:
    """Return a pair with something in its view; the seed determines its look, the same for all pairs of a drive."""
    fixed = np.random.default_rng(seed)
    add = VIEW_FAULTS[fault.kind]
    left, right = add(pair, fault.amount, moment, rig, fixed)
    return StereoPair(
        pair.stamp_ns,
        pair.left if fault.camera == "right" else left,
        pair.right if fault.camera == "left" else right,
    )


def _with_body(pair: StereoPair, amount: float, moment: Moment, rig: StereoRig, fixed: np.random.Generator) -> Views:
    """Cover the bottom of both images by a textured plane."""
    disparity = rig.fx / BODY_DEPTH
    texture = _texture(rig.height, rig.width + int(disparity) + 2, pair.left, fixed)
    cover = np.zeros((rig.height, rig.width), np.float32)
    cover[rig.height - round(amount * rig.height) :] = 1.0
    seen = (texture[:, : rig.width], _moved(texture, -disparity)[:, : rig.width])
    left, right = (_covered(image, view, cover, moment) for image, view in zip(_images(pair), seen, strict=True))
    return left, right


def _with_object(pair: StereoPair, amount: float, moment: Moment, rig: StereoRig, fixed: np.random.Generator) -> Views:
    """Cover an ellipse that moves from the left edge of the images to the right one, at a constant depth."""
    side = np.sqrt(amount * 4.0 / np.pi)
    width, height = side * rig.width, side * rig.height
    texture = _texture(rig.height, rig.width, pair.left, fixed)
    centre = moment.progress * (rig.width + width) - 0.5 * width
    v, u = np.mgrid[: rig.height, : rig.width].astype(np.float32)
    row = (0.3 + 0.4 * fixed.random()) * rig.height
    views = []
    for image, x in zip(_images(pair), (centre, centre - rig.fx / OBJECT_DEPTH), strict=True):
        inside = ((u - x) / (0.5 * width + 1e-6)) ** 2 + ((v - row) / (0.5 * height + 1e-6)) ** 2 < 1.0
        texture_here = _moved(texture, x - 0.5 * rig.width)
        views.append(_covered(image, texture_here, inside.astype(np.float32), moment))
    return views[0], views[1]


def _with_dirt(pair: StereoPair, amount: float, moment: Moment, rig: StereoRig, fixed: np.random.Generator) -> Views:
    """Darken blurred spots, others in each image."""
    left, right = (_darkened(image, _spots(rig, amount, fixed), DIRT_BRIGHTNESS, moment.rng) for image in _images(pair))
    return left, right


def _with_shadow(pair: StereoPair, amount: float, moment: Moment, rig: StereoRig, fixed: np.random.Generator) -> Views:
    """Darken a rectangle at the bottom, with a penumbra; in the right image where ground of a usual depth has it."""
    side = np.sqrt(amount)
    width, height = round(min(side, 0.9) * rig.width), round(amount / min(side, 0.9) * rig.height)
    first = round(fixed.random() * (rig.width - width))
    shade = np.zeros((rig.height, rig.width), np.float32)
    shade[rig.height - min(height, rig.height) :, first : first + width] = 1.0
    shade = cv2.GaussianBlur(shade, (0, 0), 0.01 * rig.width).astype(np.float32)
    right_shade = _moved(shade, -rig.fx / SHADOW_DEPTH)
    left, right = (
        _darkened(image, mask, SHADOW_BRIGHTNESS, moment.rng)
        for image, mask in zip(_images(pair), (shade, right_shade), strict=True)
    )
    return left, right


Views = tuple[GreyImage, GreyImage]
"""Left and right image."""
VIEW_FAULTS: dict[FaultKind, Callable[[StereoPair, float, Moment, StereoRig, np.random.Generator], Views]] = {
    FaultKind.BODY: _with_body,
    FaultKind.OBJECT: _with_object,
    FaultKind.DIRT: _with_dirt,
    FaultKind.SHADOW: _with_shadow,
}
"""Each takes the pair, the amount, the moment, the true rig and a generator that is the same for all pairs."""


def _images(pair: StereoPair) -> Views:
    return pair.left, pair.right


def _texture(height: int, width: int, like: GreyImage, fixed: np.random.Generator) -> FloatImage:
    """Return a texture of coarse and fine grains, about as bright as an image."""
    noise = fixed.standard_normal((2, height, width), np.float32)
    grains = [cv2.GaussianBlur(layer, (0, 0), sigma) for layer, sigma in zip(noise, (1.0, 4.0), strict=True)]
    total = sum(layer / max(float(layer.std()), 1e-6) for layer in grains)
    bright = float(np.clip(like.mean(), 60.0, 190.0))
    return np.asarray(bright + TEXTURE_CONTRAST / np.sqrt(2.0) * total, np.float32)


def _moved(image: FloatImage, columns: float) -> FloatImage:
    """Return an image moved to the right by a part of a pixel too, mirrored at its edges."""
    height, width = image.shape
    transform = np.array([[1.0, 0.0, columns], [0.0, 1.0, 0.0]])
    flags, border = cv2.INTER_CUBIC, cv2.BORDER_REFLECT
    return np.asarray(cv2.warpAffine(image, transform, (width, height), flags=flags, borderMode=border), np.float32)


def _spots(rig: StereoRig, amount: float, fixed: np.random.Generator) -> FloatImage:
    """Return how much dirt covers each pixel, 0 .. 1: blurred spots on a share of the image."""
    cover = np.zeros((rig.height, rig.width), np.uint8)
    while cover.mean() < amount:
        centre = (round(fixed.random() * rig.width), round(fixed.random() * rig.height))
        radius = max(1, round(SPOT_RADIUS * (0.5 + fixed.random()) * rig.width))
        cv2.circle(cover, centre, radius, 1, -1)
    return np.asarray(cv2.GaussianBlur(cover.astype(np.float32), (0, 0), 0.25 * SPOT_RADIUS * rig.width), np.float32)


def _covered(image: GreyImage, view: FloatImage, cover: FloatImage, moment: Moment) -> GreyImage:
    """Return the image with another view where it is covered; only there the noise is new."""
    new = with_noise(view, READ_NOISE, moment.rng)
    return np.where(cover > 0.5, new, image).astype(np.uint8)


def _darkened(image: GreyImage, shade: FloatImage, brightness: float, rng: np.random.Generator) -> GreyImage:
    return with_noise(image * (1.0 - (1.0 - brightness) * shade), 0.0, rng)
