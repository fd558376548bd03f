"""What comes from outside: files, JSON and YAML of bounded size and depth, texts made fit for a terminal, shared names.

Everything that reads a file of another program comes through here. What is refused is raised as the error that the
parser or the system itself would raise (`OSError`, `ValueError`, `yaml.YAMLError`); each reader says in its own words
which file it needs.
"""

from __future__ import annotations

import csv
import errno
import hashlib
import json
import os
import re
import stat
import struct
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import yaml

from sfr_loc_map.errors import GeometryError, InputError

if TYPE_CHECKING:  # messages and short files do without it
    import numpy as np
    from numpy.typing import NDArray

NS_PER_S = 1_000_000_000  #: Nanoseconds in a second.
Side = Literal["left", "right"]
SIDES: tuple[Side, Side] = ("left", "right")  #: The cameras of a stereo rig, in the order of all files and topics.
LOST_VARIANCE = 9999.0  #: Variance on the whole diagonal of the covariance of a pose that is unknown (m^2, rad^2).
JUMP_BACK_NS = NS_PER_S  #: A clock that goes back by more than this was set, or a bag was started again.

MB = 1_000_000
MAX_TEXT_BYTES = MB  #: Largest settings file, rig or list of topics: a legitimate one has some kilobytes.
MAX_JSON_BYTES = 64 * MB
MAX_IMAGE_BYTES = 512 * MB
IMAGE_ENDINGS = (".png", ".jpg", ".jpeg", ".pgm", ".ppm")  #: Endings of files of images, in lower case.
MAX_CLOUD_BYTES = 4096 * MB
MAX_TABLE_BYTES = 256 * MB  #: Largest table of text: a trajectory of 1.5 million poses.
MAX_TABLE_LINES = 4_000_000
MAX_LINE_BYTES = 64_000
BLOCK_BYTES = 4 * MB  #: Tables are read in blocks of whole lines of about so many: a million lines take much memory.
FREE_BYTES = 64 * 2**20
LARGEST_RATIO = 20
"""What is compressed may become `FREE_BYTES`, or this many times its own size where that is more: images and points of
real sensors do not compress so well."""
MAX_DEPTH = 64  #: Deepest nesting of JSON and YAML.
MAX_NODES = 100_000  #: Most values of a YAML file once its aliases are written out.
MAX_DIGITS = 20  #: Longest integer of JSON and YAML: 64 bits have 19 digits and a sign.
MAX_MESSAGE = 600  #: Characters of a message; the first and the last ones of a longer text are kept.
_TAIL = 200
_LFS_POINTER = b"version https://git-lfs.github.com/spec/"
_LONGEST_POINTER = 1024  #: Bytes of a pointer of Git LFS (git-lfs spec.md).
_SURROGATE = re.compile(r"\\u[dD][89a-fA-F]|[\ud800-\udfff]")
_EXPONENT = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)[eE][-+]?[0-9]+$")
_UNPRINTABLE = re.compile(
    r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff\ufeff\ufffe\uffff]"
)
"""Controls (C0 without tab and line feed, DEL, C1), marks of direction, separators of lines, surrogates."""
_SPECIAL_FILES = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a named pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}


class Task(StrEnum):
    """The two tasks of the suite, each with a rig of its own."""

    LOCALISATION = "localisation"
    MAPPING = "mapping"

    @classmethod
    def of_rig(cls, rig: str) -> Task:
        """Return the task of a rig, `loc` or `nav`."""
        return next(task for task in cls if task.rig == rig)

    @property
    def rig(self) -> str:
        """Prefix of its image topics and name of its part of a data set: `loc` or `nav`."""
        return "loc" if self is Task.LOCALISATION else "nav"

    @property
    def node(self) -> str:
        """Name of its node."""
        return f"{self}_node"


OURS = "sfr"  #: Name of the suite's own localiser and mapper among the methods.
MONITOR_NODE = "monitor_node"
PLAYER_NODE = "sfr_player"  #: Node of a replay.
SUITE_NODES = (*(task.node for task in Task), MONITOR_NODE)


REFUSED: tuple[type[Exception], ...] = (OSError, ValueError, ArithmeticError, LookupError, TypeError, GeometryError)
REFUSED += (yaml.YAMLError, csv.Error, SyntaxError)
"""What parsers and checks raise for a broken input; of XML a SyntaxError."""


@contextmanager
def refusing(where: str, advice: str = "correct the file") -> Iterator[None]:
    """Turn what is raised for a broken input into an `InputError` in one line: WHERE: what is wrong; ADVICE."""
    try:
        yield
    except REFUSED as error:
        reason = getattr(error, "strerror", None) or " ".join(str(error).split())
        raise InputError(f"{where}: {reason}; {advice}") from error


def stamp_of(message: Any) -> int:  # noqa: ANN401 - any message with a header
    """Return the header's stamp of a message, nanoseconds."""
    stamp = message.header.stamp
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def serialised_stamp(raw: bytes) -> int:
    """Return the stamp of a message that begins with a header, without deserialising it (CDR, XTypes 1.3, 7.4)."""
    seconds, nanoseconds = struct.unpack_from("<iI" if raw[1] & 1 else ">iI", raw, 4)
    return int(seconds) * NS_PER_S + int(nanoseconds)


def jumped_back(latest_ns: int, stamp_ns: int) -> bool:
    """Return whether a stamp is so far before the latest one that the clock was set back or a new run has begun."""
    return latest_ns - stamp_ns >= JUMP_BACK_NS


def special_kind(mode: int) -> str:
    """Return what a file of this `st_mode` is if neither a regular file nor a folder, in words; else an empty text."""
    return "" if stat.S_ISDIR(mode) else _SPECIAL_FILES.get(stat.S_IFMT(mode), "")


def _open_at_once(path: str, flags: int) -> int:
    return os.open(path, flags | os.O_NONBLOCK)


def check_regular(path: Path) -> None:
    """Raise OSError if a path is missing, or neither a regular file nor a link to one (a pipe would wait for ever)."""
    if "\0" in str(path):  # Python would raise a ValueError
        raise OSError(errno.EINVAL, "its name holds a zero byte", str(path))
    found = path.stat()
    if kind := _SPECIAL_FILES.get(stat.S_IFMT(found.st_mode)):
        raise OSError(errno.EINVAL, f"it is {kind}, not a file", str(path))
    if found.st_size <= _LONGEST_POINTER:
        with open(path, "rb", opener=_open_at_once) as stream:
            if stream.read(len(_LFS_POINTER)) == _LFS_POINTER:
                raise OSError(
                    errno.EINVAL, "it is a pointer of Git LFS, not the file itself: run git lfs pull", str(path)
                )


def read_bytes(path: Path, limit: int) -> bytes:
    """Return the content of a regular file of at most so many bytes; OSError if it cannot be read or is too large.

    A file whose writer holds a lease is refused, because the writer could delay the reading for 45 s.
    """
    check_regular(path)
    with open(path, "rb", opener=_open_at_once) as stream:
        size = os.fstat(stream.fileno()).st_size
        data = stream.read(limit + 1) if size <= limit else b""
    if max(size, len(data)) > limit:
        raise OSError(errno.EFBIG, f"it is larger than {limit / MB:g} MB", str(path))
    return data


def read_table(path: Path, needed: str = "the data set needs it") -> Iterator[bytes]:
    """Yield a table of text in blocks of whole lines; InputError as `read_bytes`, or for too many or too long lines."""
    lines = read = 0
    with refusing(f"cannot read '{path}'", needed):
        check_regular(path)
        with path.open("rb") as stream:
            size = os.fstat(stream.fileno()).st_size
            while block := stream.read(BLOCK_BYTES):
                block += stream.readline(MAX_TABLE_BYTES)
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


def read_table_text(path: Path, needed: str = "the data set needs it") -> str:
    """Return a table of text as a whole; InputError as `read_table`, or if it is no UTF-8."""
    with refusing(f"cannot read '{path}'", needed):
        return b"".join(read_table(path, needed)).decode("utf-8-sig")


def read_text(path: Path, limit: int = MAX_TEXT_BYTES) -> str:
    """Return the text of a regular file in UTF-8, with or without a byte order mark."""
    return read_bytes(path, limit).decode("utf-8-sig")


def expansion_limit(compressed: int) -> int:
    """Return how many bytes something may become that is compressed to a number of bytes."""
    return max(FREE_BYTES, LARGEST_RATIO * compressed)


def hash_path(path: Path) -> str:
    """Return the SHA-256 of a file, or of the names and hashes of a folder's files that are not hidden."""
    path = Path(path)
    try:
        if path.is_file():
            with path.open("rb") as stream:
                return hashlib.file_digest(stream, "sha256").hexdigest()
        if not path.is_dir():
            raise InputError(f"there is no '{path}' to hash: give a file or folder")
        digest = hashlib.sha256()
        for name, file in sorted((file.relative_to(path).as_posix(), file) for file in path.rglob("*")):
            if file.is_file() and not any(part.startswith(".") for part in name.split("/")):
                digest.update(f"{name}\0{hash_path(file)}\n".encode())
        return digest.hexdigest()
    except OSError as error:
        raise InputError(
            f"cannot read '{error.filename}' to hash it: {error.strerror}; check the permissions"
        ) from error


def hash_arrays(arrays: Iterable[NDArray[np.generic]]) -> str:
    """Return the SHA-256 of the shapes, types and bytes of arrays, in their order."""
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(f"{array.dtype.str}{array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def parse_json(text: str | bytes, parse_constant: Callable[[str], Any] | None = None) -> Any:  # noqa: ANN401 - any JSON
    """Return the value of a JSON text; `parse_constant` is called with NaN and Infinity, which are not JSON.

    Raises ValueError if it is no JSON, nested too deeply, or holds an integer of more than 20 digits or half of a
    surrogate pair, which no encoding takes.
    """
    text = text.decode("utf-8") if isinstance(text, bytes) else text
    try:
        value = json.loads(text, parse_constant=parse_constant, parse_int=_integer)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
    level: list[Any] = [[value]]
    for _ in range(MAX_DEPTH + 1):  # whoever walks through the value may do so by recursion
        items = (item for part in level for item in (part.values() if isinstance(part, dict) else part))
        level = [item for item in items if isinstance(item, (dict, list))]
    if level:
        raise ValueError("it is nested too deeply")
    if _SURROGATE.search(text):
        json.dumps(value, ensure_ascii=False).encode("utf-8")
    return value


def _integer(text: str) -> int:
    if len(text) > MAX_DIGITS:
        raise ValueError(f"an integer of {len(text)} digits")
    return int(text)


def parse_yaml(text: str) -> Any:  # noqa: ANN401 - any YAML
    """Return the value of a YAML text of plain types.

    Raises YAMLError or ValueError if it is no YAML, nested too deeply, or its aliases stand for too many values.
    """
    loader = _BoundedLoader(text)
    try:
        node = loader.get_single_node()
        if node is None:
            return None
        _expanded(node, {}, 0)
        return loader.construct_document(node)
    except (AttributeError, TypeError, RecursionError) as error:  # of the library, for keys and tags it does not know
        raise yaml.YAMLError(f"it cannot be read: {error}") from error
    finally:
        loader.dispose()


class _BoundedLoader(yaml.SafeLoader):
    """Loads plain types; nesting and integers are bounded."""

    depth = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        self.depth += 1
        if self.depth > MAX_DEPTH:
            raise yaml.YAMLError("it is nested too deeply")
        node: yaml.Node | None = super().compose_node(parent, index)
        self.depth -= 1
        return node

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:  # noqa: ANN401 - the library's
        node = super().compose_mapping_node(anchor)
        keys: set[tuple[str, str]] = set()
        for key in (key for key, _ in node.value if isinstance(key, yaml.ScalarNode)):
            if key.style is None and _EXPONENT.match(key.value):  # a name such as `1e-3`
                key.tag = "tag:yaml.org,2002:str"
            if (key.tag, key.value) in keys:  # the last one would count
                raise yaml.YAMLError(f"'{key.value}' occurs twice, again in line {key.start_mark.line + 1}")
            if key.tag != "tag:yaml.org,2002:merge":  # several are several maps
                keys.add((key.tag, key.value))
        return node

    def construct_yaml_int(self, node: yaml.ScalarNode) -> int:
        if len(node.value) > 4 * MAX_DIGITS:
            raise yaml.YAMLError(f"an integer of {len(node.value)} digits")
        if node.value.lstrip("+-").isdecimal():  # `030` is 30 in YAML 1.2, 24 in 1.1
            return int(node.value)
        return int(super().construct_yaml_int(node))


_BoundedLoader.add_constructor("tag:yaml.org,2002:int", _BoundedLoader.construct_yaml_int)
# numbers as all else writes them: `1e-3` is one in YAML 1.2, a text in 1.1
_BoundedLoader.add_implicit_resolver("tag:yaml.org,2002:float", _EXPONENT, list("-+.0123456789"))


def _expanded(node: yaml.Node, sizes: dict[int, int], depth: int) -> int:
    """Return how many values a node stands for once its aliases are written out; YAMLError if they are too many."""
    if isinstance(node, yaml.ScalarNode):
        return 1
    if depth > MAX_DEPTH:
        raise yaml.YAMLError("an alias stands within its own anchor, or it is nested too deeply")
    if id(node) not in sizes:
        pairs = node.value if isinstance(node, yaml.MappingNode) else [node.value]
        sizes[id(node)] = 1 + sum(_expanded(item, sizes, depth + 1) for pair in pairs for item in pair)
    if sizes[id(node)] > MAX_NODES:
        raise yaml.YAMLError(f"its aliases stand for more than {MAX_NODES} values")
    return sizes[id(node)]


def printable(text: str) -> str:
    r"""Return a text with unprintable characters written as in Python: ESC becomes `\x1b`.

    A file can hold escape sequences that rename a window or overwrite lines, characters that turn the direction of
    writing, halves of surrogate pairs that no encoding takes.
    """
    return _UNPRINTABLE.sub(lambda found: found[0].encode("unicode_escape").decode("ascii"), text)


def one_line(text: str) -> str:
    """Return a message as one printable line of bounded length; the middle of a longer one is omitted."""
    line = printable(" ".join(text.split()))
    if len(line) <= MAX_MESSAGE:
        return line
    left_out = len(line) - MAX_MESSAGE
    return f"{line[: MAX_MESSAGE - _TAIL]} ... ({left_out} characters left out) ... {line[-_TAIL:]}"


_COMMIT_FILE = Path(__file__).with_name("commit.txt")  # setup.py writes it
GIT = _COMMIT_FILE.read_text(encoding="utf-8").split() if _COMMIT_FILE.is_file() else []
"""Commit that the package was built from, `-dirty` if changed since, its branch and date; empty where not known."""
COMMIT = GIT[0] if GIT else None
