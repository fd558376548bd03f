"""Writes a drive and mapping pairs as a ROS 2 bag, as a stream."""

from __future__ import annotations

import sqlite3
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any, Literal

from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import McapWriter

from sfr_loc_map.errors import OutputError
from sfr_loc_map.geometry.arrays import FloatArray, GreyImage
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair, StereoRig
from sfr_loc_map.io import bag_messages as messages
from sfr_loc_map.io.bag import TYPESTORE

Storage = Literal["mcap", "sqlite3"]
STORAGE_BY_SUFFIX: dict[str, Storage] = {".mcap": "mcap", ".bag": "mcap", ".db3": "sqlite3"}
"""Storage of a bag by the ending of its name; other names are data set folders."""
CHUNK_HEAD = 9 + 24
"""Bytes from the start of an mcap chunk record to its CRC: opcode and length, two times and the size (mcap 1.0)."""


class CheckedMcapWriter(McapWriter):
    """Gives each chunk the CRC-32 that the format has room for, so that readers notice flipped bytes."""

    def close_chunk(self) -> None:
        """End the chunk."""
        crc = zlib.crc32(self.chunk.bio.getbuffer())
        start = self.bio.tell()
        super().close_chunk()
        end = self.bio.tell()
        self.bio.seek(start + CHUNK_HEAD)
        self.bio.write(crc.to_bytes(4, "little"))
        self.bio.seek(end)


class CheckedWriter(Writer):
    """Writer of bags with checksums."""

    STORAGE_PLUGINS = MappingProxyType({**Writer.STORAGE_PLUGINS, StoragePlugin.MCAP: CheckedMcapWriter})


class BagWriter:
    """A bag that is being written; a context manager. What was written counts only if the block ends well."""

    def __init__(
        self,
        path: Path,
        storage: Storage = "mcap",
        *,
        jpeg_quality: int | None = None,
        zstd: bool = False,
        truth_grid_m: float | None = None,
    ) -> None:
        """Prepare a bag.

        Args:
            path: Folder of the bag; must not exist.
            storage: `mcap` or `sqlite3`.
            jpeg_quality: Images as JPEG (sensor_msgs/CompressedImage) of this quality, 1 to 100; None: raw, exact.
            zstd: Whether chunks are compressed (mcap only).
            truth_grid_m: True points of mapping pairs are rounded to multiples of this power of two, metres, so that
                they compress well; None: exact.

        Raises:
            OutputError: If the options do not fit together.
        """
        if zstd and storage != "mcap":
            raise OutputError("only mcap bags can be compressed by chunks: name the output *.mcap or leave zstd out")
        if jpeg_quality is not None and not 1 <= jpeg_quality <= 100:
            raise OutputError(f"JPEG quality is {jpeg_quality}: 1 to 100 is needed")
        self._writer = CheckedWriter(path, version=9, storage_plugin=StoragePlugin[storage.upper()])
        if zstd:
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        self._jpeg_quality = jpeg_quality
        self._truth_grid_m = truth_grid_m
        self._connections: dict[str, Any] = {}
        self._rigs: dict[str, StereoRig] = {}
        self._static_written = False

    def __enter__(self) -> BagWriter:
        """Open the bag."""
        with _database_errors():
            self._writer.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the bag; its metadata is written only if nothing was raised."""
        with _database_errors():
            self._writer.__exit__(kind, error, trace)

    def write_loc_rig(self, rig: StereoRig) -> None:
        """Set the rig of the localisation cameras; comes before their first pair."""
        self._rigs["loc"] = rig

    def write_nav_rig(self, rig: StereoRig) -> None:
        """Set the rig of the navigation cameras; comes before their first pair."""
        self._rigs["nav"] = rig

    def write_loc_pair(self, pair: StereoPair) -> None:
        """Write a pair of the drive, with its camera_info, and `/tf_static` before the first."""
        if not self._static_written:
            self._write_static(pair.stamp_ns)
        self._write_pair("loc", pair)

    def write_nav_pair(self, nav: PosedStereoPair) -> None:
        """Write a mapping pair with its pose, camera_info and truth."""
        stamp = nav.pair.stamp_ns
        self._write("nav/pose", stamp, messages.pose(stamp, nav.T_lm_navsb))
        self._write_pair("nav", nav.pair)
        if nav.truth is not None:
            self._write("ground_truth/points", stamp, messages.points(stamp, nav.truth, self._truth_grid_m))

    def write_truth(self, stamp_ns: int, position: FloatArray, quat_xyzw: FloatArray) -> None:
        """Write one true pose of RB in DS."""
        self._write("ground_truth/odometry", stamp_ns, messages.odometry(stamp_ns, position, quat_xyzw))

    def _write_pair(self, task: str, pair: StereoPair) -> None:
        rig = self._rigs[task]
        self._write_image(task, "left", pair.stamp_ns, pair.left)
        self._write_image(task, "right", pair.stamp_ns, pair.right)
        self._write(f"{task}/left/camera_info", pair.stamp_ns, messages.camera_info(pair.stamp_ns, rig, task, "left"))
        self._write(f"{task}/right/camera_info", pair.stamp_ns, messages.camera_info(pair.stamp_ns, rig, task, "right"))

    def _write_image(self, task: str, side: messages.Side, stamp_ns: int, image: GreyImage) -> None:
        topic = f"{task}/{side}/image_rect"
        if self._jpeg_quality is None:
            self._write(topic, stamp_ns, messages.image(stamp_ns, image, task, side))
        else:
            message = messages.jpeg_image(stamp_ns, image, task, side, self._jpeg_quality)
            self._write(f"{topic}/compressed", stamp_ns, message)

    def _write_static(self, stamp_ns: int) -> None:
        self._write("/tf_static", stamp_ns, messages.static_transforms(stamp_ns, self._rigs["loc"]), (_latched(),))
        self._static_written = True

    def _write(self, topic: str, stamp_ns: int, message: Any, qos: tuple[Qos, ...] = ()) -> None:  # noqa: ANN401
        name = "/" + topic.lstrip("/")
        with _database_errors():
            if name not in self._connections:
                self._connections[name] = self._writer.add_connection(
                    name, message.__msgtype__, typestore=TYPESTORE, offered_qos_profiles=qos
                )
            self._writer.write(self._connections[name], stamp_ns, TYPESTORE.serialize_cdr(message, message.__msgtype__))


@contextmanager
def _database_errors() -> Iterator[None]:
    """Turn what sqlite says of a disk into an error of the system, as mcap files raise.

    Raises:
        OSError: If the database cannot be written.
    """
    try:
        yield
    except sqlite3.Error as error:
        raise OSError(str(error)) from error


def _latched() -> Qos:
    """Return the profile of `/tf_static`: reliable, the last one is kept for late listeners."""
    never = QosTime(0, 0)
    return Qos(
        QosHistory.KEEP_LAST,
        1,
        QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL,
        never,
        never,
        QosLiveliness.AUTOMATIC,
        never,
        False,
    )
