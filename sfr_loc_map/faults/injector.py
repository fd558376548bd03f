"""Applies injected faults to a sequence of stereo pairs: to single images, to the view, to stamps and calibration."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, pairwise
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.faults.kinds import Fault, FaultKind
from sfr_loc_map.geometry.arrays import FloatArray, FloatImage, GreyImage, Mask
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.inputs import NS_PER_S

READ_NOISE = 1.0  #: Noise of a camera that is left when no light comes in, grey levels.
BODY_DEPTH, OBJECT_DEPTH, SHADOW_DEPTH = 6.0, 8.0, 12.0
"""Depth of the own body, of a crossing object and of the ground in the own shadow, baselines: 0.7, 1.0 and 1.4 m with
the rig of the simulator, nearer than the ground in the middle of its image.
"""
TEXTURE_CONTRAST = 30.0  #: Standard deviation of the texture of body and object, grey levels (chosen by eye).
SHADOW_BRIGHTNESS, DIRT_BRIGHTNESS = 0.35, 0.4
"""Factors on grey levels in the own shadow, which the sky alone lights, and under dirt (chosen by eye)."""
SCRATCH_LIGHT = 60.0  #: Grey levels by which the strongest scratches are brighter or darker.
SPOT_RADIUS = 0.04  #: Typical radius of a spot of dirt, fraction of the image's width (chosen by eye).
SPEED = 0.006  #: Motion of a texture from pair to pair, fraction of the image's width: 3 px at 512.
REPEATING = (FaultKind.REPEATED, FaultKind.FROZEN)  #: Kinds that show the images of a pair before.
DRIFT_PAIRS = 100.0  #: Pairs over which a drift reaches its amount.
UNAFFECTED = -1  #: Start of the burst of a pair without a fault.
LAST_STAMP_NS = 2**63 - 1  #: Largest stamp of 64 bits.


class Moment(NamedTuple):
    """One affected pair."""

    progress: float  #: How much of its burst is over, 0 .. 1.
    pair: int  #: Its number.
    spot: FloatArray  #: `(2,)` random point, as shares of width and height.
    rng: np.random.Generator  #: Generator of this pair.


@dataclass(frozen=True, slots=True, eq=False)
class Affected:
    """A pair that a fault affects, and all that its change depends on."""

    fault: Fault
    pair: StereoPair  #: As the fault finds it.
    previous: StereoPair | None  #: The last new pair as the fault found it, None before the first.
    following: StereoPair | None  #: The next pair, None after the last.
    moment: Moment
    rig: StereoRig  #: The true one.
    fixed: np.random.Generator  #: Generator that is the same for all pairs of a drive.


Change = Callable[[Affected], StereoPair]  #: Returns the pair with the fault.


class FaultInjector:
    """Applies faults to a sequence of a known length; the same seed affects the same pairs in the same way."""

    def __init__(self, faults: Sequence[Fault], seed: int, count: int, rig: StereoRig) -> None:
        """Choose the affected pairs of `count`; faults are applied in their order, and the rig is the true one."""
        self._faults, self._seed, self._true_rig, self._count = tuple(faults), seed, rig, count
        self._bursts = [burst_starts(fault, np.random.default_rng([seed, k]), count) for k, fault in enumerate(faults)]
        self.kept: Mask = np.ones(count, bool)
        for fault, bursts in zip(faults, self._bursts, strict=True):
            self.kept &= (bursts < 0) | (fault.kind is not FaultKind.DROPPED)

    @property
    def rig(self) -> StereoRig:
        """The rig of the faulty calibration."""
        rig = self._true_rig
        for fault in self._faults:
            if fault.kind is FaultKind.FOCAL:
                rig = replace(rig, fx=rig.fx * fault.amount, fy=rig.fy * fault.amount)
            elif fault.kind is FaultKind.BASELINE:
                rig = replace(rig, baseline_m=rig.baseline_m * fault.amount)
        return rig

    def stamps_ns(self, stamps_ns: Sequence[int]) -> list[int]:
        """Return the stamps of the pairs left, as `pairs` yields them, by those of the source."""
        found: list[int] = []
        for index, (stamp_ns, following_ns) in enumerate(pairwise((*stamps_ns, None))):
            if stamp_ns is None or not self.kept[index]:
                continue
            for fault, bursts in zip(self._faults, self._bursts, strict=True):
                if bursts[index] != UNAFFECTED:
                    stamp_ns = stamp_with_fault(fault, stamp_ns, following_ns)
            found.append(stamp_ns)
        return found

    def pairs(self, pairs: Iterable[StereoPair]) -> Iterator[tuple[int, StereoPair]]:
        """Yield the pairs left with their numbers in the source; old images show the faults that they had then."""
        previous: list[StereoPair] = []
        for index, (pair, following) in enumerate(pairwise(chain(pairs, (None,)))):
            if pair is None or not self.kept[index]:
                continue
            stages = [pair]  # the input pair of each fault, then the delivered pair
            for number, fault in enumerate(self._faults):
                old = previous[number] if previous else None
                stages.append(self._with_fault(index, number, fault, stages[-1], (old, following)))
            yield index, stages[-1]
            # also repeated twice running, the last new images are repeated
            repeats = (f.kind in REPEATING and b[index] >= 0 for f, b in zip(self._faults, self._bursts, strict=True))
            if not any(repeats):
                previous = stages

    def _with_fault(
        self,
        index: int,
        number: int,
        fault: Fault,
        pair: StereoPair,
        beside: tuple[StereoPair | None, StereoPair | None],
    ) -> StereoPair:
        """Return a pair with one fault more; `beside` are the last new pair, as the fault found it, and the next."""
        previous, following = beside
        first = int(self._bursts[number][index])
        if first == UNAFFECTED:
            return pair
        rng = np.random.default_rng([self._seed, number, index])
        moment = Moment((index - first + 0.5) / fault.burst, index, rng.random(2), rng)
        fixed = np.random.default_rng([self._seed, number, self._count])
        return CHANGES[fault.kind](Affected(fault, pair, previous, following, moment, self._true_rig, fixed))


def burst_starts(fault: Fault, rng: np.random.Generator, count: int) -> NDArray[np.intp]:
    """Return the first pair of the burst, chosen at random up to a share, that affects each pair `(count,)`, or -1."""
    starts = np.full(count, UNAFFECTED)
    if fault.kind.info.affects_all_pairs:
        return np.zeros_like(starts)
    if fault.kind is FaultKind.START:
        starts[: max(round(fault.amount), 0)] = 0
        return starts
    candidates = np.arange(min(fault.start, count), count)
    wanted = round(fault.share * len(candidates))
    if fault.kind.info.has_complete_bursts and wanted > 0:
        wanted = max(wanted, min(fault.burst, len(candidates)))
    for first in rng.permutation(candidates):
        room = wanted - int(np.count_nonzero(starts >= 0))
        if room <= 0:
            break
        burst = slice(first, first + min(fault.burst, room))
        if fault.kind.info.has_complete_bursts:
            burst = slice(first, first + fault.burst)
            if first + min(fault.burst, len(candidates)) > count or (starts[burst] >= 0).any():
                continue
        starts[burst] = first
    return starts


def with_noise(grey: FloatImage, sigma: float, rng: np.random.Generator) -> GreyImage:
    """Return grey levels `(H, W)` with Gaussian noise, rounded and clipped."""
    return as_grey(grey + sigma * rng.standard_normal(grey.shape, np.float32))


def as_grey(values: FloatArray | FloatImage) -> GreyImage:
    """Return grey levels rounded and clipped."""
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


# ---- faults of the pair, of stamps and of the right camera


def _unchanged(at: Affected) -> StereoPair:
    """Return the pair: a dropped pair is not delivered, and a fault of the calibration is in `FaultInjector.rig`."""
    return at.pair


def _repeated(at: Affected) -> StereoPair:
    return at.pair if at.previous is None else replace(at.previous, stamp_ns=at.pair.stamp_ns)


def _swapped(at: Affected) -> StereoPair:
    return replace(at.pair, left=at.pair.right, right=at.pair.left)


def _identical(at: Affected) -> StereoPair:
    return replace(at.pair, right=at.pair.left)


def stamp_with_fault(fault: Fault, stamp_ns: int, following_ns: int | None) -> int:
    """Return the stamp of an affected pair; a late one stays before the next pair of the source, None after the last.

    Kinds that do not concern stamps leave it.
    """
    moved_ns = stamp_ns + round(fault.amount * NS_PER_S)
    if fault.kind is FaultKind.CLOCK:
        return moved_ns
    if fault.kind is FaultKind.LATE:
        return min(moved_ns, LAST_STAMP_NS if following_ns is None else following_ns - 1)
    return stamp_ns


def _with_stamp(at: Affected) -> StereoPair:
    following_ns = None if at.following is None else at.following.stamp_ns
    return replace(at.pair, stamp_ns=stamp_with_fault(at.fault, at.pair.stamp_ns, following_ns))


def _shifted(at: Affected) -> StereoPair:
    return replace(at.pair, right=as_grey(_moved(at.pair.right.astype(np.float32), at.fault.amount)))


def _rotated(axis: int, sign: float, at: Affected) -> StereoPair:
    return replace(at.pair, right=rotated(at.pair.right, axis, sign * at.fault.amount, at.rig))


def _drifting(at: Affected) -> StereoPair:
    progress = max((at.moment.pair - at.fault.start) / DRIFT_PAIRS, 0.0)
    return replace(at.pair, right=rotated(at.pair.right, 1, -at.fault.amount * progress, at.rig))


def rotated(image: GreyImage, axis: int, angle_deg: float, rig: StereoRig) -> GreyImage:
    """Return the image of a camera that is rotated against its calibration (the homography `K R K^-1`).

    `axis` is that of the optical frame about which the camera is rotated.
    """
    vector = np.zeros(3)
    vector[axis] = np.radians(angle_deg)
    K = rig.camera_matrix
    homography = K @ matrix_from_rotvec(vector).T @ np.linalg.inv(K)
    size = (rig.width, rig.height)
    return np.asarray(cv2.warpPerspective(image, homography, size, flags=cv2.INTER_CUBIC), np.uint8)


# ---- faults of single images


def _each_image(change: Callable[[GreyImage, float, Moment], GreyImage], at: Affected) -> StereoPair:
    """Return the pair with the images of the affected cameras changed, the left one first."""
    left, right, camera = at.pair.left, at.pair.right, at.fault.camera
    if camera != "right":
        left = change(left, at.fault.amount, at.moment)
    if camera != "left":
        right = change(right, at.fault.amount, at.moment)
    return replace(at.pair, left=left, right=right)


def _black(image: GreyImage, amount: float, moment: Moment) -> GreyImage:
    return np.zeros_like(image)


def _blurred(image: GreyImage, amount: float, moment: Moment) -> GreyImage:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), max(amount, 1e-3)), np.uint8)


def _sheared(image: GreyImage, amount: float, moment: Moment) -> GreyImage:
    height = len(image)
    slope = (amount if moment.spot[0] < 0.5 else -amount) / height
    shear = np.array([[1.0, slope, -0.5 * slope * height], [0.0, 1.0, 0.0]])
    return as_grey(_warped(image.astype(np.float32), shear))


def _exposed(image: GreyImage, amount: float, moment: Moment) -> GreyImage:
    return as_grey(amount * image.astype(np.float32))


def _noisy(image: GreyImage, amount: float, moment: Moment) -> GreyImage:
    return with_noise(image.astype(np.float32), amount, moment.rng)


def _faded(image: GreyImage, amount: float, moment: Moment) -> GreyImage:
    """Darken to the middle of the burst, where the image is black, and brighten again."""
    return with_noise(abs(2.0 * moment.progress - 1.0) * image.astype(np.float32), READ_NOISE, moment.rng)


def _saturated(image: GreyImage, amount: float, moment: Moment) -> GreyImage:
    """Brighten until the brightest share of the image is clipped."""
    white = max(float(np.quantile(image, 1.0 - amount)), 1.0)
    return with_noise(255.0 / white * image.astype(np.float32), READ_NOISE, moment.rng)


def _blinded(image: GreyImage, amount: float, moment: Moment) -> GreyImage:
    """Add a glare around a point."""
    height, width = image.shape
    y, x = np.mgrid[:height, :width]
    r = np.hypot(x - moment.spot[0] * width, y - moment.spot[1] * height) / max(0.5 * amount * width, 1e-6)
    glare = (255.0 * np.minimum(1.2, 1.2 / np.maximum(r, 1e-3) ** 3)).astype(np.float32)
    return as_grey(image.astype(np.float32) + glare)


# ---- faults that show the pair before


def _with_previous(
    change: Callable[[GreyImage, GreyImage, float, np.random.Generator], GreyImage], at: Affected
) -> StereoPair:
    """Return the pair with parts of the last new one; the first pair has none and does not change."""
    if at.previous is None:
        return at.pair
    left = change(at.pair.left, at.previous.left, at.fault.amount, at.moment.rng)
    right = change(at.pair.right, at.previous.right, at.fault.amount, at.moment.rng)
    return _of_cameras(at, left, right)


def _of_cameras(at: Affected, left: GreyImage, right: GreyImage) -> StereoPair:
    """Return the pair with the changed images of the affected cameras."""
    if at.fault.camera == "right":
        left = at.pair.left
    elif at.fault.camera == "left":
        right = at.pair.right
    return replace(at.pair, left=left, right=right)


def _frozen(image: GreyImage, old: GreyImage, amount: float, rng: np.random.Generator) -> GreyImage:
    return with_noise(old.astype(np.float32), amount, rng)


def _ghost(image: GreyImage, old: GreyImage, amount: float, rng: np.random.Generator) -> GreyImage:
    return as_grey((1.0 - amount) * image + amount * old)


def _torn(image: GreyImage, old: GreyImage, amount: float, rng: np.random.Generator) -> GreyImage:
    rows = np.arange(len(image)) >= round((1.0 - amount) * len(image))
    return np.where(rows[:, None], old, image)


def _interlaced(image: GreyImage, old: GreyImage, amount: float, rng: np.random.Generator) -> GreyImage:
    rows = np.arange(len(image)) % 2 == 1
    return np.where(rows[:, None], old, image)


# ---- faults of the view


def _view(
    draw: Callable[[StereoPair, float, Moment, StereoRig, np.random.Generator], Views], at: Affected
) -> StereoPair:
    """Return the pair with what is drawn into the view of both cameras."""
    return _of_cameras(at, *draw(at.pair, at.fault.amount, at.moment, at.rig, at.fixed))


def _with_body(pair: StereoPair, amount: float, moment: Moment, rig: StereoRig, fixed: np.random.Generator) -> Views:
    disparity = rig.fx / BODY_DEPTH
    texture = _texture(rig.height, rig.width + int(disparity) + 2, pair.left, fixed)
    cover = np.zeros((rig.height, rig.width), np.float32)
    cover[rig.height - round(amount * rig.height) :] = 1.0
    left = _covered(pair.left, texture[:, : rig.width], cover, moment)
    return left, _covered(pair.right, _moved(texture, -disparity)[:, : rig.width], cover, moment)


def _with_arm(pair: StereoPair, amount: float, moment: Moment, rig: StereoRig, fixed: np.random.Generator) -> Views:
    """Cover a rectangle that comes in from below, ever slower, and stays."""
    side, disparity = np.sqrt(amount), rig.fx / BODY_DEPTH
    texture = _texture(2 * rig.height, rig.width, pair.left, fixed)
    width, first = round(side * rig.width), round((1.0 - side) * fixed.random() * rig.width)
    rows = round(side * rig.height * np.sin(0.5 * np.pi * min(moment.progress, 1.0)))
    cover = np.zeros((rig.height, rig.width), np.float32)
    cover[rig.height - rows :, first : first + width] = 1.0
    view = texture[rows : rows + rig.height]
    left = _covered(pair.left, view, cover, moment)
    return left, _covered(pair.right, _moved(view, -disparity), _moved(cover, -disparity), moment)


def _with_texture(pair: StereoPair, amount: float, moment: Moment, rig: StereoRig, fixed: np.random.Generator) -> Views:
    """Cover the bottom with a texture that moves sideways, at the depth of the own body."""
    shift = round(SPEED * rig.width) * moment.pair
    texture = np.roll(_texture(rig.height, 2 * rig.width, pair.left, fixed), shift, axis=1)
    cover = np.zeros((rig.height, rig.width), np.float32)
    cover[rig.height - round(amount * rig.height) :] = 1.0
    there = texture[:, round(rig.fx / BODY_DEPTH) :][:, : rig.width]
    return _covered(pair.left, texture[:, : rig.width], cover, moment), _covered(pair.right, there, cover, moment)


def _with_reflection(
    pair: StereoPair, amount: float, moment: Moment, rig: StereoRig, fixed: np.random.Generator
) -> Views:
    """Add a fixed texture, at the depth of the own body, to the image that is left."""
    texture, kept = _texture(rig.height, rig.width, pair.left, fixed), 1.0 - amount
    there = _moved(texture, -rig.fx / BODY_DEPTH)
    return as_grey(kept * pair.left + amount * texture), as_grey(kept * pair.right + amount * there)


def _with_scratches(
    pair: StereoPair, amount: float, moment: Moment, rig: StereoRig, fixed: np.random.Generator
) -> Views:
    """Draw bright and dark lines over both images, at the same pixels, until they cover a share."""
    lines = np.zeros((rig.height, rig.width), np.uint8)
    while np.count_nonzero(lines) < amount * lines.size:
        start, end = (fixed.random((2, 2)) * (rig.width, rig.height)).astype(int).tolist()
        cv2.line(lines, start, end, int(fixed.integers(1, 256)), 1)
    light = np.where(lines > 0, SCRATCH_LIGHT * (lines / 128.0 - 1.0), 0.0).astype(np.float32)
    return as_grey(pair.left + light), as_grey(pair.right + light)


def _with_object(pair: StereoPair, amount: float, moment: Moment, rig: StereoRig, fixed: np.random.Generator) -> Views:
    """Cover an ellipse that moves from the left edge of the images to the right one, at a constant depth."""
    side = np.sqrt(amount * 4.0 / np.pi)
    width, height = side * rig.width, side * rig.height
    texture = _texture(rig.height, rig.width, pair.left, fixed)
    centre = moment.progress * (rig.width + width) - 0.5 * width
    v, u = np.mgrid[: rig.height, : rig.width].astype(np.float32)
    row = (0.3 + 0.4 * fixed.random()) * rig.height
    views = []
    for image, x in zip((pair.left, pair.right), (centre, centre - rig.fx / OBJECT_DEPTH), strict=True):
        inside = ((u - x) / (0.5 * width + 1e-6)) ** 2 + ((v - row) / (0.5 * height + 1e-6)) ** 2 < 1.0
        texture_here = _moved(texture, x - 0.5 * rig.width)
        views.append(_covered(image, texture_here, inside.astype(np.float32), moment))
    return views[0], views[1]


def _with_dirt(pair: StereoPair, amount: float, moment: Moment, rig: StereoRig, fixed: np.random.Generator) -> Views:
    """Darken blurred spots on a share of the image, others in each image."""
    views = []
    for image in (pair.left, pair.right):
        cover = np.zeros((rig.height, rig.width), np.uint8)
        while cover.mean() < amount:
            centre = (round(fixed.random() * rig.width), round(fixed.random() * rig.height))
            radius = max(1, round(SPOT_RADIUS * (0.5 + fixed.random()) * rig.width))
            cv2.circle(cover, centre, radius, 1, -1)
        shade = cv2.GaussianBlur(cover.astype(np.float32), (0, 0), 0.25 * SPOT_RADIUS * rig.width)
        views.append(_darkened(image, np.asarray(shade, np.float32), DIRT_BRIGHTNESS))
    return views[0], views[1]


def _with_shadow(pair: StereoPair, amount: float, moment: Moment, rig: StereoRig, fixed: np.random.Generator) -> Views:
    """Darken a rectangle at the bottom, with a penumbra; in the right image where ground of a usual depth has it."""
    side = np.sqrt(amount)
    width, height = round(min(side, 0.9) * rig.width), round(amount / min(side, 0.9) * rig.height)
    first = round(fixed.random() * (rig.width - width))
    shade = np.zeros((rig.height, rig.width), np.float32)
    shade[rig.height - min(height, rig.height) :, first : first + width] = 1.0
    shade = cv2.GaussianBlur(shade, (0, 0), 0.01 * rig.width).astype(np.float32)
    there = _moved(shade, -rig.fx / SHADOW_DEPTH)
    return _darkened(pair.left, shade, SHADOW_BRIGHTNESS), _darkened(pair.right, there, SHADOW_BRIGHTNESS)


Views = tuple[GreyImage, GreyImage]  #: Left and right image.
CHANGES: dict[FaultKind, Change] = {
    FaultKind.DROPPED: _unchanged,
    FaultKind.REPEATED: _repeated,
    FaultKind.SWAPPED: _swapped,
    FaultKind.IDENTICAL: _identical,
    FaultKind.FROZEN: partial(_with_previous, _frozen),
    FaultKind.TORN: partial(_with_previous, _torn),
    FaultKind.GHOST: partial(_with_previous, _ghost),
    FaultKind.INTERLACED: partial(_with_previous, _interlaced),
    FaultKind.BLACK: partial(_each_image, _black),
    FaultKind.START: partial(_each_image, _black),
    FaultKind.FADE: partial(_each_image, _faded),
    FaultKind.BLINDED: partial(_each_image, _blinded),
    FaultKind.SATURATION: partial(_each_image, _saturated),
    FaultKind.LATE: _with_stamp,
    FaultKind.BLURRED: partial(_each_image, _blurred),
    FaultKind.NOISY: partial(_each_image, _noisy),
    FaultKind.EXPOSURE: partial(_each_image, _exposed),
    FaultKind.SHEAR: partial(_each_image, _sheared),
    FaultKind.BODY: partial(_view, _with_body),
    FaultKind.OBJECT: partial(_view, _with_object),
    FaultKind.ARM: partial(_view, _with_arm),
    FaultKind.TEXTURE: partial(_view, _with_texture),
    FaultKind.REFLECTION: partial(_view, _with_reflection),
    FaultKind.SCRATCH: partial(_view, _with_scratches),
    FaultKind.DIRT: partial(_view, _with_dirt),
    FaultKind.SHADOW: partial(_view, _with_shadow),
    FaultKind.FOCAL: _unchanged,
    FaultKind.BASELINE: _unchanged,
    FaultKind.ROLL: partial(_rotated, 2, 1.0),
    FaultKind.PITCH: partial(_rotated, 0, -1.0),
    FaultKind.YAW: partial(_rotated, 1, -1.0),
    FaultKind.DRIFT: _drifting,
    FaultKind.SHIFT: _shifted,
    FaultKind.CLOCK: _with_stamp,
}
"""What each kind does to an affected pair."""


def _texture(height: int, width: int, like: GreyImage, fixed: np.random.Generator) -> FloatImage:
    noise = fixed.standard_normal((2, height, width), np.float32)
    grains = [cv2.GaussianBlur(layer, (0, 0), sigma) for layer, sigma in zip(noise, (1.0, 4.0), strict=True)]
    total = sum(layer / max(float(layer.std()), 1e-6) for layer in grains)
    bright = float(np.clip(like.mean(), 60.0, 190.0))
    return np.asarray(bright + TEXTURE_CONTRAST / np.sqrt(2.0) * total, np.float32)


def _moved(image: FloatImage, columns: float) -> FloatImage:
    """Return an image moved to the right by a part of a pixel too, mirrored at its edges."""
    return _warped(image, np.array([[1.0, 0.0, columns], [0.0, 1.0, 0.0]]))


def _warped(image: FloatImage, transform: FloatArray) -> FloatImage:
    flags, border = cv2.INTER_CUBIC, cv2.BORDER_REFLECT
    return np.asarray(cv2.warpAffine(image, transform, image.shape[::-1], flags=flags, borderMode=border), np.float32)


def _covered(image: GreyImage, view: FloatImage, cover: FloatImage, moment: Moment) -> GreyImage:
    """Return the image with another view where it is covered; only there the noise is new."""
    return np.where(cover > 0.5, with_noise(view, READ_NOISE, moment.rng), image).astype(np.uint8)


def _darkened(image: GreyImage, shade: FloatImage, brightness: float) -> GreyImage:
    return as_grey(image * (1.0 - (1.0 - brightness) * shade))
