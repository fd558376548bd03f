"""NPY arrays and NPZ archives of numbers. numpy's own readers trust the sizes in headers and accept objects."""

from __future__ import annotations

import io
import lzma
import math
import struct
import zipfile
import zlib
from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

MAX_HEADER = 1024  #: Largest header, bytes; numpy writes about 120 for an array of numbers.
MIN_UNPACKED, MAX_RATIO = 16_000_000, 20
"""Limit of the decompressed members: this number of bytes or this multiple of the archive's size, if that is larger."""
_BROKEN_ARCHIVE = (
    *(zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error, OSError, EOFError),
    *(NotImplementedError, RuntimeError),  # raised for an unknown compression and for a password
)


def parse_npy(data: bytes, fields: Collection[str] = ()) -> NDArray[Any]:
    """Return the array of an NPY file (version 1 or 2): booleans, integers or floating-point numbers of any shape.

    With `fields`, a list of numeric records with at least these fields is required.
    """
    stream = io.BytesIO(data)
    try:
        first = np.lib.format.read_magic(stream) == (1, 0)
        read = np.lib.format.read_array_header_1_0 if first else np.lib.format.read_array_header_2_0
        shape, fortran, dtype = read(stream, max_header_size=MAX_HEADER)
    except Exception as error:  # corrupt headers cause various exceptions
        raise ValueError("it is not an NPY array, or its header is corrupt") from error
    names = dtype.names or ()
    if not set(fields) <= set(names) or (fields and len(shape) != 1):
        raise ValueError(f"it is not a list of records with the fields {', '.join(fields)}")
    parts = [dtype[name] for name in names] if fields else [dtype]
    if any(part.kind not in "biuf" or part.itemsize > 8 for part in parts):
        raise ValueError(f"its elements are {str(dtype)[:40]}: real numbers are required")
    if not all(type(n) is int and n >= 0 for n in shape):
        raise ValueError("its header is corrupt: a shape of integers is required")
    count, begin = math.prod(shape), stream.tell()
    if len(data) - begin < count * dtype.itemsize:
        raise ValueError(f"it declares shape {shape} and type {dtype}, but has only {len(data) - begin} bytes of data")
    return np.frombuffer(data, dtype, count, begin).reshape(shape, order="F" if fortran else "C").copy()


def parse_npz(data: bytes, names: Collection[str]) -> dict[str, NDArray[Any]]:
    """Return the named members of an NPZ archive. The case of names is ignored, and missing members are omitted."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            infos = {info.filename.removesuffix(".npy").lower(): info for info in archive.infolist()}
            wanted = {name: infos[name] for name in names if name in infos}
            unpacked = sum(info.file_size for info in wanted.values())
            limit = max(MIN_UNPACKED, MAX_RATIO * len(data))
            if unpacked > limit:
                raise ValueError(
                    f"its {len(data)} bytes declare {unpacked} decompressed bytes: at most {limit} are allowed"
                )
            members = {name: archive.read(info) for name, info in wanted.items()}
    except _BROKEN_ARCHIVE as error:
        raise ValueError(f"it is not a complete NPZ archive ({error})") from error
    return {name: parse_npy(member) for name, member in members.items()}


def npz_names(data: bytes) -> list[str]:
    """Return the names of the members of a complete NPZ archive."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return [name.removesuffix(".npy") for name in archive.namelist()]
