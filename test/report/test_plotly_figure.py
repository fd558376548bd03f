"""Figures outside the page have the colours of the page."""

from __future__ import annotations

import re
from pathlib import Path

import sfr_loc_map.report
from sfr_loc_map.report.plots import (
    PALETTE,
    Plot,
    axis,
    band,
    line,
    to_figure,
)

SCRIPT = Path(sfr_loc_map.report.__file__).parent / "templates" / "page.js"


def test_colours_are_those_of_the_light_theme() -> None:
    light = SCRIPT.read_text(encoding="utf-8").partition("light: {")[2].partition("}")[0]
    colours = {name.strip('"'): value for name, value in re.findall(r'("?[\w-]+"?): "([^"]+)"', light)}
    assert {name: value for name, value in PALETTE.items() if name != "sequential"} == colours


def test_names_of_colours_are_replaced_and_values_stay() -> None:
    data = [line("a", ([0.0, 1.0], [2.0, None]), "@one"), band("b", [0.0, 1.0], 0.0, 1.0, "@one-soft")]
    figure = to_figure(Plot("p", "Title", "", data, {"xaxis": axis("x, m"), "shapes": [{"line": {"color": "@bad"}}]}))
    assert figure.data[0].line.color == PALETTE["one"]
    assert figure.data[0].y == (2.0, None)
    assert figure.data[1].fillcolor == PALETTE["one-soft"]
    assert figure.layout.shapes[0].line.color == PALETTE["bad"]
    assert figure.layout.title.text == "Title"
