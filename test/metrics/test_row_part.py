"""The part of a row is read from its text into place, kind of call and the rest, and is written as it was."""

from __future__ import annotations

import pytest

from sfr_loc_map.metrics.config import CallKind
from sfr_loc_map.metrics.row_part import Place, RowPart
from sfr_loc_map.metrics.table import figure_row

PARTS = {
    None: RowPart(),
    "pose": RowPart("pose"),
    "0-4 m": RowPart("0-4 m"),
    "drive": RowPart("drive"),
    "first call": RowPart("first call"),
    "localisation": RowPart(call=CallKind.LOCALISATION),
    "target": RowPart(place=Place.TARGET),
    "target after the first call": RowPart("after the first call", place=Place.TARGET),
    "stated mapping_call": RowPart(call=CallKind.MAPPING_CALL, place=Place.STATED),
    "memory localisation": RowPart("memory", CallKind.LOCALISATION),
    "target calls fusion": RowPart("calls", CallKind.FUSION, Place.TARGET),
}


@pytest.mark.parametrize(("text", "part"), PARTS.items())
def test_a_text_is_a_part_and_the_part_is_the_text(text: str | None, part: RowPart) -> None:
    assert RowPart.of(text) == part
    assert part.text == text


@pytest.mark.parametrize("text", ["on  two", "a stage of mapping", "host", "targeted", "call"])
def test_the_name_of_a_stage_is_written_as_it_was(text: str) -> None:
    assert RowPart.of(text).text == text
    assert RowPart.of(text).place is Place.HOST


def test_a_row_has_place_and_kind_of_call() -> None:
    time = figure_row("mapping_call", part="target first call", value=1.0)
    assert (time.place, time.call) == (Place.TARGET, CallKind.MAPPING_CALL)
    memory = figure_row("peak", part="stated localisation", value=1.0)
    assert (memory.place, memory.call) == (Place.STATED, CallKind.LOCALISATION)
    position = figure_row("position", "distance=5", "pose", value=1.0)
    assert (position.place, position.call) == (Place.HOST, None)
