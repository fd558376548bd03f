"""A client of the Foxglove protocol: channels as the server advertises them, the first message of each as its bytes."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Callable
from typing import Any

import aiohttp

SUBPROTOCOL = "foxglove.sdk.v1"
PATIENCE_S = 60.0


async def first_messages(
    url: str, before_leaving: Callable[[], None]
) -> tuple[dict[str, dict[str, Any]], dict[str, bytes]]:
    """Return all channels by topic, and the first message of each that gives one in time."""
    channels: dict[str, dict[str, Any]] = {}
    messages: dict[str, bytes] = {}
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
                received = await asyncio.wait_for(socket.receive(), PATIENCE_S)
            except TimeoutError:
                break
            if received.type is not aiohttp.WSMsgType.BINARY or received.data[0] != 1:
                continue
            (subscription,) = struct.unpack_from("<I", received.data, 1)
            channel = by_subscription[subscription]
            messages.setdefault(channel["topic"], received.data[13:])
        before_leaving()
    return channels, messages
