"""Structs of MATLAB files (version 5 to 7), with bounds before memory is taken.

The elements of such a file are compressed one by one; they are unpacked here, bounded, before SciPy reads them. Form of
the file: "MAT-File Format", The MathWorks, chapter 1.
"""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path
from typing import Any

from sfr_loc_map.errors import InputError
from sfr_loc_map.inputs import MB, read_bytes

MAX_BYTES = 16 * MB
MAX_UNPACKED_BYTES = 32 * MB
HEADER_BYTES = 128
COMPRESSED = 15
"""Type of an element that is compressed."""


def load_struct(path: Path, name: str) -> dict[str, Any]:
    """Return the fields of a struct, structs within it as the same.

    Args:
        path: The file.
        name: Name of the variable.

    Raises:
        InputError: If the file cannot be read, is too large, or has no such struct.
    """
    from scipy.io import loadmat  # a fifth of a second that no other source needs

    try:
        data = io.BytesIO(_unpacked(read_bytes(path, MAX_BYTES)))
        content: dict[str, Any] = loadmat(data, variable_names=[name], simplify_cells=True)  # type: ignore[arg-type]
    except OSError as error:
        raise InputError(f"cannot read '{path}': {error.strerror or error}; a .mat file is needed") from error
    except MemoryError:
        raise
    except Exception as error:  # of the library for broken data: of many kinds
        text = " ".join(str(error).split())[:200]
        raise InputError(f"'{path}' cannot be read as a .mat file (version 5 to 7): {text}") from error
    value = content.get(name)
    if not isinstance(value, dict):
        raise InputError(f"'{path}' has no struct '{name}': save it again as a struct (docs/formats.md)")
    return value


def _unpacked(data: bytes) -> bytes:
    """Return a file of the same elements, none of them compressed.

    Raises:
        ValueError: If it is broken, of another version, or holds too much.
    """
    if len(data) < HEADER_BYTES or data[126:128] != b"IM" or data[125] != 1:
        raise ValueError("it has no header of a little-endian file of version 5")
    parts, offset, left = [data[:HEADER_BYTES]], HEADER_BYTES, MAX_UNPACKED_BYTES
    while offset + 8 <= len(data):
        kind, size = struct.unpack_from("<II", data, offset)
        body = data[offset + 8 : offset + 8 + size]
        if kind == COMPRESSED:
            decompressor = zlib.decompressobj()
            part = decompressor.decompress(body, left + 1)
            if not decompressor.eof and len(part) <= left:
                raise ValueError("a compressed part is cut off")
        else:
            part = data[offset : offset + 8 + size]
        left -= len(part)
        if left < 0:
            raise ValueError(f"it holds more than {MAX_UNPACKED_BYTES} bytes")
        parts.append(part)
        offset += 8 + size
    return b"".join(parts)
