"""Plot of paths: view from above, height, and distance to the truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sfr_loc_map.atomic import write_text
from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.metrics.config import AlignedErrorConfig
from sfr_loc_map.metrics.trajectory.aligned_error import aligned_poses
from sfr_loc_map.report.plots import COLORS, Plot, Trace, axis, error_scale, line, plain, scaled, to_figure

TIME = "time, s"
MOST_POINTS = 5000  #: Maximum number of drawn poses of a path.


class Curve(NamedTuple):
    """One path: seconds since the first stamp of all paths, positions `(N, 3)` in m, distance to the truth if known."""

    name: str
    colour: str  #: `@` and a name of the palette; `@truth` only for the truth.
    seconds: FloatArray
    positions: FloatArray
    error_m: FloatArray | None = None


def curves_of(
    trajectories: Mapping[str, Trajectory], truth: Trajectory | None, config: AlignedErrorConfig
) -> list[Curve]:
    """Return trajectories as curves. A given truth is the first curve, and each trajectory is aligned with the truth.

    Raises MetricsError if a trajectory has no poses, or no stamps near those of the truth.
    """
    given = [poses for poses in (*trajectories.values(), truth) if poses is not None and len(poses)]
    if len(given) < len(trajectories) + (truth is not None) or not given:
        raise MetricsError("a trajectory without poses cannot be drawn: omit it")
    begin_ns = min(int(poses.stamps_ns.min()) for poses in given)
    drawn: list[tuple[str, str, Trajectory, FloatArray | None]] = []
    if truth is not None:
        drawn.append(("truth", "@truth", truth, None))
    for (name, poses), colour in zip(trajectories.items(), cycle(COLORS), strict=False):
        paired = None if truth is None else aligned_poses(poses, truth, config)
        shown = (poses, None) if paired is None else (paired.estimate, paired.errors_m())
        drawn.append((name, colour, *shown))
    curves = []
    for name, colour, poses, error_m in drawn:
        every = slice(None, None, max(1, -(-len(poses) // MOST_POINTS)))
        seconds = ((poses.stamps_ns[every] - begin_ns) / NS_PER_S).astype(np.float64)
        error_m = None if error_m is None else error_m[every]
        curves.append(Curve(name, colour, seconds, poses.positions[every], error_m))
    return curves


def path_plot(curves: Sequence[Curve]) -> Plot:
    """Return the plot of paths."""
    factor, unit = error_scale(
        max((float(each.error_m.max()) for each in curves if each.error_m is not None), default=0.0)
    )
    data: list[Trace] = []
    for k, curve in enumerate(curves):
        width = 3 if curve.colour == "@truth" else 2
        style: dict[str, Any] = {"color": curve.colour, "width": width, "legendgroup": str(k)}
        name = plain(curve.name)
        x, y, z = (scaled(column.tolist(), 1.0) for column in curve.positions.T)
        seconds = scaled(curve.seconds.tolist(), 1.0)
        data.append(line(name, (x, y), **style))
        data.append(line(name, (seconds, z), **style, xaxis="x2", yaxis="y2", showlegend=False))
        if curve.error_m is not None:
            error = scaled(curve.error_m.tolist(), factor)
            data.append(line(name, (seconds, error), **style, xaxis="x3", yaxis="y3", showlegend=False))
    errors = any(curve.error_m is not None for curve in curves)
    split = (0.38, 0.2) if errors else (0.28, 0.0)
    layout: dict[str, Any] = {
        "xaxis": axis("x of DS (east), m", anchor="y"),
        "yaxis": axis("y of DS (north), m", scaleanchor="x", scaleratio=1, domain=[split[0] + 0.14, 1.0]),
        "xaxis2": axis("" if errors else TIME, anchor="y2"),
        "yaxis2": axis("z of DS (up), m", domain=[split[1] + (0.06 if errors else 0.0), split[0]]),
    }
    if errors:
        layout["xaxis3"] = axis(TIME, anchor="y3", matches="x2")
        layout["yaxis3"] = axis(f"position error, {unit}", domain=[0.0, split[1] - 0.02], rangemode="tozero")
    return Plot("paths", "Trajectories", "", data, layout, height=900 if errors else 750, width="full")


def save_path_html(curves: Sequence[Curve], path: Path) -> None:
    """Write the plot as a page that requires no network; raise OutputError if the file cannot be written."""
    figure = to_figure(path_plot(curves)).to_html(full_html=False, include_plotlyjs=True, div_id="paths")
    head = '<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>Trajectories</title></head>'
    write_text(f"{head}<body>{figure}</body></html>\n", path)
