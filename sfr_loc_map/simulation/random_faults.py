"""Random faults: what may happen to a rover's cameras, drawn from a seed."""

from __future__ import annotations

from typing import Final

import numpy as np

from sfr_loc_map.simulation.faults import SHARES_OF_IMAGE, FaultKind
from sfr_loc_map.simulation.image_faults import IMAGE_FAULTS, ROTATION_AXES

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
COUNTS: Final = (0.6, 0.3, 0.1)
"""Probability of one, two and three faults at a time."""
WHOLE_DRIVE: Final = (FaultKind.BODY, FaultKind.DIRT, FaultKind.SHADOW, FaultKind.START, *ROTATION_AXES)
ONE_CAMERA: Final = (*IMAGE_FAULTS, *SHARES_OF_IMAGE, FaultKind.FROZEN)
"""Kinds that may affect one camera alone."""


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
