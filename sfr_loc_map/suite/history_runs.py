"""A suite's folder as one run of a history."""

from __future__ import annotations

from sfr_loc_map.suite.figure_table import figures_of
from sfr_loc_map.suite.history import HistoryRun
from sfr_loc_map.suite.store import Store
from sfr_loc_map.suite.summary import summarise


def history_run(store: Store, name: str) -> HistoryRun:
    """Return the figures of a suite's drives.

    Raises:
        InputError: If a result cannot be read.
    """
    drives = summarise(store).drives
    one = len({drive.configuration for drive in drives}) == 1
    keys = {drive.key: drive.pairing + ("" if one else f" {drive.configuration}") for drive in drives}
    return HistoryRun(name=name, figures={keys[drive.key]: figures_of(drive.score) for drive in drives})
