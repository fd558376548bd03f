"""The reasons why figures or limits of a score could not be judged, as text."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.metrics.config import Condition, ConditionKind, VerdictState, label_of
from sfr_loc_map.metrics.judging.incomplete import incompleteness
from sfr_loc_map.metrics.judging.proof import words_of
from sfr_loc_map.metrics.score.limits import Rules
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.score.verdict import Verdict
from sfr_loc_map.metrics.table.row_part import Scope


def reasons_not_judged(score: Score, asked: Collection[Condition] = ()) -> tuple[str, ...]:
    """Return why figures and limits are not judged, one phrase each; `asked` restricts the reported conditions."""
    if score.contradiction is not None:
        return (score.contradiction,)
    incomplete = () if score.incomplete is None else (f"incomplete: {names_of_incomplete_parts(score)}",)
    unmet: dict[str | None, str] = {}
    if (drive := score.association) is not None:
        extent = drive.matched, drive.path_length_m, drive.duration_s or 0.0
        for row in score.rows("position", part=str(drive.rebase)):
            if row.condition is not None and not row.n and not row.unknown:
                condition = Condition.parse(row.condition)
                if not asked or condition in asked:
                    unmet[row.condition] = _reason(condition, *extent)
    reasons = [*incomplete, *unmet.values()]
    points = score.figure("point_error")
    if points is not None and not points.n:
        reasons.append("map: no point of the cloud has a true point")
    for item in score.verdicts:
        if item.state is VerdictState.NOT_ENOUGH_DATA and item.condition not in unmet:
            over = "" if item.condition is None else f" over {label_of(item.condition)}"
            reasons.append(f"limit {item.name}{over}: {why_open(item, score)}")
    return tuple(reasons)


def names_of_incomplete_parts(score: Score) -> str:
    """Return the names of the incomplete parts of a score; `score.incomplete` states the missing data."""
    parts = {str(item.part.text) for item in incompleteness(score)}
    return ", ".join(sorted(parts)) or Scope.DRIVE


def why_open(item: Verdict, score: Score) -> str:
    """Return why there is not enough data for the verdict on a limit."""
    if item.is_within_truth_error:
        return f"its margin of {item.margin:.3g} is within the error of the truth, {item.truth_error:.3g}"
    if item.proof is not None:
        return words_of(item.proof, item.state)
    rules = score.rules or Rules()
    row = score.row_of(item)
    if item.n and item.n < rules.minimum_count:
        return f"only {item.n} values"
    if item.value is None:
        if not item.n and (unknown := unknown_of_truth(item.figure or "", score)) is not None:
            return unknown
        if row is None or not row.unknown:
            return "no data"
        if not item.n:
            return f"all {row.unknown} values are unknown"
        return f"{row.unknown} of {item.n + row.unknown} values are unknown"
    independent = item.independent
    if independent is not None and independent < rules.minimum_independent:
        return (
            f"{item.n} values, of which {independent:.3g} are independent ({rules.minimum_independent:g} are required)"
        )
    within = ", which it does not have" if item.interval is None else " within the limit"
    return f"'certain' requires its 95 % interval{within}"


def unknown_of_truth(figure: str, score: Score) -> str | None:
    """Return why a figure cannot be judged by the truth of a score; None if it can."""
    truth = score.truth
    if truth is None:
        return None
    if figure in ("position", "chord") and not truth.height:
        return "the truth has no heights: limit the figure horizontal instead"
    if figure == "attitude" and truth.attitude and not truth.tilt:
        return "the truth has no roll and pitch: limit the figure heading instead"
    return None


def conditions_beyond(truth: Trajectory, conditions: Collection[Condition]) -> tuple[str, ...]:
    """Return why a drive with this truth never meets some conditions, for a warning before the drive is processed."""
    length_m = float(np.linalg.norm(np.diff(truth.positions, axis=0), axis=1).sum())
    duration_s = float(truth.stamps_ns[-1] - truth.stamps_ns[0]) / NS_PER_S if len(truth) else 0.0
    longest = {ConditionKind.TIME: duration_s, ConditionKind.FRAMES: len(truth) - 1.0}
    # the straight-line distance cannot exceed the path length
    longest |= dict.fromkeys((ConditionKind.DISTANCE, ConditionKind.DISPLACEMENT), length_m)
    beyond = (
        item for item in conditions if any(part.value > longest.get(part.kind, part.value) for part in item.parts)
    )
    return tuple(_reason(item, len(truth), length_m, duration_s) for item in beyond)


def _reason(condition: Condition, frames: int, length_m: float, duration_s: float) -> str:
    path = f"is {length_m:.1f} m long"
    texts = {ConditionKind.TIME: f"lasts {duration_s:.1f} s", ConditionKind.FRAMES: f"has {frames} frames"}
    texts[ConditionKind.TURN] = "never turns by this angle"
    texts[ConditionKind.DISPLACEMENT] = "never reaches this straight-line distance"
    told = " and ".join(dict.fromkeys(texts.get(part.kind, path) for part in condition.parts))
    named = ",".join(f"{part.kind}={part.value:g}" for part in condition.parts)
    one = "at most one pose of the estimate has a true pose, but two are required"
    return f"condition {named}: {f'the drive {told}' if frames > 1 else one}"
