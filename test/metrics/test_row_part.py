"""The part of a row is read from its text into place, kind of call and the rest, and is written as it was."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from sfr_loc_map.metrics.config import CallKind
from sfr_loc_map.metrics.figures.row_part import (
    Place,
    RowPart,
    calls_part,
    distance_of,
    distance_part,
    pair_part,
    range_of,
    range_part,
)
from sfr_loc_map.metrics.figures.rows import Figure, figure_row, find_rows
from sfr_loc_map.metrics.stored.score_json import RecordError, from_plain, to_plain

PARTS: dict[str, tuple[str, CallKind | None, Place]] = {
    "pose": ("pose", None, Place.HOST),
    "0-4 m": ("0-4 m", None, Place.HOST),
    "drive": ("drive", None, Place.HOST),
    "first call": ("first call", None, Place.HOST),
    "localisation": ("", CallKind.LOCALISATION, Place.HOST),
    "target": ("", None, Place.TARGET),
    "target after the first call": ("after the first call", None, Place.TARGET),
    "stated mapping_call": ("", CallKind.MAPPING_CALL, Place.STATED),
    "memory localisation": ("memory", CallKind.LOCALISATION, Place.HOST),
    "target calls fusion": ("calls", CallKind.FUSION, Place.TARGET),
}


@pytest.mark.parametrize(("text", "content"), PARTS.items())
def test_a_part_is_its_text_and_states_what_the_text_states(
    text: str, content: tuple[str, CallKind | None, Place]
) -> None:
    part = RowPart(text)
    assert part == text
    assert (part.what, part.call, part.place) == content
    assert calls_part(*content) == text
    copied = pickle.loads(pickle.dumps(part))
    assert (copied, copied.what, copied.call, copied.place) == (text, *content)


@pytest.mark.parametrize("text", PARTS)
def test_a_row_is_found_by_its_part_and_reads_back(text: str) -> None:
    row = figure_row("peak", part=text, value=1.0)
    assert [*find_rows((row,), "peak", part=RowPart(text))] == [*find_rows((row,), "peak", part=text)] == [row]
    read = from_plain(Figure, to_plain(row))
    assert read == row
    assert read.part is not None
    assert read.part.place is row.place


@pytest.mark.parametrize("part", [1, 1.5, ["pose"], {}])
def test_the_part_of_a_row_is_a_text(part: object) -> None:
    with pytest.raises(RecordError, match="part"):
        from_plain(Figure, {"subject": "memory", "figure": "peak", "unit": "bytes", "part": part})


def test_parts_with_a_number_are_read_as_they_are_written() -> None:
    assert range_of(range_part(0.0, 4.5)) == (0.0, 4.5)
    for low_m, high_m in ((0.0, 1e-5), (1e-5, 2.5e-5), (2.5e-5, 1e6), (10.0, np.inf)):
        assert range_of(range_part(low_m, high_m)) == (low_m, high_m)
        assert distance_of(range_part(low_m, high_m)) is None
    assert range_of("near-far m") is None
    assert range_of(pair_part(3)) is None
    assert distance_of(distance_part(5.0)) == 5.0


@pytest.mark.parametrize("text", ["on  two", "a stage of mapping", "host", "targeted", "call"])
def test_the_name_of_a_stage_is_no_place(text: str) -> None:
    assert RowPart(text).place is Place.HOST


def test_a_row_has_place_and_kind_of_call() -> None:
    time = figure_row("mapping_call", part="target first call", value=1.0)
    assert (time.place, time.call) == (Place.TARGET, CallKind.MAPPING_CALL)
    memory = figure_row("peak", part="stated localisation", value=1.0)
    assert (memory.place, memory.call) == (Place.STATED, CallKind.LOCALISATION)
    position = figure_row("position", "distance=5", "pose", value=1.0)
    assert (position.place, position.call) == (Place.HOST, None)


@pytest.mark.parametrize("value", [1, "text", None, [1.5], {"a": "b"}])
def test_any_json_is_read_as_it_is(value: object) -> None:
    """A record with a field of type `object`, such as the settings of a scenario, has no parts of rows."""
    assert from_plain(dict[str, object], {"name": value}) == {"name": value}
