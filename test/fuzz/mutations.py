"""Mutations: what makes a hostile file of a valid one. All chance comes from the generator that is given."""

from __future__ import annotations

import io
import json
import re
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from random import Random
from typing import Any

import yaml

from sfr_loc_map.inputs import parse_yaml

Mutation = Callable[[Random, bytes], bytes]

_NUMBERS = """nan inf -inf -1 0 -0.0 1e308 -1e308 1e300 1e-320 1e9 1e5 1e400 0.5 2147483648 4294967295 65536 70000
9223372036854775807 9223372036854775808 18446744073709551616 -9223372036854775809 1000000000000
1_000 0x10 1,5 \u0663 \u00bd 1e + --1 00012 True 1:30:00 1e+ 0o17 1j"""
_STRINGS = "../../../../etc/passwd /dev/zero /dev/null . .. / %s%n {} ${HOME} ' , ; \\ null ~ \U0001f600 [red] [/]"
NUMBERS = (*_NUMBERS.split(), "", "9" * 400, "-" + "9" * 400, "9" * 5000, "0." + "0" * 400 + "1")
STRINGS = (
    *("", "\0", "a\0b", "\x1b[31mred\x1b[0m", "\x1b]0;title\x07", "\x9b31m", "\udc80", "\ud800", "\u202e", "\ufeff"),
    *("\r", "\n", "a\r\nb", "\x7f", '"', "\u2028", "a" * 300, "x" * 100_000, *_STRINGS.split()),
)
HUGE_INTS = (0, 1, 2, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 0x10000, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 2**62, 2**63, 2**64 - 1)
NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")
DEEP = "@@deep@@"
"""Stands for brackets within brackets until the tree is text."""
DEPTHS = (50, 900, 3000, 100_000)


def encoded(text: str) -> bytes:
    return text.encode("utf-8", "surrogatepass")


# ---- bytes


def flip_bytes(rng: Random, data: bytes) -> bytes:
    """Half of the time in the header only: it is short, and all sizes are in it."""
    altered, end = bytearray(data), min(len(data), rng.choice((128, len(data))))
    for _ in range(rng.choice((1, 1, 4, 32)) if altered else 0):
        altered[rng.randrange(end)] ^= 1 << rng.randrange(8)
    return bytes(altered)


def truncate(rng: Random, data: bytes) -> bytes:
    return data[: rng.choice((0, 1, rng.randrange(len(data) + 1), max(len(data) - 1, 0), rng.randrange(64)))]


def drop_or_repeat(rng: Random, data: bytes) -> bytes:
    start, length = rng.randrange(len(data) + 1), rng.choice((1, 4, 64, 4096))
    return data[:start] + data[start : start + length] * rng.choice((0, 0, 2, 50)) + data[start + length :]


def append(rng: Random, data: bytes) -> bytes:
    return data + rng.choice((b"\0" * 100, rng.randbytes(1000), b"\n", data[:5000]))


def huge_int(rng: Random, data: bytes) -> bytes:
    """Overwrite a number of 2, 4 or 8 bytes; most often in the first bytes, where headers are."""
    size = rng.choice((2, 4, 4, 8))
    last = len(data) - size
    offset = rng.randrange(min(last, 200) + 1) if rng.random() < 0.7 else rng.randrange(last + 1)
    number = (rng.choice(HUGE_INTS) % 256**size).to_bytes(size, rng.choice(("little", "big")))
    return data[:offset] + number + data[offset + size :]


BYTES: tuple[Mutation, ...] = (flip_bytes, flip_bytes, truncate, drop_or_repeat, drop_or_repeat, append, huge_int)


def any_bytes(rng: Random, data: bytes) -> bytes:
    return rng.choice((*BYTES, huge_int))(rng, data)


# ---- text


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
    new = rng.choice(([], [line] * 2, [line] * 4, [encoded(rng.choice(STRINGS))], [b"".join(words)], None))
    if new is None:
        rng.shuffle(lines)
    else:
        lines[chosen : chosen + 1] = new
    return b"\n".join(lines)


def another_encoding(rng: Random, data: bytes) -> bytes:
    return data.decode("utf-8", "replace").encode(rng.choice(("utf-16", "utf-32", "utf-8-sig", "utf-7")), "replace")


TEXT: tuple[Mutation, ...] = (replace_number, replace_number, insert_text, edit_lines, edit_lines, another_encoding)


# ---- nested values (JSON, YAML)

VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 2**31, 2**63, -(2**63) - 1, 10**399, -(10**399), float("nan"), float("inf")),
    *(1e308, -1e308, 1e-320, 1e9, [], {}, [[]], {"a": 1}, [None], DEEP, DEEP, "1", "0"),
    *([1] * 20_000, {str(i): i for i in range(2000)}, [float("nan")] * 9, [1e308] * 9, [0] * 9, [-1] * 4),
)


def _slots(tree: Any) -> Iterator[tuple[Any, Any]]:
    """Yield container and key of all values within."""
    for key in tree if isinstance(tree, dict) else range(len(tree) if isinstance(tree, list) else 0):
        yield tree, key
        yield from _slots(tree[key])


def mutate_tree(rng: Random, tree: Any) -> Any:
    value = json.loads(json.dumps(rng.choice((*VALUES, *rng.sample(STRINGS, 8)))))
    slots = list(_slots(tree))
    if not slots or rng.random() < 0.03:
        return value
    container, key = rng.choice(slots)
    edit = rng.randrange(8)
    if edit == 0:
        del container[key]
    elif edit == 1 and isinstance(container, list):
        container.extend([container[key]] * rng.choice((1, 10, 1000)))
    elif edit == 1:
        container[rng.choice(STRINGS)] = container[key]
    elif edit == 2:
        other, there = rng.choice(slots)
        container[key] = json.loads(json.dumps(other[there]))
    elif edit == 3:
        container[key] = {"a": container[key]} if rng.random() < 0.5 else [container[key]]
    else:
        container[key] = value
    return tree


def _deepened(rng: Random, text: str) -> bytes:
    depth = rng.choice(DEPTHS)
    nested = rng.choice(("[" * depth + "]" * depth, '{"a":' * depth + "1" + "}" * depth))
    return encoded(text.replace(f'"{DEEP}"', nested))


def json_tree(rng: Random, data: bytes) -> bytes:
    return _deepened(rng, json.dumps(mutate_tree(rng, json.loads(data)), ensure_ascii=rng.random() < 0.7))


def yaml_tree(rng: Random, data: bytes) -> bytes:
    text = json.dumps(mutate_tree(rng, parse_yaml(data.decode())))  # bounded: the data may hold a bomb already
    if rng.random() < 0.5 and DEEP not in text and "\\ud" not in text:
        return encoded(yaml.safe_dump(json.loads(text), sort_keys=False))
    return _deepened(rng, text)


def _bomb(name: str, first: str, level: str, count: int = 12) -> str:
    """Return anchors each of which holds the one before nine times; `@` stands for the alias."""
    levels = (f"{name}{i}: &{name}{i} {level.replace('@', f'*{name}{i - 1}')}" for i in range(1, count))
    return "\n".join([f"{name}0: &{name}0 {first}", *levels])


YAML_TRICKS = (
    _bomb("a", "[x]", f"[{', '.join('@' * 9)}]"),
    _bomb("b", "{x: 1}", f"{{{', '.join(f'k{j}: @' for j in range(9))}}}"),
    _bomb("c", "{x: 1}", f"{{<<: [{', '.join('@' * 9)}]}}", 9),
    *("a: &a [*a]", "m: &m {<<: *m}", "<<: [1]", "{[]: 1}", "---\na: 1\n---\nb: 2", "%YAML 9.9\n---\na: 1"),
    *("x: !!python/object/apply:os.system ['true']", "x: !!binary aaaa\ny: !!set {a, b}", "x: 2001-99-99"),
    *("x: !!int '" + "9" * 5000 + "'", "x: !!float abc\ny: !!timestamp 9999-99-99"),
    *("x: 190:20:30:59:59:59:59:59:59:59:59:59\n? [a, b]\n: c", "x: 0b11\ny: 0o17\nz: 0x" + "f" * 400),
    *("? " * 3000, "- " * 3000, "x: " + "[" * 20_000, "x: '" + "y" * 200_000),
)


def yaml_trick(rng: Random, data: bytes) -> bytes:
    """Put in what only YAML has: aliases of aliases, tags, other types, more documents."""
    parts = [encoded(rng.choice(YAML_TRICKS)), rng.choice((b"", data))]
    rng.shuffle(parts)
    return b"\n".join(parts)


def json_trick(rng: Random, data: bytes) -> bytes:
    depth = rng.choice(DEPTHS)
    deep = (b"[" * depth, b'{"a":' * depth, b"[" * depth + b"]" * depth, b"[1" + b",1" * 100_000 + b"]")
    twice = data[:-2] + b',"width":1' + data[-2:]
    return rng.choice((*deep, b"9" * 5000, b"-", b'"\\ud800"', b"NaN", twice, data.replace(b"1", b"1" * 400, 1)))


JSON: tuple[Mutation, ...] = (json_tree, json_tree, json_tree, json_trick, *TEXT, *BYTES)
YAML: tuple[Mutation, ...] = (yaml_tree, yaml_tree, yaml_tree, yaml_trick, yaml_trick, *TEXT, *BYTES)


# ---- images, arrays, clouds


def png_chunk(rng: Random, data: bytes) -> bytes:
    """Change one chunk of a PNG and give it its checksum again."""
    chunks, offset = [], 8
    while offset + 8 <= len(data):
        (length,), kind = struct.unpack(">I", data[offset : offset + 4]), data[offset + 4 : offset + 8]
        chunks.append((kind, data[offset + 8 : offset + 8 + length]))
        offset += 12 + length
    chosen = rng.randrange(len(chunks)) if rng.random() < 0.6 else 0
    kind, body = chunks[chosen]
    if kind == b"IHDR" and rng.random() < 0.7:
        width, height, *rest = struct.unpack(">IIBBBBB", body)
        size = rng.choice(((20_000, 20_000), (2**31 - 1, 1), (1, 2**31 - 1), (0, 0), (65_535, 65_535), (width, 2**20)))
        if rng.random() < 0.4:
            size, rest = (width, height), [rng.choice((1, 2, 4, 8, 16, 7)), rng.randrange(8), 0, 0, rng.randrange(3)]
        chunks[chosen] = (kind, struct.pack(">IIBBBBB", *size, *rest))
    elif rng.random() < 0.4:
        extra = rng.choice((b"zTXt", b"iCCP", b"PLTE", b"tRNS", b"eXIf", b"acTL"))
        chunks.insert(1, (extra, b"name\0\0" + zlib.compress(b"\0" * rng.choice((10, 30_000_000)))))
    else:
        chunks[chosen : chosen + 1] = rng.choice(([chunks[chosen]] * 2, [(kind, any_bytes(rng, body))]))
    return data[:8] + b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body)) for kind, body in chunks
    )


def jpeg_size(rng: Random, data: bytes) -> bytes:
    """Change the size in the frame header of a JPEG."""
    frame = re.search(rb"\xff[\xc0-\xc2]", data)
    size = struct.pack(">HH", *rng.choice(((65_535, 65_535), (0, 0), (1, 65_535), (65_535, 1), (120, 161))))
    return data[: frame.start() + 5] + size + data[frame.start() + 9 :]


def npy_header(rng: Random, data: bytes) -> bytes:
    """Write an NPY header with another shape or type."""
    shape = rng.choice(("(120,160,3)", "(10000000000,3)", "()", "(-1,3)", "(120,160,3.0)", "(2**40,)", "(1,)*1000"))
    kind = rng.choice(("<f4", "<f8", "|O", "<c16", "<U4", "<M8[ns]", "<f4,<f4", "|V1000000000", "|b1", "<U99999999"))
    head = f"{{'descr': '{kind}', 'fortran_order': {rng.choice(('False', 'True', '7'))}, 'shape': {shape}, }}"
    if rng.random() < 0.15:
        head = rng.choice(("(" * 3000, "[" * 100_000, "{'a': " * 200, "1" * 9000, "\0"))
    return b"\x93NUMPY\x02\x00" + struct.pack("<I", len(head)) + encoded(head) + data[128:]


def zip_member(rng: Random, data: bytes) -> bytes:
    """Change, drop, add or rename a member of an NPZ."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = [(name, archive.read(name)) for name in archive.namelist()]
    chosen = rng.randrange(len(members))
    name, body = members[chosen]
    members[chosen : chosen + 1] = rng.choice(
        (
            [],
            [(name, npy_header(rng, body))],
            [(rng.choice(("x", "\x1b[31m.npy", "../x.npy", "a" * 1000, "u.npy")), body)],
            [members[chosen], (rng.choice(("unused.npy", "x.npy")), b"\0" * 40_000_000)],
            [(name, any_bytes(rng, body))],
        )
    )
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as archive:
        for name, body in members:
            archive.writestr(name, body)
    return stream.getvalue()


def head_text(rng: Random, data: bytes) -> bytes:
    """Mutate the text header of a binary file (PLY, PCD, PGM)."""
    end = max(20, *(data.find(mark) + len(mark) for mark in (b"end_header", b"DATA binary", b"DATA ascii", b"255")))
    return rng.choice((replace_number, replace_number, edit_lines, insert_text))(rng, data[:end]) + data[end:]


IMAGE: tuple[Mutation, ...] = (*BYTES, huge_int, head_text)
PNG: tuple[Mutation, ...] = (png_chunk, png_chunk, png_chunk, *BYTES)
JPEG: tuple[Mutation, ...] = (jpeg_size, huge_int, *BYTES)
NPY: tuple[Mutation, ...] = (npy_header, npy_header, *BYTES)
NPZ: tuple[Mutation, ...] = (zip_member, zip_member, zip_member, *BYTES)
CLOUD: tuple[Mutation, ...] = (head_text, head_text, head_text, *BYTES)


def mutated(rng: Random, data: bytes, mutations: tuple[Mutation, ...]) -> bytes:
    """Return the data after one to three mutations; structured ones come first and may be impossible after others."""
    for _ in range(rng.choice((1, 1, 2, 3))):
        with suppress(Exception):  # a mutation that needs a whole file, after one that broke it
            data = rng.choice(mutations)(rng, data)
    return data
