"""Is the right camera where its calibration says? What the runs over a recording estimate of its rotation.

The localiser estimates pitch and roll of the right camera from vertical disparities, and its yaw from disparities that
change as the rover moves. Each run gives one value, the median of the second half of its pairs. A calibration file is
wrong where the interval of the runs excludes zero and the offset is large. The baseline cannot be seen in a recording.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from sfr_loc_map.evidence.variants import Run
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.metrics.config import label_of
from sfr_loc_map.metrics.intervals import student_quantile
from sfr_loc_map.metrics.table import Figure, figure_row
from sfr_loc_map.report.tables import Cell, Column, Table, Unit

ANGLES = {"pitch": "vertical_offset_px", "roll": "roll_offset_px", "yaw": "disparity_offset_px"}
"""Statistic of the localiser by the angle that causes it."""
NAMES = {"right_camera": "right camera, ", "depth_error": "error of depth ", "scale": "excess of length, "}
"""Figures of the table of the calibration, and how their names begin."""
LARGE_PX = 0.2  #: Smaller offsets are corrected on the way and cost less than matching noise (chosen).
RANGE_M = 4.0  #: Range at which the error of depth is stated.


class CameraOffset(NamedTuple):
    """Offset of the right camera about one axis; its interval is that of the mean over the runs."""

    angle: str
    runs: int
    px: float
    low_px: float
    high_px: float
    degrees: float
    depth_error_m: float | None  #: Of a point at RANGE_M, by the calibration file as it is; None but for yaw.

    @property
    def is_wrong(self) -> bool:
        """Whether the calibration file should be redone."""
        return self.low_px * self.high_px > 0.0 and abs(self.px) >= LARGE_PX

    @property
    def text(self) -> str:
        """What is wrong, in words."""
        cost = (
            "" if self.depth_error_m is None else f", which moves points at {RANGE_M:g} m by {self.depth_error_m:.2g} m"
        )
        offset = f"the right camera is off by {self.px:.2f} px in {self.angle} ({self.degrees:.3f} deg)"
        return f"{offset}{cost}: calibrate the cameras again"


def right_camera_offsets(runs: Sequence[Run], rig: StereoRig) -> list[CameraOffset]:
    """Return the offset about each axis that at least two runs have estimated."""
    found = []
    for angle, statistic in ANGLES.items():
        values = [value for run in runs if (value := settled(run, statistic)) is not None]
        if len(values) < 2:
            continue
        mean, sigma = float(np.mean(values)), float(np.std(values, ddof=1))
        half = student_quantile(0.975, len(values) - 1.0) * sigma / np.sqrt(len(values))
        depth_m = RANGE_M**2 * abs(mean) / (rig.fx * rig.baseline_m) if angle == "yaw" else None
        degrees = float(np.degrees(np.arctan2(mean, rig.fx)))
        found.append(CameraOffset(angle, len(values), mean, mean - half, mean + half, degrees, depth_m))
    return found


def settled(run: Run, statistic: str) -> float | None:
    """Return the median of a statistic over the second half of a run."""
    values = [getattr(item, statistic) for item in run.statistics[len(run.statistics) // 2 :]]
    known = [value for value in values if value is not None]
    return float(np.median(known)) if known else None


def offset_rows(offset: CameraOffset) -> Iterator[Figure]:
    """Yield the rows of an offset."""
    low, high = offset.low_px, offset.high_px
    yield figure_row("right_camera", part=offset.angle, n=offset.runs, value=offset.px, low95=low, high95=high)
    if offset.depth_error_m is not None:
        yield figure_row("depth_error", part=f"at {RANGE_M:g} m", n=offset.runs, value=offset.depth_error_m)


def calibration_table(figures: Sequence[Figure]) -> Table:
    """Return the offsets of the right camera as a table."""
    rows = []
    for place, row in enumerate(figures):
        if row.figure in NAMES:
            over = f" over {label_of(row.condition)}" if row.condition else ""
            name = f"{NAMES[row.figure]}{row.part}{over}"
            cell = Cell.number(row.value, f"figures.{place}.value")
            interval = Cell.interval(row.interval, f"figures.{place}", Unit())
            rows.append((Cell.head(name), Cell(row.unit), cell, interval, Cell.number(row.n, f"figures.{place}.n")))
    columns = (
        Column("calibration", words=True),
        Column("unit"),
        Column("value"),
        Column("95 % interval"),
        Column("runs"),
    )
    note = (
        "Against the calibration file. Interval of the mean over the runs, which share their images. A wrong baseline "
        "or focal length does not show in a recording without a truth or wheels."
    )
    return Table("calibration", "Calibration of the right camera", columns, tuple(rows), note)
