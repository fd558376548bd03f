"""LZF, by which the Point Cloud Library compresses PCD files: literal runs and copies of what was written before.

The format is that of LibLZF (Marc Lehmann, 2000 to 2008). A control byte below 32 is followed by that many literals and
one more. Others are a copy: length in the three upper bits (7: one more byte adds to it), distance in 13 bits.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.jit import jit


@jit
def decompress_lzf(data: NDArray[np.uint8], out: NDArray[np.uint8]) -> int:
    """Decompress all data into `out`; return the number of bytes, -1 if the data is broken or larger than `out`."""
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
        for k in range(length):  # the copy may overlap what it writes
            out[end + k] = out[start + k]
        end += length
    return end
