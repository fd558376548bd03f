"""Numbers and tables of text files, read strictly, and the stamps in them, exact to the nanosecond.

Python's own conversions take more than files mean: underscores, digits of other scripts, `nan` and `infinity`,
integers of any length. Stamps go to and from integer nanoseconds by integer arithmetic, never through a floating-point
number. A table is read in blocks; what is wrong in one is looked for, line by line, only once that has failed.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from decimal import ROUND_HALF_EVEN, Decimal, InvalidOperation
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sfr_loc_map.errors import GeometryError, InputError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.plausibility import MAX_POSITION_M, plausible_positions, plausible_quats
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import NS_PER_S, read_table_text, refusing

MAX_NUMBER_LENGTH = 400
STAMP_LENGTH = 64
STAMP_LIMIT = 2**62  #: 146 years from 1970: differences of stamps have 64 bits, too.
BOM = b"\xef\xbb\xbf"
COMMENT = ord("#")
_WHOLE = re.compile(r"[+-]?[0-9]{1,19}")
_COUNT = re.compile(r"[0-9]{1,12}")
_DECIMAL = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]{1,4})?")


def parse_stamp_ns(text: str) -> int:
    """Return whole nanoseconds; spaces around them are allowed."""
    if _WHOLE.fullmatch(text.strip(" \t")) and -STAMP_LIMIT <= int(text) < STAMP_LIMIT:
        return int(text)
    raise ValueError(f"stamp '{text[:40]}' is not whole nanoseconds, up to 146 years from 1970")


def parse_seconds(text: str) -> int:
    """Return the nanoseconds of decimal seconds, exactly; beyond nine decimals to the nearest (half to even)."""
    word = text.strip(" \t")
    whole, _, fraction = word.partition(".")
    if 0 < len(whole) <= 10 and len(fraction) <= 9 and (whole + fraction).isdecimal() and word.isascii():
        stamp = int(whole) * NS_PER_S + int(fraction.ljust(9, "0"))  # the form that nearly all have
        if stamp < STAMP_LIMIT:
            return stamp
    elif _is_decimal(word):
        with suppress(InvalidOperation):
            stamp = int(Decimal(word).scaleb(9).quantize(Decimal(1), ROUND_HALF_EVEN))
            if -STAMP_LIMIT <= stamp < STAMP_LIMIT:
                return stamp
    hint = " (are these nanoseconds?)" if word.isdigit() else ""
    raise ValueError(f"stamp '{word[:40]}' is not a number of seconds{hint}")


def seconds_text(stamp_ns: int) -> str:
    """Return nanoseconds as seconds with nine decimals, exactly."""
    whole, rest = divmod(abs(stamp_ns), NS_PER_S)
    return f"{'-' if stamp_ns < 0 else ''}{whole}.{rest:09d}"


def parse_count(text: str) -> int:
    """Return a number of things, as a header gives it."""
    if not _COUNT.fullmatch(text):
        raise ValueError(f"'{text[:40]}' is not a number of points, bytes or values")
    return int(text)


def parse_number(text: str) -> float:
    """Return a finite decimal number; spaces around it are allowed."""
    word = text.strip(" \t")
    value = float(word) if _is_decimal(word) else math.nan
    if not math.isfinite(value):
        raise ValueError(f"'{word[:40]}' is not a finite number")
    return value


def check_order(stamps_ns: ArrayLike, name: str, *, strict: bool) -> None:
    """Check that stamps do not go backwards (strict: that they grow)."""
    stamps = np.asarray(stamps_ns, dtype=np.int64)
    wrong = np.diff(stamps) < (1 if strict else 0)
    if wrong.any():
        first = int(np.argmax(wrong))
        word = "does not come after" if strict else "goes back behind"
        raise InputError(
            f"{name}: stamp {stamps[first + 1]} (entry {first + 2}) {word} {stamps[first]}: stamps must be in order"
        )


def read_lines(path: Path) -> list[str]:
    """Return the lines of a text file that are not empty and no comment (`#`)."""
    lines = read_table_text(path).splitlines()
    return [line for line in lines if line.strip() and not line.lstrip().startswith("#")]


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Rows of a text."""

    name: str  #: Name of the text, for messages.
    lines: IntArray  #: `(N,)` number of the line of each row, from 1.
    stamps_ns: IntArray  #: `(N,)` nanoseconds; empty without a column of stamps.
    values: FloatArray  #: `(N, K)` finite numbers.

    def trajectory(self, signs: FloatArray) -> Trajectory:
        """Return the poses of the rows: x, y, z, quaternion by `signs`; the error names the first line with none."""
        positions, quats_xyzw = self.values[:, :3].copy(), self.values[:, 3:] * signs
        try:
            return Trajectory(self.stamps_ns, positions, quats_xyzw)
        except GeometryError as error:
            near, unit = plausible_positions(positions), plausible_quats(quats_xyzw)
            row = int(np.argmin(near & unit))
            problem = f"the quaternion {quats_xyzw[row].tolist()} is not a rotation: a unit quaternion is needed"
            if not near[row]:
                problem = f"the position is absurd: numbers up to {MAX_POSITION_M:g} are possible, in metres"
            text = f"{self.name} line {self.lines[row]}: {problem}; correct or leave out the line"
            raise InputError(text) from error


def parse_table(
    blocks: Iterable[bytes],
    name: str,
    form: str,
    places: Sequence[int],
    *,
    stamp: Callable[[str], int] | None = None,
    separator: str | None = None,
    more: bool = False,
    skip: int = 0,
) -> Table:
    """Return the stamps and numbers of a text without empty lines, comments and `skip` lines of a header.

    It comes in blocks of whole lines. `places` are the columns read, from 0, the first of them for `stamp` if given,
    which makes nanoseconds of a text; `more`: lines may have more columns than the last of them. Spaces separate
    without a `separator`. `name` and `form` (what stands in a line) are for messages.
    """
    columns, width = list(places[1:] if stamp else places), max(places) + 1

    def check(row: bytes) -> None:
        cells = row.decode("utf-8", "replace").split(separator)
        if len(cells) < width or (len(cells) > width and not more):
            raise ValueError(f"{len(cells)} columns found where {width} ({form}) are needed")
        if stamp:
            stamp(cells[places[0]])
        for column in columns:
            parse_number(cells[column])

    number, table = 0, Table(name, np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, len(columns))))
    for block in blocks:
        texts = [text.strip() for text in (block if number else block.removeprefix(BOM)).splitlines()]
        chosen = [k for k, text in enumerate(texts) if text and text[0] != COMMENT and number + k >= skip]
        rows = [texts[k] for k in chosen]
        stamps_ns, values = np.zeros(0, np.int64), np.zeros((0, len(columns)))
        try:
            used = list(places) if more else None  # without them numpy refuses rows of unequal length
            if stamp and rows:
                kinds = [("stamp", f"S{STAMP_LENGTH}"), ("values", np.float64, (len(columns),))]
                found = np.loadtxt(rows, kinds, None, separator, usecols=used, ndmin=1, encoding="ascii")
                stamps_ns, values = _stamps_of(found["stamp"], stamp), found["values"]
            elif rows:
                values = np.loadtxt(rows, np.float64, None, separator, usecols=used, ndmin=2, encoding="ascii")
                if values.shape[1] != len(columns):
                    raise ValueError("columns that nobody needs")
            if not np.isfinite(values).all():
                raise ValueError("a number that is none")
        except (ValueError, IndexError) as error:
            for k in chosen:
                with refusing(f"{name} line {number + k + 1}", "correct or leave out the line"):
                    check(texts[k])
            raise InputError(f"{name} cannot be read as a table of {form}") from error
        lines = np.array(chosen, np.int64) + number + 1
        for column, part in ((table.lines, lines), (table.stamps_ns, stamps_ns), (table.values, values)):
            end = len(column)  # it grows where it is: parts that are joined at last take twice the memory
            column.resize((end + len(part), *column.shape[1:]), refcheck=False)
            column[end:] = part
        number += len(texts)
    return table


def _stamps_of(texts: NDArray[np.bytes_], stamp: Callable[[str], int]) -> IntArray:
    """Return the nanoseconds of stamps; all at once where they have as many digits each before the point."""
    chars = np.ascontiguousarray(texts).view(np.uint8).reshape(len(texts), STAMP_LENGTH)
    point = int(stamp is parse_seconds)
    places = texts[0].find(b".") if point else len(texts[0]) - 9
    used = places + point + 9
    digits, ended = chars[:, :used] - np.uint8(ord("0")), chars[:, :used] == 0
    alike = 0 < places <= 10 and not chars[:, used:].any() and not ended[:, : places if point else None].any()
    if alike and point:
        alike = bool((chars[:, places] == ord(".")).all())
        digits = np.delete(np.where(ended, np.uint8(0), digits), places, axis=1)
        ended = ended[:, places + 1 :]
    powers = 10.0 ** np.arange(9, -1, -1)  # sums of ten digits are exact
    whole = digits[:, :places] @ powers[-places:] if alike else np.zeros(1)
    if not alike or digits.max() > 9 or (ended[:, :-1] > ended[:, 1:]).any() or whole.max() >= STAMP_LIMIT // NS_PER_S:
        return np.array([stamp(text.decode("ascii")) for text in texts.tolist()], np.int64)
    fraction = digits[:, places:] @ powers[1:]
    return np.asarray(whole.astype(np.int64) * NS_PER_S + fraction.astype(np.int64))


def _is_decimal(text: str) -> bool:
    return len(text) <= MAX_NUMBER_LENGTH and _DECIMAL.fullmatch(text) is not None
