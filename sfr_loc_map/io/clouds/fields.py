"""The fields of a cloud in a file: values, comments that state properties, and tables of numbers in text."""

from __future__ import annotations

import io
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.cloud import COLUMNS, PointCloud
from sfr_loc_map.io.number_text import is_decimal
from sfr_loc_map.io.stamps.stamp_text import parse_stamp_ns
from sfr_loc_map.message_text import counted

Columns = dict[str, NDArray[Any]]  # values of each field, one per point
FUSED, PAIR_STAMPS = "fused", "pair_stamps_ns"
"""Names of properties of a cloud: members of an NPZ archive, or comments of other formats, such as `sfr fused true` and
`sfr pair_stamps_ns 1 2 3`."""
MAX_PAIR_STAMPS = 256  #: Number of pairs that the field `pair` of points can distinguish.
PLAIN_NAN = re.compile(rb"[-+]?(?:nan\([a-z0-9_]*\)|1\.#(?:qnan|snan|ind)[a-z0-9]*)", re.IGNORECASE)
"""Pattern of NaN in the notations of C and of Windows."""


@dataclass(frozen=True, slots=True, eq=False)
class CloudFields:
    """The fields of a cloud in a file."""

    columns: Columns
    fused: bool | None = None  #: As in `PointCloud`; None if not stated.
    pair_stamps_ns: tuple[int, ...] | None = None  #: As in `PointCloud`; None if not stated.
    comments: Sequence[str] = ()  #: All comments of the file.
    grid: tuple[int, int] | None = None  #: Width and height of an organised cloud.
    notes: tuple[str, ...] = ()  #: Content of the file that is ignored, for warnings.

    @classmethod
    def with_comments(
        cls, columns: Columns, comments: Sequence[str], grid: tuple[int, int] | None = None, notes: tuple[str, ...] = ()
    ) -> CloudFields:
        """Return the fields of a file with the properties that its comments state.

        ValueError if comments contradict each other or state invalid properties.
        """
        stated: dict[str, str] = {}
        for text in comments:
            sign, name, value = (*text.split(" ", 2), "", "")[:3]
            if sign == "sfr" and stated.setdefault(name, value.strip()) != value.strip():
                raise ValueError(f"its comments 'sfr {name}' contradict each other")
        fused = stated.get(FUSED)
        if fused not in (None, "true", "false"):
            raise ValueError(f"its comment 'sfr {FUSED}' has the value '{fused[:40]}': true or false is required")
        pair_stamps_ns = None
        if PAIR_STAMPS in stated:
            try:
                pair_stamps_ns = checked_stamps(map(parse_stamp_ns, stated[PAIR_STAMPS].split()))
            except ValueError as error:
                raise ValueError(f"its comment 'sfr {PAIR_STAMPS}': {error}") from error
        return cls(columns, None if fused is None else fused == "true", pair_stamps_ns, comments, grid, notes)

    @classmethod
    def of(cls, cloud: PointCloud) -> CloudFields:
        """Return the fields of a cloud."""
        columns = cls.of_points(cloud.xyz).columns | {name: getattr(cloud, name) for name in COLUMNS[1:]}
        return cls(columns, cloud.fused, cloud.pair_stamps_ns)

    @classmethod
    def of_points(cls, xyz: NDArray[Any]) -> CloudFields:
        """Return the fields of points `(N, 3)` without pixels."""
        return cls({name: xyz[:, axis] for axis, name in enumerate("xyz")})

    def property_comments(self) -> list[str]:
        """Return the comments that state the properties of the cloud."""
        comments = [] if self.fused is None else [f"sfr {FUSED} {str(self.fused).lower()}"]
        if self.pair_stamps_ns is not None:
            comments.append(f"sfr {PAIR_STAMPS} {' '.join(map(str, self.pair_stamps_ns))}")
        return comments

    def records(self) -> NDArray[np.void]:
        """Return the points as packed records `(N,)` of little-endian numbers."""
        types = [(name, values.dtype.newbyteorder("<")) for name, values in self.columns.items()]
        records = np.empty(len(self.columns["x"]), types)
        for name, values in self.columns.items():
            records[name] = values
        return records


def checked_stamps(stamps_ns: Iterable[int]) -> tuple[int, ...]:
    """Return the stamps of the pairs of a cloud, ns; ValueError if there are too many."""
    stamps = tuple(stamps_ns)
    if len(stamps) > MAX_PAIR_STAMPS:
        raise ValueError(f"{len(stamps)} stamps are listed: at most {MAX_PAIR_STAMPS} are allowed")
    return stamps


def check_names_differ(names: Sequence[str], where: str) -> None:
    """Raise ValueError if a name occurs twice, because it is then ambiguous which field has the values."""
    if doubled := sorted(name for name, count in Counter(names).items() if count > 1):
        raise ValueError(f"{where} has the field {doubled[0]} twice")


def text_lines(body: bytes) -> list[bytes]:
    """Return the lines of a text that are neither empty nor comments."""
    return [line for line in body.splitlines() if line.partition(b"#")[0].strip()]


def number_table(lines: Sequence[bytes], width: int) -> FloatArray:
    """Return lines of `width` numbers; NaN may be in the notation of Windows."""
    if not lines or not width:
        return np.zeros((len(lines), width))
    text = PLAIN_NAN.sub(b"nan", b"\n".join(lines))
    if b"#" in text and len(text_lines(text)) < len(lines):  # loadtxt would ignore the comment
        raise ValueError(_invalid_line(text, width))
    try:
        table = np.loadtxt(io.BytesIO(text), np.float64, ndmin=2)
    except ValueError as error:
        raise ValueError(_invalid_line(text, width)) from error
    if table.shape != (len(lines), width):
        raise ValueError(_invalid_line(text, width))
    return table


def _invalid_line(text: bytes, width: int) -> str:
    """Return a text about the first line of a table that does not have `width` numbers."""
    for number, line in enumerate(text.splitlines(), 1):
        words = line.decode("utf-8", "replace").partition("#")[0].split()
        if len(words) != width:
            return f"point {number} has {counted(len(words), 'number')}: {width} are required"
        for word in words:
            if not is_decimal(word) and word.lower().lstrip("+-") not in ("nan", "inf", "infinity"):
                return f"point {number} has '{word[:40]}': a number is required"
    return f"its data is not a table of {width} numbers in a line"


def ignored_after(rest: bytes) -> tuple[str, ...]:
    """Return the note on the data after the last point; empty if only padding follows."""
    is_padding = not rest.strip(b"\0 \t\r\n")
    return () if is_padding else (f"{counted(len(rest), 'byte')} after its last point ignored",)
