"""A live page that is served during a test, and an operator that records the requests."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

from sfr_loc_map.errors import InputError
from sfr_loc_map.live.commands import Command
from sfr_loc_map.live.config import LiveConfig
from sfr_loc_map.live.server import LiveServer
from sfr_loc_map.live.state import LiveState


class Recorder:
    """Carries out nothing."""

    def __init__(self) -> None:
        self.commands: list[Command] = []

    def close(self) -> None:
        pass

    def run(self, command: Command) -> str:
        if command.node == "nowhere":
            raise InputError("there is no such node")
        self.commands.append(command)
        return f"{command.action} done"


@asynccontextmanager
async def served(
    state: LiveState, title: str = "", operator: Recorder | None = None, **config: Any
) -> AsyncIterator[LiveServer]:
    server = LiveServer(LiveConfig(port=0, **config), state, operator or Recorder(), title)
    ready = asyncio.Event()
    task = asyncio.create_task(server.serve(lambda _: ready.set()))
    await asyncio.wait_for(ready.wait(), 10)
    yield server
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
