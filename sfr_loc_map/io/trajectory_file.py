"""Trajectories as text files: the csv of the suite and TUM.

- csv: header `stamp_ns,rbOriginPos_m_Ds_{x,y,z},att_q_DsToRb_{1..4}`, scalar last. `att_q_DsToRb` turns components in
  DS into components in RB: the conjugate of the orientation in ROS messages.
- TUM (`.txt`, `.tum`): `t x y z qx qy qz qw`, t in seconds, orientation as in ROS messages; `#` starts a comment.

Stamps go to and from integer nanoseconds by integer arithmetic, never through a floating-point number.
"""

from __future__ import annotations

from collections.abc import Iterator
from decimal import ROUND_HALF_EVEN, Decimal
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import GeometryError, InputError, OutputError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.plausibility import MAX_POSITION_M, plausible_positions, plausible_quats
from sfr_loc_map.geometry.rotation import quat_conjugate
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import NS_PER_S, count_line_ends, read_table
from sfr_loc_map.io.atomic import atomic_path
from sfr_loc_map.io.fast_rows import parse_rows
from sfr_loc_map.io.text_numbers import fitting, is_decimal, parse_number, parse_stamp_ns

CSV_HEADER = "stamp_ns,rbOriginPos_m_Ds_x,rbOriginPos_m_Ds_y,rbOriginPos_m_Ds_z," + ",".join(
    f"att_q_DsToRb_{i}" for i in (1, 2, 3, 4)
)
TUM_HEADER = "# t x y z qx qy qz qw"
TUM_SUFFIXES = (".txt", ".tum")
COLUMNS = 8
STAMP_BYTES = 24
"""Longer stamps are read one by one."""
HEAD_BYTES = 10_000
"""The header is looked for in these."""
FAST_BYTES = 1_000_000
"""Shorter files are read without the kernel for long ones."""
BLOCK_BYTES = 2_000_000
"""Text is taken apart in blocks of whole lines of about so many bytes: a million lines at once take much memory."""


def load_trajectory(path: Path) -> Trajectory:
    """Read a trajectory: csv if the first line is its header, TUM otherwise.

    Stamps come as they are: out of order or twice, if so written.

    Raises:
        InputError: If the file is missing or empty, or a line does not hold eight finite numbers and a rotation;
            names the line.
    """
    path = Path(path)
    return parse_trajectory(path, _read(path))


def parse_trajectory(path: Path, data: bytes) -> Trajectory:
    """Return the trajectory of the content of a file: csv if the first line is its header, TUM otherwise.

    Args:
        path: The file, for messages.
        data: Its content.

    Raises:
        InputError: As `load_trajectory`.
    """
    data = data.removeprefix(b"\xef\xbb\xbf")
    first = data[:HEAD_BYTES].splitlines()
    is_csv = _has_csv_header(path, first[0] if first else b"")
    try:
        trajectory = _parse(data, is_csv)
    except (ValueError, ArithmeticError, GeometryError) as error:
        raise _explain(path, data, is_csv) from error
    if not len(trajectory):
        raise InputError(f"trajectory '{path}' has no pose: at least one line of eight numbers is needed")
    return trajectory


def save_trajectory(path: Path, trajectory: Trajectory, *, tum: bool | None = None) -> None:
    """Write a trajectory.

    Numbers are written in the shortest form that reads back to the same bits.

    Args:
        path: The file.
        trajectory: The poses.
        tum: Whether as TUM or as csv; None: TUM if the name ends in .txt or .tum.

    Raises:
        OutputError: If the file cannot be written.
    """
    path = Path(path)
    with atomic_path(path) as temporary:
        as_tum = path.suffix in TUM_SUFFIXES if tum is None else tum
        temporary.write_text(trajectory_text(trajectory, tum=as_tum), encoding="ascii")


def trajectory_text(trajectory: Trajectory, *, tum: bool) -> str:
    """Return a trajectory as the text of a TUM or a csv file."""
    stamps = trajectory.stamps_ns.tolist()
    quats = trajectory.quats_xyzw if tum else trajectory.att_q_ds_to_rb
    numbers = np.hstack((trajectory.positions, quats)).tolist()
    if tum:
        body = [f"{seconds_text(s)} {' '.join(map(repr, row))}" for s, row in zip(stamps, numbers, strict=True)]
    else:
        body = [f"{s},{','.join(map(repr, row))}" for s, row in zip(stamps, numbers, strict=True)]
    return "\n".join([TUM_HEADER if tum else CSV_HEADER, *body]) + "\n"


def csv_row(stamp_ns: int, position: FloatArray, quat_xyzw: FloatArray) -> str:
    """Return one line of the csv, without its end: the pose of RB in DS, orientation given as in ROS messages."""
    return ",".join([str(stamp_ns), *map(repr, (*position.tolist(), *quat_conjugate(quat_xyzw).tolist()))])


def seconds_text(stamp_ns: int) -> str:
    """Return nanoseconds as seconds with nine decimals, exactly."""
    whole, rest = divmod(abs(stamp_ns), NS_PER_S)
    return f"{'-' if stamp_ns < 0 else ''}{whole}.{rest:09d}"


def parse_seconds(text: str) -> int:
    """Return the nanoseconds of decimal seconds, exactly; beyond nine decimals to the nearest (half to even).

    Raises:
        ValueError: If it is not a finite decimal number, or does not fit 64 bit.
        decimal.InvalidOperation: The same.
    """
    if not is_decimal(text):
        raise ValueError("it is not a decimal number")
    whole, _, fraction = text.partition(".")
    if whole.isdigit() and len(fraction) <= 9 and (fraction or "0").isdigit():
        return fitting(int(whole) * NS_PER_S + int(fraction.ljust(9, "0")))
    stamp = Decimal(text).scaleb(9).quantize(Decimal(1), ROUND_HALF_EVEN)
    return fitting(int(stamp))


def check_order(stamps_ns: list[int], name: str, *, strict: bool) -> None:
    """Check that stamps do not go backwards (strict: that they grow).

    Raises:
        InputError: At the first that does; names it.
    """
    stamps = np.asarray(stamps_ns, dtype=np.int64)
    steps = np.diff(stamps)
    wrong = steps <= 0 if strict else steps < 0
    if wrong.any():
        first = int(np.argmax(wrong))
        word = "does not come after" if strict else "goes back behind"
        raise InputError(
            f"{name}: stamp {stamps[first + 1]} (entry {first + 2}) {word} {stamps[first]}: stamps must be in order"
        )


def check_stamp(stamp_ns: int) -> None:
    """Check that a stamp fits a ROS message (seconds in 32 bit).

    Raises:
        OutputError: If not.
    """
    if not 0 <= stamp_ns < 2**31 * NS_PER_S:
        raise OutputError(f"stamp {stamp_ns} ns does not fit a ROS message: 0 to 2^31 seconds are possible")


def _read(path: Path) -> bytes:
    try:
        return read_table(path)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"cannot read trajectory '{path}': {reason}; give a csv or TUM file") from error


def _has_csv_header(path: Path, first: bytes) -> bool:
    header = first.decode("utf-8", "replace").strip().replace(" ", "")
    if header != CSV_HEADER and (path.suffix == ".csv" or header.startswith("stamp_ns")):
        raise InputError(f"'{path}' line 1 is '{header[:60]}': the header '{CSV_HEADER}' is needed")
    return header == CSV_HEADER


def _parse(data: bytes, is_csv: bool) -> Trajectory:
    room = 1 + count_line_ends(data)
    stamps_ns, positions, quats = np.empty(room, np.int64), np.empty((room, 3)), np.empty((room, 4))
    count = 0
    header = data[:HEAD_BYTES].splitlines(keepends=True)[:is_csv]
    for text in _blocks(data, len(b"".join(header))):
        rows = parse_rows(text, COLUMNS - 1, comma=is_csv) if len(data) >= FAST_BYTES else None
        stamps, numbers = rows or _strict_rows(text, is_csv)
        new = slice(count, count + len(stamps))
        stamps_ns[new], positions[new], quats[new] = stamps, numbers[:, :3], numbers[:, 3:]
        count = new.stop
    stamps_ns, positions, quats = stamps_ns[:count], positions[:count], quats[:count]
    return Trajectory(stamps_ns, positions, quat_conjugate(quats) if is_csv else quats)


def _blocks(data: bytes, start: int) -> Iterator[bytes]:
    """Yield a text from a place on in portions of whole lines."""
    while start < len(data):
        end = data.find(b"\n", start + BLOCK_BYTES) + 1 or len(data)
        yield data[start:end]
        start = end


def _strict_rows(text: bytes, is_csv: bool) -> tuple[IntArray, FloatArray]:
    """Return the stamps and numbers of lines of any form that is allowed."""
    rows = [line for line in text.splitlines() if line[:1] > b"#" or _is_row(line)]
    if not rows:
        return np.zeros(0, np.int64), np.zeros((0, COLUMNS - 1))
    return _stamps(rows, is_csv), _floats(rows, "," if is_csv else None)


def _is_row(line: bytes) -> bool:
    """Tell whether a line is to hold a pose: it is neither empty nor a comment."""
    return line[:1] not in (b"", b"#") and bool(line.strip())


def _stamps(rows: list[bytes], is_csv: bool) -> IntArray:
    """Return the nanoseconds of the first column; what is not plain digits takes the strict, slower way."""
    stamps = np.empty(len(rows), np.int64)
    letters = np.array(rows, f"S{STAMP_BYTES}").view(np.uint8).reshape(len(rows), STAMP_BYTES)  # cuts longer rows
    ends = letters == ord(",") if is_csv else (letters == ord(" ")) | (letters == ord("\t"))
    widths = ends.argmax(axis=1)
    for width in np.unique(widths).tolist():
        same = np.flatnonzero(widths == width)
        plain = _plain_stamps(letters[same, :width], is_csv)
        stamps[same] = [_strict_stamp(rows[n], is_csv) for n in same.tolist()] if plain is None else plain
    return stamps


def _plain_stamps(letters: NDArray[np.uint8], is_csv: bool) -> IntArray | None:
    """Return the nanoseconds of texts `(N, width)` if all are like `1700123456` (csv) or `1700.123456`, else None."""
    width = letters.shape[1]
    if is_csv:
        digits, last = letters - np.uint8(ord("0")), width - 1
    else:
        dot = int((letters[0] == ord(".")).argmax()) if width else 0
        if not (0 < dot <= 10 and width - dot <= 10 and (letters[:, dot] == ord(".")).all()):
            return None
        digits, last = np.delete(letters, dot, axis=1) - np.uint8(ord("0")), dot + 8
    if not (width > 0 and last <= 18 and (digits <= 9).all() and (last < 18 or (digits[:, 0] < 9).all())):
        return None  # what is below "0" became large; nineteen digits from 9 on do not fit
    return np.asarray(digits.astype(np.int64) @ (10 ** np.arange(last, last - digits.shape[1], -1, dtype=np.int64)))


def _strict_stamp(row: bytes, is_csv: bool) -> int:
    text = row.split(b"," if is_csv else None, 1)[0].decode()
    return parse_stamp_ns(text) if is_csv else parse_seconds(text)


def _floats(rows: list[bytes], separator: str | None) -> FloatArray:
    """Return columns 2 to 8; the reader of numpy is used for its speed, and refuses rows of unequal length."""
    values = np.loadtxt(rows, dtype=np.float64, delimiter=separator, comments=None, ndmin=2, encoding="ascii")
    if values.shape[1] != COLUMNS:
        raise ValueError("wrong number of columns")
    return np.asarray(values[:, 1:])


def _explain(path: Path, data: bytes, is_csv: bool) -> InputError:
    """Return the error that names the first line that is wrong."""
    for number, row in enumerate(data.splitlines(), 1):
        problem = _problem(row.decode("utf-8", "replace"), is_csv) if _is_row(row) and number > int(is_csv) else ""
        if problem:
            return InputError(f"'{path}' line {number}: {problem}; correct or leave out the line")
    return InputError(f"'{path}' cannot be read as a trajectory")


def _problem(row: str, is_csv: bool) -> str:
    words = row.split("," if is_csv else None)
    if len(words) != COLUMNS:
        form = CSV_HEADER if is_csv else TUM_HEADER.lstrip("# ")
        return f"{len(words)} columns found where {COLUMNS} ({form}) are needed"
    try:
        parse_stamp_ns(words[0]) if is_csv else parse_seconds(words[0])
    except (ValueError, ArithmeticError):
        too_large = " (are these nanoseconds?)" if words[0].isdigit() else ""
        return f"stamp '{words[0]}' is not {'whole nanoseconds' if is_csv else f'a number of seconds{too_large}'}"
    try:
        values = np.array([parse_number(word) for word in words[1:]])
    except ValueError as error:
        return str(error)
    if not plausible_positions(values[:3]):
        return f"the position is absurd: numbers up to {MAX_POSITION_M:g} are possible, in metres"
    if not plausible_quats(values[3:]):
        return f"the quaternion {values[3:].tolist()} is not a rotation: a unit quaternion is needed"
    return ""
