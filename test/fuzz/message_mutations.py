"""Mutations of ROS messages and of the bags that hold them."""

from __future__ import annotations

import sqlite3
import tempfile
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
from mutations import BYTES, STRINGS, Mutation, any_bytes, encoded
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode
from rosbags.rosbag2.storage_mcap import zstd

from sfr_loc_map.io.bag import TYPESTORE

MCAP_MAGIC = b"\x89MCAP0\r\n"
CHUNK, DATA_END = 0x06, 0x0F
INTEGERS = (0, 1, -1, 2, 127, 255, 32767, 65535, 2**31 - 1, -(2**31), 2**32 - 1, 2**63 - 1, 10**9, 7, 8)
FLOATS = (float("nan"), float("inf"), -float("inf"), 0.0, -0.0, -1.0, 1e308, -1e308, 1e300, 1e9, 1e-320, 0.5, 1e5)
LENGTHS = (0, 1, 2, 7, 37, 20_000)


# ---- messages


def hostile_fields(msgtype: str, rng: Random, raw: bytes) -> bytes:
    """Give fields of a message hostile values; the result can be read as that type."""
    for _ in range(20):
        message = TYPESTORE.deserialize_cdr(raw, msgtype)
        for _ in range(rng.choice((1, 1, 2, 4))):
            owner, name = rng.choice(list(_slots(message)))
            object.__setattr__(owner, name, _hostile(rng, getattr(owner, name)))
        try:
            return bytes(TYPESTORE.serialize_cdr(message, msgtype))
        except Exception:  # the value does not fit the field
            continue
    return raw


def _slots(message: Any) -> Iterator[tuple[Any, str]]:
    """Yield owner and name of all fields within."""
    for item in fields(message):
        if item.name.startswith("__"):
            continue
        value = getattr(message, item.name)
        if not is_dataclass(value):
            yield message, item.name
        for part in value[:8] if isinstance(value, list) else [value]:
            if is_dataclass(part):
                yield from _slots(part)


def _hostile(rng: Random, value: Any) -> Any:
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return rng.choice((*INTEGERS, value + 1, value - 1, value * 2))
    if isinstance(value, float):
        return rng.choice(FLOATS)
    if isinstance(value, str):
        return rng.choice(STRINGS).encode("utf-8", "ignore").decode() if rng.random() < 0.8 else value + " "
    if isinstance(value, list):
        return rng.choice(([], value * 2, value[:1], value[1:], value * 300))
    edit = rng.randrange(4)
    if edit == 0 or not value.size:
        return np.resize(value, rng.choice((*LENGTHS, max(value.size - 1, 0), value.size + 1))).astype(value.dtype)
    altered, limits = value.copy(), FLOATS
    if value.dtype.kind in "iu":
        limits = (np.iinfo(value.dtype).min, np.iinfo(value.dtype).max, 0)
    with np.errstate(over="ignore"):
        altered[slice(None) if edit == 1 else rng.randrange(value.size)] = rng.choice(limits)
    return altered


# ---- bags


def rewrite(suffix: str, rng: Random, data: bytes) -> bytes:
    """Write a bag's storage file again with messages of one or two topics changed, or with other names of them."""
    plugin = StoragePlugin.MCAP if suffix == ".mcap" else StoragePlugin.SQLITE3
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / f"source{suffix}", Path(folder) / "new"
        source.write_bytes(data)
        writer = Writer(target, version=9, storage_plugin=plugin)
        if plugin is StoragePlugin.MCAP and rng.random() < 0.5:
            writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        with Reader(source) as reader, writer:
            chosen = rng.sample(sorted(c.topic for c in reader.connections), rng.choice((1, 1, 2)))
            renamed = encoded(rng.choice(STRINGS[:12])).decode("utf-8", "replace") if rng.random() < 0.15 else None
            new = {}
            for c in reader.connections:
                name = renamed if renamed and c.topic in chosen else c.topic
                new[c.topic] = writer.add_connection(f"/{name.strip('/')}", c.msgtype, typestore=TYPESTORE)
            for c, stamp, raw in reader.messages():
                content = bytes(raw)
                if c.topic in chosen and rng.random() < 0.7:
                    edit = partial(hostile_fields, c.msgtype) if rng.random() < 0.7 else any_bytes
                    content = edit(rng, content)
                writer.write(new[c.topic], rng.choice((0, 2**62)) if rng.random() < 0.01 else stamp, content)
        return next(target.glob(f"*{suffix}")).read_bytes()


def mcap_records(rng: Random, data: bytes) -> bytes:
    """Change one record; half of the time the end is left out, as of a recording that broke off."""
    records, offset, end = [], len(MCAP_MAGIC), MCAP_MAGIC
    while offset + 9 <= len(data) - len(MCAP_MAGIC):
        length = int.from_bytes(data[offset + 1 : offset + 9], "little")
        records.append((data[offset], data[offset + 9 : offset + 9 + length]))
        offset += 9 + length
    if rng.random() < 0.5:
        records, end = records[: [kind for kind, _ in records].index(DATA_END)], b""
    chosen = rng.randrange(len(records))
    kind, body = records[chosen]
    if kind == CHUNK and rng.random() < 0.8:
        new = [(kind, _changed_chunk(rng, body))]
    else:
        new = rng.choice(([], [records[chosen]] * 2, [(rng.randrange(256), body)], [(kind, any_bytes(rng, body))]))
    records[chosen : chosen + 1] = new
    return MCAP_MAGIC + b"".join(bytes([k]) + len(body).to_bytes(8, "little") + body for k, body in records) + end


def _changed_chunk(rng: Random, body: bytes) -> bytes:
    """Change what is in a chunk, or what it claims of its size and compression."""
    name_end = 32 + int.from_bytes(body[28:32], "little")
    compression, packed = body[32:name_end], body[name_end + 8 :]
    content = zstd.decompress(packed) if compression == b"zstd" else packed
    size, edit = len(content), rng.randrange(5)
    if edit == 0:
        size = rng.choice((0, 1, size + 1, 2**31, 2**40, 2**63, 2**64 - 1))
    elif edit == 1:
        compression = rng.choice((b"lz4", b"zstd", b"", b"\xff\xfe", b"gzip"))
    elif edit == 2:
        compression, packed = b"zstd", zstd.compress(b"\0" * 200_000_000)
        size = rng.choice((200_000_000, 100, 2**40))
    else:
        content = any_bytes(rng, content)
        size, packed = len(content), zstd.compress(content) if compression == b"zstd" else content
    head = body[:16] + size.to_bytes(8, "little") + bytes(4) + len(compression).to_bytes(4, "little") + compression
    return head + len(packed).to_bytes(8, "little") + packed


SQL = (
    "UPDATE messages SET data = zeroblob(100000000) WHERE id = 1",
    *(f"UPDATE messages SET data = {value} WHERE id % 3 = 0" for value in ("NULL", "'text'", "17", "x''", "x'0001'")),
    *(f"UPDATE messages SET timestamp = {value}" for value in ("'soon'", "-9223372036854775808", "1e300")),
    "UPDATE messages SET topic_id = 99 WHERE id % 2 = 0",
    *(f"UPDATE topics SET name = {value} WHERE id = 1" for value in ("char(27) || '[31m'", "x'ff00'")),
    *(f"UPDATE topics SET name = {value}" for value in ("NULL", "'same'")),
    *(f"UPDATE topics SET type = {value}" for value in ("'a/msg/B'", "''", "char(10) || 'x'")),
    "UPDATE topics SET serialization_format = 'json'",
    *(f"UPDATE topics SET offered_qos_profiles = {value}" for value in ("'[[[[' || zeroblob(10)", "'a: &a [*a]'")),
    *(
        "DELETE FROM topics",
        "DELETE FROM topics WHERE id = 1",
        "DELETE FROM messages",
        "DELETE FROM messages WHERE id % 2",
    ),
    *("DROP TABLE messages", "DROP TABLE topics", "DROP TABLE schema"),
    *("UPDATE schema SET schema_version = 99", "UPDATE schema SET schema_version = 'x'"),
    "ALTER TABLE messages RENAME COLUMN data TO content",
    "DROP TABLE messages; CREATE VIEW messages AS WITH RECURSIVE c(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM c "
    "LIMIT 3000000) SELECT id, 1 AS topic_id, id AS timestamp, x'00' AS data FROM c",
    "INSERT INTO messages SELECT id + 100000, topic_id, timestamp, data FROM messages",
)


def sqlite_statement(rng: Random, data: bytes) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "bag.db3"
        file.write_bytes(data)
        connection = sqlite3.connect(file)
        connection.executescript(rng.choice(SQL))
        connection.close()
        return file.read_bytes()


MCAP: tuple[Mutation, ...] = (*[partial(rewrite, ".mcap")] * 4, mcap_records, mcap_records, mcap_records, *BYTES)
SQLITE: tuple[Mutation, ...] = (*[partial(rewrite, ".db3")] * 3, sqlite_statement, sqlite_statement, *BYTES)
