"""Records whose tuples are the columns of one table."""

from __future__ import annotations

from dataclasses import MISSING, fields
from typing import Any, cast


class Columns:
    """Base of a frozen dataclass; columns with a default may be empty."""

    __slots__ = ()

    def __post_init__(self) -> None:
        """Check that the columns are of one length.

        Raises:
            ValueError: If not.
        """
        lengths = {
            item.name: len(value)
            for item in fields(cast(Any, self))
            if isinstance(value := getattr(self, item.name), tuple) and (value or item.default is MISSING)
        }
        if len(set(lengths.values())) > 1:
            raise ValueError(f"its columns differ in length: {lengths}")
