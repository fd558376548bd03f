"""Rotation of the right camera relative to its calibration, as estimated by the runs over a recording.

The localiser estimates pitch and roll of the right camera from vertical disparities, and its yaw from disparities that
change as the rover moves. Each run gives one value, the median over the second half of its pairs. The runs share their
images, so that their values are not independent samples and have no confidence interval. The calibration should be
repeated if all runs agree on the sign of a large offset. The effect of the offset is measured by an additional run
with the right images rotated back. The baseline is unobservable.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from sfr_loc_map.evidence.agreement import Agreement
from sfr_loc_map.evidence.localiser_runs import ComparedRun, PairsInMemory
from sfr_loc_map.faults.images import rotated
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.metrics import formulas
from sfr_loc_map.metrics.figures.rows import Figure, figure_row

ANGLES = {"pitch": "vertical_offset_px", "roll": "roll_offset_px", "yaw": "disparity_offset_px"}
"""Statistic of the localiser by the angle that causes it."""
AXES = {"pitch": (0, -1.0), "roll": (2, 1.0), "yaw": (1, -1.0)}
"""Axis of the optical frame and sign of the rotation that corrects an offset, by angle."""
LARGE_PX = 0.2  #: Minimum of a large offset; smaller ones matter less than matching noise (chosen by hand).
RANGE_M = 4.0  #: Range at which the depth error is reported.


class Advice(StrEnum):
    """Recommended action for the calibration file, from the offset about one axis. The JSON contains this word."""

    REDO = "redo"
    KEEP = "keep"
    UNCLEAR = "unclear"  #: The runs disagree on whether the offset is large, or a yaw is insignificant or small.


class CameraOffset(NamedTuple):
    """Offset of the right camera about one axis."""

    angle: str
    runs: int
    px: float  #: Mean over the runs.
    low_px: float  #: Lowest value of a run.
    high_px: float  #: Highest value of a run.
    degrees: float
    depth_error_m: float | None = None  #: Depth error at RANGE_M with the calibration file; None if no yaw is wrong.

    @property
    def advice(self) -> Advice:
        """Recommended action for the calibration file.

        The localiser reports a yaw of 0 until the yaw is significant, so a small yaw does not prove that the file is
        correct.
        """
        if self.low_px * self.high_px > 0.0 and abs(self.px) >= LARGE_PX:
            return Advice.REDO
        if self.angle == "yaw":
            return Advice.UNCLEAR
        return Advice.KEEP if max(-self.low_px, self.high_px) < LARGE_PX else Advice.UNCLEAR

    @property
    def is_wrong(self) -> bool:
        """Whether the calibration should be repeated."""
        return self.advice is Advice.REDO

    @property
    def text(self) -> str:
        """Description of the offset."""
        cost = (
            "" if self.depth_error_m is None else f", which moves points at {RANGE_M:g} m by {self.depth_error_m:.2g} m"
        )
        offset = f"the right camera is off by {self.px:.2f} px in {self.angle} ({self.degrees:.3f} deg)"
        return f"{offset}{cost}: calibrate the cameras again"


def right_camera_offsets(runs: Sequence[ComparedRun], rig: StereoRig) -> list[CameraOffset]:
    """Return the offset about each axis that at least two runs have estimated."""
    found = []
    for angle, statistic in ANGLES.items():
        values = [value for run in runs if (value := settled(run, statistic)) is not None]
        if len(values) < 2:
            continue
        mean = float(np.mean(values))
        degrees = float(np.degrees(np.arctan2(mean, rig.fx)))
        offset = CameraOffset(angle, len(values), mean, min(values), max(values), degrees)
        if angle == "yaw" and offset.is_wrong:
            offset = offset._replace(depth_error_m=RANGE_M**2 * abs(mean) / (rig.fx * rig.baseline_m))
        found.append(offset)
    return found


def settled(run: ComparedRun, statistic: str) -> float | None:
    """Return the median of a statistic over the second half of a run."""
    values = [getattr(item, statistic) for item in run.statistics[len(run.statistics) // 2 :]]
    known = [value for value in values if value is not None]
    return float(np.median(known)) if known else None


def offset_rows(offset: CameraOffset) -> Iterator[Figure]:
    """Yield the rows of an offset."""
    yield figure_row("right_camera", part=offset.angle, n=offset.runs, value=offset.px)
    spread_px = offset.high_px - offset.low_px
    yield figure_row("right_camera_spread", part=offset.angle, n=offset.runs, value=spread_px)
    if offset.angle == "yaw":
        yield figure_row("depth_error", part=f"at {RANGE_M:g} m", n=offset.runs, value=offset.depth_error_m)


def corrected_drive(drive: PairsInMemory, offsets: Sequence[CameraOffset]) -> PairsInMemory:
    """Return a drive whose right images are rotated back by the offsets, so that they agree with the calibration."""
    pairs = list(drive.kept)
    for offset in offsets:
        axis, sign = AXES[offset.angle]
        pairs = [replace(pair, right=rotated(pair.right, axis, sign * offset.degrees, drive.rig)) for pair in pairs]
    return replace(drive, kept=pairs)


def cost_row(offsets: Sequence[CameraOffset], agreement: Agreement) -> Figure:
    """Return how the correction of the offsets changes the positions, from the runs with and without it."""
    moved = formulas.statistics(agreement.position_m)
    part = " and ".join(offset.angle for offset in offsets)
    return figure_row("calibration_cost", agreement.condition, part, n=moved.n, value=moved.rmse)
