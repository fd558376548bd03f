"""Rows read at speed have the bits that Python's own conversions give; what is not plain is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfr_loc_map.io.fast_rows import parse_rows
from sfr_loc_map.io.trajectory_file import parse_seconds

finite = st.floats(allow_nan=False, allow_infinity=False)
plain = st.floats(min_value=1e-40, max_value=1e40) | st.floats(min_value=-1e40, max_value=-1e-40) | st.just(-0.0)
forms = st.sampled_from(("{!r}", "{:.9f}", "{:.17e}", "{:.3g}", "{:.0f}", "{:.25f}"))


def of(text: str, *, comma: bool = True) -> tuple[list[int], list[str]] | None:
    found = parse_rows(text.encode(), 1, comma=comma)
    return None if found is None else (found[0].tolist(), [value.hex() for value in found[1][:, 0].tolist()])


@settings(max_examples=300)
@given(finite | plain, forms)
def test_numbers_have_the_bits_of_float(value: float, form: str) -> None:
    text = form.format(value)
    assert of(f"7,{text}\n") in (None, ([7], [float(text).hex()]))


@settings(max_examples=100)
@given(plain)
def test_the_shortest_form_of_a_usual_number_is_plain(value: float) -> None:
    assert of(f"7,{value!r}") == ([7], [value.hex()])


@settings(max_examples=200)
@given(st.integers(2**52, 2**53 - 1), st.integers(0, 9), st.integers(-1, 1))
def test_numbers_half_way_between_two_doubles_are_rounded_to_even(mantissa: int, power: int, more: int) -> None:
    text = str(((2 * mantissa + 1) << power) + more)
    assert of(f"7,{text}") == ([7], [float(text).hex()])


@settings(max_examples=100)
@given(st.integers(0, 2**63 - 1), st.integers(0, 9))
def test_seconds_are_those_of_the_strict_reader(stamp_ns: int, decimals: int) -> None:
    text = f"{stamp_ns // 10**9}.{stamp_ns % 10**9:09d}"[: -9 + decimals or None]
    wanted = None if text.endswith(".") else ([parse_seconds(text)], [(1.0).hex()])
    assert of(f"{text} 1", comma=False) == wanted


def test_comments_and_empty_lines_are_no_rows_and_columns_are_parted_as_the_form_asks() -> None:
    assert of("# t x\n\n1 \t2\n3.5 -4e2\n#", comma=False) == ([10**9, 3_500_000_000], [(2.0).hex(), (-400.0).hex()])
    found = parse_rows(b"1,0.5,-.25\n-0,1,2\n"[:11] + b"12,3,4", 2, comma=True)
    assert found is not None
    np.testing.assert_array_equal(found[1], [[0.5, -0.25], [3.0, 4.0]])


REFUSED = """1 1, 1,2,3 1;2 x,1 1,x 1,nan 1,inf 1,1_0 1,+1 1,--1 1,1e 1,1e5000 1.5,1 .5,1 -1,1
9223372036854775808,1 1,. 1,1.2.3 1,12345678901234567890 1,1e-70 1,\u0661"""


@pytest.mark.parametrize("text", [*REFUSED.split(), "1, 2", " 1,2", "1,2\r\n", "# a\r1,2\n"])
def test_what_is_not_plain_is_refused(text: str) -> None:
    assert of(text) is None
