"""Numbers of text: stamps are exact to the nanosecond, numbers have the bits of `float`, wrong lines are named."""

from __future__ import annotations

import math
from decimal import Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfr_loc_map.errors import InputError
from sfr_loc_map.inputs import read_table
from sfr_loc_map.io.number_text import number_or_nan
from sfr_loc_map.io.stamps.stamp_text import StampParser, parse_seconds, parse_utc, seconds_text
from sfr_loc_map.io.tables.text_table import RowForm, parse_table

finite = st.floats(-1e308, 1e308)  # which no form rounds to infinity
forms = st.sampled_from(("{!r}", "{:.9f}", "{:.17e}", "{:.3g}", "{:.0f}"))


@pytest.mark.parametrize(
    ("text", "stamp_ns"),
    [
        ("1700000000.123456789", 1_700_000_000_123_456_789),  # a float would give ...123456768
        *(("0", 0), ("7.", 7_000_000_000), (".5", 500_000_000), ("-1.000000001", -1_000_000_001)),
        *(("1.305031e+09", 1_305_031_000_000_000_000), ("4611686018.427387903", 2**62 - 1)),
        *(("1.0000000004999", 1_000_000_000), ("1.0000000005001", 1_000_000_001)),
    ],
)
def test_seconds_are_exact(text: str, stamp_ns: int) -> None:
    assert parse_seconds(text) == stamp_ns


def test_times_are_exact_and_limited() -> None:
    assert parse_utc("2023-11-14 22:13:20.123456789+00:00") == 1_700_000_000_123_456_789
    assert parse_utc("2023-11-14T22:13:20.5") == 1_700_000_000_500_000_000
    for text in ("2117-01-01 00:00:00", "2263-01-01 00:00:00"):
        with pytest.raises(ValueError, match="146 years"):
            parse_utc(text)


@given(st.integers(-(2**62), 2**62 - 1))
def test_seconds_text_inverts(stamp_ns: int) -> None:
    assert parse_seconds(seconds_text(stamp_ns)) == stamp_ns


@given(st.lists(st.tuples(finite, forms), min_size=1, max_size=4), st.decimals(0, 2**32, places=9))
@pytest.mark.parametrize("size", [1, 30, 10**6])
def test_numbers_have_the_bits_of_float_and_stamps_those_of_integers_in_blocks_of_any_size(
    tmp_path_factory: pytest.TempPathFactory, size: int, rows: list, stamp: Decimal
) -> None:
    path = tmp_path_factory.getbasetemp() / "table.txt"
    texts = [form.format(value) for value, form in rows]
    data = "header\n" + "".join(f"  {stamp} {text}\r\n# comment\n\n" for text in texts)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sfr_loc_map.inputs.BLOCK_BYTES", size)
        path.write_bytes(data.encode())
        table = parse_table(read_table(path), "x", RowForm("t, x", (0, 1), StampParser.of("s")), skip=1)
        with pytest.raises(InputError, match=f"line {3 * len(rows) + 2} has 1 column:"):
            parse_table([data.encode(), b"7\n"], "x", RowForm("t, x", (0, 1), StampParser.of("s")), skip=1)
    assert [value.hex() for value in table.values[:, 0].tolist()] == [float(text).hex() for text in texts]
    assert table.stamps_ns.tolist() == [int(stamp * 10**9)] * len(rows)
    assert table.lines.tolist() == [3 * number + 2 for number in range(len(rows))]


@pytest.mark.parametrize(
    ("line", "words"),
    [
        *((f"{word},1", f": stamp '{word}' is not") for word in ("2x5", "2_0", "\u0662", "4611686018427387904")),
        *(("5", " has 1 column: 2"), ("5,1,2", " has 3 columns: 2")),
        *((f"5,{word}", f": '{word}' is not a finite number") for word in ("", "nan", "1e999", "1_0", "0x10")),
    ],
)
def test_the_line_that_is_wrong_is_named(line: str, words: str) -> None:
    with pytest.raises(InputError, match=f"^x line 3{words}"):
        parse_table([f"#\n1,2\n{line}\n".encode()], "x", RowForm("t, x", (0, 1), StampParser.of("ns"), ","))


@pytest.mark.parametrize(
    ("rows", "separator", "more"),
    [
        ("5\t1.5\t\n6\t-0\t\n", "\t", False),
        ("5;x;1.5\n6;y;-0\n", ";", True),
        ('5;"x";1,5\n6;"y";-0\n', ";", True),
        ("5   1.5\n6    -0\n", None, False),
        ("5, 1.5\r\n6, -0\r\n", ",", False),
        ("+5,+1.5\n6.,-.0\n", ",", False),
        ("5,1.5\n6,-0", ",", False),
        ("5,1.5,1\n6,-0\n", ",", True),
    ],
)
def test_the_form_of_a_table_does_not_change_its_numbers(rows: str, separator: str | None, more: bool) -> None:
    columns = (0, 2) if rows[2] in 'x"' else (0, 1)
    table = parse_table([rows.encode()], "x", RowForm("t, x", columns, StampParser.of("s"), separator, more))
    assert table.stamps_ns.tolist() == [5 * 10**9, 6 * 10**9]
    assert [value.hex() for value in table.values[:, 0].tolist()] == [(1.5).hex(), (-0.0).hex()]


@pytest.mark.parametrize("text", ["1_0", "infinity", "\u0661"])
def test_only_decimal_numbers_are_detected_as_numbers(text: str) -> None:
    assert math.isnan(number_or_nan(text))
