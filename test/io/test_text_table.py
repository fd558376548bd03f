"""Numbers of text: stamps are exact to the nanosecond, numbers have the bits of `float`, wrong lines are named."""

from __future__ import annotations

import math
from decimal import Decimal
from pathlib import Path

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from sfr_loc_map.errors import InputError
from sfr_loc_map.io.text_table import check_order, parse_seconds, parse_stamp_ns, parse_table, read_lines, seconds_text

finite = st.floats(allow_nan=False, allow_infinity=False)
forms = st.sampled_from(("{!r}", "{:.9f}", "{:.17e}", "{:.3g}", "{:.0f}"))


@pytest.mark.parametrize(
    ("text", "stamp_ns"),
    [
        ("1700000000.123456789", 1_700_000_000_123_456_789),  # a float would give ...123456768
        ("0", 0),
        ("7.", 7_000_000_000),
        (".5", 500_000_000),
        ("-1.000000001", -1_000_000_001),
        ("1.305031e+09", 1_305_031_000_000_000_000),
        ("1.0000000004999", 1_000_000_000),
        ("1.0000000005001", 1_000_000_001),
        ("9223372036.854775807", 2**63 - 1),
    ],
)
def test_seconds_are_exact(text: str, stamp_ns: int) -> None:
    assert parse_seconds(text) == stamp_ns


@given(st.integers(-(2**63), 2**63 - 1))
def test_seconds_text_inverts(stamp_ns: int) -> None:
    assert parse_seconds(seconds_text(stamp_ns)) == stamp_ns


@given(st.lists(st.tuples(finite, forms), min_size=1, max_size=4), st.decimals(0, 2**33, places=9))
def test_numbers_have_the_bits_of_float_and_stamps_those_of_integers(rows: list, stamp: Decimal) -> None:
    texts = [text for value, form in rows if math.isfinite(float(text := form.format(value)))]  # rounded up
    assume(texts)
    data = "".join(f"  {stamp} {text}\r\n# comment\n\n" for text in texts).encode()
    table = parse_table(data, "x", "t, x", (0, 1), stamp=parse_seconds)
    assert [value.hex() for value in table.values[:, 0].tolist()] == [float(text).hex() for text in texts]
    assert table.stamps_ns.tolist() == [int(stamp * 10**9)] * len(texts)
    assert table.lines.tolist() == [3 * number + 1 for number in range(len(texts))]


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("2.5,1", "stamp '2.5' is not whole nanoseconds"),
        ("2_0,1", "stamp '2_0' is not"),
        ("\u0662,1", "stamp '\u0662' is not"),
        ("9223372036854775808,1", "stamp .* is not whole nanoseconds"),
        ("5", "1 columns found where 2"),
        ("5,1,2", "3 columns found where 2"),
        ("5,", "'' is not a finite number"),
        ("5,nan", "'nan' is not a finite number"),
        ("5,1e999", "'1e999' is not a finite number"),
        ("5,1_0", "'1_0' is not a finite number"),
        ("5,0x10", "'0x10' is not a finite number"),
    ],
)
def test_the_line_that_is_wrong_is_named(line: str, words: str) -> None:
    with pytest.raises(InputError, match=f"^x line 3: {words}"):
        parse_table(f"#\n1,2\n{line}\n".encode(), "x", "t, x", (0, 1), stamp=parse_stamp_ns, separator=",")


def test_columns_are_chosen_and_more_may_follow() -> None:
    table = parse_table(b"a,3,x,7\nb,4,y,8,9\n", "x", "form", (3, 1), stamp=parse_stamp_ns, separator=",", more=True)
    assert (table.stamps_ns.tolist(), table.values.tolist()) == ([7, 8], [[3.0], [4.0]])
    assert not len(parse_table(b"# nothing\n", "x", "form", (0, 1)).lines)


def test_stamps_are_in_order() -> None:
    check_order([1, 1, 2], "x", strict=False)
    with pytest.raises(InputError, match=r"stamp 1 \(entry 2\)"):
        check_order([1, 1, 2], "x", strict=True)
    with pytest.raises(InputError, match=r"stamp 1 \(entry 3\) goes back behind 2"):
        check_order([1, 2, 1], "x", strict=False)


def test_what_is_no_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x").write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match="cannot read"):
        read_lines(tmp_path / "x")


@pytest.mark.parametrize("size", [1, 30, 10**6])
def test_blocks_of_any_size_give_the_same(monkeypatch: pytest.MonkeyPatch, size: int) -> None:
    monkeypatch.setattr("sfr_loc_map.io.text_table.BLOCK_BYTES", size)
    stamps = ["0", "9.5", "1e3", "1700000000.123456789"]
    text = "header\n" + "".join(f"{stamp} {k}\r\n# comment\n\n" for k, stamp in enumerate(stamps))
    table = parse_table(text.encode(), "x", "t, x", (0, 1), stamp=parse_seconds, skip=1)
    assert table.stamps_ns.tolist() == [parse_seconds(stamp) for stamp in stamps]
    assert table.values[:, 0].tolist() == [0, 1, 2, 3]
    assert table.lines.tolist() == [2, 5, 8, 11]
    with pytest.raises(InputError, match="line 14: 1 columns"):
        parse_table(text.encode() + b"7\n", "x", "t, x", (0, 1), stamp=parse_seconds, skip=1)
