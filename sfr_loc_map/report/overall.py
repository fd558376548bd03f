"""The verdict over all limits of a score, as the banner of a page shows it."""

from __future__ import annotations

from dataclasses import dataclass

from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.score import Score
from sfr_loc_map.tables.html import OPEN_CLASS, VERDICT_CLASSES
from sfr_loc_map.tables.table import OPEN_ICON, VERDICT_ICONS

NO_VERDICT, NO_VERDICT_ICON = "no verdict", "\u2013"


@dataclass(frozen=True, slots=True)
class Overall:
    """The banner of the page.

    Attributes:
        state: Verdict over all limits.
        text: The same in a sentence.
        style: Its class of the style sheet.
        icon: Its sign.
    """

    state: str
    text: str
    style: str
    icon: str


def overall_of(score: Score) -> Overall:
    """Return the verdict over all limits; no figure judges where estimate and truth contradict each other."""
    if score.contradiction is not None:
        return Overall(NO_VERDICT, f"Not judged: {score.contradiction}", OPEN_CLASS, NO_VERDICT_ICON)
    states = [item.state for item in score.verdicts]
    if not states:
        return Overall(NO_VERDICT, "No limits were given: there is no verdict.", OPEN_CLASS, NO_VERDICT_ICON)
    passed, failed = states.count(VerdictState.PASS), states.count(VerdictState.FAIL)
    rest = len(states) - passed - failed
    text = f"{passed} of {len(states)} limits met, {failed} missed, {rest} without enough data."
    state = VerdictState.FAIL if failed else VerdictState.NOT_ENOUGH_DATA if rest else VerdictState.PASS
    return Overall(state.value, text, VERDICT_CLASSES.get(state, OPEN_CLASS), VERDICT_ICONS.get(state, OPEN_ICON))
