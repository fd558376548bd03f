"""Where the C header of candidates is."""

from __future__ import annotations

from pathlib import Path

from sfr_loc_map.errors import MethodError

HEADER = "sfr_candidate.h"
PLACES = ("include", "share/sfr_loc_map/include")
"""Of the sources, and of what is installed."""


def header_folder() -> Path:
    """Return the folder of the header, of the sources or of the installation that this module belongs to.

    Raises:
        MethodError: If it is not there.
    """
    for parent in Path(__file__).resolve().parents[2:]:
        for place in PLACES:
            if (parent / place / HEADER).is_file():
                return parent / place
    raise MethodError(f"{HEADER} is not installed beside '{Path(__file__).parents[1]}': install the package again")
