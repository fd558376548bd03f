"""Faults injected into stereo pairs: failures of cameras, clocks and calibrations."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import NamedTuple

import cv2
import numpy as np

from sfr_loc_map.constants import NS_PER_S
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.geometry.arrays import FloatArray, GreyImage, Mask
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig


class FaultKind(StrEnum):
    """Kinds of fault; `KINDS` says what each does."""

    DROPPED = "dropped"
    REPEATED = "repeated"
    SWAPPED = "swapped"
    BLACK = "black"
    BLINDED = "blinded"
    LATE = "late"
    BLURRED = "blurred"
    NOISY = "noisy"
    EXPOSURE = "exposure"
    FOCAL = "focal"
    BASELINE = "baseline"
    ROLL = "roll"
    PITCH = "pitch"
    YAW = "yaw"
    CLOCK = "clock"


class KindInfo(NamedTuple):
    """Default amount and effect of a kind of fault."""

    amount: float
    effect: str


KINDS = {
    FaultKind.DROPPED: KindInfo(0.0, "the pair is missing"),
    FaultKind.REPEATED: KindInfo(0.0, "the pair repeats the previous images"),
    FaultKind.SWAPPED: KindInfo(0.0, "left and right images are swapped"),
    FaultKind.BLACK: KindInfo(0.0, "the image is black"),
    FaultKind.BLINDED: KindInfo(1.0, "glare: AMOUNT of the image width is saturated around a point"),
    FaultKind.LATE: KindInfo(0.2, "the stamp is AMOUNT s late, but before that of the next pair"),
    FaultKind.BLURRED: KindInfo(2.5, "Gaussian blur of AMOUNT px"),
    FaultKind.NOISY: KindInfo(10.0, "noise of AMOUNT grey levels"),
    FaultKind.EXPOSURE: KindInfo(0.5, "brightness times AMOUNT"),
    FaultKind.FOCAL: KindInfo(1.01, "calibration: focal length in the rig file times AMOUNT"),
    FaultKind.BASELINE: KindInfo(1.01, "calibration: baseline in the rig file times AMOUNT"),
    FaultKind.ROLL: KindInfo(0.2, "calibration: the right image is rotated by AMOUNT deg about its axis"),
    FaultKind.PITCH: KindInfo(0.1, "calibration: the right camera looks AMOUNT deg down"),
    FaultKind.YAW: KindInfo(0.1, "calibration: the right camera looks AMOUNT deg to the left"),
    FaultKind.CLOCK: KindInfo(0.1, "all stamps of pairs are AMOUNT s late against the ground truth"),
}
CAMERAS = ("both", "left", "right")
RIG_KINDS = (FaultKind.FOCAL, FaultKind.BASELINE)
ROTATION_AXES = {FaultKind.ROLL: 2, FaultKind.PITCH: 0, FaultKind.YAW: 1}
"""Axis of the optical frame about which the right camera is rotated."""
IMAGE_KINDS = (FaultKind.BLACK, FaultKind.BLINDED, FaultKind.BLURRED, FaultKind.NOISY, FaultKind.EXPOSURE)


@dataclass(frozen=True, slots=True)
class Fault:
    """One kind of fault and which pairs it affects.

    Attributes:
        kind: What it does.
        amount: How strong, in the unit of the kind.
        share: Share of pairs that are affected; faults of calibration and clock affect all.
        burst: Consecutive pairs that are affected.
        start: First pair that may be affected.
        camera: `both`, `left` or `right`, for faults of images.
    """

    kind: FaultKind
    amount: float
    share: float = 0.1
    burst: int = 1
    start: int = 1
    camera: str = "both"


def parse_fault(text: str) -> Fault:
    """Return the fault of a text `KIND[:name=value,...]`, as `blurred:share=0.2,amount=3,camera=left`.

    Raises:
        ConfigError: For an unknown kind or name, or a value out of range.
    """
    name, _, rest = text.partition(":")
    try:
        kind = FaultKind(name)
    except ValueError as error:
        raise ConfigError(f"fault '{text}': '{name}' is unknown; one of {', '.join(KINDS)} is needed") from error
    values: dict[str, float | int | str] = {"kind": kind, "amount": KINDS[kind].amount}
    types = {"amount": float, "share": float, "burst": int, "start": int, "camera": str}
    for item in filter(None, rest.split(",")):
        name, _, value = item.partition("=")
        try:
            values[name] = types[name](value)
        except (KeyError, ValueError) as error:
            raise ConfigError(
                f"fault '{text}': '{item}' must be NAME=VALUE with a name of {', '.join(types)}"
            ) from error
    fault = Fault(**values)  # type: ignore[arg-type]
    if not (0 <= fault.share <= 1 and fault.burst >= 1 and fault.start >= 0 and np.isfinite(fault.amount)):
        raise ConfigError(f"fault '{text}': share must lie in 0 .. 1, burst be >= 1, start >= 0 and amount finite")
    if fault.camera not in CAMERAS:
        raise ConfigError(f"fault '{text}': camera must be one of {', '.join(CAMERAS)}")
    return fault


class Perturber:
    """Applies faults to a sequence of a known length; the same seed affects the same pairs in the same way."""

    def __init__(self, faults: Sequence[Fault], seed: int, count: int, rig: StereoRig) -> None:
        """Choose the affected pairs.

        Args:
            faults: Applied in this order.
            seed: Seed of the choice and of noise.
            count: Number of pairs.
            rig: True rig.
        """
        self._faults, self._seed, self._true_rig = tuple(faults), seed, rig
        self._affected = [_affected(fault, np.random.default_rng([seed, k]), count) for k, fault in enumerate(faults)]
        gone = [
            affected for fault, affected in zip(faults, self._affected, strict=True) if fault.kind is FaultKind.DROPPED
        ]
        self.kept: Mask = ~np.any(gone, axis=0) if gone else np.ones(count, bool)

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

    def pairs(self, pairs: Iterable[StereoPair]) -> Iterator[tuple[int, StereoPair]]:
        """Yield the pairs that are left, each with its number in the source."""
        previous: StereoPair | None = None
        for index, (pair, following) in enumerate(_with_next(pairs)):
            if self.kept[index]:
                yield index, self._perturbed(index, pair, previous, following)
            if not self._repeats(index):  # also repeated twice running, the last new images are repeated
                previous = pair

    def _repeats(self, index: int) -> bool:
        faults = zip(self._faults, self._affected, strict=True)
        return any(fault.kind is FaultKind.REPEATED and affected[index] for fault, affected in faults)

    def _perturbed(
        self, index: int, pair: StereoPair, previous: StereoPair | None, following: StereoPair | None
    ) -> StereoPair:
        for number, fault in enumerate(self._faults):
            if not self._affected[number][index]:
                continue
            if fault.kind is FaultKind.REPEATED and previous is not None:
                pair = StereoPair(pair.stamp_ns, previous.left, previous.right)
            elif fault.kind is FaultKind.SWAPPED:
                pair = StereoPair(pair.stamp_ns, pair.right, pair.left)
            elif fault.kind is FaultKind.CLOCK:
                pair = replace(pair, stamp_ns=pair.stamp_ns + round(fault.amount * NS_PER_S))
            elif fault.kind is FaultKind.LATE:
                last = following.stamp_ns - 1 if following is not None else 2**63 - 1
                pair = replace(pair, stamp_ns=min(pair.stamp_ns + round(fault.amount * NS_PER_S), last))
            elif fault.kind in ROTATION_AXES:
                pair = replace(pair, right=_rotated(pair.right, fault, self._true_rig))
            elif fault.kind in IMAGE_KINDS:
                pair = self._degraded_pair(pair, fault, np.random.default_rng([self._seed, number, index]))
        return pair

    @staticmethod
    def _degraded_pair(pair: StereoPair, fault: Fault, rng: np.random.Generator) -> StereoPair:
        glare = rng.random(2)
        left = pair.left if fault.camera == "right" else _degraded(pair.left, fault, glare, rng)
        right = pair.right if fault.camera == "left" else _degraded(pair.right, fault, glare, rng)
        return StereoPair(pair.stamp_ns, left, right)


def _affected(fault: Fault, rng: np.random.Generator, count: int) -> Mask:
    """Return the mask of the pairs that a fault affects: random bursts until the share is reached."""
    if fault.kind in (*RIG_KINDS, *ROTATION_AXES, FaultKind.CLOCK):
        return np.ones(count, bool)
    affected = np.zeros(count, bool)
    candidates = np.arange(min(fault.start, count), count)
    wanted = round(fault.share * len(candidates))
    for first in rng.permutation(candidates):
        if affected.sum() >= wanted:
            break
        room = wanted - int(affected.sum())
        affected[first : first + min(fault.burst, room)] = True
    return affected


def _degraded(image: GreyImage, fault: Fault, glare: FloatArray, rng: np.random.Generator) -> GreyImage:
    """Return an image with a fault; `glare` `(2,)` is the centre of glare as shares of width and height."""
    if fault.kind is FaultKind.BLACK:
        return np.zeros_like(image)
    if fault.kind is FaultKind.BLURRED:
        return np.asarray(cv2.GaussianBlur(image, (0, 0), max(fault.amount, 1e-3)), np.uint8)
    grey = image.astype(np.float32)
    if fault.kind is FaultKind.EXPOSURE:
        grey *= fault.amount
    elif fault.kind is FaultKind.NOISY:
        grey += fault.amount * rng.standard_normal(image.shape, np.float32)
    else:
        height, width = image.shape
        y, x = np.mgrid[:height, :width]
        r = np.hypot(x - glare[0] * width, y - glare[1] * height) / max(0.5 * fault.amount * width, 1e-6)
        grey += 255.0 * np.minimum(1.2, 1.2 / np.maximum(r, 1e-3) ** 3)
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def _rotated(image: GreyImage, fault: Fault, rig: StereoRig) -> GreyImage:
    """Return the image of a camera that is rotated against its calibration (the homography `K R K^-1`)."""
    vector = np.zeros(3)
    sign = 1.0 if fault.kind is FaultKind.ROLL else -1.0
    vector[ROTATION_AXES[fault.kind]] = sign * np.radians(fault.amount)
    K = rig.camera_matrix
    homography = K @ matrix_from_rotvec(vector).T @ np.linalg.inv(K)
    size = (rig.width, rig.height)
    return np.asarray(cv2.warpPerspective(image, homography, size, flags=cv2.INTER_CUBIC), np.uint8)


def _with_next(pairs: Iterable[StereoPair]) -> Iterator[tuple[StereoPair, StereoPair | None]]:
    iterator = iter(pairs)
    current = next(iterator, None)
    while current is not None:
        following = next(iterator, None)
        yield current, following
        current = following
