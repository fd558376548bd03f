"""The figures of the score beside their limits, in one table with the strings of the score's tables."""

from __future__ import annotations

from collections.abc import Iterator

from sfr_loc_map.metrics.config import CallKind, VerdictState
from sfr_loc_map.metrics.score import Score, Verdict
from sfr_loc_map.report.score_tables import (
    headline_table,
    keyed_conditions,
    limit_name,
    limit_unit,
    map_error,
)
from sfr_loc_map.report.tables import (
    ABSENT,
    Cell,
    Column,
    Row,
    Table,
    fitting,
    number,
)

NAME = "live"
FIRST_FIGURE = 2
"""Column of the mean in the table of the headline, behind the name and the unit."""
WORST_FIRST = (VerdictState.FAIL, VerdictState.NOT_ENOUGH_DATA, VerdictState.PASS)


def live_table(score: Score) -> Table | None:
    """Return the figures with their limits and verdicts, None where there is no figure yet."""
    headline = headline_table(score)
    if headline is None:
        return None
    limits: dict[str, list[Verdict]] = {}
    for item in score.verdicts:
        limits.setdefault(next(_places(score, item), ""), []).append(item)
    rows = tuple(_row(row, limits.get(row[FIRST_FIGURE].key.rpartition(".")[0], [])) for row in headline.rows)
    *columns, count = headline.columns
    verdict = Column("verdict", words=True)
    return Table(NAME, "Figures", (*columns, Column("limit", words=True), verdict, count), rows, headline.note)


def _places(score: Score, item: Verdict) -> Iterator[str]:
    """Yield the place in the JSON of the statistic that a limit is on."""
    metric = item.metric
    for key, part in keyed_conditions(score):
        for name in ("position_m", "attitude_deg", "heading_deg"):
            if metric.startswith(name.partition("_")[0]) and part.condition == item.condition:
                yield f"{key}.{name}"
    error = map_error(score.map) if score.map is not None else None
    if metric.startswith("point_error_") and error is not None:
        yield error.key
    for kind in CallKind:
        if metric.startswith(f"{kind}_") and metric.endswith("_s"):
            yield f"timing.{kind}_s"


def _row(row: Row, limits: list[Verdict]) -> Row:
    *cells, count = row
    if not limits:
        return (*cells, Cell(ABSENT), Cell(ABSENT), count)
    text = "; ".join(map(_limit, limits))
    worst = min((item.state for item in limits), key=WORST_FIRST.index)
    return (*cells, Cell(text), Cell.verdict(worst.value), count)


def _limit(item: Verdict) -> str:
    """Return a limit with its unit: `mean + 3 sigma ≤ 50 mm`."""
    unit = fitting(limit_unit(item.metric), item.limit, item.value)
    return f"{_statistic(item)} ≤ {number(item.limit, unit=unit)} {unit.symbol}"


def _statistic(item: Verdict) -> str:
    """Return the statistic that a limit is on: `mean + 3 sigma`."""
    name = limit_name(item.metric)
    subjects = ("position ", "attitude ", "heading ", "point error ", *(f"{kind} time " for kind in CallKind))
    return next((name.removeprefix(subject) for subject in subjects if name.startswith(subject)), name)
