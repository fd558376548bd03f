"""Faults of the view, such as occlusions, dirt and shadows, as functions of the affected pair.

Each function draws both images. Only the images of the affected cameras are changed (`Affected.with_images`).
"""

from __future__ import annotations

import numpy as np

from sfr_loc_map.faults.images import READ_NOISE, Affected, as_grey, moved, smoothed, with_noise
from sfr_loc_map.geometry.arrays import FloatImage, GreyImage
from sfr_loc_map.geometry.stereo import StereoPair

# With the simulated rig, these depths are nearer than the ground in the middle of the image.
BODY_DEPTH = 6.0  #: Depth of the rover's own body as a multiple of the baseline: 0.7 m with the simulated rig.
OBJECT_DEPTH = 8.0  #: Depth of a crossing object as a multiple of the baseline: 1.0 m with the simulated rig.
SHADOW_DEPTH = 12.0
"""Depth of the ground in the rover's shadow as a multiple of the baseline: 1.4 m with the simulated rig."""
TEXTURE_CONTRAST = 30.0  #: Standard deviation of the texture of body and object, grey levels (chosen by eye).
SHADOW_BRIGHTNESS = 0.35  #: Factor on grey levels in the rover's shadow, which is lit only by the sky (chosen by eye).
DIRT_BRIGHTNESS = 0.4  #: Factor on grey levels under dirt (chosen by eye).
SCRATCH_LIGHT = 60.0  #: Grey levels by which the strongest scratches are brighter or darker.
SPOT_RADIUS = 0.04  #: Typical radius of a spot of dirt, fraction of the image's width (chosen by eye).
SPEED = 0.006  #: Motion of a texture from pair to pair, fraction of the image's width: 3 px at 512 px.


def with_body(at: Affected) -> StereoPair:
    """Cover the bottom rows of both images with a fixed texture, at the depth of the rover's own body."""
    rig = at.rig
    disparity = rig.fx / BODY_DEPTH
    texture = _texture(rig.height, rig.width + int(disparity) + 2, at.pair.left, at.drive_rng)
    cover = np.zeros((rig.height, rig.width), np.float32)
    cover[rig.height - round(at.amount * rig.height) :] = 1.0
    there = moved(texture, -disparity)
    left = _covered(at.pair.left, texture[:, : rig.width], cover, at)
    right = _covered(at.pair.right, there[:, : rig.width], cover, at)
    return at.with_images(left, right)


def with_arm(at: Affected) -> StereoPair:
    """Cover a rectangle that enters from below, decelerates and stops at the end of the burst."""
    rig = at.rig
    side = np.sqrt(at.amount)  # fraction of the width and of the height
    disparity = rig.fx / BODY_DEPTH
    texture = _texture(2 * rig.height, rig.width, at.pair.left, at.drive_rng)
    width = round(side * rig.width)
    first = round((1.0 - side) * at.drive_rng.random() * rig.width)
    rows = round(side * rig.height * np.sin(0.5 * np.pi * min(at.progress, 1.0)))
    cover = np.zeros((rig.height, rig.width), np.float32)
    cover[rig.height - rows :, first : first + width] = 1.0
    view = texture[rows : rows + rig.height]
    left = _covered(at.pair.left, view, cover, at)
    right = _covered(at.pair.right, moved(view, -disparity), moved(cover, -disparity), at)
    return at.with_images(left, right)


def with_texture(at: Affected) -> StereoPair:
    """Cover the bottom rows of both images with a texture that moves sideways, at the depth of the rover's own body."""
    rig = at.rig
    shift = round(SPEED * rig.width) * at.index
    texture = np.roll(_texture(rig.height, 2 * rig.width, at.pair.left, at.drive_rng), shift, axis=1)
    cover = np.zeros((rig.height, rig.width), np.float32)
    cover[rig.height - round(at.amount * rig.height) :] = 1.0
    there = texture[:, round(rig.fx / BODY_DEPTH) :][:, : rig.width]
    left = _covered(at.pair.left, texture[:, : rig.width], cover, at)
    right = _covered(at.pair.right, there, cover, at)
    return at.with_images(left, right)


def with_reflection(at: Affected) -> StereoPair:
    """Blend both images with a fixed texture at the depth of the rover's own body."""
    rig = at.rig
    texture = _texture(rig.height, rig.width, at.pair.left, at.drive_rng)
    kept = 1.0 - at.amount  # fraction of the light of the scene
    there = moved(texture, -rig.fx / BODY_DEPTH)
    left = as_grey(kept * at.pair.left + at.amount * texture)
    right = as_grey(kept * at.pair.right + at.amount * there)
    return at.with_images(left, right)


def with_scratches(at: Affected) -> StereoPair:
    """Draw bright and dark lines at the same pixels of both images, until they cover the fraction `amount`."""
    import cv2

    rig = at.rig
    lines = np.zeros((rig.height, rig.width), np.uint8)
    while np.count_nonzero(lines) < at.amount * lines.size:
        start, end = (at.drive_rng.random((2, 2)) * (rig.width, rig.height)).astype(int).tolist()
        cv2.line(lines, start, end, int(at.drive_rng.integers(1, 256)), 1)
    light = np.where(lines > 0, SCRATCH_LIGHT * (lines / 128.0 - 1.0), 0.0).astype(np.float32)
    left = as_grey(at.pair.left + light)
    right = as_grey(at.pair.right + light)
    return at.with_images(left, right)


def with_object(at: Affected) -> StereoPair:
    """Cover an ellipse that moves from the left to the right edge of the images at a constant depth."""
    rig = at.rig
    side = np.sqrt(at.amount * 4.0 / np.pi)
    width = side * rig.width
    height = side * rig.height
    texture = _texture(rig.height, rig.width, at.pair.left, at.drive_rng)
    centre = at.progress * (rig.width + width) - 0.5 * width
    v, u = np.mgrid[: rig.height, : rig.width].astype(np.float32)
    row = (0.3 + 0.4 * at.drive_rng.random()) * rig.height
    views = []
    for image, x in zip((at.pair.left, at.pair.right), (centre, centre - rig.fx / OBJECT_DEPTH), strict=True):
        inside = ((u - x) / (0.5 * width + 1e-6)) ** 2 + ((v - row) / (0.5 * height + 1e-6)) ** 2 < 1.0
        texture_here = moved(texture, x - 0.5 * rig.width)
        views.append(_covered(image, texture_here, inside.astype(np.float32), at))
    return at.with_images(views[0], views[1])


def with_dirt(at: Affected) -> StereoPair:
    """Darken blurred spots on the fraction `amount` of each image; the images have different spots."""
    import cv2

    rig = at.rig
    views = []
    for image in (at.pair.left, at.pair.right):
        cover = np.zeros((rig.height, rig.width), np.uint8)
        while cover.mean() < at.amount:
            centre = (round(at.drive_rng.random() * rig.width), round(at.drive_rng.random() * rig.height))
            radius = max(1, round(SPOT_RADIUS * (0.5 + at.drive_rng.random()) * rig.width))
            cv2.circle(cover, centre, radius, 1, -1)
        shade = smoothed(cover.astype(np.float32), 0.25 * SPOT_RADIUS * rig.width)
        views.append(_darkened(image, shade, DIRT_BRIGHTNESS))
    return at.with_images(views[0], views[1])


def with_shadow(at: Affected) -> StereoPair:
    """Darken a rectangle at the bottom, with a penumbra, at the disparity of ground at `SHADOW_DEPTH`."""
    rig = at.rig
    side = np.sqrt(at.amount)
    width = round(min(side, 0.9) * rig.width)
    height = round(max(side, at.amount / 0.9) * rig.height)
    first = round(at.drive_rng.random() * (rig.width - width))
    shade = np.zeros((rig.height, rig.width), np.float32)
    shade[rig.height - min(height, rig.height) :, first : first + width] = 1.0
    shade = smoothed(shade, 0.01 * rig.width)
    there = moved(shade, -rig.fx / SHADOW_DEPTH)
    left = _darkened(at.pair.left, shade, SHADOW_BRIGHTNESS)
    right = _darkened(at.pair.right, there, SHADOW_BRIGHTNESS)
    return at.with_images(left, right)


def _texture(height: int, width: int, like: GreyImage, drive_rng: np.random.Generator) -> FloatImage:
    noise = drive_rng.standard_normal((2, height, width), np.float32)
    grains = [smoothed(layer, sigma) for layer, sigma in zip(noise, (1.0, 4.0), strict=True)]
    total = sum(layer / max(float(layer.std()), 1e-6) for layer in grains)
    bright = float(np.clip(like.mean(), 60.0, 190.0))
    return np.asarray(bright + TEXTURE_CONTRAST / np.sqrt(2.0) * total, np.float32)


def _covered(image: GreyImage, view: FloatImage, cover: FloatImage, at: Affected) -> GreyImage:
    """Return the image, replaced by another view with new noise where `cover` exceeds 0.5."""
    return np.where(cover > 0.5, with_noise(view, READ_NOISE, at.pair_rng), image).astype(np.uint8)


def _darkened(image: GreyImage, shade: FloatImage, brightness: float) -> GreyImage:
    return as_grey(image * (1.0 - (1.0 - brightness) * shade))
