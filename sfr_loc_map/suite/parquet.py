"""The results of a suite as a table for pandas: one row a result, one column a figure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from sfr_loc_map.io.atomic import atomic_path
from sfr_loc_map.metrics.score_json import to_plain
from sfr_loc_map.suite.groups import Drive
from sfr_loc_map.suite.summary import Summary

NAMES = ("key", "label", "task", "source", "configuration", "faults", "repeat", "seconds")
PARTS = ("trajectory", "map", "timing", "memory")
"""Parts of the score whose numbers become columns."""


def write_parquet(summary: Summary, path: Path) -> bool:
    """Write the table; return False where pyarrow is not installed (extra `[suite]`).

    Raises:
        OutputError: If it cannot be written.
    """
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        return False
    rows = [_row(drive) for drive in summary.drives]
    names = list(dict.fromkeys(name for row in rows for name in row))
    columns = {name: [row.get(name) for row in rows] for name in names}
    with atomic_path(path) as temporary:
        pyarrow.parquet.write_table(pyarrow.table(columns), temporary)
    return True


def _row(drive: Drive) -> dict[str, Any]:
    row: dict[str, Any] = {name: getattr(drive, name) for name in NAMES}
    plain = to_plain(drive.score)
    for part in PARTS:
        row |= dict(_numbers(plain.get(part) or {}, part))
    return row


def _numbers(value: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, float | int | None]]:
    """Yield the numbers of nested objects by their place; lists are of single drives and stay in their file."""
    for key, item in value.items():
        place = f"{prefix}.{key}"
        if isinstance(item, Mapping):
            yield from _numbers(item, place)
        elif item is None or (isinstance(item, (int, float)) and not isinstance(item, bool)):
            yield place, None if item is None else float(item)
