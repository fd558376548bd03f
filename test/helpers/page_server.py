"""A live page that is served during a test, and an operator that records the requests."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

from sfr_loc_map.errors import InputError
from sfr_loc_map.live.commands import Action, Command
from sfr_loc_map.live.config import LiveConfig
from sfr_loc_map.live.server import LiveServer
from sfr_loc_map.live.state import LiveState
from sfr_loc_map.suite_names import SUITE_NODES


class Recorder:
    """Carries out nothing."""

    actions = frozenset(Action)
    node_actions = dict.fromkeys(SUITE_NODES, tuple(action for action in Action if action is not Action.BOOKMARK))

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
async def served(state: LiveState, title: str = "", **config: Any) -> AsyncIterator[LiveServer]:
    server, ready = LiveServer(LiveConfig(port=0, **config), state, title), asyncio.Event()
    task = asyncio.create_task(server.serve(lambda _: ready.set()))
    await asyncio.wait_for(ready.wait(), 10)
    yield server
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
