"""A client of the Foxglove protocol: reads the channels by the schemas that the server advertises, and nothing else.

Protobuf is decoded by the advertised descriptor (https://protobuf.dev/programming-guides/encoding), so that the test
does not read with the library that wrote.
"""

from __future__ import annotations

import asyncio
import base64
import json
import struct
from collections.abc import Callable, Iterator
from typing import Any

import aiohttp

SUBPROTOCOL = "foxglove.sdk.v1"
PATIENCE_S = 8.0
REPEATED, STRING, MESSAGE = 3, 9, 11
FIXED = {1: "<d", 2: "<f", 6: "<Q", 7: "<I", 15: "<i", 16: "<q"}
DEFAULTS: dict[int, Any] = {1: 0.0, 2: 0.0, STRING: "", MESSAGE: None, 12: b""}


def fields(data: bytes) -> Iterator[tuple[int, Any]]:
    """Yield number and raw value of each field of a message."""
    at = 0

    def varint() -> int:
        nonlocal at
        value = shift = 0
        while True:
            byte = data[at]
            at += 1
            value |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                return value

    while at < len(data):
        tag = varint()
        number, kind = tag >> 3, tag & 7
        if kind == 0:
            yield number, varint()
        else:
            size = {1: 8, 5: 4}[kind] if kind != 2 else varint()
            yield number, data[at : at + size]
            at += size


def descriptors(schema: bytes) -> dict[str, list[tuple[str, int, bool, int, str]]]:
    """Return the fields of each message of a FileDescriptorSet: name, number, repeated, type, name of its message."""
    found: dict[str, list[tuple[str, int, bool, int, str]]] = {}

    def add(message: bytes, space: str) -> None:
        parts = list(fields(message))
        name = f"{space}.{next(value for number, value in parts if number == 1).decode()}"
        found[name] = []
        for number, value in parts:
            if number == 2:
                field = dict(fields(value))
                other = field.get(6, b"").decode()
                found[name].append((field[1].decode(), field[3], field[4] == REPEATED, field[5], other))
            elif number == 3:
                add(value, name)

    for _, file in fields(schema):
        parts = list(fields(file))
        package = next(value for number, value in parts if number == 2).decode()
        for number, value in parts:
            if number == 4:
                add(value, f".{package}")
    return found


def decoded(data: bytes, name: str, known: dict[str, Any]) -> dict[str, Any]:
    by_number = {number: (key, many, kind, other) for key, number, many, kind, other in known[name]}
    message: dict[str, Any] = {key: [] if many else DEFAULTS.get(kind, 0) for key, many, kind, _ in by_number.values()}
    for number, raw in fields(data):
        key, many, kind, other = by_number[number]
        value = raw
        if kind in FIXED:
            (value,) = struct.unpack(FIXED[kind], raw)
        elif kind == STRING:
            value = raw.decode()
        elif kind == MESSAGE:
            value = decoded(raw, other, known)
        if many:
            message[key].append(value)
        else:
            message[key] = value
    return message


def read(channel: dict[str, Any], data: bytes) -> Any:
    if channel["encoding"] == "json":
        return json.loads(data)
    known = descriptors(base64.b64decode(channel["schema"]))
    return decoded(data, f".{channel['schemaName']}", known)


async def first_messages(
    url: str, before_leaving: Callable[[], None]
) -> tuple[dict[str, dict[str, Any]], dict[str, Any]]:
    """Return all channels by topic, and the first message of each that gives one within a few seconds."""
    channels: dict[str, dict[str, Any]] = {}
    messages: dict[str, Any] = {}
    async with aiohttp.ClientSession() as session, session.ws_connect(url, protocols=[SUBPROTOCOL]) as socket:
        assert socket.protocol == SUBPROTOCOL
        assert (await socket.receive_json())["op"] == "serverInfo"
        advertised = await socket.receive_json()
        assert advertised["op"] == "advertise"
        for channel in advertised["channels"]:
            channels[channel["topic"]] = channel
        wanted = [{"id": 100 + channel["id"], "channelId": channel["id"]} for channel in channels.values()]
        await socket.send_json({"op": "subscribe", "subscriptions": wanted})
        by_subscription = {100 + channel["id"]: channel for channel in channels.values()}
        end = asyncio.get_running_loop().time() + PATIENCE_S
        while len(messages) < len(channels) and asyncio.get_running_loop().time() < end:
            try:
                received = await asyncio.wait_for(socket.receive(), 3.0)
            except TimeoutError:
                break
            if received.type is not aiohttp.WSMsgType.BINARY or received.data[0] != 1:
                continue
            (subscription,) = struct.unpack_from("<I", received.data, 1)
            channel = by_subscription[subscription]
            if channel["topic"] not in messages:
                messages[channel["topic"]] = read(channel, received.data[13:])
        before_leaving()
    return channels, messages
