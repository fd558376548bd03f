"""Strict reading of numbers and tables in text files, with stamps exact to the nanosecond.

Python's own conversions accept more than is valid in files: underscores, digits of other scripts, `nan` and
`infinity`, integers of any length. Stamps are converted to and from integer nanoseconds by integer arithmetic, never
by floating-point numbers. A table is read in blocks; only a block that fails is read line by line to find the errors.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from decimal import ROUND_HALF_EVEN, Decimal, InvalidOperation
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.inputs import NS_PER_S, read_table_text

MAX_NUMBER_LENGTH = 400
STAMP_LENGTH = 64
UNIT_WORDS = {1: "nanoseconds", 1_000: "microseconds", 1_000_000: "milliseconds", NS_PER_S: "seconds"}
STAMP_LIMIT = 2**62  #: 146 years from 1970, ns; differences of two stamps fit 64 bits.
BOM = b"\xef\xbb\xbf"
COMMENTS = b"#%"  #: First characters of comment lines.
NO_VALUE = ("", "nan", "null", "none", "-")  #: Cells without a value (target not observed), in lower case.
MAX_BROKEN = 0.1  #: Largest fraction of invalid lines that are skipped.
_WHOLE = re.compile(r"[+-]?[0-9]{1,19}")
_COUNT = re.compile(r"[0-9]{1,12}")
_DECIMAL = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]{1,4})?")


def parse_stamp_ns(text: str) -> int:
    """Return integer nanoseconds; surrounding spaces are allowed."""
    if _WHOLE.fullmatch(text.strip(" \t")) and -STAMP_LIMIT <= int(text) < STAMP_LIMIT:
        return int(text)
    raise ValueError(f"stamp '{text[:40]}' is not an integer number of nanoseconds within 146 years of 1970")


def parse_seconds(text: str) -> int:
    """Return decimal seconds as nanoseconds, exactly; more than nine decimals are rounded half to even."""
    word = text.strip(" \t")
    whole, _, fraction = word.partition(".")
    if 0 < len(whole) <= 10 and len(fraction) <= 9 and (whole + fraction).isdecimal() and word.isascii():
        stamp = int(whole) * NS_PER_S + int(fraction.ljust(9, "0"))  # fast path for the common form
        if stamp < STAMP_LIMIT:
            return stamp
    elif _is_decimal(word):
        with suppress(InvalidOperation):
            stamp = int(Decimal(word).scaleb(9).quantize(Decimal(1), ROUND_HALF_EVEN))
            if -STAMP_LIMIT <= stamp < STAMP_LIMIT:
                return stamp
    hint = " (are these nanoseconds?)" if word.isdigit() else ""
    raise ValueError(f"stamp '{word[:40]}' is not a number of seconds{hint}")


def parse_decimal(text: str, unit_ns: int) -> int:
    """Return the nanoseconds of a decimal number in a unit of `unit_ns` nanoseconds, rounded half to even."""
    word = text.strip(" \t").replace(",", ".")
    if _is_decimal(word):
        with suppress(InvalidOperation):
            stamp = int((Decimal(word) * unit_ns).quantize(Decimal(1), ROUND_HALF_EVEN))
            if -STAMP_LIMIT <= stamp < STAMP_LIMIT:
                return stamp
    raise ValueError(f"stamp '{word[:40]}' is not a number of {UNIT_WORDS[unit_ns]} up to 146 years from 1970")


def parse_nanoseconds(text: str) -> int:
    """Return the nanoseconds in a text that may have decimals or an exponent: `1700000000000000000.000`."""
    try:
        return parse_stamp_ns(text)
    except ValueError:
        return parse_decimal(text, 1)


def parse_utc(text: str) -> int:
    """Return the nanoseconds of a time written as `2026-05-04 10:22:01.25`, UTC unless the text has a zone."""
    moment = datetime.fromisoformat(text.strip())
    since = (moment if moment.tzinfo else moment.replace(tzinfo=UTC)) - datetime.fromtimestamp(0, UTC)
    return since // timedelta(microseconds=1) * 1000


def seconds_text(stamp_ns: int) -> str:
    """Return nanoseconds as seconds with nine decimals, exactly."""
    whole, rest = divmod(abs(stamp_ns), NS_PER_S)
    return f"{'-' if stamp_ns < 0 else ''}{whole}.{rest:09d}"


def parse_count(text: str) -> int:
    """Return a count in a header."""
    if not _COUNT.fullmatch(text):
        raise ValueError(f"'{text[:40]}' is not a count: a whole number is required")
    return int(text)


def parse_number(text: str) -> float:
    """Return a finite decimal number; surrounding spaces are allowed."""
    word = text.strip(" \t")
    value = float(word) if _is_decimal(word) else math.nan
    if not math.isfinite(value):
        raise ValueError(f"'{word[:40]}' is not a finite number")
    return value


def check_order(stamps_ns: ArrayLike, name: str, *, strict: bool) -> None:
    """Check that stamps do not decrease; `strict`: that they increase."""
    stamps = np.asarray(stamps_ns, dtype=np.int64)
    wrong = np.diff(stamps) < (1 if strict else 0)
    if wrong.any():
        first = int(np.argmax(wrong))
        word = "is not later than" if strict else "is earlier than"
        raise InputError(
            f"{name}: stamp {stamps[first + 1]} (entry {first + 2}) {word} {stamps[first]}: stamps must be in order"
        )


def read_lines(path: Path) -> list[str]:
    """Return the lines of a text file that are neither empty nor a comment (`#`)."""
    lines = read_table_text(path).splitlines()
    return [line for line in lines if line.strip() and not line.lstrip().startswith("#")]


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """The rows of a text table."""

    name: str  #: Name of the text, for messages.
    lines: IntArray  #: `(N,)` line number of each row, from 1.
    stamps_ns: IntArray  #: `(N,)` nanoseconds; empty without a column of stamps.
    values: FloatArray  #: `(N, K)` finite numbers.
    missing: int = 0  #: Number of skipped rows without a value in a column that is read.
    broken: tuple[str, ...] = ()  #: The error in each invalid row, with its line number.

    def without(self, good: Mask, problems: Sequence[str]) -> Table:
        """Return the good rows; `problems` has the error in each of the other rows."""
        stamps_ns = self.stamps_ns[good] if len(self.stamps_ns) else self.stamps_ns
        kept = replace(self, lines=self.lines[good], stamps_ns=stamps_ns, values=self.values[good])
        return replace(kept, broken=(*self.broken, *problems))

    def checked(self) -> Table:
        """Return the table; InputError if the fraction of invalid rows exceeds `MAX_BROKEN`."""
        count = len(self.broken)
        rows = len(self.lines) + count
        if count > MAX_BROKEN * rows:
            several = f" ({count} of {rows} lines are invalid)" if count > 1 else ""
            raise InputError(f"{self.name} {self.broken[0]}; correct or remove the line{several}")
        return self

    @property
    def left_out(self) -> str:
        """Description of the skipped rows; empty if no row was skipped."""
        parts = [f"{self.missing} lines without values skipped"] if self.missing else []
        if self.broken:
            parts.append(f"{len(self.broken)} invalid lines skipped, the first: {self.broken[0]}")
        return "; ".join(parts)


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
    tolerant: bool = False,
) -> Table:
    """Return the stamps and numbers of a text; empty lines, comments and the first `skip` lines are ignored.

    The text is given in blocks of complete lines. `places` are the columns to read, from 0. If `stamp` is given, it
    converts the first of these columns to nanoseconds. With `more`, lines may have further columns. Without a
    `separator`, cells are separated by spaces. Messages call the text `name` and the content of a line `form`. With
    `tolerant`, invalid rows up to the fraction `MAX_BROKEN` are skipped and counted.
    """
    reader = _RowReader(form, tuple(places), stamp, separator, more, tolerant)
    columns = len(places) - (stamp is not None)
    number, missing, broken = 0, 0, list[str]()
    table = Table(name, np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, columns)))
    for block in blocks:
        texts = [text.strip() for text in (block if number else block.removeprefix(BOM)).splitlines()]
        chosen = [k for k, text in enumerate(texts) if text and text[0] not in COMMENTS and number + k >= skip]
        try:
            stamps_ns, values = reader.all_at_once([texts[k] for k in chosen])
        except (ValueError, IndexError) as error:
            found = [reader.one(texts[k], number + k + 1) for k in chosen]
            problems = [row for row in found if isinstance(row, str)]
            if problems and not tolerant:
                raise InputError(f"{name} {problems[0]}; correct or remove the line") from error
            broken += problems
            missing += found.count(None)
            good = [(k, row) for k, row in zip(chosen, found, strict=True) if isinstance(row, tuple)]
            chosen = [k for k, _ in good]
            stamps_ns = np.array([row[0] for _, row in good] if stamp else [], np.int64)
            values = np.array([row[1] for _, row in good], np.float64).reshape(-1, columns)
        lines = np.array(chosen, np.int64) + number + 1
        for column, part in ((table.lines, lines), (table.stamps_ns, stamps_ns), (table.values, values)):
            end = len(column)  # in place: concatenating all parts takes twice the memory
            column.resize((end + len(part), *column.shape[1:]), refcheck=False)
            column[end:] = part
        number += len(texts)
    return replace(table, missing=missing, broken=tuple(broken)).checked()


@dataclass(frozen=True, slots=True)
class _RowReader:
    """Reads the cells of rows, either many rows by numpy, which fails if a single row is invalid, or one row."""

    form: str
    places: tuple[int, ...]
    stamp: Callable[[str], int] | None
    separator: str | None
    more: bool
    tolerant: bool

    def all_at_once(self, rows: list[bytes]) -> tuple[IntArray, FloatArray]:
        """Return stamps and numbers of rows; ValueError or IndexError if a row does not consist of numbers."""
        columns = len(self.places) - (self.stamp is not None)
        if not rows:
            return np.zeros(0, np.int64), np.zeros((0, columns))
        used = list(self.places) if self.more else None  # None: numpy rejects rows of unequal length
        stamps_ns = np.zeros(0, np.int64)
        if self.stamp:
            kinds = [("stamp", f"S{STAMP_LENGTH}"), ("values", np.float64, (columns,))]
            found = np.loadtxt(rows, kinds, None, self.separator, usecols=used, ndmin=1, encoding="ascii")
            stamps_ns, values = _stamps_of(found["stamp"], self.stamp), found["values"]
        else:
            values = np.loadtxt(rows, np.float64, None, self.separator, usecols=used, ndmin=2, encoding="ascii")
        if values.shape[1] != columns:
            raise ValueError("a row has additional columns")
        if not np.isfinite(values).all():
            raise ValueError("a number is not finite")
        return stamps_ns, values

    def one(self, row: bytes, line: int) -> tuple[int, list[float]] | str | None:
        """Return the stamp and numbers of a row, or the error in the row, or None if a value is missing."""
        cells = split_cells(row.decode("utf-8", "replace"), self.separator)
        width = max(self.places) + 1
        if len(cells) < width or (len(cells) > width and not self.more):
            return f"line {line}: {len(cells)} columns found where {width} ({self.form}) are required"
        words = [cells[place].lower().lstrip("+-").partition("(")[0] for place in self.places]
        if self.tolerant and any(word in NO_VALUE for word in words):
            return None
        texts = [cells[place] for place in self.places]
        try:
            if self.separator not in (None, ","):  # decimal commas, if the separator is not a comma
                texts = [text.replace(",", ".") for text in texts]
            stamp_ns = self.stamp(texts.pop(0)) if self.stamp else 0
            return stamp_ns, [parse_number(text) for text in texts]
        except (ValueError, ArithmeticError) as error:
            return f"line {line}: {error}"


def split_cells(text: str, separator: str | None) -> list[str]:
    """Return the cells of a line without surrounding spaces and quotes; separator None: spaces."""
    if separator is None:
        return [cell.strip('"') for cell in text.split()]
    return [cell.strip() for cell in next(csv.reader([text], delimiter=separator, skipinitialspace=True), [])]


def _stamps_of(texts: NDArray[np.bytes_], stamp: Callable[[str], int]) -> IntArray:
    """Return the nanoseconds of stamps; vectorised if all have the same number of digits before the point."""
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
    alike = alike and stamp in (parse_seconds, parse_stamp_ns, parse_nanoseconds)
    whole = digits[:, :places] @ powers[-places:] if alike else np.zeros(1)
    if not alike or digits.max() > 9 or (ended[:, :-1] > ended[:, 1:]).any() or whole.max() >= STAMP_LIMIT // NS_PER_S:
        return np.array([stamp(text.decode("ascii")) for text in texts.tolist()], np.int64)
    fraction = digits[:, places:] @ powers[1:]
    return np.asarray(whole.astype(np.int64) * NS_PER_S + fraction.astype(np.int64))


def _is_decimal(text: str) -> bool:
    return len(text) <= MAX_NUMBER_LENGTH and _DECIMAL.fullmatch(text) is not None
