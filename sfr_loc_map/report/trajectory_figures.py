"""Figures of the course of the drive: from above, in height, and how far the estimate is off."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from sfr_loc_map.report.cells import condition_text, dig
from sfr_loc_map.report.plots import Plot, Trace, axis, error_scale, largest, line, marks, scaled
from sfr_loc_map.report.sub_trajectories import TRACE_BACK, Part, error_sizes, parts_of, traces_to

ELLIPSES = 15


def trajectory_figures(score: Mapping[str, Any]) -> list[Plot]:
    """Return the figures of the path, as far as the score has their data."""
    path = dig(score, "details.trajectory.path")
    if not path or not path.get("stamp_ns"):
        return []
    return [_top_view(path, parts_of(score)), _height(path), _accumulated(path)]


def _top_view(path: Mapping[str, Any], parts: list[Part]) -> Plot:
    frames = [[k * path["every"], str(stamp)] for k, stamp in enumerate(path["stamp_ns"])]
    hover = "frame %{customdata[0]}<br>stamp %{customdata[1]} ns<br>x %{x:.3f} m, y %{y:.3f} m"
    more = {"customdata": frames, "hovertemplate": hover}
    truth, estimate = ([path[f"{who}_{a}_m"] for a in "xy"] for who in ("truth", "estimate"))
    factor = _exaggeration(path)
    drawn = [[t + factor * (e - t) for t, e in zip(*pair, strict=True)] for pair in zip(truth, estimate, strict=True)]
    drawn = [scaled(values, 1.0) for values in drawn]
    data = [
        line("truth", truth, "@truth", width=3, **more),
        line("estimate", estimate, "@one", dash="dash", **more),
    ]
    if factor > 1:
        name = f"estimate, error drawn {factor:g} times"
        data.append(line(name, drawn, "@two", dash="dot", width=1.5, hoverinfo="skip"))
    if path.get("sigma_x_m"):
        data.append(_covariances(path, drawn, factor))
    data += _lost(path)
    if parts:
        data.append(_ends(path, parts[0][1]))
    data.append(line("chosen sub-trajectory", ([], []), "@chosen", width=7, opacity=0.5, hoverinfo="skip"))
    data.append(marks("start", (truth[0][:1], truth[1][:1]), "@truth", symbol="star", size=13, hoverinfo="skip"))
    layout = {
        "xaxis": axis("x of DS (east), m", constrain="domain"),
        "yaxis": axis("y of DS (north), m", scaleanchor="x", scaleratio=1, constrain="domain"),
    }
    caption = (
        "Equal axes. Marks: ends of the sub-trajectories, coloured by their position error. A click on the mark of "
    )
    caption += "a sub-trajectory, here or in a figure below, shows its stretch of the way."
    return Plot("top-view", "Trajectory from above", caption, data, layout, height=560, width="full")


def _covariances(path: Mapping[str, Any], centres: list[list[float | None]], factor: float) -> Trace:
    """Return ellipses with 3 sigma of x and y as half axes about some estimates, as large as the errors are drawn."""
    x: list[float | None] = []
    y: list[float | None] = []
    turns = [2 * math.pi * k / 24 for k in range(25)]
    usable = [k for k in range(len(centres[0])) if path["sigma_x_m"][k] is not None and not path["lost"][k]]
    for k in usable[:: max(1, -(-len(usable) // ELLIPSES))]:
        sizes = [3 * factor * path[f"sigma_{a}_m"][k] for a in "xy"]
        x += [*(centres[0][k] + sizes[0] * math.cos(turn) for turn in turns), None]
        y += [*(centres[1][k] + sizes[1] * math.sin(turn) for turn in turns), None]
    name = "3 sigma of its covariance" + (f", drawn {factor:g} times" if factor > 1 else "")
    return line(name, (scaled(x, 1.0), scaled(y, 1.0)), "@three", width=1, hoverinfo="skip")


def _exaggeration(path: Mapping[str, Any]) -> float:
    """Return 1, 2 or 5 times a power of ten by which the largest error is a twentieth of the drive's extent."""
    pairs = [(path[f"truth_{a}_m"], path[f"estimate_{a}_m"]) for a in "xy"]
    error = max(abs(e - t) for truth, estimate in pairs for t, e in zip(truth, estimate, strict=True))
    extent = max(max(truth) - min(truth) for truth, _ in pairs)
    if error <= 0 or extent <= 0:
        return 1.0
    wanted = 0.05 * extent / error
    if wanted < 2:
        return 1.0
    power = 10.0 ** math.floor(math.log10(wanted))
    return max(step * power for step in (1, 2, 5) if step * power <= wanted)


def _lost(path: Mapping[str, Any]) -> list[Trace]:
    lost = [k for k, value in enumerate(path.get("lost") or []) if value]
    if not lost:
        return []
    places = [[path[f"estimate_{a}_m"][k] for k in lost] for a in "xy"]
    return [marks("lost", places, "@bad", symbol="x", size=8)]


def _ends(path: Mapping[str, Any], rows: Mapping[str, Any]) -> Trace:
    factor, unit = error_scale(largest(error_sizes(rows)))
    last = len(path["stamp_ns"]) - 1
    at = [min(frame // path["every"], last) for frame in rows["end_frame"]]
    places = [[path[f"truth_{a}_m"][k] for k in at] for a in "xy"]
    bar = {
        "title": {"text": f"error over {condition_text(rows['condition'])}, {unit}", "side": "right"},
        "thickness": 12,
    }
    style = {"colorscale": "@sequential", "showscale": True, "colorbar": bar, "line": {"color": "@ink", "width": 0.5}}
    return marks(
        "ends of sub-trajectories",
        places,
        scaled(error_sizes(rows), factor),
        size=9,
        marker=style,
        customdata=traces_to(rows),
        hovertemplate=f"{TRACE_BACK}<br>position error %{{marker.color:.4g}} {unit}<extra></extra>",
    )


def _height(path: Mapping[str, Any]) -> Plot:
    way = path["travelled_m"]
    data = [
        line("truth", (way, path["truth_z_m"]), "@truth", width=3),
        line("estimate", (way, path["estimate_z_m"]), "@one", dash="dash"),
    ]
    layout = {"xaxis": axis("distance travelled (truth), m"), "yaxis": axis("z of DS (up), m")}
    return Plot("height", "Height", "Axes not to one scale.", data, layout)


def _accumulated(path: Mapping[str, Any]) -> Plot:
    errors = [[e - t for t, e in zip(path[f"truth_{a}_m"], path[f"estimate_{a}_m"], strict=True)] for a in "xyz"]
    size = [math.hypot(*vector) for vector in zip(*errors, strict=True)]
    factor, unit = error_scale(largest(size))
    way = path["travelled_m"]
    styles = (("x (east)", "@one", "dash"), ("y (north)", "@two", "dot"), ("z (up)", "@three", "dashdot"))
    data = [line("size", (way, scaled(size, factor)), "@truth", width=2.5)]
    data += [
        line(name, (way, scaled(values, factor)), color, dash=dash, width=1.5)
        for values, (name, color, dash) in zip(errors, styles, strict=True)
    ]
    if path.get("sigma_x_m"):
        data.append(line("3 sigma of the covariance", (way, _three_sigma(path, factor)), "@five", width=1.5))
    layout = {
        "xaxis": axis("distance travelled (truth), m"),
        "yaxis": axis(f"estimate - truth in DS, {unit}", zeroline=True),
    }
    caption = "Error accumulated since the first frame, without re-basing; not a figure of the specification."
    return Plot("accumulated", "Accumulated position error", caption, data, layout)


def _three_sigma(path: Mapping[str, Any], factor: float) -> list[float | None]:
    """Return 3 times the norm of the sigmas of the axes, None where they are not known or the frame is lost."""
    rows = zip(*(path[f"sigma_{a}_m"] for a in "xyz"), path["lost"], strict=True)
    return scaled([None if lost or None in sigmas else 3 * math.hypot(*sigmas) for *sigmas, lost in rows], factor)
