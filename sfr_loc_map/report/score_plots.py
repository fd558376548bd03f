"""The plots of a score, in the sections of a page."""

from __future__ import annotations

from sfr_loc_map.metrics.config import CallKind
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.report.call_plots import timeline
from sfr_loc_map.report.drive_plots import drive_plots
from sfr_loc_map.report.map_plots import map_plots
from sfr_loc_map.report.plots import Plot


def score_plots(score: Score) -> list[tuple[str, list[Plot]]]:
    """Return the plots by heading for which the score has data."""
    groups = (
        ("Localisation", drive_plots(score)),
        ("Time and memory", [plot for kind in CallKind for plot in timeline(score, kind)]),
        ("Map", map_plots(score)),
    )
    return [(title, plots) for title, plots in groups if plots]
