"""The part of a row is read from its text into place, kind of call and the rest, and is written as it was."""

from __future__ import annotations

import numpy as np
import pytest

from sfr_loc_map.metrics.config import CallKind
from sfr_loc_map.metrics.figures.row_part import (
    Place,
    RowPart,
    distance_of,
    distance_part,
    is_of_pair,
    pair_part,
    range_of,
    range_part,
)
from sfr_loc_map.metrics.figures.rows import figure_row, find_rows

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


@pytest.mark.parametrize(("text", "part"), PARTS.items())
def test_a_row_is_made_and_found_by_its_part_or_by_the_text_of_the_part(text: str | None, part: RowPart) -> None:
    row = figure_row("peak", part=part, value=1.0)
    assert row == figure_row("peak", part=text, value=1.0)
    assert [*find_rows((row,), "peak", part=part)] == [*find_rows((row,), "peak", part=text)] == [row]


def test_parts_with_a_number_are_read_as_they_are_written() -> None:
    assert range_of(range_part(0.0, 4.5)) == (0.0, 4.5)
    for low_m, high_m in ((0.0, 1e-5), (1e-5, 2.5e-5), (2.5e-5, 1e6), (10.0, np.inf)):
        assert range_of(range_part(low_m, high_m)) == (low_m, high_m)
        assert distance_of(range_part(low_m, high_m)) is None
    assert range_of("near-far m") is None
    assert range_of(pair_part(3)) is None
    assert distance_of(distance_part(5.0)) == 5.0
    assert is_of_pair(pair_part(12))
    assert not any(map(is_of_pair, (None, "pair", "pairs 0", range_part(0.0, 4.0))))


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
