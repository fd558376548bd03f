"""The figure of an elevation model: heights coloured and shaded, with axes in metres, a scale and a colour bar."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import OutputError
from sfr_loc_map.geometry.arrays import ColourImage
from sfr_loc_map.io.atomic import atomic_path
from sfr_loc_map.mapping.terrain.elevation import ElevationModel

HEIGHT_QUANTILES = (0.01, 0.99)
"""Heights between these fill the range of colours; what is beyond takes the colour at the end."""
LIGHT = np.array([-1.0, 1.0, 1.5])
"""Direction towards the light of the shaded image: from the upper left, as on maps."""
AMBIENT = 0.35
BRIDGED_SHARE = 0.1
"""Share of weighted neighbours that must have a height for a gap to be bridged in the image."""
RIM_SHARE = 0.01
VOID = (32, 32, 32)
LONGER_SIDE = 800
"""Pixels of the longer side of the plotted area."""
LEFT, TOP, RIGHT, BOTTOM = 80, 40, 150, 70
"""Margins around the plotted area, pixels."""
BAR_WIDTH = 22
TICKS = 6
"""About so many ticks an axis."""
INK, PAPER = (40, 40, 40), (255, 255, 255)
_FONT, _SIZE = cv2.FONT_HERSHEY_SIMPLEX, 0.45


@dataclass(frozen=True, slots=True, eq=False)
class ShadedHeights:
    """Heights as an image.

    Attributes:
        image: `(R, C, 3)` blue, green, red; rows along y.
        origin_m: x and y of the outer corner of its cell (0, 0).
        cell_m: Side of a cell.
        range_m: Heights at the two ends of the colours.
    """

    image: ColourImage
    origin_m: tuple[float, float]
    cell_m: float
    range_m: tuple[float, float]


def shaded_heights(model: ElevationModel) -> ShadedHeights:
    """Return heights as colours, shaded by their slopes.

    For the look of it gaps of a cell or two are bridged, and sparse rows and columns at the rim are left out.
    """
    rows, columns = _dense(model.count)
    heights = _bridged(model.height_m)[rows, columns]
    known = np.isfinite(heights)
    filled = np.where(known, heights, np.float32(np.nanmedian(model.height_m) if known.any() else 0.0))
    slope_y, slope_x = np.gradient(filled.astype(np.float64), model.cell_m) if min(filled.shape) > 1 else (0.0, 0.0)
    light = LIGHT / np.linalg.norm(LIGHT)
    lit = (light[2] - slope_x * light[0] - slope_y * light[1]) / np.sqrt(1.0 + np.square(slope_x) + np.square(slope_y))
    shade = AMBIENT + (1.0 - AMBIENT) * np.clip(lit / light[2], 0.0, 1.3)
    range_m = height_range(filled[known])
    image = height_colours(filled, range_m) * np.asarray(shade)[..., None]
    image[~known] = VOID
    x, y = model.origin_m
    corner = (x + columns.start * model.cell_m, y + rows.start * model.cell_m)
    return ShadedHeights(np.asarray(np.clip(image, 0.0, 255.0), np.uint8), corner, model.cell_m, range_m)


def height_range(height_m: NDArray[np.float32]) -> tuple[float, float]:
    """Return the heights at the two ends of the colours; 0 and 1 without any height."""
    if not height_m.size:
        return 0.0, 1.0
    low, high = np.quantile(height_m, HEIGHT_QUANTILES)
    return float(low), float(max(high, low + 1e-6))


def height_colours(height_m: NDArray[np.float32], range_m: tuple[float, float]) -> ColourImage:
    """Return colours `(..., 3)`, in the order blue, green, red, of heights."""
    level = np.clip((height_m - range_m[0]) / (range_m[1] - range_m[0]), 0.0, 1.0)
    flat = np.asarray(np.rint(255.0 * level), np.uint8).reshape(-1, 1)
    return np.asarray(cv2.applyColorMap(flat, cv2.COLORMAP_VIRIDIS), np.uint8).reshape(*height_m.shape, 3)


def elevation_figure(model: ElevationModel) -> ColourImage:
    """Return the figure: y of LM upwards, cells without height dark."""
    shaded = shaded_heights(model)
    rows, columns = shaded.image.shape[:2]
    zoom = LONGER_SIDE / max(rows, columns)
    width, height = max(1, round(columns * zoom)), max(1, round(rows * zoom))
    method = cv2.INTER_NEAREST if zoom >= 1.0 else cv2.INTER_AREA
    canvas = np.full((TOP + max(height, 200) + BOTTOM, LEFT + max(width, 200) + RIGHT, 3), PAPER, np.uint8)
    canvas[TOP : TOP + height, LEFT : LEFT + width] = cv2.resize(
        shaded.image[::-1], (width, height), None, 0, 0, method
    )
    cv2.rectangle(canvas, (LEFT - 1, TOP - 1), (LEFT + width, TOP + height), INK)
    _axes(canvas, shaded, (width, height))
    _colour_bar(canvas, shaded.range_m, LEFT + width + 30, max(height, 200))
    _scale(canvas, width / (columns * shaded.cell_m), (LEFT, TOP + height + 58), width)
    return canvas


def save_elevation_figure(path: Path, model: ElevationModel) -> None:
    """Write the figure as PNG.

    Raises:
        OutputError: If the file cannot be written.
    """
    with atomic_path(path) as temporary:
        if not cv2.imwrite(str(temporary), elevation_figure(model)):
            raise OutputError(f"cannot write '{path}': the image could not be encoded")


def ticks(low: float, high: float, count: int = TICKS) -> list[float]:
    """Return round numbers between two, about `count` of them; their step is 1, 2 or 5 times a power of ten."""
    step = _round_step((high - low) / count)
    return [n * step for n in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]


def _round_step(value: float) -> float:
    power = 10.0 ** math.floor(math.log10(value))
    return next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= value * (1.0 - 1e-9))


def _axes(canvas: ColourImage, shaded: ShadedHeights, size: tuple[int, int]) -> None:
    x0, y0 = shaded.origin_m
    rows, columns = shaded.image.shape[:2]
    across, up = columns * shaded.cell_m, rows * shaded.cell_m
    for x in ticks(x0, x0 + across):
        column, row = LEFT + round((x - x0) / across * size[0]), TOP + size[1]
        cv2.line(canvas, (column, row), (column, row + 5), INK)
        _text(canvas, f"{x:g}", (column, row + 18), centre=True)
    for y in ticks(y0, y0 + up):
        row = TOP + size[1] - round((y - y0) / up * size[1])
        cv2.line(canvas, (LEFT - 6, row), (LEFT - 1, row), INK)
        _text(canvas, f"{y:g}", (LEFT - 10, row + 4), right=True)
    _text(canvas, "x of LM, m", (LEFT + size[0] // 2, TOP + size[1] + 36), centre=True)
    _text(canvas, "y of LM, m", (8, TOP - 14))


def _colour_bar(canvas: ColourImage, range_m: tuple[float, float], column: int, height: int) -> None:
    low, high = range_m
    levels = np.linspace(high, low, height, dtype=np.float32)[:, None]
    canvas[TOP : TOP + height, column : column + BAR_WIDTH] = height_colours(levels, range_m)
    cv2.rectangle(canvas, (column - 1, TOP - 1), (column + BAR_WIDTH, TOP + height), INK)
    for level in ticks(low, high):
        row = TOP + round((high - level) / (high - low) * (height - 1))
        cv2.line(canvas, (column + BAR_WIDTH, row), (column + BAR_WIDTH + 5, row), INK)
        _text(canvas, f"{level:g}", (column + BAR_WIDTH + 9, row + 4))
    _text(canvas, "height, m", (column - 4, TOP - 14))


def _scale(canvas: ColourImage, px_per_m: float, place: tuple[int, int], width: int) -> None:
    """Draw a bar of a round length of about a fifth of the width."""
    length = _round_step(width / px_per_m / 5.0)
    column, row = place
    end = column + round(length * px_per_m)
    cv2.rectangle(canvas, (column, row - 6), (end, row), INK, cv2.FILLED)
    _text(canvas, f"{length:g} m", (end + 8, row))


def _text(canvas: ColourImage, text: str, place: tuple[int, int], *, centre: bool = False, right: bool = False) -> None:
    (width, _), _ = cv2.getTextSize(text, _FONT, _SIZE, 1)
    column = place[0] - (width // 2 if centre else width if right else 0)
    cv2.putText(canvas, text, (column, place[1]), _FONT, _SIZE, INK, 1, cv2.LINE_AA)


def _bridged(height_m: NDArray[np.float32]) -> NDArray[np.float32]:
    known = np.isfinite(height_m).astype(np.float32)
    total, share = (cv2.GaussianBlur(image, (0, 0), 1.0) for image in (np.where(known > 0, height_m, 0.0), known))
    near = np.asarray(total / np.maximum(share, 1e-6), np.float32)
    near[share < BRIDGED_SHARE] = np.nan
    return np.where(known > 0, height_m, near)


def _dense(count: NDArray[np.int32]) -> tuple[slice, slice]:
    """Return the rows and columns between which nearly all cells with points lie."""
    some = count > 0
    spans = []
    for axis in (1, 0):
        share = np.cumsum(some.sum(axis=axis)) / some.sum()
        first, last = np.searchsorted(share, RIM_SHARE), np.searchsorted(share, 1.0 - RIM_SHARE)
        spans.append(slice(int(first), int(last) + 1))
    return spans[0], spans[1]
