"""Small sources with one fault each."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rosbags.rosbag2 import Reader, StoragePlugin, Writer

from helpers.made_scene import write_bag, write_folder
from sfr_loc_map.io.bag.encoding import TYPESTORE

Edit = Callable[[str, int, Any], Any]
"""Takes a topic, the number of the message on the topic, and the message; returns the message to write, or None."""


def good_folder(path: Path) -> Path:
    return write_folder(path, 3, 2)


def good_bag(path: Path) -> Path:
    return write_bag(path, 3, 2)


def rewritten_bag(path: Path, edit: Edit) -> Path:
    """Write a good bag again with changed messages, in the same order."""
    good = good_bag(path.with_name("good.mcap"))
    counts: dict[str, int] = {}
    with Reader(good) as reader, Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {
            c.topic: writer.add_connection(c.topic, c.msgtype, typestore=TYPESTORE) for c in reader.connections
        }
        for connection, recorded_ns, raw in reader.messages():
            topic, kind = connection.topic, connection.msgtype
            number = counts[topic] = counts.get(topic, -1) + 1
            message = edit(topic, number, TYPESTORE.deserialize_cdr(raw, kind))
            if message is not None:
                writer.write(connections[topic], recorded_ns, TYPESTORE.serialize_cdr(message, kind))
    return path


def renamed_bag(path: Path, before: str, after: str) -> Path:
    """Write a good bag again with a part of all names changed."""
    good = good_bag(path.with_name(f"before_{path.name}"))
    with Reader(good) as reader, Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {
            c.topic: writer.add_connection(c.topic.replace(before, after), c.msgtype, typestore=TYPESTORE)
            for c in reader.connections
        }
        for connection, recorded_ns, raw in reader.messages():
            writer.write(connections[connection.topic], recorded_ns, raw)
    return path


def missing(path: Path) -> Path:
    return path


def empty_folder(path: Path) -> Path:
    path.mkdir()
    return path


def empty_bag(path: Path) -> Path:
    return rewritten_bag(path, lambda topic, number, message: None)


def storage_of(bag: Path) -> Path:
    (file,) = bag.glob("*.mcap")
    return file


def truncated_bag(path: Path) -> Path:
    file = storage_of(good_bag(path.with_suffix(".mcap")))
    file.write_bytes(file.read_bytes()[: file.stat().st_size * 2 // 3])
    return file.parent


def flipped_image(path: Path) -> Path:
    for task in ("loc", "nav"):
        file = good_folder(path) / task / "left/000001.png" if task == "loc" else path / task / "left/000001.png"
        data = bytearray(file.read_bytes())
        data[len(data) // 2] ^= 0xFF
        file.write_bytes(data)
    return path


def no_camera_info(path: Path) -> Path:
    return renamed_bag(path, "right/camera_info", "right/other")


def silent_camera_info(path: Path) -> Path:
    return rewritten_bag(path, lambda topic, number, message: None if "left/camera_info" in topic else message)


def unequal_sizes(path: Path) -> Path:
    good_folder(path)
    for task in ("loc", "nav"):
        cv2.imwrite(str(path / task / "right/000001.png"), np.zeros((120, 150), np.uint8))
    return path


def not_rectified(path: Path) -> Path:
    return rewritten_bag(path, lambda t, n, m: replace(m, p=np.zeros(12)) if t.endswith("left/camera_info") else m)


def nan_in_poses(path: Path) -> Path:
    good_folder(path)
    for name, column in (("loc/groundtruth.csv", 2), ("nav/pairs.csv", 4)):
        lines = (path / name).read_text().splitlines()
        words = lines[2].split(",")
        words[column] = "nan"
        (path / name).write_text("\n".join([*lines[:2], ",".join(words), *lines[3:]]) + "\n")
    return path


def backwards(path: Path) -> Path:
    good_folder(path)
    for task in ("loc", "nav"):
        head, first, second, *rest = (path / task / "pairs.csv").read_text().splitlines()
        (path / task / "pairs.csv").write_text("\n".join([head, second, first, *rest]) + "\n")
    return path


def no_place_on_the_rover(path: Path) -> Path:
    rig = good_folder(path) / "loc/rig.json"
    content = json.loads(rig.read_text())
    del content["T_rb_locsb"]
    rig.write_text(json.dumps(content))
    return path


def broken_rig(path: Path) -> Path:
    good_folder(path)
    for task in ("loc", "nav"):
        (path / task / "rig.json").write_text('{"width": 160')
    return path


def four_pairs(path: Path) -> Path:
    return write_folder(path, 0, 4)
