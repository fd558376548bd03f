"""Kinds of fault that are injected into stereo pairs: failures of cameras, clocks, calibrations and of the view."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Final, NamedTuple

import numpy as np

from sfr_loc_map.errors import ConfigError


class FaultKind(StrEnum):
    """Kinds of fault; `KINDS` says what each does."""

    DROPPED = "dropped"
    REPEATED = "repeated"
    SWAPPED = "swapped"
    IDENTICAL = "identical"
    FROZEN = "frozen"
    TORN = "torn"
    BLACK = "black"
    START = "start"
    FADE = "fade"
    BLINDED = "blinded"
    SATURATION = "saturation"
    LATE = "late"
    BLURRED = "blurred"
    NOISY = "noisy"
    EXPOSURE = "exposure"
    BODY = "body"
    OBJECT = "object"
    DIRT = "dirt"
    SHADOW = "shadow"
    FOCAL = "focal"
    BASELINE = "baseline"
    ROLL = "roll"
    PITCH = "pitch"
    YAW = "yaw"
    DRIFT = "drift"
    CLOCK = "clock"


class KindInfo(NamedTuple):
    """Effect of a kind of fault and the defaults of its `Fault`."""

    amount: float
    effect: str
    share: float = 0.1
    burst: int = 1
    start: int = 1


KINDS = {
    FaultKind.DROPPED: KindInfo(0.0, "the pair is missing"),
    FaultKind.REPEATED: KindInfo(0.0, "the pair repeats the previous images"),
    FaultKind.SWAPPED: KindInfo(0.0, "left and right images are swapped"),
    FaultKind.IDENTICAL: KindInfo(0.0, "the right image is the left one"),
    FaultKind.FROZEN: KindInfo(1.0, "the images stay as they were, with new noise of AMOUNT grey levels", burst=5),
    FaultKind.TORN: KindInfo(0.5, "the lower AMOUNT of the image is that of the pair before"),
    FaultKind.BLACK: KindInfo(0.0, "the image is black"),
    FaultKind.START: KindInfo(5.0, "the first AMOUNT pairs are black", share=1.0, start=0),
    FaultKind.FADE: KindInfo(0.0, "slow blackout: over `burst` pairs the image turns black and back", burst=20),
    FaultKind.BLINDED: KindInfo(1.0, "glare: AMOUNT of the image width is saturated around a point"),
    FaultKind.SATURATION: KindInfo(0.5, "overexposed: AMOUNT of the image is clipped"),
    FaultKind.LATE: KindInfo(0.2, "the stamp is AMOUNT s late, but before that of the next pair"),
    FaultKind.BLURRED: KindInfo(2.5, "Gaussian blur of AMOUNT px"),
    FaultKind.NOISY: KindInfo(10.0, "noise of AMOUNT grey levels"),
    FaultKind.EXPOSURE: KindInfo(0.5, "brightness times AMOUNT"),
    FaultKind.BODY: KindInfo(0.3, "own body: fixed texture in the bottom AMOUNT of the image", share=1.0, start=0),
    FaultKind.OBJECT: KindInfo(0.3, "an object of AMOUNT of the image crosses over `burst` pairs", burst=20),
    FaultKind.DIRT: KindInfo(0.1, "dirt on the lenses: fixed spots on AMOUNT of the image", share=1.0, start=0),
    FaultKind.SHADOW: KindInfo(0.2, "own shadow: a fixed dark region, AMOUNT of the image", share=1.0, start=0),
    FaultKind.FOCAL: KindInfo(1.01, "calibration: focal length in the rig file times AMOUNT", share=1.0, start=0),
    FaultKind.BASELINE: KindInfo(1.01, "calibration: baseline in the rig file times AMOUNT", share=1.0, start=0),
    FaultKind.ROLL: KindInfo(0.2, "the right image is rotated by AMOUNT deg about its axis", share=1.0, start=0),
    FaultKind.PITCH: KindInfo(0.1, "the right camera looks AMOUNT deg down", share=1.0, start=0),
    FaultKind.YAW: KindInfo(0.1, "the right camera looks AMOUNT deg to the left", share=1.0, start=0),
    FaultKind.DRIFT: KindInfo(0.3, "the right camera turns AMOUNT deg to the left in 100 pairs", share=1.0, start=0),
    FaultKind.CLOCK: KindInfo(0.1, "all stamps are AMOUNT s late against the ground truth", share=1.0, start=0),
}
CAMERAS = ("both", "left", "right")
RIG_KINDS = (FaultKind.FOCAL, FaultKind.BASELINE)  #: Kinds that change the rig alone: they affect all pairs.
IMAGE_KINDS = (
    FaultKind.BLACK,
    FaultKind.START,
    FaultKind.FADE,
    FaultKind.BLURRED,
    FaultKind.EXPOSURE,
    FaultKind.NOISY,
    FaultKind.SATURATION,
    FaultKind.BLINDED,
)
"""Kinds that change single images."""
ROTATION_AXES = {FaultKind.ROLL: 2, FaultKind.PITCH: 0, FaultKind.YAW: 1, FaultKind.DRIFT: 1}
"""Axis of the optical frame about which the right camera is rotated."""
SHARES_OF_IMAGE = (
    FaultKind.TORN,
    FaultKind.SATURATION,
    FaultKind.BODY,
    FaultKind.OBJECT,
    FaultKind.DIRT,
    FaultKind.SHADOW,
)
"""Kinds whose amount is a share of the image."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One kind of fault and which pairs it affects."""

    kind: FaultKind  #: What it does.
    amount: float  #: How strong, in the unit of the kind.
    share: float = 0.1  #: Share of pairs that are affected; faults of rotation, clock and rig affect all.
    burst: int = 1  #: Consecutive pairs that are affected.
    start: int = 1  #: First pair that may be affected.
    camera: str = "both"  #: `both`, `left` or `right`, for faults of images.


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
    default = KINDS[kind]
    values: dict[str, float | int | str] = {"kind": kind, "amount": default.amount}
    values |= {"share": default.share, "burst": default.burst, "start": default.start}
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
    if kind in SHARES_OF_IMAGE and not 0 <= fault.amount <= 1:
        raise ConfigError(f"fault '{text}': amount is a share of the image and must lie in 0 .. 1")
    return fault


AMOUNTS: Final[dict[FaultKind, tuple[float, float]]] = {
    FaultKind.BODY: (0.1, 0.4),
    FaultKind.OBJECT: (0.1, 0.4),
    FaultKind.SHADOW: (0.1, 0.3),
    FaultKind.DIRT: (0.03, 0.2),
    FaultKind.ROLL: (0.05, 0.2),
    FaultKind.PITCH: (0.03, 0.1),
    FaultKind.YAW: (0.01, 0.1),
    FaultKind.DRIFT: (0.05, 0.4),
    FaultKind.BLURRED: (1.0, 5.0),
    FaultKind.BLINDED: (0.3, 1.5),
    FaultKind.EXPOSURE: (0.3, 1.8),
    FaultKind.SATURATION: (0.2, 0.9),
    FaultKind.FADE: (0.0, 0.0),
    FaultKind.NOISY: (5.0, 30.0),
    FaultKind.START: (1.0, 10.0),
    FaultKind.BLACK: (0.0, 0.0),
    FaultKind.FROZEN: (0.0, 3.0),
    FaultKind.TORN: (0.2, 0.8),
    FaultKind.REPEATED: (0.0, 0.0),
    FaultKind.IDENTICAL: (0.0, 0.0),
    FaultKind.SWAPPED: (0.0, 0.0),
    FaultKind.DROPPED: (0.0, 0.0),
}
"""Range of the amount of each kind, in the order from the scene to the receiver: view, lens, exposure, transfer.

Wrong stamps are no fault of a pose, and a wrong focal length or baseline is unobservable: neither is drawn.
"""
COUNTS: Final = (0.6, 0.3, 0.1)  #: Probability of one, two and three faults at a time.
WHOLE_DRIVE: Final = (FaultKind.BODY, FaultKind.DIRT, FaultKind.SHADOW, FaultKind.START, *ROTATION_AXES)
ONE_CAMERA: Final = (*IMAGE_KINDS, *SHARES_OF_IMAGE, FaultKind.FROZEN)  #: Kinds that may affect one camera alone.


def random_faults(rng: np.random.Generator, pairs: int) -> str:
    """Return one to three faults for a drive of some pairs, joined by `+`, in the order in which they happen."""
    count = 1 + int(rng.choice(len(COUNTS), p=COUNTS))
    kinds = sorted(rng.choice(len(AMOUNTS), count, replace=False))
    return "+".join(_random_fault(rng, list(AMOUNTS)[kind], pairs) for kind in kinds)


def _random_fault(rng: np.random.Generator, kind: FaultKind, pairs: int) -> str:
    low, high = AMOUNTS[kind]
    values = []
    if high > 0.0:
        amount = low + (high - low) * float(rng.random())
        if kind in ROTATION_AXES and rng.random() < 0.5:
            amount = -amount
        values.append(f"amount={round(amount)}" if kind is FaultKind.START else f"amount={amount:.3f}")
    if kind not in WHOLE_DRIVE:
        long = kind in (FaultKind.OBJECT, FaultKind.FADE)
        burst = int(rng.integers(10, 41)) if long else int(rng.choice((1, 1, 2, 5, 10)))
        start = int(rng.integers(1, max(2, pairs // 2)))
        values += [f"share={0.05 + 0.35 * float(rng.random()):.2f}", f"burst={burst}", f"start={start}"]
    camera = rng.choice(("both", "both", "both", "left", "right"))
    if kind in ONE_CAMERA and camera != "both":
        values.append(f"camera={camera}")
    return f"{kind}:{','.join(values)}" if values else str(kind)
