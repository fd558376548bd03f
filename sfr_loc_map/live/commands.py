"""Commands of an operator to the nodes, and the interface for executing them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from types import MappingProxyType
from typing import Protocol

import msgspec

from sfr_loc_map.errors import InputError
from sfr_loc_map.message_text import one_line

MAX_TEXT = 200  #: Maximum length of a command's texts.


class Action(StrEnum):
    """Actions that an operator can request."""

    ACTIVATE = "activate"
    DEACTIVATE = "deactivate"
    RESET = "reset"
    FINISH = "finish"
    SAVE = "save"
    BOOKMARK = "bookmark"


@dataclass(frozen=True, slots=True)
class Command:
    """A requested action, with the name of a node or the text of a bookmark if the action requires one of them."""

    action: Action
    node: str = ""
    text: str = ""

    @classmethod
    def parse(cls, text: bytes) -> Command:
        """Parse a command from untrusted JSON; raise an InputError if the command is invalid."""
        try:
            found = msgspec.json.decode(text, type=cls)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            raise InputError(f"invalid command: {error}") from error
        return replace(found, node=one_line(found.node)[:MAX_TEXT], text=one_line(found.text)[:MAX_TEXT])


class Operator(Protocol):
    """Executes commands through the nodes' services.

    `run` returns a text about the result and may take seconds; it raises an SfrError if the command fails. `close`
    cancels pending commands.
    """

    @property
    def actions(self) -> frozenset[Action]: ...  # noqa: D102

    @property
    def node_actions(self) -> Mapping[str, Sequence[Action]]: ...  # noqa: D102

    def run(self, command: Command) -> str: ...  # noqa: D102

    def close(self) -> None: ...  # noqa: D102


class NoOperator:
    """The operator before the graph is joined, when no command is possible."""

    actions: frozenset[Action] = frozenset()
    node_actions: Mapping[str, Sequence[Action]] = MappingProxyType({})

    def run(self, command: Command) -> str:
        """Raise an InputError."""
        raise InputError(f"'{command.action}' is not possible yet: this process has not joined the ROS graph yet")

    def close(self) -> None:
        """Do nothing, because no command is pending."""
