"""Kinds of faults that are injected into stereo pairs: failures of cameras, clocks, calibration and view.

`FaultKind` has one row for each kind: its effect, how its pairs are selected, its options with their defaults and
limits, and the functions that change the images, the stamp or the rig.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, StrEnum, auto
from typing import NamedTuple, Self

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.faults import images, views
from sfr_loc_map.faults.images import Change
from sfr_loc_map.faults.stamps_and_rig import (
    RigChange,
    StampChange,
    late_stamp,
    moved_stamp,
    same_rig,
    same_stamp,
    with_baseline_factor,
    with_focal_factor,
)
from sfr_loc_map.message_text import alternatives

CAMERAS = ("both", "left", "right")
LAST_INDEX = 10**9  #: Largest `burst` and `start`, pairs. No source has as many.


class Option(NamedTuple):
    """An option of a fault."""

    parse: type[float] | type[int] | type[str]
    applies_to: str  #: Faults to which the option applies.
    limits: tuple[float, float] | None = None  #: None for a text, and for the amount, whose limits depend on the kind.
    unit: str = ""  #: Unit of the limits in a message.


OPTIONS = {
    "amount": Option(float, "faults with a strength"),
    "share": Option(float, "faults of single pairs", (0.0, 1.0)),
    "burst": Option(int, "faults of single pairs", (1, LAST_INDEX), " pairs"),
    "start": Option(int, "faults of single pairs and drift", (0, LAST_INDEX), " pairs"),
    "camera": Option(str, "faults of the images of one camera"),
}
"""Options of faults by name."""
ALL_OPTIONS = tuple(OPTIONS)
PAIR_OPTIONS = ("share", "burst", "start")  #: Options that select the affected pairs.


class Selection(Enum):
    """How the affected pairs of a drive are selected."""

    BURSTS = auto()  #: Bursts of `burst` pairs from the pair `start` on, until `share` of these pairs is affected.
    #: As `BURSTS`, but a burst is not shortened to `share`, and begins only if the drive contains all its pairs. If
    #: fewer than `burst` pairs remain from `start` on, the burst begins at `start` and ends with the drive.
    COMPLETE_BURSTS = auto()
    FIRST_PAIRS = auto()  #: The first `amount` pairs.
    ALL_PAIRS = auto()  #: All pairs.


class KindInfo(NamedTuple):
    """Effect of a kind of fault, its options with their defaults and limits, and its functions."""

    effect: str
    amount: float = 0.0  #: Default strength; 0 if the kind has no strength.
    neutral: float | None = None  #: Amount that has no effect; None if every amount has an effect.
    min_amount: float = 0.0
    max_amount: float = 1000.0
    selection: Selection = Selection.BURSTS  #: How the affected pairs are selected.
    options: tuple[str, ...] = ALL_OPTIONS  #: Options that have an effect.
    share: float = 0.1  #: Default.
    burst: int = 1  #: Default.
    start: int = 1  #: Default.
    change: Change = images.unchanged  #: Changes the images of an affected pair.
    stamp: StampChange = same_stamp  #: Changes the stamp of an affected pair.
    rig: RigChange = same_rig  #: Changes the rig of the drive.
    drops: bool = False  #: Whether affected pairs are missing.
    #: Whether affected pairs show the images of an earlier pair, so that no later pair shows them.
    repeats: bool = False

    @property
    def is_signed(self) -> bool:
        """Whether the amount may be negative."""
        return self.min_amount < 0.0


def _fixed_region(*, effect: str, amount: float, change: Change, max_amount: float = 1.0) -> KindInfo:
    """Describe a kind that changes a region of the image, by default in all pairs of a drive."""
    return KindInfo(effect=effect, amount=amount, neutral=0.0, max_amount=max_amount, share=1.0, start=0, change=change)


def _all_pairs(
    *,
    effect: str,
    amount: float,
    neutral: float = 0.0,
    min_amount: float,
    max_amount: float,
    options: tuple[str, ...] = ("amount",),
    change: Change = images.unchanged,
    stamp: StampChange = same_stamp,
    rig: RigChange = same_rig,
) -> KindInfo:
    """Describe a kind that affects all pairs: the right camera, the clock or the rig file."""
    return KindInfo(
        effect=effect,
        amount=amount,
        neutral=neutral,
        min_amount=min_amount,
        max_amount=max_amount,
        selection=Selection.ALL_PAIRS,
        options=options,
        share=1.0,
        start=0,
        change=change,
        stamp=stamp,
        rig=rig,
    )


class FaultKind(StrEnum):
    """Kinds of faults; `info` describes them."""

    info: KindInfo

    def __new__(cls, word: str, info: KindInfo) -> Self:
        """Create a kind that is equal to its name."""
        kind = str.__new__(cls, word)
        kind._value_ = word
        kind.info = info
        return kind

    # fmt: off
    DROPPED = "dropped", KindInfo(effect="the pair is missing", options=PAIR_OPTIONS, drops=True)
    REPEATED = "repeated", KindInfo(
        effect="the pair repeats the previous images",
        options=PAIR_OPTIONS, change=images.repeated, repeats=True,
    )
    SWAPPED = "swapped", KindInfo(
        effect="left and right images are swapped",
        options=PAIR_OPTIONS, change=images.swapped,
    )
    IDENTICAL = "identical", KindInfo(
        effect="the right image is a copy of the left image",
        options=PAIR_OPTIONS, change=images.identical,
    )
    LATE = "late", KindInfo(
        effect="the stamp is AMOUNT s late, but before the next stamp",
        amount=0.2, neutral=0.0, max_amount=1e6, options=("amount", *PAIR_OPTIONS), stamp=late_stamp,
    )

    BLACK = "black", KindInfo(effect="the image is black", options=(*PAIR_OPTIONS, "camera"), change=images.black)
    INTERLACED = "interlaced", KindInfo(
        effect="every second row is from the previous pair",
        options=(*PAIR_OPTIONS, "camera"), change=images.interlaced,
    )
    START = "start", KindInfo(
        effect="the first AMOUNT pairs are black",
        amount=5.0, neutral=0.0, max_amount=1e9, selection=Selection.FIRST_PAIRS, options=("amount", "camera"),
        share=1.0, start=0, change=images.black,
    )
    FROZEN = "frozen", KindInfo(
        effect="the previous images are shown with new noise of AMOUNT grey levels",
        amount=1.0, burst=5, change=images.frozen, repeats=True,
    )
    TORN = "torn", KindInfo(
        effect="the lower fraction AMOUNT of the image is from the previous pair",
        amount=0.5, neutral=0.0, max_amount=1.0, change=images.torn,
    )
    GHOST = "ghost", KindInfo(
        effect="the previous image is blended in with weight AMOUNT",
        amount=0.5, neutral=0.0, max_amount=1.0, change=images.ghost,
    )
    SATURATION = "saturation", KindInfo(
        effect="overexposure: a fraction AMOUNT of the image is clipped",
        amount=0.5, max_amount=1.0, change=images.saturated,
    )
    BLINDED = "blinded", KindInfo(
        effect="glare: a spot, AMOUNT image widths wide, is saturated",
        amount=1.0, neutral=0.0, change=images.blinded,
    )
    BLURRED = "blurred", KindInfo(
        effect="Gaussian blur of AMOUNT px",
        amount=2.5, neutral=0.0, max_amount=50.0, change=images.blurred,
    )
    NOISY = "noisy", KindInfo(
        effect="Gaussian noise of AMOUNT grey levels",
        amount=10.0, neutral=0.0, change=images.noisy,
    )
    EXPOSURE = "exposure", KindInfo(
        effect="brightness times AMOUNT",
        amount=0.5, neutral=1.0, change=images.exposed,
    )
    SHEAR = "shear", KindInfo(
        effect="rows are sheared by AMOUNT px in a random direction, as by a rolling shutter",
        amount=1.0, neutral=0.0, change=images.sheared,
    )

    FADE = "fade", KindInfo(
        effect="slow blackout: over `burst` pairs the image turns black and back",
        selection=Selection.COMPLETE_BURSTS, options=(*PAIR_OPTIONS, "camera"), burst=20, change=images.faded,
    )
    OBJECT = "object", KindInfo(
        effect="an object that covers a fraction AMOUNT of the image crosses it in `burst` pairs",
        amount=0.3, neutral=0.0, max_amount=1.0, selection=Selection.COMPLETE_BURSTS, burst=20,
        change=views.with_object,
    )
    ARM = "arm", KindInfo(
        effect="an arm slowly covers a fraction AMOUNT of the image over `burst` pairs",
        amount=0.4, neutral=0.0, max_amount=1.0, selection=Selection.COMPLETE_BURSTS, burst=20, change=views.with_arm,
    )

    BODY = "body", _fixed_region(
        effect="own body: fixed texture in the bottom fraction AMOUNT of the image",
        amount=0.3, change=views.with_body,
    )
    TEXTURE = "texture", _fixed_region(
        effect="a texture moves sideways in the bottom fraction AMOUNT of the image",
        amount=0.6, change=views.with_texture,
    )
    REFLECTION = "reflection", _fixed_region(
        effect="a fixed reflection of the rover, fraction AMOUNT of the light",
        amount=0.5, change=views.with_reflection,
    )
    SCRATCH = "scratch", _fixed_region(
        effect="scratched window: fixed lines over a fraction AMOUNT of the image",
        amount=0.3, max_amount=0.9, change=views.with_scratches,
    )
    DIRT = "dirt", _fixed_region(
        effect="dirt on the lenses: fixed spots on a fraction AMOUNT of the image",
        amount=0.1, change=views.with_dirt,
    )
    SHADOW = "shadow", _fixed_region(
        effect="own shadow: a fixed dark region over a fraction AMOUNT of the image",
        amount=0.2, change=views.with_shadow,
    )

    FOCAL = "focal", _all_pairs(
        effect="calibration: focal length in the rig file times AMOUNT",
        amount=1.01, neutral=1.0, min_amount=0.001, max_amount=1000.0, rig=with_focal_factor,
    )
    BASELINE = "baseline", _all_pairs(
        effect="calibration: baseline in the rig file times AMOUNT",
        amount=1.01, neutral=1.0, min_amount=0.001, max_amount=1000.0, rig=with_baseline_factor,
    )
    # Positive amounts of yaw, drift and pitch turn the camera to the left and down. The angles that the mapper measures
    # (`CameraRotation`) have the opposite sign. The signs of roll are equal.
    ROLL = "roll", _all_pairs(
        effect="the right camera is rotated by AMOUNT deg about its optical axis",
        amount=0.2, min_amount=-45.0, max_amount=45.0, change=images.rolled,
    )
    PITCH = "pitch", _all_pairs(
        effect="the right camera is pitched down by AMOUNT deg",
        amount=0.1, min_amount=-45.0, max_amount=45.0, change=images.pitched,
    )
    YAW = "yaw", _all_pairs(
        effect="the right camera is turned to the left by AMOUNT deg",
        amount=0.1, min_amount=-45.0, max_amount=45.0, change=images.yawed,
    )
    DRIFT = "drift", _all_pairs(
        effect="from `start` on, the right camera turns to the left, AMOUNT deg in 100 pairs",
        amount=0.3, min_amount=-45.0, max_amount=45.0, options=("amount", "start"), change=images.drifting,
    )
    SHIFT = "shift", _all_pairs(
        effect="the right image is shifted to the right by AMOUNT px",
        amount=3.0, min_amount=-1000.0, max_amount=1000.0, change=images.shifted,
    )
    CLOCK = "clock", _all_pairs(
        effect="all stamps are AMOUNT s late relative to the ground truth",
        amount=0.1, min_amount=-1e9, max_amount=1e9, stamp=moved_stamp,
    )
    # fmt: on


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
    values: dict[str, float | int | str] = {}
    for item in filter(None, options.split(",")):
        name, _, value = item.partition("=")
        if name not in OPTIONS:
            raise ConfigError(f"fault '{text}': unknown option '{item}': give {alternatives(OPTIONS)}, as NAME=VALUE")
        option = OPTIONS[name]
        try:
            values[name] = option.parse(value)
        except ValueError as error:
            kind_of_number = "a whole number" if option.parse is int else "a number"
            raise ConfigError(f"fault '{text}': {name} is '{value}': {kind_of_number} is required") from error
        if name not in info.options:
            raise ConfigError(
                f"fault '{text}': '{name}' applies to {option.applies_to}, not to {kind}, which has the options "
                f"{', '.join(info.options)}"
            )
    defaults = {"amount": info.amount, "share": info.share, "burst": info.burst, "start": info.start, "camera": "both"}
    fault = Fault(kind, **{**defaults, **values})  # type: ignore[arg-type]
    for name, option in OPTIONS.items():
        if option.limits is None:
            continue
        low, high = option.limits
        number = getattr(fault, name)
        if not low <= number <= high:
            raise ConfigError(f"fault '{text}': {name} is {number:g}: {low:g} to {high:.10g}{option.unit} is required")
    if fault.camera not in CAMERAS:
        raise ConfigError(f"fault '{text}': camera is '{fault.camera}': one of {', '.join(CAMERAS)} is required")
    if not info.min_amount <= fault.amount <= info.max_amount:
        raise ConfigError(
            f"fault '{text}': amount is {fault.amount:g}: {info.min_amount:g} to {info.max_amount:g} is required "
            f"({info.effect})"
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
