"""What all figures share: plotly figures as plain values, with colours by name so that light and dark share a figure.

A colour is written `@name`; the page's script puts in the colour of its theme. No text of a user goes into a figure,
since plotly reads some tags in texts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

Trace = dict[str, Any]
Column = Sequence[float | None]


@dataclass(frozen=True, slots=True)
class Plot:
    """One figure of the page.

    Attributes:
        name: Short name, used as an anchor and by the script.
        title: What it shows.
        caption: How it is to be read.
        data: Traces of plotly.
        layout: Layout of plotly, without what all figures share.
        height: Height in CSS pixels.
        width: Share of the width of the page: `full`, `half` or `third`.
    """

    name: str
    title: str
    caption: str
    data: list[Trace]
    layout: dict[str, Any]
    height: int = 380
    width: str = "half"


def axis(title: str, **more: Any) -> dict[str, Any]:  # noqa: ANN401 - whatever plotly takes
    """Return an axis whose title names its unit."""
    return {"title": {"text": title}, "automargin": True, **more}


def log_axis(title: str, low: float, high: float, steps: Sequence[int] = (1, 2, 5)) -> dict[str, Any]:
    """Return a logarithmic axis with ticks written in full at the steps of each power of ten around the values."""
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    ticks = [float(f"{step}e{power}") for power in powers for step in steps]
    return axis(title, type="log", tickvals=ticks, ticktext=[f"{tick:g}" for tick in ticks])


def line(name: str, xy: Sequence[Column], color: str, **more: Any) -> Trace:  # noqa: ANN401
    """Return a line through the points of columns x and y; `dash` and `width` style it."""
    style = {"color": color, "width": more.pop("width", 2), "dash": more.pop("dash", "solid")}
    return {"type": "scatter", "mode": "lines", "name": name, "x": xy[0], "y": xy[1], "line": style, **more}


def marks(name: str, xy: Sequence[Column], color: str | Column, **more: Any) -> Trace:  # noqa: ANN401
    """Return marks at the points of columns x and y; `symbol` and `size` style them, `marker` adds to that."""
    style = {"color": color, "symbol": more.pop("symbol", "circle"), "size": more.pop("size", 7)}
    style |= more.pop("marker", {})
    return {"type": "scatter", "mode": "markers", "name": name, "x": xy[0], "y": xy[1], "marker": style, **more}


def band(name: str, x: Column, low: float, high: float, color: str, **more: Any) -> Trace:  # noqa: ANN401
    """Return a filled band between two levels over the extent of x."""
    first, last = x[0], x[-1]
    return {
        "type": "scatter",
        "mode": "lines",
        "name": name,
        "x": [first, last, last, first],
        "y": [low, low, high, high],
        "fill": "toself",
        "fillcolor": color,
        "line": {"width": 0},
        "hoverinfo": "skip",
        **more,
    }


def error_scale(largest: float) -> tuple[float, str]:
    """Return factor and unit for errors in metres: millimetres as long as all are under a metre."""
    return (1e3, "mm") if largest < 1.0 else (1.0, "m")


def scaled(values: Sequence[float | None], factor: float) -> list[float | None]:
    """Return the values times a factor, to six significant digits; None stays."""
    return [None if value is None else float(f"{value * factor:.6g}") for value in values]


def largest(*columns: Sequence[float | None]) -> float:
    """Return the largest absolute value, 0 if there is none."""
    return max((abs(value) for column in columns for value in column if value is not None), default=0.0)


def seconds_since(stamps_ns: Sequence[int]) -> list[float]:
    """Return seconds since the first stamp."""
    return [round((stamp - stamps_ns[0]) * 1e-9, 6) for stamp in stamps_ns]
