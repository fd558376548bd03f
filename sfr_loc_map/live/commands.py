"""Commands of an operator to the nodes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import msgspec

from sfr_loc_map.errors import InputError
from sfr_loc_map.message_text import one_line
from sfr_loc_map.suite_names import MONITOR_NODE, SUITE_NODES, Task

MAX_TEXT = 200  #: Maximum length of a command's texts.


class Action(StrEnum):
    """Actions that an operator can request."""

    ACTIVATE = "activate"
    DEACTIVATE = "deactivate"
    RESET = "reset"
    FINISH = "finish"
    SAVE = "save"
    BOOKMARK = "bookmark"


TRANSITIONS = (Action.ACTIVATE, Action.DEACTIVATE)  #: Actions of all nodes that change the state of their lifecycle.
SERVICES = {Action.RESET: SUITE_NODES, Action.FINISH: (Task.MAPPING.node, MONITOR_NODE), Action.SAVE: (MONITOR_NODE,)}
"""Actions that are services of the same name, each with the nodes that offer the service."""
NODE_ACTIONS = {
    node: (*TRANSITIONS, *(action for action, nodes in SERVICES.items() if node in nodes)) for node in SUITE_NODES
}
"""Actions of each node."""


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
