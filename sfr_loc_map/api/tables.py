"""Tables for pandas, which is not needed otherwise."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from sfr_loc_map.errors import MissingExtraError

if TYPE_CHECKING:
    import numpy as np
    import pandas
    from numpy.typing import NDArray


def data_frame(columns: Mapping[str, NDArray[np.generic]]) -> pandas.DataFrame:
    """Return columns as a pandas table.

    Raises:
        MissingExtraError: If pandas is not installed.
    """
    try:
        import pandas
    except ImportError as error:
        raise MissingExtraError("to_pandas() needs pandas: pip install pandas") from error
    return pandas.DataFrame(dict(columns))
