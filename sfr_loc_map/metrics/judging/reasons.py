"""The reasons why figures or limits of a score could not be judged, as text."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.trajectory import Trajectory, as_truth
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.metrics.conditions import Condition, ConditionKind, label_of
from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.figures.catalogue import KINDS
from sfr_loc_map.metrics.figures.subjects import Scope
from sfr_loc_map.metrics.formulas import DISTANCE_TOLERANCE_M
from sfr_loc_map.metrics.frames.association import unique_rows
from sfr_loc_map.metrics.judging.incomplete import incompleteness
from sfr_loc_map.metrics.judging.judge import OpenCause, open_cause
from sfr_loc_map.metrics.judging.proof import words_of
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.score.verdict import Verdict


def reasons_not_judged(score: Score, asked: Collection[Condition] = ()) -> tuple[str, ...]:
    """Return why figures and limits are not judged, one phrase each; `asked` restricts the reported conditions."""
    if score.contradiction is not None:
        return (score.contradiction,)
    unmet = unmet_conditions(score, asked)
    reasons = [] if score.incomplete is None else [f"incomplete data ({names_of_incomplete_scopes(score)})"]
    reasons += unmet.values()
    points = score.figure("point_error")
    if points is not None and not points.n:
        reasons.append("no point of the cloud has a true point")
    for item in score.verdicts:
        if item.state is VerdictState.NOT_ENOUGH_DATA and item.condition not in unmet:
            over = "" if item.condition is None else f" over {label_of(item.condition)}"
            reasons.append(f"limit {item.name}{over}: {why_open(item, score)}")
    return tuple(reasons)


def unmet_conditions(score: Score, asked: Collection[Condition] = ()) -> dict[str | None, str]:
    """Return for each unmet condition why no sub-trajectory meets it; if `asked` is given, only for those."""
    drive = score.association
    if drive is None:
        return {}
    extent = DriveExtent(drive.matched, drive.path_length_m, drive.duration_s or 0.0)
    found: dict[str | None, str] = {}
    for row in score.rows("position", part=drive.reading):
        if row.condition is None or row.n or row.unknown:
            continue
        condition = Condition.parse(row.condition)
        if not asked or condition in asked:
            found[row.condition] = why_unmet(condition, extent)
    return found


def names_of_incomplete_scopes(score: Score) -> str:
    """Return the names of the incomplete scopes of a score; `score.incomplete` states the missing data."""
    scopes = {item.scope.words for item in incompleteness(score)}
    return ", ".join(sorted(scopes)) or Scope.DRIVE


def why_open(item: Verdict, score: Score) -> str:
    """Return why there is not enough data for the verdict on a limit."""
    if item.proof is not None:
        return why_within_error(item) if item.is_within_truth_error else words_of(item.proof, item.state, item.n)
    rules = score.active_rules
    match open_cause(item, rules):
        case OpenCause.NO_VALUE:
            return why_without_value(item, score)
        case OpenCause.TOO_FEW_VALUES:
            return f"too few values: {item.n} ({rules.minimum_count} are required)"
        case OpenCause.TOO_FEW_INDEPENDENT:
            required = f"{rules.minimum_independent:g} are required"
            return f"{item.n} values, of which {item.independent:.3g} are independent ({required})"
        case OpenCause.TRUTH_ERROR:
            return why_within_error(item)
        case _ if item.interval is None:
            return "'certain' requires a 95 % interval, which this figure does not have"
        case _:
            return "'certain' requires the complete 95 % interval to be within the limit"


def why_within_error(item: Verdict) -> str:
    """Return the reason of a verdict whose margin is within the error of the ground truth."""
    unit = "" if item.figure is None or KINDS[item.figure].unit == "1" else f" {KINDS[item.figure].unit}"
    return f"its margin, {item.margin:.3g}{unit}, is within the error of the truth, {item.truth_error:.3g}{unit}"


def why_without_value(item: Verdict, score: Score) -> str:
    """Return why the limited number of a verdict is undefined."""
    if not item.n and (unknown := unknown_of_truth(item.figure or "", score)) is not None:
        return unknown
    row = score.row_of(item)
    if row is None or not row.unknown:
        return unmet_conditions(score).get(item.condition, "no data")
    if not item.n:
        return f"all {row.unknown} values are unknown"
    return f"{row.unknown} of {item.n + row.unknown} values are unknown"


def unknown_of_truth(figure: str, score: Score) -> str | None:
    """Return why a figure cannot be judged by the truth of a score; None if it can be judged."""
    truth = score.truth
    if truth is None:
        return None
    if figure in ("position", "chord") and not truth.height:
        return "the truth has no heights: set a limit on the figure 'horizontal' instead"
    if figure == "attitude" and truth.attitude and not truth.tilt:
        return "the truth has no roll and pitch: set a limit on the figure 'heading' instead"
    return None


def conditions_beyond(truth: Trajectory, conditions: Collection[Condition]) -> tuple[str, ...]:
    """Return why a drive with this truth never meets some conditions, for a warning before the drive is processed."""
    path = as_truth(truth).at_rows(unique_rows(truth.stamps_ns))
    drive = DriveExtent(
        frames=len(path),
        length_m=float(np.linalg.norm(np.diff(path.positions, axis=0), axis=1).sum()),
        duration_s=float(path.stamps_ns[-1] - path.stamps_ns[0]) / NS_PER_S if len(path) else 0.0,
    )
    return tuple(why_unmet(item, drive) for item in conditions if drive.shortages(item))


class DriveExtent(NamedTuple):
    """The extent of a drive, which no sub-trajectory exceeds."""

    frames: int
    length_m: float
    duration_s: float

    def shortages(self, condition: Condition) -> list[str]:
        """Return the extents that are too short for a part of a condition, each once; angles are not checked.

        Lengths have the tolerance of the selection of sub-trajectories.
        """
        length_m = self.length_m + DISTANCE_TOLERANCE_M
        extents = {
            ConditionKind.DISTANCE: (length_m, f"is {self.length_m:.1f} m long"),
            ConditionKind.DISPLACEMENT: (length_m, "never reaches this straight-line distance"),
            ConditionKind.TIME: (self.duration_s, f"lasts {self.duration_s:.1f} s"),
            ConditionKind.FRAMES: (self.frames - 1.0, f"has {self.frames} frames"),
        }
        known = [(each.value, *extents[each.kind]) for each in condition.components if each.kind in extents]
        return list(dict.fromkeys(text for required, extent, text in known if required > extent))


def why_unmet(condition: Condition, drive: DriveExtent) -> str:
    """Return why no sub-trajectory of a drive meets a condition; the caller has checked that none does."""
    if drive.frames < 2:
        why = "at most one pose of the estimate has a true pose, but two are required"
    elif short := drive.shortages(condition):
        why = f"the drive {' and '.join(short)}"
    elif len(condition.components) > 1:
        why = "no sub-trajectory of the drive meets all its parts"
    elif condition.components[0].kind is ConditionKind.TURN:
        why = "the drive never turns by this angle"
    else:
        why = "the drive never reaches this straight-line distance"
    return f"condition {condition.setting}: {why}"
