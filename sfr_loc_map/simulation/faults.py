"""Kinds of fault that are injected into stereo pairs: failures of cameras, clocks, calibrations and of the view.

A kind is declared here; what it does to images stands in `perturber.py`.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple, Self

from sfr_loc_map.errors import ConfigError


class KindInfo(NamedTuple):
    """Effect of a kind of fault and the defaults of its `Fault`."""

    amount: float
    effect: str
    share: float = 0.1
    burst: int = 1
    start: int = 1


class FaultKind(StrEnum):
    """Kinds of fault; `info` says what each does."""

    info: KindInfo

    def __new__(cls, word: str, info: KindInfo) -> Self:
        """Make a kind that is equal to its word."""
        kind = str.__new__(cls, word)
        kind._value_, kind.info = word, info
        return kind

    DROPPED = "dropped", KindInfo(0.0, "the pair is missing")
    REPEATED = "repeated", KindInfo(0.0, "the pair repeats the previous images")
    SWAPPED = "swapped", KindInfo(0.0, "left and right images are swapped")
    IDENTICAL = "identical", KindInfo(0.0, "the right image is the left one")
    FROZEN = "frozen", KindInfo(1.0, "the images stay as they were, with new noise of AMOUNT grey levels", burst=5)
    TORN = "torn", KindInfo(0.5, "the lower AMOUNT of the image is that of the pair before")
    GHOST = "ghost", KindInfo(0.5, "AMOUNT of the image is that of the pair before, as by a slow shutter")
    INTERLACED = "interlaced", KindInfo(0.0, "every second row is that of the pair before")
    BLACK = "black", KindInfo(0.0, "the image is black")
    START = "start", KindInfo(5.0, "the first AMOUNT pairs are black", share=1.0, start=0)
    FADE = "fade", KindInfo(0.0, "slow blackout: over `burst` pairs the image turns black and back", burst=20)
    BLINDED = "blinded", KindInfo(1.0, "glare: AMOUNT of the image width is saturated around a point")
    SATURATION = "saturation", KindInfo(0.5, "overexposed: AMOUNT of the image is clipped")
    LATE = "late", KindInfo(0.2, "the stamp is AMOUNT s late, but before that of the next pair")
    BLURRED = "blurred", KindInfo(2.5, "Gaussian blur of AMOUNT px")
    NOISY = "noisy", KindInfo(10.0, "noise of AMOUNT grey levels")
    EXPOSURE = "exposure", KindInfo(0.5, "brightness times AMOUNT")
    SHEAR = "shear", KindInfo(1.0, "rows are sheared by AMOUNT px, to a random side, as by a rolling shutter")
    BODY = "body", KindInfo(0.3, "own body: fixed texture in the bottom AMOUNT of the image", share=1.0, start=0)
    OBJECT = "object", KindInfo(0.3, "an object of AMOUNT of the image crosses over `burst` pairs", burst=20)
    ARM = "arm", KindInfo(0.4, "an arm over AMOUNT of the image comes in slowly over `burst` pairs", burst=20)
    TEXTURE = "texture", KindInfo(0.6, "a texture moves sideways in the bottom AMOUNT of the image", share=1.0, start=0)
    REFLECTION = (
        "reflection",
        KindInfo(0.5, "a fixed reflection of the rover has AMOUNT of the light", share=1.0, start=0),
    )
    SCRATCH = "scratch", KindInfo(0.3, "a scratched window: fixed lines over AMOUNT of the image", share=1.0, start=0)
    DIRT = "dirt", KindInfo(0.1, "dirt on the lenses: fixed spots on AMOUNT of the image", share=1.0, start=0)
    SHADOW = "shadow", KindInfo(0.2, "own shadow: a fixed dark region, AMOUNT of the image", share=1.0, start=0)
    FOCAL = "focal", KindInfo(1.01, "calibration: focal length in the rig file times AMOUNT", share=1.0, start=0)
    BASELINE = "baseline", KindInfo(1.01, "calibration: baseline in the rig file times AMOUNT", share=1.0, start=0)
    ROLL = "roll", KindInfo(0.2, "the right image is rotated by AMOUNT deg about its axis", share=1.0, start=0)
    PITCH = "pitch", KindInfo(0.1, "the right camera looks AMOUNT deg down", share=1.0, start=0)
    YAW = "yaw", KindInfo(0.1, "the right camera looks AMOUNT deg to the left", share=1.0, start=0)
    DRIFT = "drift", KindInfo(0.3, "the right camera turns AMOUNT deg to the left in 100 pairs", share=1.0, start=0)
    SHIFT = "shift", KindInfo(3.0, "the right image is AMOUNT px to the right", share=1.0, start=0)
    CLOCK = "clock", KindInfo(0.1, "all stamps are AMOUNT s late against the ground truth", share=1.0, start=0)


CAMERAS = ("both", "left", "right")
RIG_KINDS = (FaultKind.FOCAL, FaultKind.BASELINE)  #: Kinds that change the rig alone: they affect all pairs.
IMAGE_KINDS = ("black", "start", "fade", "blurred", "exposure", "noisy", "saturation", "blinded", "shear")
"""Kinds that change single images."""
ROTATION_AXES = {FaultKind.ROLL: 2, FaultKind.PITCH: 0, FaultKind.YAW: 1, FaultKind.DRIFT: 1}
"""Axis of the optical frame about which the right camera is rotated."""
SHARES_OF_IMAGE = (
    *("torn", "ghost", "saturation", "body", "object", "arm", "texture"),
    *("reflection", "scratch", "dirt", "shadow"),
)
"""Kinds whose amount is a share of the image."""
SIGNED = (*ROTATION_AXES, FaultKind.SHIFT, FaultKind.CLOCK)  #: Kinds whose amount may be below zero.
LARGEST = {"blurred": 50.0, "start": 1e9, "late": 1e6, "clock": 1e9}
LARGEST |= dict.fromkeys(SHARES_OF_IMAGE, 1.0) | dict.fromkeys(ROTATION_AXES, 45.0)
MAX_PAIRS = 10**9  #: Of a burst, and of what comes before the first.
LARGEST_AMOUNT = 1000.0  #: Of all other kinds.


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
    """Return the fault of a text `KIND[:name=value,...]`, as `blurred:share=0.2`; ConfigError if it is none."""
    name, _, rest = text.partition(":")
    kind = next((kind for kind in FaultKind if kind == name), None)
    if kind is None:
        raise ConfigError(f"fault '{text}': '{name}' is unknown; one of {', '.join(FaultKind)} is needed")
    values: dict[str, float | int | str] = {"kind": kind, **kind.info._asdict()}
    del values["effect"]
    types = {"amount": float, "share": float, "burst": int, "start": int, "camera": str}
    for item in filter(None, rest.split(",")):
        name, _, value = item.partition("=")
        try:
            values[name] = types[name](value)
        except (KeyError, ValueError) as error:
            known = ", ".join(types)
            raise ConfigError(f"fault '{text}': '{item}' must be NAME=VALUE with a name of {known}") from error
    fault = Fault(**values)  # type: ignore[arg-type]
    if not (0 <= fault.share <= 1 and 1 <= fault.burst <= MAX_PAIRS and 0 <= fault.start <= MAX_PAIRS):
        raise ConfigError(
            f"fault '{text}': share must lie in 0 .. 1, burst in 1 .. {MAX_PAIRS}, start in 0 .. {MAX_PAIRS}"
        )
    if fault.camera not in CAMERAS:
        raise ConfigError(f"fault '{text}': camera must be one of {', '.join(CAMERAS)}")
    high = LARGEST.get(kind, LARGEST_AMOUNT)
    low = -high if kind in SIGNED else 0.0
    if not low <= fault.amount <= high:
        raise ConfigError(f"fault '{text}': amount must lie in {low:g} .. {high:g}: {kind.info.effect}")
    return fault
