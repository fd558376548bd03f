"""What an operator may ask of the nodes from a page."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

from sfr_loc_map.errors import InputError
from sfr_loc_map.inputs import one_line

MAX_TEXT = 200


class Action(StrEnum):
    """What may be asked."""

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
    """One request.

    Attributes:
        action: What.
        node: Of which node, such as `mapping_node`; empty where it concerns none.
        text: Words of a bookmark.
        at_s: Where to seek to, seconds.
    """

    action: Action
    node: str = ""
    text: str = ""
    at_s: float = 0.0

    @classmethod
    def parse(cls, content: object) -> Command:
        """Return the command of JSON values that a stranger may have written.

        Raises:
            InputError: If it is none.
        """
        if not isinstance(content, dict):
            raise InputError("a command is an object with an action")
        try:
            action = Action(content.get("action", ""))
            at_s = float(content.get("at_s", 0.0))
        except (ValueError, TypeError, OverflowError) as error:
            known = ", ".join(Action)
            raise InputError(f"no command: an action of {known} is needed, at_s is a number") from error
        if not 0.0 <= at_s < 1e9:
            raise InputError("at_s must be seconds from 0 on")
        node, text = (one_line(str(content.get(name, "")))[:MAX_TEXT] for name in ("node", "text"))
        return cls(action, node, text, at_s)


class Operator(Protocol):
    """Carries commands out."""

    @property
    def actions(self) -> frozenset[Action]:
        """What it can do."""
        ...

    def run(self, command: Command) -> str:
        """Carry a command out; may take seconds, called in a thread of its own.

        Returns:
            What was done, in words.

        Raises:
            SfrError: If it cannot be done: why.
        """
        ...

    def close(self) -> None:
        """Give up what is under way: a program that ends waits for its threads."""
        ...


class NoOperator:
    """Can do nothing: there are no nodes."""

    actions: frozenset[Action] = frozenset()

    def run(self, command: Command) -> str:
        """Refuse.

        Raises:
            InputError: Always.
        """
        raise InputError(f"'{command.action}' is not possible here: there are no nodes")

    def close(self) -> None:
        """Do nothing."""


class LateOperator:
    """Hands commands to an operator that comes later. May be used in any thread."""

    def __init__(self) -> None:
        """Start without one."""
        self._operator: Operator | None = None

    def follow(self, operator: Operator) -> None:
        """Hand commands to this one from now on."""
        self._operator = operator

    @property
    def actions(self) -> frozenset[Action]:
        """What it can do; nothing before there is one."""
        return frozenset() if self._operator is None else self._operator.actions

    def run(self, command: Command) -> str:
        """Carry a command out.

        Raises:
            SfrError: If it cannot be done: why.
        """
        if self._operator is None:
            raise InputError(f"'{command.action}' is not possible yet: the page is still joining the nodes; try again")
        return self._operator.run(command)

    def close(self) -> None:
        """Give up what is under way."""
        if self._operator is not None:
            self._operator.close()
