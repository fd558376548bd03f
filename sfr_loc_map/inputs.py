"""Input from outside: bounded reading of files, and the errors of a broken input.

All files of other programs are read through this module. A rejected file raises the error that the system itself would
raise (`OSError`, `ValueError`). Each reader adds, by `refusing`, which file it requires. `json_yaml` parses the texts.
"""

from __future__ import annotations

import codecs
import csv
import errno
import io
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import yaml

from sfr_loc_map.errors import GeometryError, InputError

# ---- errors of a broken input

REFUSED: tuple[type[Exception], ...] = (OSError, ValueError, ArithmeticError, LookupError, TypeError, GeometryError)
REFUSED += (yaml.YAMLError, csv.Error, SyntaxError)
"""Errors that parsers and checks raise for a broken input. The XML parser raises SyntaxError."""


@contextmanager
def refusing(where: str, advice: str = "correct the file") -> Iterator[None]:
    """Convert errors of a broken input to an `InputError` with one line: WHERE: what is wrong; ADVICE."""
    try:
        yield
    except REFUSED as error:
        reason = getattr(error, "strerror", None) or " ".join(str(error).split())
        raise InputError(f"{where}: {reason};", advice) from error


def missing(path: Path) -> str:
    """Return the message about an input that does not exist, in the same words as for unreadable files."""
    return f"cannot read '{path}': {os.strerror(errno.ENOENT)}"


def check_exists(path: Path, advice: str) -> None:
    """Raise InputError if an input does not exist."""
    if not path.exists():
        raise InputError(f"{missing(path)};", advice)


# ---- files

MB = 1_000_000
MAX_TEXT_BYTES = MB  #: Maximum size of a configuration, rig or topic file. Typical files have a few kilobytes.
MAX_JSON_BYTES = 64 * MB
MAX_IMAGE_BYTES = 512 * MB
MAX_CLOUD_BYTES = 4096 * MB
MAX_TABLE_BYTES = 256 * MB  #: Maximum size of a text table: a trajectory of 1.5 million poses.
MAX_TABLE_LINES = 4_000_000
MAX_INVALID = 0.1
"""Largest fraction of the rows, messages or poses of an input that are skipped as invalid, stray or out of order."""
MAX_LINE_BYTES = 64_000
BLOCK_BYTES = 4 * MB
"""Approximate size, bytes, of the blocks of whole lines in which tables are read, to limit memory."""
FREE_BYTES = 64 * 2**20  #: Decompressed size that is always accepted, bytes.
LARGEST_RATIO = 20
"""Maximum ratio of decompressed to compressed size above `FREE_BYTES`. Images and points of real sensors have lower
ratios."""
HEAD_BYTES = 4096  #: Number of bytes at the start of a file by which a text is recognised.
_PACKED = {b"\x1f\x8b": "gzip", b"BZh": "bzip2", b"\xfd7zXZ\0": "xz", b"\x28\xb5\x2f\xfd": "zstd", b"PK\x03\x04": "zip"}
"""Programs that compress files, by the first bytes of these files."""
_LFS_POINTER = b"version https://git-lfs.github.com/spec/"
_LONGEST_POINTER = 1024  #: Maximum size of a Git LFS pointer, bytes (git-lfs spec.md).
_SPECIAL_FILES = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a named pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}


def parent_of(path: Path) -> Path:
    """Return the folder that contains a path.

    Unlike `Path.parent`, this is correct for `.` and paths that end in `..`.
    """
    return path / ".." if path.name in ("", "..") else path.parent


def special_kind(mode: int) -> str:
    """Return the kind of a special file with this `st_mode` in words; empty for a regular file or a folder."""
    return "" if stat.S_ISDIR(mode) else _SPECIAL_FILES.get(stat.S_IFMT(mode), "")


def _open_at_once(path: str, flags: int) -> int:
    return os.open(path, flags | os.O_NONBLOCK)


def check_regular(path: Path) -> None:
    """Raise OSError unless a path is a regular file or a link to a regular file. Reading a pipe could block forever.

    A pointer of Git LFS is rejected, too.
    """
    if "\0" in str(path):  # Python would raise a ValueError
        raise OSError(errno.EINVAL, "its name contains a zero byte", str(path))
    found = path.stat()
    if kind := _SPECIAL_FILES.get(stat.S_IFMT(found.st_mode)):
        raise OSError(errno.EINVAL, f"it is {kind}, not a file", str(path))
    if found.st_size <= _LONGEST_POINTER:
        with open(path, "rb", opener=_open_at_once) as stream:
            if stream.read(len(_LFS_POINTER)) == _LFS_POINTER:
                raise OSError(
                    errno.EINVAL, "it is a pointer of Git LFS, which git lfs pull replaces by the file", str(path)
                )


def read_bytes(path: Path, limit: int) -> bytes:
    """Return the content of a regular file of at most `limit` bytes; raises OSError if this fails.

    A file whose writer holds a lease is rejected, because the writer could delay the reading for 45 s.
    """
    check_regular(path)
    with open(path, "rb", opener=_open_at_once) as stream:
        size = os.fstat(stream.fileno()).st_size
        data = stream.read(limit + 1) if size <= limit else b""
    if max(size, len(data)) > limit:
        raise OSError(errno.EFBIG, f"it is larger than {limit / MB:g} MB", str(path))
    return data


def check_is_not_packed(data: bytes) -> None:
    """Raise ValueError if the first bytes of a file are those of compressed data."""
    program = next((program for magic, program in _PACKED.items() if data.startswith(magic)), "")
    if program == "zip":
        raise ValueError("it is a ZIP archive or an Excel workbook: unpack it, or export it as text")
    if program:
        raise ValueError(f"it is compressed by {program}: decompress it first")


def _decoded(data: bytes) -> str:
    """Return a text in UTF-8, with or without a byte order mark; raise ValueError for another encoding."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise ValueError(f"line {line} is not text in UTF-8") from error


def check_text(data: bytes) -> None:
    """Raise ValueError if a file begins like UTF-16 or compressed data, or has a zero byte near its beginning."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise ValueError("it is a text in UTF-16: save it in UTF-8")
    check_is_not_packed(data)
    if b"\0" in data[:HEAD_BYTES]:
        raise ValueError("it is a binary file: a text file is required")


def read_table(path: Path, needed: str = "the data set requires it") -> Iterator[bytes]:
    """Yield a text table in blocks of whole lines.

    Raises InputError if the table cannot be read, is too large, or has too many or too long lines.
    """
    lines = read = 0
    with refusing(f"cannot read '{path}'", needed):
        check_regular(path)
        with path.open("rb") as stream:
            size = os.fstat(stream.fileno()).st_size
            while block := stream.read(BLOCK_BYTES):
                block += stream.readline(MAX_TABLE_BYTES)
                if not read:
                    check_text(block)
                read += len(block)
                lines += block.count(b"\n") + block.count(b"\r") - block.count(b"\r\n")
                if max(size, read) > MAX_TABLE_BYTES:
                    raise OSError(errno.EFBIG, f"it is larger than {MAX_TABLE_BYTES / MB:g} MB", str(path))
                if lines > MAX_TABLE_LINES:
                    raise OSError(errno.EFBIG, f"it has more than {MAX_TABLE_LINES} lines", str(path))
                begin = 0
                while len(block) - begin > MAX_LINE_BYTES:
                    window = begin + MAX_LINE_BYTES
                    end = max(block.rfind(b"\n", begin, window), block.rfind(b"\r", begin, window))
                    if end < 0:
                        raise OSError(errno.EFBIG, f"it has a line of more than {MAX_LINE_BYTES} bytes", str(path))
                    begin = end + 1
                yield block


def read_table_text(path: Path, needed: str = "the data set requires it") -> str:
    """Return the complete text of a table; raises InputError like `read_table`, or if the text is not UTF-8."""
    with refusing(f"cannot read '{path}'", needed):
        return _decoded(b"".join(read_table(path, needed)))


def split_lines(text: str) -> list[str]:
    """Return the lines of a text as all parsers of tables count them: only CR and LF end a line.

    `str.splitlines` also divides a line at form feeds and at line separators of Unicode.
    """
    return [line.removesuffix("\n") for line in io.StringIO(text, newline=None)]


def read_text(path: Path, limit: int = MAX_TEXT_BYTES) -> str:
    """Return the text of a regular file in UTF-8, with or without a byte order mark."""
    data = read_bytes(path, limit)
    check_text(data)
    return _decoded(data)


def expansion_limit(compressed: int) -> int:
    """Return the maximum decompressed size of data with this compressed size, both in bytes."""
    return max(FREE_BYTES, LARGEST_RATIO * compressed)
