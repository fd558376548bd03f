"""Input from outside: shared names of data and programs, bounded reading of files, and texts for messages.

All files of other programs are read through this module. A rejected file raises the error that the system itself would
raise (`OSError`, `ValueError`). Each reader adds, by `refusing`, which file it requires. `json_yaml` parses the texts.
"""

from __future__ import annotations

import codecs
import csv
import errno
import io
import os
import re
import stat
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Any, Literal

import yaml

from sfr_loc_map.errors import GeometryError, InputError

# ---- shared names

NS_PER_S = 1_000_000_000  #: Nanoseconds in a second.
Side = Literal["left", "right"]
SIDES: tuple[Side, Side] = ("left", "right")  #: The cameras of a stereo rig, in the order of all files and topics.
LOST_VARIANCE = 9999.0  #: Diagonal of the covariance of an unknown pose, m^2 and rad^2.
JUMP_BACK_NS = NS_PER_S  #: Minimum backward jump of stamps that indicates a reset clock or a restarted bag, ns.
IMAGE_ENDINGS = (".png", ".jpg", ".jpeg", ".pgm", ".ppm")  #: Suffixes of image files, in lower case.
OURS = "sfr"  #: Name of the suite's own localiser and mapper among the methods.
MONITOR_NODE = "monitor_node"
PLAYER_NODE = "sfr_player"  #: Node of a replay.


class Task(StrEnum):
    """The two tasks of the suite, each with its own rig."""

    LOCALISATION = "localisation"
    MAPPING = "mapping"

    @classmethod
    def of_rig(cls, rig: str) -> Task:
        """Return the task of a rig, `loc` or `nav`."""
        return next(task for task in cls if task.rig == rig)

    @property
    def rig(self) -> str:
        """Prefix of the task's image topics and name of its part of a data set: `loc` or `nav`."""
        return "loc" if self is Task.LOCALISATION else "nav"

    @property
    def node(self) -> str:
        """Name of the task's node."""
        return f"{self}_node"


SUITE_NODES = (*(task.node for task in Task), MONITOR_NODE)


def stamp_of(message: Any) -> int:  # noqa: ANN401 - any message with a header
    """Return the stamp in the header of a message, nanoseconds."""
    stamp = message.header.stamp
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def serialised_stamp(raw: bytes) -> int:
    """Return the stamp of a serialised message that begins with a header, nanoseconds (CDR, XTypes 1.3, 7.4)."""
    seconds, nanoseconds = struct.unpack_from("<iI" if raw[1] & 1 else ">iI", raw, 4)
    return int(seconds) * NS_PER_S + int(nanoseconds)


def jumped_back(latest_ns: int, stamp_ns: int) -> bool:
    """Return whether a stamp is so far before the latest one that the clock was reset or a new run has begun."""
    return latest_ns - stamp_ns >= JUMP_BACK_NS


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
        raise InputError(f"{where}: {reason}; {advice}") from error


# ---- files

MB = 1_000_000
MAX_TEXT_BYTES = MB  #: Maximum size of a configuration, rig or topic file. Typical files have a few kilobytes.
MAX_JSON_BYTES = 64 * MB
MAX_IMAGE_BYTES = 512 * MB
MAX_CLOUD_BYTES = 4096 * MB
MAX_TABLE_BYTES = 256 * MB  #: Maximum size of a text table: a trajectory of 1.5 million poses.
MAX_TABLE_LINES = 4_000_000
MAX_LINE_BYTES = 64_000
BLOCK_BYTES = 4 * MB  #: Approximate size of the blocks of whole lines in which tables are read, to limit memory.
FREE_BYTES = 64 * 2**20  #: Decompressed size that is always accepted.
LARGEST_RATIO = 20
"""Maximum ratio of decompressed to compressed size above `FREE_BYTES`. Images and points of real sensors have lower
ratios."""
HEAD_BYTES = 4096  #: Size of the head of a file that shows whether it is a text.
_LFS_POINTER = b"version https://git-lfs.github.com/spec/"
_LONGEST_POINTER = 1024  #: Maximum size of a Git LFS pointer, bytes (git-lfs spec.md).
_SPECIAL_FILES = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a named pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}


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


def check_text(data: bytes) -> None:
    """Raise ValueError if the first bytes of a file are not those of a text in ASCII or UTF-8."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise ValueError("it is a text in UTF-16: save it in UTF-8")
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
                lines += block.count(b"\n") + block.count(b"\r")
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
        return b"".join(read_table(path, needed)).decode("utf-8-sig")


def split_lines(text: str) -> list[str]:
    """Return the lines of a text as all parsers of tables count them: only CR and LF end a line.

    `str.splitlines` also divides a line at form feeds and at line separators of Unicode.
    """
    return [line.removesuffix("\n") for line in io.StringIO(text, newline=None)]


def read_text(path: Path, limit: int = MAX_TEXT_BYTES) -> str:
    """Return the text of a regular file in UTF-8, with or without a byte order mark."""
    data = read_bytes(path, limit)
    check_text(data)
    return data.decode("utf-8-sig")


def expansion_limit(compressed: int) -> int:
    """Return the maximum decompressed size, bytes, of data with a compressed size in bytes."""
    return max(FREE_BYTES, LARGEST_RATIO * compressed)


# ---- texts in messages

MAX_MESSAGE = 600  #: Maximum length of a message, characters. The middle of a longer text is omitted.
_TAIL = 200
_UNPRINTABLE = re.compile(
    r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff\ufeff\ufffe\uffff]"
)
"""Control characters (C0 without tab and line feed, DEL, C1), direction marks, line separators, surrogates, byte order
marks and noncharacters."""


def printable(text: str) -> str:
    r"""Return a text with unprintable characters written as in Python: ESC becomes `\x1b`.

    A file can contain escape sequences that rename a window or overwrite lines, characters that change the direction of
    writing, and halves of surrogate pairs, which cannot be encoded.
    """
    return _UNPRINTABLE.sub(lambda found: found[0].encode("unicode_escape").decode("ascii"), text)


def one_line(text: str) -> str:
    """Return a message as one printable line of bounded length. The middle of a longer message is omitted."""
    line = printable(" ".join(text.split()))
    if len(line) <= MAX_MESSAGE:
        return line
    left_out = len(line) - MAX_MESSAGE
    return f"{line[: MAX_MESSAGE - _TAIL]} ... ({left_out} characters omitted) ... {line[-_TAIL:]}"
