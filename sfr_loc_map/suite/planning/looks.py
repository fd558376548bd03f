"""The looks at the results of a suite that was extended or given other limits: what each look had judged.

The confidence of a tolerance bound holds for a number of drives that is fixed in advance. If drives are added because a
limit was not met, the suite is judged again until it passes, and the confidence does not hold. A plan therefore keeps
the looks of the plans before it, and the order in which drives were added.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from msgspec import Struct

from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.suite.jobs.job import GroupKey
from sfr_loc_map.suite.jobs.sources import PlannedSource


class LookVerdict(Struct, frozen=True, kw_only=True):
    """A verdict over the drives of a group, in the report of an earlier plan."""

    name: str  #: Name of the limit.
    condition: str | None
    state: VerdictState
    n: int | None  #: Number of values: drives, unless the proof is temporal.


class LookGroup(Struct, frozen=True, kw_only=True):
    """A group in the report of an earlier plan."""

    key: GroupKey  #: Group of the suite.
    measurements: tuple[str, ...]  #: `Job.measurement` of each result.
    verdicts: tuple[LookVerdict, ...]


class Look(Struct, frozen=True, kw_only=True):
    """The report of an earlier plan, which had other drives or other limits."""

    limits: str  #: Hash of the limits.
    groups: tuple[LookGroup, ...]


def extensions_of(
    own: Sequence[PlannedSource], merged: Sequence[PlannedSource], known: Mapping[str, int]
) -> tuple[dict[str, int], list[int]]:
    """Return the extension of each drive, and that of each source.

    `own` are the sources with their own drives, and `merged` those with the drives of their copies. `known` contains
    the extensions of earlier plans, by drive. A copy has the extension of the first of its copies.
    """
    new = max(known.values(), default=-1) + 1
    names = [_name(source) for source in own]
    extensions = dict(known) | {name: new for name in names if name not in known}
    first: dict[str, int] = {}
    for name, source in zip(names, merged, strict=True):
        drive = _name(source)
        first[drive] = min(first.get(drive, new), extensions[name])
    return extensions, [first[_name(source)] for source in merged]


def _name(source: PlannedSource) -> str:
    return ":".join(source.drive_identity)


def looks_of_group(looks: Iterable[Look], key: GroupKey, measurements: Iterable[str]) -> list[tuple[Look, LookGroup]]:
    """Return the looks that have judged some of the measurements of a group, with that group."""
    present = set(measurements)
    return [
        (look, group)
        for look in looks
        for group in look.groups
        if group.key == key and not present.isdisjoint(group.measurements)
    ]
