"""Where the thread that receives a run and those that show it meet: records one way, requests the other.

The receiving thread never waits: of images and clouds the newest replaces what nobody has taken yet, all other records
queue up to a bound, beyond which the oldest is dropped and counted.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from enum import StrEnum
from threading import Lock
from typing import Annotated, Protocol

import msgspec
from msgspec import Meta

from sfr_loc_map.errors import InputError
from sfr_loc_map.inputs import one_line
from sfr_loc_map.live.updates import Media, Update, View

MAX_WAITING = 20_000  #: Records that wait: at 100 a second more than three minutes.
MAX_TEXT = 200


class Action(StrEnum):
    """What may be asked of the nodes or of a player."""

    ACTIVATE = "activate"
    DEACTIVATE = "deactivate"
    RESET = "reset"
    FINISH = "finish"
    SAVE = "save"
    BOOKMARK = "bookmark"
    PLAY = "play"
    PAUSE = "pause"
    SEEK = "seek"


@dataclass(frozen=True, slots=True)
class Command:
    """One request: of which node, the words of a bookmark, seconds to seek to, as far as it needs them."""

    action: Action
    node: str = ""
    text: str = ""
    at_s: Annotated[float, Meta(ge=0.0, lt=1e9)] = 0.0

    @classmethod
    def parse(cls, text: bytes) -> Command:
        """Return the command of JSON that a stranger may have written; InputError if it is none."""
        try:
            found = msgspec.json.decode(text, type=cls)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            raise InputError(f"no command: {error}") from error
        return replace(found, node=one_line(found.node)[:MAX_TEXT], text=one_line(found.text)[:MAX_TEXT])


class Operator(Protocol):
    """Carries commands out: the nodes' services, or a player. `run` says what was done, and may take seconds."""

    @property
    def actions(self) -> frozenset[Action]: ...  # noqa: D102

    def run(self, command: Command) -> str: ...  # noqa: D102

    def close(self) -> None: ...  # noqa: D102


class Hub:
    """Takes records of a feed in one thread and gives them out in another. All methods may be called in any thread."""

    def __init__(self, also: Hub | None = None) -> None:
        """Start empty, with nobody who looks on; `also` is given the same records, for a second view."""
        self.operator: Operator | None = None  # set by the feed once it can carry out what is asked
        self.dropped = self.replaced = 0  # records without room; images and clouds that a newer one replaced
        self._also = also
        self._lock = Lock()
        self._waiting: deque[Update] = deque()
        self._newest: dict[tuple[type[Media], str], Media] = {}
        self._wanted: frozenset[View] = frozenset()

    def put(self, update: Update) -> None:
        """Give a record; returns at once."""
        with self._lock:
            if isinstance(update, Media):
                key = (type(update), update.topic)
                self.replaced += key in self._newest
                self._newest[key] = update
            else:
                if len(self._waiting) >= MAX_WAITING:
                    self._waiting.popleft()
                    self.dropped += 1
                self._waiting.append(update)
        if self._also is not None:
            self._also.put(update)

    def take(self) -> list[Update]:
        """Return all records that wait, in their order, images and clouds last."""
        with self._lock:
            updates: list[Update] = [*self._waiting, *self._newest.values()]
            self._waiting.clear()
            self._newest.clear()
        return updates

    @property
    def waiting(self) -> int:
        """How many records wait where most do, but for images and clouds."""
        return max(len(self._waiting), 0 if self._also is None else self._also.waiting)

    @property
    def wanted(self) -> frozenset[View]:
        """What somebody looks at; a feed makes nothing else of it."""
        return self._wanted if self._also is None else self._wanted | self._also.wanted

    def want(self, views: frozenset[View]) -> None:
        """Say what somebody looks at."""
        self._wanted = views

    @property
    def actions(self) -> list[Action]:
        """What can be asked now."""
        return [] if self.operator is None else sorted(self.operator.actions)

    def run(self, command: Command) -> str:
        """Carry a command out and say what was done; an SfrError says why it cannot be done."""
        if self.operator is None:
            raise InputError(f"'{command.action}' is not possible (yet): no nodes have been joined")
        return self.operator.run(command)
