"""Facts that restrict the meaning of a score, one sentence each.

A score has these sentences as warnings, and the test report has the same sentences as deviations. The functions of this
module derive sentences from the records of a score. Sentences about inputs are in `Score.caveats`.
"""

from __future__ import annotations

from collections.abc import Iterator

from sfr_loc_map.metrics.completeness.shortfall_kinds import COPIES_MOST, OF_TRUTH
from sfr_loc_map.metrics.conditions import label_of
from sfr_loc_map.metrics.figures.records import TruthRecord
from sfr_loc_map.metrics.score.score import Score

MAX_PATH_EXCESS = 0.05  #: Largest fraction by which noise lengthens the true path without a warning.


def caveats_of(score: Score) -> Iterator[str]:
    """Yield the caveats of a score, in the words of its warnings."""
    if score.truth is not None:
        yield from truth_caveats(score.truth)
    yield from reading_caveats(score)
    yield from score.caveats


def truth_caveats(about: TruthRecord) -> Iterator[str]:
    """Yield how this truth restricts the score: one sentence for each missing or noisy component."""
    if not about.attitude:
        tilt = "" if about.tilt_deg is None else f", tilt {about.tilt_deg:.3g} deg"
        yield (
            "the truth has only positions: attitude and heading errors are unknown; the estimate was aligned with "
            f"the truth over the drive (yaw {about.yaw_deg or 0.0:.3g} deg{tilt}, and a translation), so attitude "
            "errors from before a sub-trajectory count in its position error (chord errors require no alignment)"
        )
    if not (about.height and about.tilt):
        names = [name for name, is_known in (("height", about.height), ("roll and pitch", about.tilt)) if not is_known]
        judged = [] if about.height else ["horizontal position errors are judged in place of position errors"]
        judged += [] if about.tilt else ["attitude errors are unknown, and roll and pitch are those of the estimate"]
        yield f"the truth has no {' and no '.join(names)}: {'; '.join(judged)}"
    if about.path_excess is not None and about.path_excess > MAX_PATH_EXCESS:
        yield (
            f"the noise of the truth ({about.sigma_m or 0.0:.3g} m) lengthens its path by about "
            f"{100.0 * about.path_excess:.3g} %: a sub-trajectory distance=METRES ends too early; give the condition "
            "displacement=METRES, or a smoothed truth"
        )


def copies_caveat(score: Score) -> str:
    """Return a warning if the estimate is a copy of the truth and no limits judge this; empty otherwise."""
    share = score.number("poses_of_truth")
    if score.verdicts or share is None or share <= COPIES_MOST:
        return ""
    return f"{100.0 * share:.3g} % of the steps {OF_TRUTH}"


def reading_caveats(score: Score) -> Iterator[str]:
    """Yield a sentence if verdicts depend on the reading of the specification."""
    differ = [item for item in score.verdicts if len(set(item.by_reading.values())) > 1]
    if not differ or score.contradiction is not None:
        return
    first = differ[0]
    each = ", ".join(f"{reading} {state}" for reading, state in first.by_reading.items())
    over = f" over {label_of(first.condition)}" if first.condition else ""
    text = f"{len(differ)} of {len(score.verdicts)} verdicts depend on the reading of the specification (option rebase)"
    starts = "displacement and position require an estimate that starts at a true pose"
    yield f"{text}, the first {first.name}{over}: {each} ({starts})"
