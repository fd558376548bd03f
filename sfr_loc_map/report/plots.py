"""Common parts of all plots. Plots are plain values, with named colours so that light and dark themes share a plot.

A colour is written `@name`. The page's script inserts the colour of its theme, `to_figure` that of the light theme.
Plotly interprets HTML tags in texts, so texts of a user must pass through `plain`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any

from sfr_loc_map.message_text import printable
from sfr_loc_map.tables.model import METRE, fitting

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

Trace = dict[str, Any]
Values = Sequence[float | None]
TRAVELLED = "distance travelled (truth), m"
SYMBOLS = ("circle", "diamond", "square", "triangle-up", "cross")
TITLE_DISTANCE_PX = 8  #: Minimum distance of the title of an axis from its tick labels.
STATES = {
    "initialising": ("@two", "diamond"),
    "tracking": ("@one", "circle"),
    "degraded": ("@three", "triangle-up"),
    "lost": ("@bad", "x"),
    "mapped": ("@one", "circle"),
    "fused": ("@three", "square"),
    "other": ("@four", "square"),
}
"""Colour and mark of each state that a call reports."""
AXES_IN_SPACE = ("xaxis", "yaxis", "zaxis")
COLORS = ("@one", "@two", "@three", "@four", "@five")
PALETTES = {
    "light": {
        "truth": "#1a1f24",
        "one": "#0067a8",
        "two": "#c14a00",
        "three": "#007a5a",
        "four": "#8a6d00",
        "five": "#a3437b",
        "bad": "#b3001b",
        "faint": "rgba(87,96,106,0.35)",
        "chosen": "#e69f00",
        "ink": "#1a1f24",
        "soft": "#57606a",
        "paper": "#ffffff",
        "grid": "#e3e7eb",
        "zero": "#8c959f",
        "one-soft": "rgba(0,103,168,0.16)",
        "two-soft": "rgba(193,74,0,0.16)",
        "three-soft": "rgba(0,122,90,0.16)",
        "four-soft": "rgba(138,109,0,0.16)",
        "five-soft": "rgba(163,67,123,0.16)",
        "sequential": "Viridis",
    },
    "dark": {
        "truth": "#f0f3f6",
        "one": "#56b4e9",
        "two": "#ff9a52",
        "three": "#3ecf9f",
        "four": "#f0e442",
        "five": "#e49ac4",
        "bad": "#ff7b7b",
        "faint": "rgba(169,180,191,0.35)",
        "chosen": "#ffd166",
        "ink": "#e8ecf0",
        "soft": "#a9b4bf",
        "paper": "#171c22",
        "grid": "#2b333c",
        "zero": "#6b7682",
        "one-soft": "rgba(86,180,233,0.2)",
        "two-soft": "rgba(255,154,82,0.2)",
        "three-soft": "rgba(62,207,159,0.2)",
        "four-soft": "rgba(240,228,66,0.2)",
        "five-soft": "rgba(228,154,196,0.2)",
        "sequential": "Viridis",
    },
}
"""Named colours after Okabe and Ito (suitable for colour-blind readers), darker on light and lighter on dark."""
TEMPLATE: dict[str, Any] = {
    "layout": {
        "margin": {"l": 60, "r": 20, "t": 12, "b": 50},
        "font": {"color": "@ink", "size": 12, "family": "system-ui, Segoe UI, Roboto, DejaVu Sans, Arial, sans-serif"},
        "paper_bgcolor": "@paper",
        "plot_bgcolor": "@paper",
        "legend": {"orientation": "h", "traceorder": "normal", "y": 1.02, "yanchor": "bottom", "x": 0},
        "hovermode": "closest",
        "hoverlabel": {"align": "left"},
    },
    "axis": {
        "exponentformat": "none",
        "zeroline": False,
        "gridcolor": "@grid",
        "zerolinecolor": "@zero",
        "linecolor": "@zero",
    },
    "axis_in_space": {
        "backgroundcolor": "@paper",
        "gridcolor": "@grid",
        "zerolinecolor": "@zero",
        "linecolor": "@zero",
    },
}
"""Common settings of the layout, of each axis, and of each axis of a 3D view."""


@dataclass(frozen=True, slots=True)
class Plot:
    """One plot of a page."""

    name: str  #: Anchor of the plot in the page, by which the script of the page finds the plot.
    title: str
    caption: str  #: Explanation for the reader.
    data: list[Trace]
    layout: dict[str, Any]  #: Layout without the common settings.
    height: int = 380  #: In CSS pixels.
    width: str = "half"  #: Fraction of the page width: `full`, `half` or `third`.


def plain(text: str) -> str:
    """Return a text of a user, such as a name, with its HTML tags escaped, because plotly would interpret them.

    A leading `@` is escaped, too, because it marks the name of a colour in the data of a plot.
    """
    escaped = escape(printable(text), quote=False)
    return f"&#64;{escaped[1:]}" if escaped.startswith("@") else escaped


def axis(title: str, **more: Any) -> dict[str, Any]:  # noqa: ANN401 - whatever plotly takes
    """Return an axis whose title names its unit."""
    return {"title": {"text": title, "standoff": TITLE_DISTANCE_PX}, "automargin": True, **more}


def log_axis(title: str, low: float, high: float, steps: Sequence[int] = (1, 2, 5)) -> dict[str, Any]:
    """Return a logarithmic axis from `low` to `high` with ticks at the steps of each decade, without exponents."""
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    ticks = [float(f"{step}e{power}") for power in powers for step in steps]
    return axis(title, type="log", tickvals=ticks, ticktext=[f"{tick:g}" for tick in ticks])


def line(name: str, xy: Sequence[Values], color: str, **more: Any) -> Trace:  # noqa: ANN401
    """Return a line through the points of columns x and y; `dash` and `width` style it."""
    style = {"color": color, "width": more.pop("width", 2), "dash": more.pop("dash", "solid")}
    return {"type": "scatter", "mode": "lines", "name": name, "x": xy[0], "y": xy[1], "line": style, **more}


def line_style(k: int) -> dict[str, str]:
    """Return colour and dash of the k-th of several lines."""
    return {"color": COLORS[k % len(COLORS)], "dash": ("solid", "dash", "dot")[k // len(COLORS) % 3]}


def span(values: Values) -> tuple[float, float]:
    """Return bounds of a logarithmic axis around values."""
    known = [value for value in values if value is not None and value > 0] or [1.0]
    return 0.8 * min(known), 1.25 * max(known)


def marks(name: str, xy: Sequence[Values], color: str | Values, **more: Any) -> Trace:  # noqa: ANN401
    """Return marks at the points of columns x and y; `symbol`, `size` and `marker` style them."""
    style = {"color": color, "symbol": more.pop("symbol", "circle"), "size": more.pop("size", 7)}
    style |= more.pop("marker", {})
    return {"type": "scatter", "mode": "markers", "name": name, "x": xy[0], "y": xy[1], "marker": style, **more}


def band(name: str, x: Values, low: float, high: float, color: str, **more: Any) -> Trace:  # noqa: ANN401
    """Return a filled band between two levels over the extent of x."""
    corners = [x[0], x[-1], x[-1], x[0]], [low, low, high, high]
    filled = {"fill": "toself", "fillcolor": color, "line": {"width": 0}, "hoverinfo": "skip"}
    return {"type": "scatter", "mode": "lines", "name": name, "x": corners[0], "y": corners[1], **filled, **more}


def segments(pieces: Sequence[Sequence[Values]]) -> list[Values]:
    """Return the columns x and y of pieces for one trace, with a gap after each piece."""
    return [[value for piece in pieces for value in (*piece[side], None)] for side in (0, 1)]


def colour_bar(title: str, **ticks: Any) -> dict[str, Any]:  # noqa: ANN401
    """Return the colour bar of a trace."""
    return {"title": {"text": title, "side": "right"}, "thickness": 12, **ticks}


def from_above() -> dict[str, Any]:
    """Return the layout of a view from above with equal axes."""
    return {
        "xaxis": axis("x of DS (east), m", constrain="domain"),
        "yaxis": axis("y of DS (north), m", scaleanchor="x", scaleratio=1, constrain="domain"),
    }


def error_scale(largest: float) -> tuple[float, str]:
    """Return the factor and the unit for errors in metres, as in the tables."""
    unit = fitting(METRE, largest)
    return 1.0 / unit.size, unit.symbol


def scaled(values: Values, factor: float) -> list[float | None]:
    """Return the values times a factor, to six significant digits; None remains None."""
    return [None if value is None else float(f"{value * factor:.6g}") for value in values]


def largest(*columns: Values) -> float:
    """Return the largest absolute value; 0 if there is none."""
    return max((abs(value) for column in columns for value in column if value is not None), default=0.0)


def to_figure(plot: Plot) -> Figure:
    """Return a plotly figure with its title, for a notebook or a file; `page.js` does the same for a page."""
    from plotly.graph_objects import Figure

    layout = {
        **TEMPLATE["layout"],
        "margin": {**TEMPLATE["layout"]["margin"], "t": 80},
        "title": {"text": plot.title, "font": {"size": 16}, "y": 0.98, "yanchor": "top"},
        "height": plot.height + 60,
        **plot.layout,
    }
    for name in list(layout):
        if name.startswith(("xaxis", "yaxis")):
            layout[name] = {**TEMPLATE["axis"], **layout[name]}
    if "scene" in layout:
        axes = {name: {**TEMPLATE["axis_in_space"], **layout["scene"].get(name, {})} for name in AXES_IN_SPACE}
        layout["scene"] = {**layout["scene"], **axes}
    return Figure(data=_coloured(plot.data), layout=_coloured(layout))


def _coloured(value: Any) -> Any:  # noqa: ANN401 - any value of plotly
    """Return traces or a layout with `@name` replaced by the colour of the light theme."""
    if isinstance(value, str):
        return PALETTES["light"][value[1:]] if value.startswith("@") else value
    if isinstance(value, dict):
        return {key: _coloured(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)) and not (value and isinstance(value[0], (int, float))):
        return [_coloured(item) for item in value]
    return value
