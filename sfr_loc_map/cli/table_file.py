"""Writes tables to Parquet or CSV files."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from sfr_loc_map.atomic import atomic_path
from sfr_loc_map.errors import MissingExtraError
from sfr_loc_map.suffixes import suffix_of


def save_table(path: Path, columns: Mapping[str, NDArray[Any]]) -> None:
    """Write columns of equal length as a table, Parquet or CSV; numbers in a CSV are exact when read back."""
    with atomic_path(path) as temporary:
        if suffix_of(path) == ".csv":
            with temporary.open("w", encoding="utf-8", newline="") as stream:
                writer = csv.writer(stream, lineterminator="\n")
                writer.writerow(columns)
                writer.writerows(zip(*(values.tolist() for values in columns.values()), strict=True))
            return
        try:
            import pyarrow
            import pyarrow.parquet
        except ImportError as error:
            raise MissingExtraError(
                f"'{path}' requires pyarrow: pip install 'sfr_loc_map[suite]', or choose a name ending in .csv"
            ) from error
        pyarrow.parquet.write_table(pyarrow.table(dict(columns)), temporary)
