"""A page of an elevation model: each layer as a figure with axes in metres and a colour bar."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sfr_loc_map.io.geotiff import Band
from sfr_loc_map.report.page import render_overview
from sfr_loc_map.report.plots import Plot, axis, colour_bar, heat

MAX_SIDE = 400  #: Most cells of a figure along a side; of larger grids every so many cells are shown.
CAPTIONS = {
    "height": "z of LM, mean of the points of the cell.",
    "sigma": "One standard deviation of the height.",
    "count": "Points of the cell.",
    "slope": "Angle of the plane through the heights within the rover's footprint.",
    "roughness": "Root of the mean squared difference of these heights from the plane.",
    "step": "Largest difference of heights above the plane within the radius of a step.",
    "hazard": "Largest share of what the rover can bear; 100 and more is a hazard.",
}


def dem_page(bands: Sequence[Band], origin_m: tuple[float, float], cell_m: float) -> str:
    """Return the page of a grid as HTML; its layers have one shape, its origin is the corner of least x and y."""
    rows, columns = bands[0].values.shape
    step = -(-max(rows, columns) // MAX_SIDE)
    text = f"{columns * cell_m:g} x {rows * cell_m:g} m in cells of {cell_m:g} m"
    if step > 1:
        text += f"; the figures show every {step}th cell along x and y"
    plots = [_figure(band, origin_m, cell_m, step) for band in bands]
    return render_overview("Elevation model", None, text, [], [("Layers", plots)], heading="grid in LM")


def _figure(band: Band, origin_m: tuple[float, float], cell_m: float, step: int) -> Plot:
    values = band.values[::step, ::step]
    name = f"{band.name}, {band.unit}" if band.unit else band.name
    known = values[np.isfinite(values)]
    low, high = np.quantile(known, (0.01, 0.99)).tolist() if known.size else (0.0, 1.0)
    shown = [[float(f"{value:.5g}") if value == value else None for value in row] for row in values.tolist()]
    x, y = ((least + cell_m / 2, cell_m * step) for least in origin_m)
    hover = "x %{x:.2f} m, y %{y:.2f} m: %{z:.4g}<extra></extra>"
    layer = heat(shown, x, y, (low, max(high, low + 1e-6)), colour_bar(name), hover)
    layout = {
        "xaxis": axis("x of LM, m", constrain="domain", showgrid=False),
        "yaxis": axis("y of LM, m", scaleanchor="x", constrain="domain", showgrid=False),
    }
    width = "full" if band.name == "height" else "half"
    caption = f"{CAPTIONS.get(band.name, '')} Colours end at the 1st and the 99th percentile."
    return Plot(f"dem-{band.name}", band.name.capitalize(), caption, [layer], layout, height=440, width=width)
