"""Draw the figures of the page on Mars and write its table: `make figures`.

The pairs are those of `sample/spirit-1` and `sample/spirit-5`: NASA/JPL, public domain.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
mpl.rcParams |= {"font.size": 8, "axes.spines.top": False, "axes.spines.right": False}

from matplotlib import pyplot as plt  # noqa: E402

from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair, StereoRig  # noqa: E402
from sfr_loc_map.io.registry import open_source  # noqa: E402
from sfr_loc_map.mapping.config import TerrainConfig  # noqa: E402
from sfr_loc_map.mapping.mapper import Mapper  # noqa: E402
from sfr_loc_map.mapping.maps import PairMap  # noqa: E402
from sfr_loc_map.mapping.terrain.terrain_grid import terrain_grid  # noqa: E402

DOCS = Path(__file__).resolve().parents[1]
PAIRS = ("spirit-1", "spirit-5")
CUT = 56
"""Columns that are cut off: the left ones of the left frame, the right ones of the right frame."""


def read(name: str) -> tuple[PosedStereoPair, StereoRig]:
    """Return a pair of the repository and its rig."""
    nav = open_source(DOCS.parent / "sample" / name).nav
    assert nav is not None
    return next(iter(nav.pairs())), nav.rig


def right_disparity(mapper: Mapper, item: PosedStereoPair) -> np.ndarray:
    """Return the disparity of the right image `(H, W)`: the mapper sees both images mirrored and exchanged."""
    left, right = (np.ascontiguousarray(image[:, ::-1]) for image in (item.pair.right, item.pair.left))
    return mapper.process(StereoPair(0, left, right), item.T_lm_navsb, 0).disparity_px[:, ::-1]


def seen_by_both(disparity: np.ndarray) -> np.ndarray:
    """Tell which pixels `(H, W)` are in both cut frames, holes being filled along the row."""
    filled = disparity.copy()
    columns = np.arange(filled.shape[1])
    for row in filled:
        known = np.isfinite(row)
        row[~known] = np.interp(columns[~known], columns[known], row[known])
    return (columns >= CUT) & (columns - filled < filled.shape[1] - CUT)


def figures_of(mapper: Mapper, item: PosedStereoPair, found: PairMap) -> tuple[str, ...]:
    """Return the row of a pair in the table."""
    disparity, other = found.disparity_px, right_disparity(mapper, item)
    columns = np.arange(disparity.shape[1])
    real, seen = np.isfinite(disparity) & (columns >= CUT), seen_by_both(disparity)
    v, u = np.nonzero(real)
    back = np.rint(u - disparity[v, u]).astype(int)
    difference = np.abs(other[v, back] - disparity[v, u])
    difference = difference[np.isfinite(difference)]
    shares = (
        real.sum() / (len(disparity) * (len(columns) - CUT)),
        (real & seen).sum() / seen.sum(),
        len(difference) / len(v),
        np.mean(difference < 1.0),
    )
    return (*(f"{100 * share:.0f} %" for share in shares), f"{np.median(difference):.2f} px")


def draw(name: str, item: PosedStereoPair, rig: StereoRig, found: PairMap) -> None:
    """Draw image, disparity, elevation and cloud of a pair."""
    figure, panels = plt.subplots(1, 4, figsize=(11.5, 3.2), width_ratios=(1.0, 1.25, 1.0, 1.7), layout="constrained")
    image, field, heights, view = panels
    image.imshow(item.pair.left[:, CUT:], cmap="gray", extent=(CUT, rig.width, rig.height, 0))
    image.set_title("left image")
    shown = field.imshow(found.disparity_px[:, CUT:], cmap="turbo", extent=(CUT, rig.width, rig.height, 0))
    field.set_title("disparity, px; white: none")
    figure.colorbar(shown, ax=field)
    grid = terrain_grid(found.cloud, TerrainConfig(cell_m=0.04), [found.T_lm_left], found.random_sigma)
    model = grid.elevation
    x, y = model.origin_m
    rows, columns = model.height_m.shape
    extent = (y, y + rows * model.cell_m, x, x + columns * model.cell_m)
    shown = heights.imshow(model.height_m.T, cmap="terrain", origin="lower", extent=extent)
    heights.invert_xaxis()
    heights.set_xlabel("y to the left, m")
    heights.set_ylabel("x ahead, m")
    heights.set_title("elevation, m")
    figure.colorbar(shown, ax=heights)
    angle, lift = np.deg2rad(35.0), np.deg2rad(30.0)
    points = found.cloud.xyz - np.median(found.cloud.xyz, axis=0)
    across = points[:, 1] * np.cos(angle) - points[:, 0] * np.sin(angle)
    along = points[:, 1] * np.sin(angle) + points[:, 0] * np.cos(angle)
    order = np.argsort(-along)
    upwards = points[:, 2] * np.cos(lift) + along * np.sin(lift)
    view.scatter(-across[order], upwards[order], c=found.cloud.intensity[order], s=1.2, cmap="gray", linewidths=0)
    view.set_aspect("equal")
    view.set_xlabel("m")
    view.set_title("cloud from 35 deg aside, 30 deg above")
    figure.savefig(DOCS / "images" / "mars" / f"{name}.webp", dpi=110, facecolor="white")
    plt.close(figure)


def main() -> None:
    """Draw both pairs, and write the table into the page."""
    (DOCS / "images" / "mars").mkdir(parents=True, exist_ok=True)
    rows = [
        "| pair | of all pixels | of pixels in both images | compared | agree within 1 px | median |",
        "|---|---|---|---|---|---|",
    ]
    for name in PAIRS:
        item, rig = read(name)
        mapper = Mapper(rig)
        found = mapper.process(item.pair, item.T_lm_navsb, 0)
        draw(name, item, rig, found)
        rows.append("| " + " | ".join((name, *figures_of(mapper, item, found))) + " |")
    page = DOCS / "mapping.md"
    begin, end = "<!-- made by docs/_figures/mars.py -->\n", "<!-- end -->"
    before, _, rest = page.read_text(encoding="utf-8").partition(begin)
    table = "\n".join(rows)
    page.write_text(f"{before}{begin}\n{table}\n\n{end}{rest.partition(end)[2]}", encoding="utf-8")


if __name__ == "__main__":
    main()
