"""A figure of the report as a plotly figure of its own, in the page's light colours."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfr_loc_map.report.plots import Plot

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

PALETTE = {
    "truth": "#1a1f24",
    "one": "#0067a8",
    "two": "#c14a00",
    "three": "#007a5a",
    "four": "#8a6d00",
    "five": "#a3437b",
    "one-soft": "rgba(0,103,168,0.16)",
    "two-soft": "rgba(193,74,0,0.16)",
    "three-soft": "rgba(0,122,90,0.16)",
    "four-soft": "rgba(138,109,0,0.16)",
    "five-soft": "rgba(163,67,123,0.16)",
    "bad": "#b3001b",
    "faint": "rgba(87,96,106,0.35)",
    "chosen": "#e69f00",
    "ink": "#1a1f24",
    "soft": "#57606a",
    "paper": "#ffffff",
    "grid": "#e3e7eb",
    "zero": "#8c959f",
    "sequential": "Viridis",
}
"""Colours by name: those of the light theme of `templates/page.js` (Okabe and Ito)."""
LINES = {"gridcolor": PALETTE["grid"], "zerolinecolor": PALETTE["zero"], "linecolor": PALETTE["zero"]}


def to_figure(plot: Plot) -> Figure:
    """Return a figure that plotly shows in a notebook or writes to a file, its title above it."""
    from plotly.graph_objects import Figure

    layout = {
        "title": {"text": plot.title, "font": {"size": 16}, "y": 0.98, "yanchor": "top"},
        "margin": {"l": 60, "r": 20, "t": 80, "b": 50},
        "paper_bgcolor": PALETTE["paper"],
        "plot_bgcolor": PALETTE["paper"],
        "font": {"color": PALETTE["ink"], "size": 12},
        "legend": {"orientation": "h", "traceorder": "normal", "y": 1.02, "yanchor": "bottom", "x": 0},
        "hovermode": "closest",
        "height": plot.height + 60,
        **coloured(plot.layout),
    }
    for name in list(layout):
        if name.startswith(("xaxis", "yaxis")):
            layout[name] = {"zeroline": False, **LINES, **layout[name]}
    return Figure(data=coloured(plot.data), layout=layout)


def coloured(value: Any) -> Any:  # noqa: ANN401 - any value of plotly
    """Return traces or a layout with the colours that `@name` stands for."""
    if isinstance(value, str):
        return PALETTE[value[1:]] if value.startswith("@") else value
    if isinstance(value, dict):
        return {key: coloured(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)) and not (value and isinstance(value[0], (int, float))):
        return [coloured(item) for item in value]
    return value
