"""LAS and LAZ files of points (ASPRS LAS 1.4), by laspy, an extra of the package.

Written is point format 0, coordinates in whole multiples of 1 micrometre, of more where the cloud is larger than 2 km.
Read are x, y, z and dimensions of the names of `EXTRA` of any LAS or LAZ file.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import MissingExtraError
from sfr_loc_map.geometry.cloud import FIELD_TYPES, PointCloud
from sfr_loc_map.inputs import check_expansion

SUFFIXES = (".las", ".laz")
USER, RECORD = "sfr_loc_map", 1  #: The variable length record with what the cloud says of itself, a comment a line.
FINEST_M = 1e-6  # unit of the coordinates
EXTRA = ("sigma", "grey", "u", "v", "pair")
"""Extra dimensions; `grey` is the intensity, which the format has in whole numbers only."""
HEADER_BYTES = {2: 227, 3: 235, 4: 375}  #: Least size of the header by minor version.
VLR_BYTES, EVLR_BYTES = 54, 60


def las_bytes(cloud: PointCloud, comments: Sequence[str], *, compressed: bool) -> bytes:
    """Return a cloud as a LAS or a LAZ file with all its fields; `comments` are what it says of itself."""
    laspy = load_laspy()
    xyz = cloud.xyz.astype(np.float64)
    low, high = (xyz.min(axis=0), xyz.max(axis=0)) if len(xyz) else (np.zeros(3), np.zeros(3))
    header = laspy.LasHeader(point_format=0, version="1.4")
    header.offsets = np.floor(low)
    header.scales = np.maximum(FINEST_M, 10.0 ** np.ceil(np.log10(np.maximum(high - low + 1.0, 1.0) / 2.0**31)))
    header.system_identifier = header.generating_software = USER
    kinds = {"grey": np.float32, **{name: FIELD_TYPES[name] for name in EXTRA if name != "grey"}}
    header.add_extra_dims([laspy.ExtraBytesParams(name=name, type=kinds[name]) for name in EXTRA])
    record = laspy.VLR(user_id=USER, record_id=RECORD, record_data="\n".join(comments).encode())
    header.vlrs.append(record)
    data = laspy.LasData(header)
    data.x, data.y, data.z = xyz.T
    data.intensity = np.clip(np.rint(np.nan_to_num(cloud.intensity)), 0, 65535).astype(np.uint16)
    for name in EXTRA:
        data[name] = cloud.intensity if name == "grey" else getattr(cloud, name)
    buffer = io.BytesIO()
    data.write(buffer, do_compress=compressed)
    return buffer.getvalue()


def read_las(data: bytes) -> tuple[dict[str, NDArray[Any]], list[str]]:
    """Return x, y, z, the intensity and dimensions of this package of a LAS or LAZ file, and its comments."""
    laspy = load_laspy()
    if not data.startswith(b"LASF") or len(data) < min(HEADER_BYTES.values()):
        raise ValueError("it has no LAS header")
    records = struct.unpack_from("<I", data, 100)[0]
    extended = struct.unpack_from("<I", data, 243)[0] if data[25] >= 4 and len(data) >= HEADER_BYTES[4] else 0
    if records * VLR_BYTES + extended * EVLR_BYTES > len(data):  # a reader would believe it
        raise ValueError(f"its header names {records} and {extended} records, more than {len(data)} bytes hold")
    content = _points(laspy, data)
    names = set(content.point_format.dimension_names)
    columns = {axis: np.asarray(content[axis], np.float64) for axis in "xyz"}
    columns |= {name: np.asarray(content[name]) for name in ("sigma", "u", "v", "pair", "intensity") if name in names}
    if "grey" in names:
        columns["intensity"] = np.asarray(content["grey"])
    others = (vlr for vlr in content.header.vlrs if isinstance(vlr, laspy.VLR))
    texts = [vlr.record_data for vlr in others if (vlr.user_id, vlr.record_id) == (USER, RECORD)]
    return columns, [line for text in texts for line in text.decode("ascii", "replace").splitlines()]


def _points(laspy: Any, data: bytes) -> Any:  # noqa: ANN401 - of a module without types
    """Return what laspy reads; whatever it raises for broken data becomes a `ValueError`."""
    try:
        # the backend of one thread: the other takes memory for as many bytes as a broken table of chunks claims
        with laspy.open(io.BytesIO(data), read_evlrs=False, laz_backend=laspy.LazBackend.Lazrs) as reader:
            header = reader.header
            count = header.point_count
            check_expansion(len(data), count * header.point_format.size, "a file of points")
            if header.are_points_compressed:
                _check_chunks(data, header.offset_to_point_data, count)
            content = reader.read()
    except (MemoryError, KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:  # the compressor panics with an exception that is none of Python's kinds
        raise ValueError(f"{type(error).__name__}: {' '.join(str(error).split())[:200]}") from error
    if len(content.x) != count:
        raise ValueError(f"{len(content.x)} points found where {count} are said to be")
    return content


def _check_chunks(data: bytes, begin: int, points: int) -> None:
    """Check the table of chunks: the compressor takes memory for as many as it says and ends the process without it.

    Its place stands where the points begin, or at the end of the file where that is -1; it begins with a version and
    the number of chunks (LASzip specification, "chunk table").
    """
    place = struct.unpack_from("<q", data, begin)[0]
    if place == -1:
        place = struct.unpack_from("<q", data, len(data) - 8)[0]
    if not begin < place <= len(data) - 8:
        raise ValueError("its table of chunks lies outside of it")
    chunks = struct.unpack_from("<I", data, place + 4)[0]
    if chunks > max(points, 1):
        raise ValueError(f"its table names {chunks} chunks for {points} points")


def load_laspy() -> Any:  # noqa: ANN401 - only the parts used here have types
    """Return the module."""
    try:
        import laspy  # type: ignore[import-untyped]
        import lazrs  # type: ignore[import-untyped]  # noqa: F401 - what laspy compresses with
    except ImportError as error:
        raise MissingExtraError(f"LAS and LAZ need laspy ({error}): pip install 'sfr_loc_map[laz]'") from error
    return laspy
