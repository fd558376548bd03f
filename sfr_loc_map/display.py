"""Display of values of the Python interface: a line in a console, a table in a notebook or in pandas."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import TYPE_CHECKING, Any

from sfr_loc_map.errors import MissingExtraError
from sfr_loc_map.inputs import printable

if TYPE_CHECKING:
    import pandas


class Shown:
    """Base class that displays its facts in one line and as an HTML table with escaped texts."""

    __slots__ = ()

    def _facts(self) -> dict[str, str]:
        """Return the displayed facts by name."""
        raise NotImplementedError

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(self._facts().values())})"

    def _repr_html_(self) -> str:
        left = "style='text-align:left'"
        rows = "".join(
            f"<tr><th {left}>{escape(printable(name))}</th><td {left}>{escape(printable(value))}</td></tr>"
            for name, value in self._facts().items()
        )
        return f"<b>{type(self).__name__}</b><table>{rows}</table>"


def data_frame(columns: Mapping[str, Any]) -> pandas.DataFrame:
    """Return a pandas table of columns; raise MissingExtraError if pandas is not installed."""
    try:
        import pandas
    except ImportError as error:
        raise MissingExtraError("to_pandas() needs pandas: pip install 'sfr_loc_map[notebook]'") from error
    return pandas.DataFrame(dict(columns))
