"""Kinds of faults that are injected into stereo pairs: failures of cameras, clocks, calibration and view.

`FaultKind` declares the effect, the options and the defaults of each kind. `injector.CHANGES` contains the function of
each kind that changes a pair. Some kinds are implemented in a further place:

- dropped pairs: `FaultInjector.__init__`
- the first pairs of a drive (`start`): `injector.burst_starts`
- faults of the calibration (`focal`, `baseline`): `FaultInjector.rig`
- faults of the stamps (`late`, `clock`): `images.stamp_with_fault` and `images.following_stamp`
- repeated images (`repeated`, `frozen`): `injector.REPEATING`
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple, Self

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.message_text import alternatives

PAIR_OPTIONS = ("share", "burst", "start")  #: Options that select the affected pairs.
APPLIES_TO: dict[str, str] = {
    "amount": "faults with a strength",
    "share": "faults of single pairs",
    "burst": "faults of single pairs",
    "start": "faults of single pairs and drift",
    "camera": "faults of the images of one camera",
}
"""Faults to which each option of a fault applies."""
ALL_OPTIONS = tuple(APPLIES_TO)


class KindInfo(NamedTuple):
    """Effect of a kind of fault, the defaults of `Fault`, and the limits of the user's values."""

    amount: float
    effect: str
    neutral: float | None  #: Amount that has no effect; None if every amount has an effect.
    share: float = 0.1
    burst: int = 1
    start: int = 1
    max_amount: float = 1000.0  #: Maximum amount.
    is_signed: bool = False  #: Whether the amount may be negative.
    options: tuple[str, ...] = ALL_OPTIONS  #: Options that have an effect.
    has_complete_bursts: bool = False  #: Whether a burst begins only if it can end within the sequence.


def _pairs(effect: str) -> KindInfo:
    """Faults of both images of single pairs, without a strength."""
    return KindInfo(0.0, effect, None, options=PAIR_OPTIONS)


def _images(effect: str) -> KindInfo:
    """Faults of the images of one or both cameras, without a strength."""
    return KindInfo(0.0, effect, None, options=(*PAIR_OPTIONS, "camera"))


def _strength(
    amount: float, effect: str, max_amount: float = 1000.0, burst: int = 1, neutral: float | None = 0.0
) -> KindInfo:
    """Faults of the images of one or both cameras with a strength."""
    return KindInfo(amount, effect, neutral, burst=burst, max_amount=max_amount)


def _episode(amount: float, effect: str) -> KindInfo:
    """Faults that cover a fraction of the image and begin and end within a burst."""
    return KindInfo(amount, effect, 0.0, burst=20, max_amount=1.0, has_complete_bursts=True)


def _fixed_region(amount: float, effect: str, max_amount: float = 1.0) -> KindInfo:
    """Faults of a region of the image in all pairs of a drive."""
    return KindInfo(amount, effect, 0.0, share=1.0, start=0, max_amount=max_amount)


def _all_pairs(amount: float, effect: str, max_amount: float, options: tuple[str, ...] = ("amount",)) -> KindInfo:
    """Faults of all pairs with an amount of any sign."""
    return KindInfo(amount, effect, 0.0, share=1.0, start=0, max_amount=max_amount, is_signed=True, options=options)


def _factor(amount: float, effect: str) -> KindInfo:
    """Factors on a number of the rig file."""
    return KindInfo(amount, effect, 1.0, share=1.0, start=0, options=("amount",))


class FaultKind(StrEnum):
    """Kinds of faults; `info` describes their effects."""

    info: KindInfo

    def __new__(cls, word: str, info: KindInfo) -> Self:
        """Create a kind that is equal to its name."""
        kind = str.__new__(cls, word)
        kind._value_, kind.info = word, info
        return kind

    # fmt: off
    DROPPED = "dropped", _pairs("the pair is missing")
    REPEATED = "repeated", _pairs("the pair repeats the previous images")
    SWAPPED = "swapped", _pairs("left and right images are swapped")
    IDENTICAL = "identical", _pairs("the right image is a copy of the left image")
    LATE = "late", KindInfo(
        0.2, "the stamp is AMOUNT s late, but before the next stamp", 0.0, max_amount=1e6,
        options=("amount", *PAIR_OPTIONS),
    )

    BLACK = "black", _images("the image is black")
    INTERLACED = "interlaced", _images("every second row is from the previous pair")
    START = "start", KindInfo(
        5.0, "the first AMOUNT pairs are black", 0.0, share=1.0, start=0, max_amount=1e9, options=("amount", "camera")
    )
    FROZEN = "frozen", _strength(
        1.0, "the previous images are shown with new noise of AMOUNT grey levels", burst=5, neutral=None
    )
    TORN = "torn", _strength(0.5, "the lower fraction AMOUNT of the image is from the previous pair", max_amount=1.0)
    GHOST = "ghost", _strength(0.5, "the previous image is blended in with weight AMOUNT", max_amount=1.0)
    SATURATION = "saturation", _strength(
        0.5, "overexposure: a fraction AMOUNT of the image is clipped", max_amount=1.0, neutral=None
    )
    BLINDED = "blinded", _strength(1.0, "glare: a spot, AMOUNT image widths wide, is saturated")
    BLURRED = "blurred", _strength(2.5, "Gaussian blur of AMOUNT px", max_amount=50.0)
    NOISY = "noisy", _strength(10.0, "Gaussian noise of AMOUNT grey levels")
    EXPOSURE = "exposure", _strength(0.5, "brightness times AMOUNT", neutral=1.0)
    SHEAR = "shear", _strength(1.0, "rows are sheared by AMOUNT px in a random direction, as by a rolling shutter")

    FADE = "fade", KindInfo(
        0.0, "slow blackout: over `burst` pairs the image turns black and back", None, burst=20,
        has_complete_bursts=True, options=(*PAIR_OPTIONS, "camera"),
    )
    OBJECT = "object", _episode(0.3, "an object that covers a fraction AMOUNT of the image crosses it in `burst` pairs")
    ARM = "arm", _episode(0.4, "an arm slowly covers a fraction AMOUNT of the image over `burst` pairs")

    BODY = "body", _fixed_region(0.3, "own body: fixed texture in the bottom fraction AMOUNT of the image")
    TEXTURE = "texture", _fixed_region(0.6, "a texture moves sideways in the bottom fraction AMOUNT of the image")
    REFLECTION = "reflection", _fixed_region(0.5, "a fixed reflection of the rover, fraction AMOUNT of the light")
    SCRATCH = "scratch", _fixed_region(0.3, "scratched window: fixed lines over a fraction AMOUNT of the image", 0.9)
    DIRT = "dirt", _fixed_region(0.1, "dirt on the lenses: fixed spots on a fraction AMOUNT of the image")
    SHADOW = "shadow", _fixed_region(0.2, "own shadow: a fixed dark region over a fraction AMOUNT of the image")

    FOCAL = "focal", _factor(1.01, "calibration: focal length in the rig file times AMOUNT")
    BASELINE = "baseline", _factor(1.01, "calibration: baseline in the rig file times AMOUNT")
    ROLL = "roll", _all_pairs(0.2, "the right camera is rotated by AMOUNT deg about its optical axis", 45.0)
    PITCH = "pitch", _all_pairs(0.1, "the right camera is pitched down by AMOUNT deg", 45.0)
    YAW = "yaw", _all_pairs(0.1, "the right camera is turned to the left by AMOUNT deg", 45.0)
    DRIFT = "drift", _all_pairs(
        0.3, "from `start` on, the right camera turns to the left, AMOUNT deg in 100 pairs", 45.0, ("amount", "start")
    )
    SHIFT = "shift", _all_pairs(3.0, "the right image is shifted to the right by AMOUNT px", 1000.0)
    CLOCK = "clock", _all_pairs(0.1, "all stamps are AMOUNT s late relative to the ground truth", 1e9)
    # fmt: on


CAMERAS = ("both", "left", "right")
MAX_PAIRS = 10**9  #: Largest `burst` and `start`.


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault and the pairs that it affects."""

    kind: FaultKind  #: Effect of the fault.
    amount: float  #: Strength, in the unit of the kind.
    share: float  #: Fraction of the pairs that is affected; 1 if the kind has no such option.
    burst: int  #: Number of consecutive pairs that are affected.
    start: int  #: First pair that may be affected.
    camera: str = "both"  #: `both`, `left` or `right`, for faults of images.


def parse_fault(text: str) -> Fault:
    """Parse a fault `KIND[:name=value,...]`, such as `blurred:share=0.2`; ConfigError if the text is invalid."""
    kind_name, _, options = text.partition(":")
    kind = next((kind for kind in FaultKind if kind == kind_name), None)
    if kind is None:
        raise ConfigError(f"fault '{text}': kind '{kind_name}' is unknown; give one of {', '.join(FaultKind)}")
    info = kind.info
    values: dict[str, float | int | str] = {"kind": kind, "amount": info.amount, "share": info.share}
    values |= {"burst": info.burst, "start": info.start}
    types = {"amount": float, "share": float, "burst": int, "start": int, "camera": str}
    for item in filter(None, options.split(",")):
        name, _, value = item.partition("=")
        if name not in types:
            raise ConfigError(f"fault '{text}': unknown option '{item}': give {alternatives(types)}, as NAME=VALUE")
        try:
            values[name] = types[name](value)
        except ValueError as error:
            kind_of_number = "a whole number" if types[name] is int else "a number"
            raise ConfigError(f"fault '{text}': {name} is '{value}': {kind_of_number} is required") from error
        if name not in info.options:
            raise ConfigError(
                f"fault '{text}': '{name}' applies to {APPLIES_TO[name]}, not to {kind}, which has the options "
                f"{', '.join(info.options)}"
            )
    fault = Fault(**values)  # type: ignore[arg-type]
    bounds = {"share": (0, 1, ""), "burst": (1, MAX_PAIRS, " pairs"), "start": (0, MAX_PAIRS, " pairs")}
    for name, (lowest, highest, unit) in bounds.items():
        number = getattr(fault, name)
        if not lowest <= number <= highest:
            raise ConfigError(f"fault '{text}': {name} is {number:g}: {lowest} to {highest}{unit} is required")
    if fault.camera not in CAMERAS:
        raise ConfigError(f"fault '{text}': camera is '{fault.camera}': one of {', '.join(CAMERAS)} is required")
    high = kind.info.max_amount
    low = -high if kind.info.is_signed else 0.0
    if not low <= fault.amount <= high:
        raise ConfigError(
            f"fault '{text}': amount is {fault.amount:g}: {low:g} to {high:g} is required ({kind.info.effect})"
        )
    return fault


def with_amount(text: str, amount: float) -> str:
    """Append an amount to the text of a fault: `blurred:share=0.3` becomes `blurred:share=0.3,amount=2.5`.

    ConfigError if the text already has an amount, which would have no effect.
    """
    options = text.partition(":")[2].split(",")
    if any(option.partition("=")[0] == "amount" for option in options):
        raise ConfigError(f"fault '{text}': its amount would be replaced by another one: omit 'amount'")
    return f"{text}{',' if ':' in text else ':'}amount={amount:.9g}"
