"""Values that the shell completes, beside commands and options."""

from __future__ import annotations

from collections.abc import Callable

Complete = Callable[[str], list[str]]


def words(*choices: str) -> Complete:
    """Return what completes one of some words."""

    def complete(incomplete: str) -> list[str]:
        return [word for word in choices if word.startswith(incomplete)]

    return complete


def faults(incomplete: str) -> list[str]:
    """Complete the kind of an injected fault."""
    from sfr_loc_map.simulation.faults import KINDS

    return [kind for kind in KINDS if kind.startswith(incomplete)]


def methods(incomplete: str) -> list[str]:
    """Complete the name of a method under test."""
    from sfr_loc_map.methods.registry import BUILT_IN

    names = {name for task in BUILT_IN.values() for name in task}
    return sorted(name for name in names if name.startswith(incomplete))


conditions = words("distance=", "time=", "frames=")
