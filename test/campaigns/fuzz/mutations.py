"""Mutations that turn valid files into hostile files. All random values come from the given generator."""

from __future__ import annotations

import io
import json
import re
import sqlite3
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import fields, is_dataclass
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import zstd

from sfr_loc_map.io.bag.encoding import TYPESTORE
from sfr_loc_map.io.bag.files import MCAP_MAGIC
from sfr_loc_map.json_yaml import parse_yaml

Mutation = Callable[[Random, bytes], bytes]

_NUMBERS = """nan inf -inf -1 0 -0.0 1e308 -1e308 1e-320 1e9 1e400 0.5 2147483648 4294967295 65536
9223372036854775808 -9223372036854775809 1000000000000 1_000 0x10 1,5 \u0663 1e + --1 00012 True 1:30:00 0o17"""
_STRINGS = "../../../../etc/passwd /dev/zero /dev/null . .. / %s%n {} ${HOME} ' , ; \\ null ~ \U0001f600 [red] [/]"
NUMBERS = (*_NUMBERS.split(), "", "9" * 400, "-" + "9" * 400, "9" * 5000, "0." + "0" * 400 + "1")
STRINGS = (
    *("", "\0", "a\0b", "\x1b[31mred\x1b[0m", "\x1b]0;title\x07", "\x9b31m", "\udc80", "\ud800", "\u202e", "\ufeff"),
    *("\r", "\n", "a\r\nb", "\x7f", '"', "\u2028", "a" * 300, "x" * 100_000, *_STRINGS.split()),
)
HUGE_INTS = (0, 1, 2, 0x7F, 0xFF, 0xFFFF, 0x10000, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 2**62, 2**63, 2**64 - 1)
NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")
DEEP = "@@deep@@"
"""Placeholder for nested brackets until the tree is serialised."""
VALUES: tuple[Any, ...] = (
    *(None, True, 0, -1, 2**31, -(2**63) - 1, 10**399, float("nan"), float("inf"), 1e308, -1e308, 1e-320, DEEP, "1"),
    *([], {}, [[]], {"a": 1}, [1] * 20_000, {str(i): i for i in range(2000)}, [float("nan")] * 9, [-1] * 4),
)


CHUNK, DATA_END = 0x06, 0x0F
INTEGERS = (0, 1, -1, 127, 255, 65535, 2**31 - 1, -(2**31), 2**32 - 1, 2**63 - 1, 7)
FLOATS = (float("nan"), float("inf"), -float("inf"), 0.0, -1.0, 1e308, -1e308, 1e9, 1e-320, 0.5)


def encoded(text: str) -> bytes:
    return text.encode("utf-8", "surrogatepass")


def flip_bytes(rng: Random, data: bytes) -> bytes:
    """Mutate half of the time only the header, because it is short and contains all sizes."""
    altered, end = bytearray(data), min(len(data), rng.choice((128, len(data))))
    for _ in range(rng.choice((1, 1, 4, 32)) if altered else 0):
        altered[rng.randrange(end)] ^= 1 << rng.randrange(8)
    return bytes(altered)


def truncate(rng: Random, data: bytes) -> bytes:
    return data[: rng.choice((0, 1, rng.randrange(len(data) + 1), max(len(data) - 1, 0), rng.randrange(64)))]


def drop_or_repeat(rng: Random, data: bytes) -> bytes:
    start, length = rng.randrange(len(data) + 1), rng.choice((1, 4, 64, 4096))
    return data[:start] + data[start : start + length] * rng.choice((0, 0, 2, 50)) + data[start + length :]


def huge_int(rng: Random, data: bytes) -> bytes:
    """Overwrite a number of 2, 4 or 8 bytes, mostly near the start, where headers are."""
    size = rng.choice((2, 4, 4, 8))
    last = len(data) - size
    offset = rng.randrange(min(last, 200) + 1) if rng.random() < 0.7 else rng.randrange(last + 1)
    number = (rng.choice(HUGE_INTS) % 256**size).to_bytes(size, rng.choice(("little", "big")))
    return data[:offset] + number + data[offset + size :]


BYTES: tuple[Mutation, ...] = (flip_bytes, flip_bytes, truncate, drop_or_repeat, drop_or_repeat, huge_int, huge_int)


def any_bytes(rng: Random, data: bytes) -> bytes:
    return rng.choice(BYTES)(rng, data)


def replace_number(rng: Random, data: bytes) -> bytes:
    chosen = rng.choice(list(NUMBER.finditer(data)))
    return data[: chosen.start()] + encoded(rng.choice(NUMBERS)) + data[chosen.end() :]


def insert_text(rng: Random, data: bytes) -> bytes:
    start = rng.randrange(len(data) + 1)
    return data[:start] + encoded(rng.choice((*STRINGS, *NUMBERS))) + data[start:]


def edit_lines(rng: Random, data: bytes) -> bytes:
    lines = data.split(b"\n")
    chosen = rng.randrange(len(lines))
    words = re.split(rb"([,\s:]+)", lines[chosen])
    words[rng.randrange(len(words))] = encoded(rng.choice((*NUMBERS, *STRINGS)))
    line = lines[chosen]
    lines[chosen : chosen + 1] = rng.choice(([], [line] * 3, [encoded(rng.choice(STRINGS))], [b"".join(words)]))
    return b"\n".join(lines)


TEXT: tuple[Mutation, ...] = (replace_number, replace_number, insert_text, edit_lines, edit_lines)


def _slots(tree: Any) -> Iterator[tuple[Any, Any]]:
    """Yield container and key of all nested values."""
    for key in tree if isinstance(tree, dict) else range(len(tree) if isinstance(tree, list) else 0):
        yield tree, key
        yield from _slots(tree[key])


def tree(rng: Random, data: bytes) -> bytes:
    """Change a value of JSON or YAML; the result is valid as both."""
    root = parse_yaml(data.decode())  # bounded, because the data may already contain a bomb
    container, key = rng.choice(list(_slots(root)))
    edit, value = rng.randrange(6), rng.choice((*VALUES, *rng.sample(STRINGS, 8)))
    if edit == 0:
        del container[key]
    elif edit == 1 and isinstance(container, list):
        container.extend([container[key]] * rng.choice((1, 10, 1000)))
    elif edit == 1:
        container[rng.choice(STRINGS)] = container[key]
    else:
        container[key] = [container[key]] if edit == 2 else value
    depth = rng.choice((50, 900, 3000, 100_000))
    nested = rng.choice(("[" * depth + "]" * depth, '{"a":' * depth + "1" + "}" * depth))
    return encoded(json.dumps(root, ensure_ascii=rng.random() < 0.7).replace(f'"{DEEP}"', nested))


_BOMB = "\n".join(["a0: &a0 {x: 1}", *(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 12))])
YAML_TRICKS = (
    *(_BOMB, "a: &a [*a]", "m: &m {<<: *m}", "{[]: 1}", "---\na: 1\n---\nb: 2", "%YAML 9.9\n---\na: 1"),
    *("x: !!python/object/apply:os.system ['true']", "x: !!binary aaaa\ny: !!set {a, b}", "x: 2001-99-99"),
    *("x: !!int '" + "9" * 5000 + "'", "x: 190:20:30:59:59:59\n? [a, b]\n: c", "? " * 3000, "x: " + "[" * 20_000),
)


def yaml_trick(rng: Random, data: bytes) -> bytes:
    """Insert YAML features: nested aliases, tags, other types, more documents."""
    return encoded(rng.choice(YAML_TRICKS)) + b"\n" + rng.choice((b"", data))


JSON: tuple[Mutation, ...] = (tree, tree, tree, *TEXT, *BYTES)
YAML: tuple[Mutation, ...] = (*JSON, tree, yaml_trick, yaml_trick)


def png_chunk(rng: Random, data: bytes) -> bytes:
    """Change one chunk of a PNG and update its checksum."""
    chunks, offset = [], 8
    while offset + 8 <= len(data):
        (length,), kind = struct.unpack(">I", data[offset : offset + 4]), data[offset + 4 : offset + 8]
        chunks.append((kind, data[offset + 8 : offset + 8 + length]))
        offset += 12 + length
    chosen = rng.randrange(len(chunks)) if rng.random() < 0.6 else 0
    kind, body = chunks[chosen]
    if kind == b"IHDR" and rng.random() < 0.7:
        size = rng.choice(((20_000, 20_000), (2**31 - 1, 1), (0, 0), (65_535, 65_535), (160, 120)))
        rest = rng.choice((1, 2, 4, 8, 16, 7)), rng.randrange(8), 0, 0, rng.randrange(3)
        chunks[chosen] = (kind, struct.pack(">IIBBBBB", *size, *rest))
    elif rng.random() < 0.4:
        extra = rng.choice((b"zTXt", b"iCCP", b"PLTE", b"tRNS"))
        chunks.insert(1, (extra, b"name\0\0" + zlib.compress(b"\0" * rng.choice((10, 30_000_000)))))
    else:
        chunks[chosen : chosen + 1] = rng.choice(([chunks[chosen]] * 2, [(kind, any_bytes(rng, body))]))
    return data[:8] + b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body)) for kind, body in chunks
    )


def zip_member(rng: Random, data: bytes) -> bytes:
    """Change, drop, add or rename a member of a zip file."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = rng.choice(list(members))
    body = members.pop(name)
    new = rng.choice((name, "x.npy", "\x1b[31m.npy", "../x.npy", "a" * 1000))
    members |= {new: rng.choice((any_bytes(rng, body), any_bytes(rng, body), b"\0" * 40_000_000))}
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as archive:
        for name, body in members.items():
            archive.writestr(name, body)
    return stream.getvalue()


def head_text(rng: Random, data: bytes) -> bytes:
    """Mutate the text header of a binary file (PLY, PCD, PGM, NPY)."""
    end = max(20, *(data.find(mark) + len(mark) for mark in (b"end_header", b"DATA binary", b"255", b"), }")))
    return rng.choice(TEXT)(rng, data[:end]) + data[end:]


PNG: tuple[Mutation, ...] = (png_chunk, png_chunk, png_chunk, *BYTES)
ZIP: tuple[Mutation, ...] = (zip_member, zip_member, zip_member, *BYTES)
HEADED: tuple[Mutation, ...] = (head_text, head_text, head_text, *BYTES)


def hostile_fields(msgtype: str, rng: Random, raw: bytes) -> bytes:
    """Set fields of a message to hostile values; the result can still be deserialised."""
    for _ in range(20):
        message = TYPESTORE.deserialize_cdr(raw, msgtype)
        for _ in range(rng.choice((1, 1, 2, 4))):
            owner, name = rng.choice(list(_fields(message)))
            object.__setattr__(owner, name, _hostile(rng, getattr(owner, name)))
        try:
            return bytes(TYPESTORE.serialize_cdr(message, msgtype))
        except Exception:  # the value does not fit the field
            continue
    return raw


def _fields(message: Any) -> Iterator[tuple[Any, str]]:
    """Yield owner and name of all nested fields."""
    for item in fields(message):
        if item.name.startswith("__"):
            continue
        value = getattr(message, item.name)
        if not is_dataclass(value):
            yield message, item.name
        for part in value[:8] if isinstance(value, list) else [value]:
            if is_dataclass(part):
                yield from _fields(part)


def _hostile(rng: Random, value: Any) -> Any:
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return rng.choice((*INTEGERS, value + 1, value - 1, value * 2))
    if isinstance(value, float):
        return rng.choice(FLOATS)
    if isinstance(value, str):
        return rng.choice(STRINGS).encode("utf-8", "ignore").decode()
    if isinstance(value, list):
        return rng.choice(([], value * 2, value[:1], value[1:], value * 300))
    if rng.random() < 0.25 or not value.size:
        return np.resize(value, rng.choice((0, 1, 7, 20_000, max(value.size - 1, 0), value.size + 1))).astype(
            value.dtype
        )
    altered, limits = value.copy(), FLOATS
    if value.dtype.kind in "iu":
        limits = (np.iinfo(value.dtype).min, np.iinfo(value.dtype).max, 0)
    with np.errstate(over="ignore"):
        altered[rng.choice((slice(None), rng.randrange(value.size)))] = rng.choice(limits)
    return altered


def rewrite(suffix: str, rng: Random, data: bytes) -> bytes:
    """Rewrite the storage file of a bag with changed messages or names of one or two topics."""
    plugin = StoragePlugin.MCAP if suffix == ".mcap" else StoragePlugin.SQLITE3
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / f"source{suffix}", Path(folder) / "new"
        source.write_bytes(data)
        with Reader(source) as reader, Writer(target, version=9, storage_plugin=plugin) as writer:
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
    """Change one record; half of the time, truncate the file as after an interrupted recording."""
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
        new = [(kind, _other_claim(rng, body))]
    else:
        new = rng.choice(([], [records[chosen]] * 2, [(rng.randrange(256), body)], [(kind, any_bytes(rng, body))]))
    records[chosen : chosen + 1] = new
    return MCAP_MAGIC + b"".join(bytes([k]) + len(body).to_bytes(8, "little") + body for k, body in records) + end


def _other_claim(rng: Random, chunk: bytes) -> bytes:
    """Change the stated size or compression of a chunk; the content may be a bomb."""
    content = chunk[40 + int.from_bytes(chunk[28:32], "little") :]
    packed, size = rng.choice(((content, len(content)), (zstd.compress(bytes(200_000_000)), 200_000_000)))
    size = rng.choice((size, size, 0, size + 1, 100, 2**31, 2**40, 2**64 - 1))
    name = rng.choice((b"zstd", b"zstd", b"lz4", b"", b"\xff\xfe"))
    head = chunk[:16] + size.to_bytes(8, "little") + bytes(4) + len(name).to_bytes(4, "little") + name
    return head + len(packed).to_bytes(8, "little") + packed


SQL = (
    "UPDATE messages SET data = zeroblob(100000000) WHERE id = 1",
    *(f"UPDATE messages SET data = {value} WHERE id % 3 = 0" for value in ("NULL", "'text'", "17", "x''", "x'0001'")),
    *(f"UPDATE messages SET timestamp = {value}" for value in ("'soon'", "-9223372036854775808", "1e300")),
    *(f"UPDATE topics SET name = {value}" for value in ("NULL", "'same'", "char(27) || '[31m'", "x'ff00'")),
    *(f"UPDATE topics SET type = {value}" for value in ("'a/msg/B'", "''", "char(10) || 'x'")),
    *(f"UPDATE topics SET offered_qos_profiles = {value}" for value in ("'[[[[' || zeroblob(10)", "'a: &a [*a]'")),
    *("UPDATE messages SET topic_id = 99 WHERE id % 2 = 0", "UPDATE topics SET serialization_format = 'json'"),
    *("DELETE FROM topics WHERE id = 1", "DELETE FROM messages", "DROP TABLE messages", "DROP TABLE topics"),
    "DROP TABLE messages; CREATE VIEW messages AS WITH RECURSIVE c(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM c "
    "LIMIT 3000000) SELECT id, 1 AS topic_id, id AS timestamp, x'00' AS data FROM c",
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


def mutated(rng: Random, data: bytes, mutations: tuple[Mutation, ...]) -> bytes:
    """Return the data after one to three mutations; a structured mutation may fail after other mutations."""
    for _ in range(rng.choice((1, 1, 2, 3))):
        with suppress(Exception):  # a mutation that requires a valid file, after a mutation that broke it
            data = rng.choice(mutations)(rng, data)
    return data
