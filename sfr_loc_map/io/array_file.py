"""NPY arrays and NPZ archives of numbers, with what they claim checked against what is there.

The format is that of numpy.lib.format, versions 1 to 3. numpy's own reader takes objects, structures and text as well,
allocates what the header claims, and ends in whatever Python's tokenizer says of a broken header.
"""

from __future__ import annotations

import ast
import io
import lzma
import math
import re
import struct
import zipfile
import zlib
from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

MAGIC = b"\x93NUMPY"
MAX_HEADER = 1024
"""Bytes of a header; those of arrays of numbers have some 120."""
KEYS = {"descr", "fortran_order", "shape"}
MIN_UNPACKED = 16_000_000
MAX_RATIO = 20
"""The members that are read may together have this many times the bytes of the archive, and `MIN_UNPACKED` anyhow."""
_NUMBERS = re.compile(r"[<>|=](b1|[iu][1248]|f[248])")
_BROKEN_ARCHIVE = (
    *(zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error, OSError, EOFError),
    *(NotImplementedError, RuntimeError),  # an unknown compression, a password
)


def parse_npy(data: bytes) -> NDArray[Any]:
    """Return the array of an NPY file: truth values, whole numbers or floating-point numbers, any shape.

    Raises:
        ValueError: If it is of another kind, or claims more than is there.
    """
    if not data.startswith(MAGIC) or len(data) < 12 or data[6] not in (1, 2, 3):
        raise ValueError("it is no NPY array")
    kind, start = ("<H", 10) if data[6] == 1 else ("<I", 12)
    (length,) = struct.unpack_from(kind, data, 8)
    if length > MAX_HEADER:
        raise ValueError(f"its header has {length} bytes: an array of numbers is needed")
    dtype, shape, order = _header(data[start : start + length].decode("latin-1"))
    count, begin = math.prod(shape), start + length
    if len(data) - begin < count * dtype.itemsize:
        raise ValueError(f"it claims {shape} numbers of {dtype}, but {len(data) - begin} bytes are there")
    return np.frombuffer(data, dtype, count, begin).reshape(shape, order=order).copy()


def parse_npz(data: bytes, names: Collection[str]) -> dict[str, NDArray[Any]]:
    """Return some members of an NPZ archive by name; others are left alone, missing ones are left out.

    Raises:
        ValueError: If the archive or one of the members is broken, or unpacks to far more than its size.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            infos = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
            wanted = {name: infos[name] for name in names if name in infos}
            unpacked = sum(info.file_size for info in wanted.values())
            if unpacked > max(MIN_UNPACKED, MAX_RATIO * len(data)):
                raise ValueError(f"its {len(data)} bytes claim to unpack to {unpacked}")
            members = {name: archive.read(info) for name, info in wanted.items()}
    except _BROKEN_ARCHIVE as error:
        raise ValueError(f"it is not a complete NPZ archive ({error})") from error
    return {name: parse_npy(member) for name, member in members.items()}


def _header(text: str) -> tuple[np.dtype[Any], tuple[int, ...], Any]:
    """Return type, shape and order of a header."""
    try:
        header = ast.literal_eval(text.strip())
    except (ValueError, SyntaxError, TypeError, MemoryError, RecursionError) as error:
        raise ValueError("its header is broken") from error
    if not isinstance(header, dict) or set(header) != KEYS:
        raise ValueError("its header is broken")
    descr, shape = header["descr"], header["shape"]
    if not isinstance(descr, str) or not _NUMBERS.fullmatch(descr):
        raise ValueError(f"its elements are {str(descr)[:40]!r}: real numbers are needed")
    if not isinstance(shape, tuple) or not all(type(n) is int and n >= 0 for n in shape) or len(shape) > 8:
        raise ValueError("its header is broken: the shape must be whole numbers")
    return np.dtype(descr), shape, "F" if header["fortran_order"] is True else "C"
