"""Writes ROS 2 bags: a drive and mapping pairs as a stream."""

from __future__ import annotations

import sqlite3
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import McapWriter

from sfr_loc_map.errors import OutputError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair, StereoRig
from sfr_loc_map.io.bag import messages
from sfr_loc_map.io.bag.encoding import TYPESTORE
from sfr_loc_map.io.bag.mcap_file import CHECKSUM_BYTES, CHUNK_HEAD, RECORD_HEAD
from sfr_loc_map.suite_names import SIDES, Task
from sfr_loc_map.topics import COMPRESSED_END, NAV_POSE, RECTIFIED, TRUE_POINTS, TRUE_POSES

Storage = Literal["mcap", "sqlite3"]
STORAGE_BY_SUFFIX: dict[str, Storage] = {".mcap": "mcap", ".bag": "mcap", ".db3": "sqlite3"}
"""Storage of a bag by the ending of its name; other names are data set folders."""
NO_TIME = QosTime(0, 0)  #: Unlimited duration in a QoS profile.
_KEPT = (QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL)
LATCHED = Qos(*_KEPT, NO_TIME, NO_TIME, QosLiveliness.AUTOMATIC, NO_TIME, False)
"""QoS profile of `/tf_static`: reliable; late subscribers receive the last message."""


class CheckedMcapWriter(McapWriter):
    """Writes the optional CRC-32 of each chunk, so that readers detect corrupt bytes."""

    def close_chunk(self) -> None:
        """End the chunk."""
        crc = zlib.crc32(self.chunk.bio.getbuffer())
        start = self.bio.tell()
        super().close_chunk()
        end = self.bio.tell()
        self.bio.seek(start + RECORD_HEAD.size + CHUNK_HEAD.size - CHECKSUM_BYTES)  # the last field of the head
        self.bio.write(crc.to_bytes(4, "little"))
        self.bio.seek(end)


class CheckedWriter(Writer):
    """Writer of bags with checksums."""

    STORAGE_PLUGINS = MappingProxyType({**Writer.STORAGE_PLUGINS, StoragePlugin.MCAP: CheckedMcapWriter})


class BagWriter:
    """Context manager that writes a bag. The bag is complete only if the block ends without an exception."""

    def __init__(
        self,
        path: Path,
        storage: Storage = "mcap",
        *,
        jpeg_quality: int | None = None,
        zstd: bool = False,
        truth_grid_m: float | None = None,
    ) -> None:
        """Prepare a bag in a folder that must not exist. `jpeg_quality`: 1 to 100, or None for raw images.

        True points are rounded to multiples of `truth_grid_m`, a power of two, so that they compress well.
        """
        if zstd and storage != "mcap":
            raise OutputError("only mcap bags can be compressed by chunks: name the output *.mcap or omit zstd")
        if jpeg_quality is not None and not 1 <= jpeg_quality <= 100:
            raise OutputError(f"JPEG quality is {jpeg_quality}: 1 to 100 is required")
        self._writer = CheckedWriter(path, version=9, storage_plugin=StoragePlugin[storage.upper()])
        if zstd:
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        self._jpeg_quality = jpeg_quality
        self._truth_grid_m = truth_grid_m
        self._connections: dict[str, Any] = {}
        self._rigs: dict[Task, StereoRig] = {}

    def __enter__(self) -> BagWriter:
        with _database_errors():
            self._writer.open()
        return self

    def __exit__(self, *raised: Any) -> None:  # noqa: ANN401 - passed on
        with _database_errors():
            self._writer.__exit__(*raised)

    def write_loc_rig(self, rig: StereoRig) -> None:
        """Set the rig of the localisation cameras; required before their first pair."""
        self._rigs[Task.LOCALISATION] = rig

    def write_nav_rig(self, rig: StereoRig) -> None:
        """Set the rig of the navigation cameras; required before their first pair."""
        self._rigs[Task.MAPPING] = rig

    def write_loc_pair(self, pair: StereoPair) -> None:
        """Write a pair of the drive with its camera_info; `/tf_static` is written before the first pair."""
        if "/tf_static" not in self._connections:
            transforms = messages.static_transforms(pair.stamp_ns, self._rigs[Task.LOCALISATION])
            self._write("/tf_static", pair.stamp_ns, transforms, (LATCHED,))
        self._write_pair(Task.LOCALISATION, pair)

    def write_nav_pair(self, nav: PosedStereoPair) -> None:
        """Write a mapping pair with its pose, camera_info and truth."""
        stamp = nav.pair.stamp_ns
        self._write(f"/{NAV_POSE}", stamp, messages.pose(stamp, nav.T_lm_navsb))
        self._write_pair(Task.MAPPING, nav.pair)
        if nav.truth is not None:
            self._write(f"/{TRUE_POINTS}", stamp, messages.points(stamp, nav.truth, self._truth_grid_m))

    def write_truth(self, stamp_ns: int, position: FloatArray, quat_xyzw: FloatArray) -> None:
        """Write one true pose of RB in DS."""
        self._write(f"/{TRUE_POSES}", stamp_ns, messages.odometry(stamp_ns, position, quat_xyzw))

    def _write_pair(self, task: Task, pair: StereoPair) -> None:
        stamp, name = pair.stamp_ns, task.rig
        for side, image in zip(SIDES, (pair.left, pair.right), strict=True):
            topic = f"/{name}/{side}/{RECTIFIED}"
            if self._jpeg_quality is None:
                self._write(topic, stamp, messages.image(stamp, image, name, side))
            else:
                jpeg = messages.jpeg_image(stamp, image, name, side, self._jpeg_quality)
                self._write(f"{topic}{COMPRESSED_END}", stamp, jpeg)
        for side in SIDES:
            info = messages.camera_info(stamp, self._rigs[task], name, side)
            self._write(f"/{name}/{side}/camera_info", stamp, info)

    def _write(self, name: str, stamp_ns: int, message: Any, qos: tuple[Qos, ...] = ()) -> None:  # noqa: ANN401
        with _database_errors():
            if name not in self._connections:
                self._connections[name] = self._writer.add_connection(
                    name, message.__msgtype__, typestore=TYPESTORE, offered_qos_profiles=qos
                )
            self._writer.write(self._connections[name], stamp_ns, TYPESTORE.serialize_cdr(message, message.__msgtype__))


@contextmanager
def _database_errors() -> Iterator[None]:
    """Convert errors of sqlite3 to OSError, because the writers of mcap files also raise OSError."""
    try:
        yield
    except sqlite3.Error as error:
        raise OSError(str(error)) from error
