"""How a command ends that judges: the verdicts and what could not be judged as exit codes."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sfr_loc_map.cli.output import warn
from sfr_loc_map.errors import FailedVerdictError, NotJudgedError

if TYPE_CHECKING:
    from sfr_loc_map.geometry.trajectory import Trajectory
    from sfr_loc_map.metrics.config import Condition
    from sfr_loc_map.metrics.limits import Limits
    from sfr_loc_map.metrics.score import Score, Verdict

LenientOption = Annotated[
    bool, typer.Option("--lenient", help="Exit 0 rather than 3 where something could not be judged.")
]


def read_limits(path: Path | None, conditions: Sequence[str] | None) -> tuple[Limits | None, tuple[Condition, ...]]:
    """Return the limits of a file, None without one, and the conditions that the user named in options or limits.

    Raises:
        ConfigError: If the limits cannot be read.
        MetricsError: If a condition is not valid.
    """
    from sfr_loc_map.metrics.config import Condition
    from sfr_loc_map.metrics.limits import load_limits

    limits = load_limits(path) if path is not None else None
    return limits, (*map(Condition.parse, conditions or ()), *(limits.conditions if limits is not None else ()))


def conclude(score: Score, asked: Collection[Condition], *, lenient: bool) -> None:
    """End a command by its score.

    Figures of an estimate and a truth that contradict each other by convention judge nothing, whatever the limits;
    otherwise a limit that was missed counts before one that could not be judged.

    Args:
        score: The score, which has been written.
        asked: Conditions that the user named.
        lenient: Whether what could not be judged is a warning only.

    Raises:
        FailedVerdictError: If a limit was missed.
        NotJudgedError: If something that was asked for could not be judged.
    """
    from sfr_loc_map.metrics.limits import reasons_not_judged

    if score.failed and (score.contradiction is None or lenient):
        missed = ", ".join(map(_missed, score.failed))
        raise FailedVerdictError(f"{len(score.failed)} of {len(score.verdicts)} limits missed: {missed}")
    not_judged(reasons_not_judged(score, asked), lenient=lenient)


def check_conditions(truth: Trajectory | None, conditions: Sequence[str], *, lenient: bool) -> None:
    """Check before the work is done that a drive meets conditions.

    Raises:
        MetricsError: If a condition is not valid.
        NotJudgedError: If the drive never meets one, and `lenient` is not given.
    """
    from sfr_loc_map.metrics.config import Condition
    from sfr_loc_map.metrics.limits import conditions_beyond

    parsed = [Condition.parse(text) for text in conditions]
    if truth is not None:
        not_judged(conditions_beyond(truth, parsed), lenient=lenient)


def not_judged(reasons: Sequence[str], *, lenient: bool) -> None:
    """End a command with the reasons why something could not be judged, if there are any.

    Raises:
        NotJudgedError: If there are, and `lenient` is not given.
    """
    if not reasons:
        return
    text = f"not judged: {'; '.join(reasons)}"
    if not lenient:
        raise NotJudgedError(f"{text} (exit 0 with --lenient)")
    warn(text)


def _missed(item: Verdict) -> str:
    """Return a limit that was missed, in the words of the limits file."""
    name = item.metric.removesuffix("_min")
    return f"{name} {item.value:.6g} {'>' if name == item.metric else 'against'} {item.limit:g}"
