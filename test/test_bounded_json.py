"""JSON from outside: depth, digits and texts are bounded when it is read, so nothing behind it has to check them."""

from __future__ import annotations

import pytest

from sfr_loc_map.bounded_input import MAX_DEPTH, parse_json

TEXTS = {
    "lists": ("[" * (MAX_DEPTH + 1) + "]" * (MAX_DEPTH + 1), "nested too deeply"),
    "objects": ('{"a":' * 900 + "1" + "}" * 900, "nested too deeply"),
    "objects that the parser gives up on": ('{"a":' * 100_000, "nested too deeply"),
    "400 digits": ("9" * 400, "400 digits"),
    "5000 digits in a list": (f"[{'9' * 5000}]", "5000 digits"),
    "half of a pair, escaped": ('"\\uD800 "', "surrogates not allowed"),
    "half of a pair in a key": ('{"\\udc80": 1}', "surrogates not allowed"),
    "half of a pair as it is": ('"\ud800"', "surrogates not allowed"),
}


@pytest.mark.parametrize(("text", "words"), TEXTS.values(), ids=TEXTS)
def test_what_others_stumble_over_is_refused(text: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        parse_json(text)


def test_what_is_within_the_bounds_is_read() -> None:
    assert parse_json("[" * MAX_DEPTH + "]" * MAX_DEPTH)
    assert parse_json('{"\\ud83d\\ude00": 18446744073709551615}') == {"\U0001f600": 2**64 - 1}
    assert parse_json(b'[1e5, "\xc3\xa4", -5]') == [1e5, "\u00e4", -5]
