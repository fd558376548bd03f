"""The headline of a run for page and terminal: its verdict with age, stale data, and the end of the run."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

from sfr_loc_map.live.limit_bars import LimitBar
from sfr_loc_map.live.run_end import ShownEnd
from sfr_loc_map.report.summary import Banner

NO_FIGURES_YET = Banner.without_verdict("waiting", "No figures yet: waiting for metrics/report of the monitor.")
NO_FIGURES = Banner.without_verdict("no figures", "The monitor reported no figures.")  # after the end


@dataclass(frozen=True, slots=True)
class Headline:
    """Headline of page and terminal."""

    icon: str
    style: str  #: Class of the style sheet: pass, fail, open or stale.
    word: str  #: Verdict.
    age: str  #: Age of the verdict; empty after the end of the run.
    text: str  #: Sentences about the end or the staleness, the verdict over all limits, and the worst limit.


def headline(
    overall: Banner | None,
    bars: Sequence[LimitBar],
    *,
    age_s: float | None,
    stale_reasons: Sequence[str],
    end: ShownEnd,
) -> Headline:
    """Return the headline of a run. The states take precedence in the order aborted, ended, stale, up to date."""
    shown = overall or (NO_FIGURES if end.is_over else NO_FIGURES_YET)
    judged = [shown.text]
    if bars and bars[0].margin:
        judged.append(f"{'Worst' if bars[0].state == 'fail' else 'Least margin'}: {bars[0].text}.")
    age = "" if overall is None or age_s is None else f"{age_s:.0f} s old"
    if end.aborted_by:
        how = [f"{end.aborted_by} at {clock_time(end.aborted_s)}."]
        if overall is not None:
            how.append(f"Verdict until then: {overall.state}.")
        return Headline("■", "fail", "aborted", "", " ".join([*how, *judged]))
    if end.at_s is not None:
        return Headline(
            shown.icon, shown.style, f"{shown.state}, ended at {clock_time(end.at_s)}", "", " ".join(judged)
        )
    if stale_reasons:
        return Headline("○", "stale", shown.state, age, " ".join([f"{', '.join(stale_reasons)}.", *judged]))
    return Headline(shown.icon, shown.style, shown.state, age, " ".join(judged))


def clock_time(at_s: float) -> str:
    """Return the local time of day, such as `20:41:03`."""
    return time.strftime("%H:%M:%S", time.localtime(at_s))
