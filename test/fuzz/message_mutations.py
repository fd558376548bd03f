"""Mutations of ROS messages and of the bags that hold them."""

from __future__ import annotations

import sqlite3
import tempfile
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from random import Random
from types import MappingProxyType
from typing import Any

import numpy as np
from mutations import BYTES, STRINGS, Mutation, encoded, huge_int
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode
from rosbags.rosbag2.storage_mcap import zstd

from sfr_loc_map.io.bag import TYPESTORE

MCAP_MAGIC = b"\x89MCAP0\r\n"
CHUNK, DATA_END = 0x06, 0x0F
INTEGERS = (0, 1, -1, 2, 127, 255, 32767, 65535, 2**31 - 1, -(2**31), 2**32 - 1, 2**63 - 1, 10**9, 7, 8)
FLOATS = (float("nan"), float("inf"), -float("inf"), 0.0, -0.0, -1.0, 1e308, -1e308, 1e300, 1e9, 1e-320, 0.5, 1e5)
LENGTHS = (0, 1, 2, 7, 37, 20_000)
STORES = MappingProxyType({".mcap": StoragePlugin.MCAP, ".db3": StoragePlugin.SQLITE3})


# ---- messages


def message_fields(msgtype: str) -> Mutation:
    """Return the mutation that gives fields of a message hostile values; the result can be read as that type."""

    def mutate(rng: Random, raw: bytes) -> bytes:
        return with_hostile_fields(rng, raw, msgtype)

    return mutate


def with_hostile_fields(rng: Random, raw: bytes, msgtype: str) -> bytes:
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
        if is_dataclass(value):
            yield from _slots(value)
            continue
        yield message, item.name
        if isinstance(value, list) and value and is_dataclass(value[0]):
            for part in value[:8]:
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
    if isinstance(value, np.ndarray):
        return _hostile_array(rng, value)
    if isinstance(value, list):
        return rng.choice(([], value * 2, value[:1], value[1:], value * 300))
    return value


def _hostile_array(rng: Random, value: np.ndarray) -> np.ndarray:
    edit = rng.randrange(4)
    if edit == 0 or not value.size:
        return np.resize(value, rng.choice((*LENGTHS, max(value.size - 1, 0), value.size + 1))).astype(value.dtype)
    altered = value.copy()
    extremes: tuple[Any, ...] = FLOATS
    if value.dtype.kind in "iu":
        extremes = (np.iinfo(value.dtype).min, np.iinfo(value.dtype).max, 0)
    with np.errstate(over="ignore"):
        if edit == 1:
            altered[:] = rng.choice(extremes)
        else:
            altered[rng.randrange(value.size)] = rng.choice(extremes)
    return altered


# ---- bags


def rewritten_messages(suffix: str) -> Mutation:
    """Return the mutation that writes a bag's storage file again with one message of each of some topics changed."""

    def mutate(rng: Random, data: bytes) -> bytes:
        with tempfile.TemporaryDirectory() as folder:
            source = Path(folder) / f"source{suffix}"
            source.write_bytes(data)
            _rewrite(rng, source, Path(folder) / "new", STORES[suffix])
            return next((Path(folder) / "new").glob(f"*{suffix}")).read_bytes()

    return mutate


def _rewrite(rng: Random, source: Path, target: Path, plugin: StoragePlugin) -> None:
    writer = Writer(target, version=9, storage_plugin=plugin)
    if plugin is StoragePlugin.MCAP and rng.random() < 0.5:
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with Reader(source) as reader, writer:
        connections = {c.topic: c for c in reader.connections}
        chosen = rng.sample(sorted(connections), rng.choice((1, 1, 2)))
        renamed = rng.choice(STRINGS[:12]) if rng.random() < 0.15 else None
        new = {}
        for topic, c in connections.items():
            name = encoded(renamed).decode("utf-8", "replace") if renamed and topic in chosen else topic
            new[topic] = writer.add_connection(f"/{name.strip('/')}", c.msgtype, typestore=TYPESTORE)
        for c, stamp, raw in reader.messages():
            content = bytes(raw)
            if c.topic in chosen and rng.random() < 0.7:
                content = _changed(rng, content, c.msgtype)
            writer.write(new[c.topic], rng.choice((0, 2**62)) if rng.random() < 0.01 else stamp, content)


def _changed(rng: Random, raw: bytes, msgtype: str) -> bytes:
    if rng.random() < 0.7:
        return with_hostile_fields(rng, raw, msgtype)
    return rng.choice(BYTES)(rng, raw)


def _records(data: bytes) -> list[tuple[int, bytes]]:
    found, offset = [], len(MCAP_MAGIC)
    while offset + 9 <= len(data) - len(MCAP_MAGIC):
        length = int.from_bytes(data[offset + 1 : offset + 9], "little")
        found.append((data[offset], data[offset + 9 : offset + 9 + length]))
        offset += 9 + length
    return found


def mcap_records(rng: Random, data: bytes) -> bytes:
    """Change one record; half of the time the end is left out, as of a recording that broke off."""
    records = _records(data)
    if rng.random() < 0.5:
        kinds = [kind for kind, _ in records]
        records = records[: kinds.index(DATA_END)]
        end = b""
    else:
        end = MCAP_MAGIC
    chosen = rng.randrange(len(records))
    kind, body = records[chosen]
    edit = rng.randrange(6)
    if kind == CHUNK and edit < 5:
        records[chosen] = (kind, _changed_chunk(rng, body))
    elif edit == 0:
        del records[chosen]
    elif edit == 1:
        records.insert(chosen, records[chosen])
    elif edit == 2:
        records[chosen] = (rng.randrange(256), body)
    else:
        records[chosen] = (kind, rng.choice((*BYTES, huge_int))(rng, body))
    written = b"".join(bytes([kind]) + len(body).to_bytes(8, "little") + body for kind, body in records)
    return MCAP_MAGIC + written + end


def _changed_chunk(rng: Random, body: bytes) -> bytes:
    """Change what is in a chunk, or what it claims of its size and compression."""
    name_end = 32 + int.from_bytes(body[28:32], "little")
    compression, packed = body[32:name_end], body[name_end + 8 :]
    content = zstd.decompress(packed) if compression == b"zstd" else packed
    size = len(content)
    edit = rng.randrange(5)
    if edit == 0:
        size = rng.choice((0, 1, size + 1, 2**31, 2**40, 2**63, 2**64 - 1))
    elif edit == 1:
        compression = rng.choice((b"lz4", b"zstd", b"", b"\xff\xfe", b"gzip"))
    elif edit == 2:
        content = b"\0" * 200_000_000
        compression, packed = b"zstd", zstd.compress(content)
        size = rng.choice((len(content), 100, 2**40))
    else:
        content = rng.choice((*BYTES, huge_int))(rng, content)
        size = len(content)
        packed = zstd.compress(content) if compression == b"zstd" else content
    head = body[:16] + size.to_bytes(8, "little") + bytes(4) + len(compression).to_bytes(4, "little") + compression
    return head + len(packed).to_bytes(8, "little") + packed


SQL = (
    "UPDATE messages SET data = zeroblob(100000000) WHERE id = 1",
    "UPDATE messages SET data = NULL WHERE id % 3 = 0",
    "UPDATE messages SET data = 'text' WHERE id % 4 = 1",
    "UPDATE messages SET data = 17",
    "UPDATE messages SET data = x'' WHERE id % 2 = 0",
    "UPDATE messages SET data = x'0001' WHERE id % 5 = 0",
    "UPDATE messages SET timestamp = 'soon' WHERE id % 2 = 0",
    "UPDATE messages SET timestamp = -9223372036854775808",
    "UPDATE messages SET timestamp = 1e300",
    "UPDATE messages SET topic_id = 99 WHERE id % 2 = 0",
    "UPDATE topics SET name = char(27) || '[31m' WHERE id = 1",
    "UPDATE topics SET name = x'ff00' WHERE id = 2",
    "UPDATE topics SET name = NULL",
    "UPDATE topics SET name = 'same'",
    "UPDATE topics SET type = 'a/msg/B'",
    "UPDATE topics SET type = ''",
    "UPDATE topics SET type = char(10) || 'x' WHERE id = 1",
    "UPDATE topics SET serialization_format = 'json'",
    "UPDATE topics SET offered_qos_profiles = '[[[[' || zeroblob(10)",
    "UPDATE topics SET offered_qos_profiles = 'a: &a [*a]'",
    "DELETE FROM topics",
    "DELETE FROM topics WHERE id = 1",
    "DELETE FROM messages",
    "DELETE FROM messages WHERE id % 2",
    "DROP TABLE messages",
    "DROP TABLE topics",
    "DROP TABLE schema",
    "UPDATE schema SET schema_version = 99",
    "UPDATE schema SET schema_version = 'x'",
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
        connection.commit()
        connection.close()
        return file.read_bytes()


MCAP: tuple[Mutation, ...] = (*[rewritten_messages(".mcap")] * 4, mcap_records, mcap_records, mcap_records, *BYTES)
SQLITE: tuple[Mutation, ...] = (*[rewritten_messages(".db3")] * 3, sqlite_statement, sqlite_statement, *BYTES)
