"""Faults as a layer over any stereo pairs: what cameras, clocks and calibrations do when they fail."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.geometry.arrays import GreyImage
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig

KINDS: dict[str, tuple[float, str]] = {
    "dropped": (0.0, "the pair is missing"),
    "repeated": (0.0, "the pictures that came last come again"),
    "swapped": (0.0, "left and right are exchanged"),
    "black": (0.0, "the picture is black"),
    "blinded": (1.0, "glare: AMOUNT of the picture's width is saturated around a place"),
    "late": (0.2, "the stamp is AMOUNT s late, but before the next pair's"),
    "blurred": (2.5, "Gaussian blur of AMOUNT px"),
    "noisy": (10.0, "noise of AMOUNT grey levels"),
    "exposure": (0.5, "brightness times AMOUNT"),
    "focal": (1.01, "calibration: focal length in the rig file times AMOUNT"),
    "baseline": (1.01, "calibration: baseline in the rig file times AMOUNT"),
    "roll": (0.2, "calibration: the right picture is turned by AMOUNT deg about its axis"),
    "pitch": (0.1, "calibration: the right camera looks AMOUNT deg down"),
    "yaw": (0.1, "calibration: the right camera looks AMOUNT deg to the left"),
    "clock": (0.1, "all stamps of pairs are AMOUNT s late against the truth"),
}
"""Kinds of fault: the usual amount, and what it does."""
CAMERAS = ("both", "left", "right")
RIG_KINDS = ("focal", "baseline")
TURN_KINDS = {"roll": 2, "pitch": 0, "yaw": 1}
PICTURE_KINDS = ("black", "blinded", "blurred", "noisy", "exposure")


@dataclass(frozen=True, slots=True)
class Fault:
    """One kind of fault and which pairs it strikes.

    Attributes:
        kind: One of `KINDS`.
        amount: How strong, in the unit that the kind says.
        share: Share of pairs that are struck; faults of calibration and clock strike all.
        burst: Pairs that a strike lasts.
        start: First pair that may be struck.
        camera: `both`, `left` or `right`, for faults of pictures.
    """

    kind: str
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
    kind, _, rest = text.partition(":")
    if kind not in KINDS:
        raise ConfigError(f"fault '{text}': '{kind}' is unknown; one of {', '.join(KINDS)} is needed")
    values: dict[str, float | int | str] = {"kind": kind, "amount": KINDS[kind][0]}
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
    """Applies faults to a sequence of a known length; the same seed strikes the same pairs in the same way."""

    def __init__(self, faults: Sequence[Fault], seed: int, count: int, rig: StereoRig) -> None:
        """Choose the pairs to strike.

        Args:
            faults: Applied in this order.
            seed: Seed of the choice and of noise.
            count: Number of pairs.
            rig: True rig.
        """
        self._faults, self._seed, self._true_rig = tuple(faults), seed, rig
        self._struck = [_struck(fault, np.random.default_rng([seed, k]), count) for k, fault in enumerate(faults)]
        gone = [struck for fault, struck in zip(faults, self._struck, strict=True) if fault.kind == "dropped"]
        self.kept: NDArray[np.bool_] = ~np.any(gone, axis=0) if gone else np.ones(count, bool)

    @property
    def rig(self) -> StereoRig:
        """The rig as the faulty calibration gives it."""
        rig = self._true_rig
        for fault in self._faults:
            if fault.kind == "focal":
                rig = replace(rig, fx=rig.fx * fault.amount, fy=rig.fy * fault.amount)
            elif fault.kind == "baseline":
                rig = replace(rig, baseline_m=rig.baseline_m * fault.amount)
        return rig

    def pairs(self, pairs: Iterable[StereoPair]) -> Iterator[tuple[int, StereoPair]]:
        """Yield the pairs that are left, each with its number in the source."""
        before: StereoPair | None = None
        for index, (pair, following) in enumerate(_with_next(pairs)):
            if self.kept[index]:
                yield index, self._strike(index, pair, before, following)
            if not self._repeats(index):  # what comes again is what came last, also twice running
                before = pair

    def _repeats(self, index: int) -> bool:
        strikes = zip(self._faults, self._struck, strict=True)
        return any(fault.kind == "repeated" and struck[index] for fault, struck in strikes)

    def _strike(
        self, index: int, pair: StereoPair, before: StereoPair | None, following: StereoPair | None
    ) -> StereoPair:
        for number, fault in enumerate(self._faults):
            if not self._struck[number][index]:
                continue
            if fault.kind == "repeated" and before is not None:
                pair = StereoPair(pair.stamp_ns, before.left, before.right)
            elif fault.kind == "swapped":
                pair = StereoPair(pair.stamp_ns, pair.right, pair.left)
            elif fault.kind == "clock":
                pair = StereoPair(pair.stamp_ns + round(fault.amount * 1e9), pair.left, pair.right)
            elif fault.kind == "late":
                last = following.stamp_ns - 1 if following is not None else 2**63 - 1
                pair = StereoPair(min(pair.stamp_ns + round(fault.amount * 1e9), last), pair.left, pair.right)
            elif fault.kind in TURN_KINDS:
                pair = StereoPair(pair.stamp_ns, pair.left, _turned(pair.right, fault, self._true_rig))
            elif fault.kind in PICTURE_KINDS:
                pair = self._spoil(pair, fault, np.random.default_rng([self._seed, number, index]))
        return pair

    @staticmethod
    def _spoil(pair: StereoPair, fault: Fault, rng: np.random.Generator) -> StereoPair:
        place = rng.random(2)
        left = pair.left if fault.camera == "right" else _spoiled(pair.left, fault, place, rng)
        right = pair.right if fault.camera == "left" else _spoiled(pair.right, fault, place, rng)
        return StereoPair(pair.stamp_ns, left, right)


def _struck(fault: Fault, rng: np.random.Generator, count: int) -> NDArray[np.bool_]:
    """Return which pairs a fault strikes: bursts at random places until the share is reached."""
    if fault.kind in (*RIG_KINDS, *TURN_KINDS, "clock"):
        return np.ones(count, bool)
    struck = np.zeros(count, bool)
    places = np.arange(min(fault.start, count), count)
    wanted = round(fault.share * len(places))
    for place in rng.permutation(places):
        if struck.sum() >= wanted:
            break
        room = wanted - int(struck.sum())
        struck[place : place + min(fault.burst, room)] = True
    return struck


def _spoiled(image: GreyImage, fault: Fault, place: NDArray[np.float64], rng: np.random.Generator) -> GreyImage:
    if fault.kind == "black":
        return np.zeros_like(image)
    if fault.kind == "blurred":
        return np.asarray(cv2.GaussianBlur(image, (0, 0), max(fault.amount, 1e-3)), np.uint8)
    grey = image.astype(np.float32)
    if fault.kind == "exposure":
        grey *= fault.amount
    elif fault.kind == "noisy":
        grey += fault.amount * rng.standard_normal(image.shape, np.float32)
    else:
        height, width = image.shape
        y, x = np.mgrid[:height, :width]
        r = np.hypot(x - place[0] * width, y - place[1] * height) / max(0.5 * fault.amount * width, 1e-6)
        grey += 255.0 * np.minimum(1.2, 1.2 / np.maximum(r, 1e-3) ** 3)
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def _turned(image: GreyImage, fault: Fault, rig: StereoRig) -> GreyImage:
    """Return what a camera sees that is turned against its calibration (the homography `K R K^-1`)."""
    vector = np.zeros(3)
    vector[TURN_KINDS[fault.kind]] = np.radians(fault.amount) * (-1.0 if fault.kind in ("pitch", "yaw") else 1.0)
    k = rig.camera_matrix
    homography = k @ matrix_from_rotvec(vector).T @ np.linalg.inv(k)
    size = (rig.width, rig.height)
    return np.asarray(cv2.warpPerspective(image, homography, size, flags=cv2.INTER_CUBIC), np.uint8)


def _with_next(pairs: Iterable[StereoPair]) -> Iterator[tuple[StereoPair, StereoPair | None]]:
    iterator = iter(pairs)
    current = next(iterator, None)
    while current is not None:
        following = next(iterator, None)
        yield current, following
        current = following
