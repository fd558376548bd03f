"""LZF decompression of PCD files of the Point Cloud Library: literal runs and copies of earlier output.

The format is that of LibLZF (Marc Lehmann, 2000 to 2008). A control byte c below 32 is followed by c + 1 literals. Any
other control byte begins a copy: its upper three bits are the length minus 2 (if they are 7, the next byte is added),
and the lower five bits with the next byte are the distance minus 1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.jit import jit


@jit
def decompress_lzf(data: NDArray[np.uint8], out: NDArray[np.uint8]) -> int:
    """Decompress all data into `out`; return the number of bytes, -1 if the data is corrupt or larger than `out`."""
    at, end = 0, 0
    while at < len(data):
        control = int(data[at])
        at += 1
        if control < 32:
            length = control + 1
            if at + length > len(data) or end + length > len(out):
                return -1
            for k in range(length):
                out[end + k] = data[at + k]
            at += length
            end += length
            continue
        length = control >> 5
        if length == 7:
            if at >= len(data):
                return -1
            length += int(data[at])
            at += 1
        if at >= len(data):
            return -1
        start = end - ((control & 31) << 8) - int(data[at]) - 1
        at += 1
        length += 2
        if start < 0 or end + length > len(out):
            return -1
        for k in range(length):  # source and destination may overlap
            out[end + k] = out[start + k]
        end += length
    return end
