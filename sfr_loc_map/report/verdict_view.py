"""Common view of a verdict for tables, bars, the test report, JUnit, the last line of a command and suites.

Unit, numbers, style and displayed name of a verdict are formatted only here. Reasons and caveats are sentences of
`metrics`. These sentences name a limit as the limits file does.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from sfr_loc_map.message_text import printable
from sfr_loc_map.metrics.conditions import label_of
from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.figures.catalogue import (
    KINDS,
    TOTAL,
    clause_of,
    defines,
    is_fraction,
    statistic_title,
    title_of,
)
from sfr_loc_map.metrics.figures.row_part import READING_PARTS
from sfr_loc_map.metrics.judging.proof import words_of
from sfr_loc_map.metrics.judging.reasons import why_open
from sfr_loc_map.metrics.score.limits import BOUND
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.score.verdict import Verdict
from sfr_loc_map.tables.model import (
    ABSENT,
    GB,
    MB,
    MIB,
    NONE,
    NOT_ENOUGH,
    PERCENT,
    Cell,
    Unit,
    VerdictStyle,
    digits_beside,
    exact_number,
    fitting,
    number,
)

STYLES = {
    VerdictState.PASS.value: VerdictStyle("✔", "pass", "green"),
    VerdictState.FAIL.value: VerdictStyle("✖", "fail", "bold red"),
}
OPEN = VerdictStyle("?", "open", "yellow")  #: Style of every other word.
WITHOUT_NAME = (None, *READING_PARTS)
"""Parts that are omitted in the name of a limit: the readings of the specification."""


@dataclass(frozen=True, slots=True)
class VerdictView:
    """A verdict with its displayed texts, and with its exact values as the values of cells."""

    item: Verdict
    key: str  #: Key in the JSON, such as `verdicts.3`.
    unit: Unit  #: Unit of all numbers.
    name: str  #: Figure, condition and statistic in words.
    title: str  #: Name with the number of the requirement in front.
    style: VerdictStyle
    value: Cell
    limit: Cell  #: Limit with the relation sign in front. A limit is given, so it is not rounded.
    margin: Cell
    interval: Cell
    count: Cell  #: Number of values.
    independent: Cell  #: Number of independent values.
    confidence: str  #: Whether the interval lies on one side of the limit, or what a tolerance bound shows.
    reason: str  #: Why there is not enough data; empty for other verdicts or without the score.

    @classmethod
    def of(cls, item: Verdict, key: str = "", score: Score | None = None) -> VerdictView:
        """Return the view of a verdict, with counts and reason if the score is given."""
        unit = unit_of(item)
        name = name_of(item)
        has_interval = item.condition is not None and item.statistic == TOTAL
        digits = digits_beside(item.value, item.limit, unit)
        is_open = item.state is VerdictState.NOT_ENOUGH_DATA
        of_nothing = ABSENT if item.state is VerdictState.PASS else NOT_ENOUGH  # a pass without a value has 0 items
        return cls(
            item=item,
            key=key,
            unit=unit,
            name=name,
            title=printable(f"{item.id}: {name}" if item.id else name),
            style=style_of(item.state.value),
            value=Cell.number(item.value, f"{key}.value", unit, of_nothing, digits=digits),
            limit=Cell(f"{sign_of(item)} {exact_number(item.limit, unit)}", item.limit, f"{key}.limit"),
            margin=Cell.number(item.margin, f"{key}.margin", unit, ABSENT),
            interval=Cell.interval(item.interval, key, unit, NOT_ENOUGH if has_interval else ABSENT),
            count=_count(item, key, score),
            independent=Cell.number(item.independent, f"{key}.independent", undefined=ABSENT),
            confidence=confidence_text(item),
            reason=why_open(item, score) if is_open and score is not None else "",
        )

    @property
    def value_text(self) -> str:
        """The value with its unit."""
        is_known = self.item.value is not None and math.isfinite(self.item.value)
        return self._with_unit(self.value.text) if is_known else self.value.text

    @property
    def limit_text(self) -> str:
        """The limit with its relation sign and its unit."""
        return self._with_unit(self.limit.text)

    @property
    def margin_text(self) -> str:
        """The margin with its sign and its unit; empty without a margin."""
        if self.item.margin is None:
            return ""
        return self._with_unit(number(self.item.margin, unit=self.unit, signed=True))

    @property
    def comparison(self) -> str:
        """Value and limit in one phrase: `18.35 mm, limit ≤ 20 mm`."""
        return f"{self.value_text}, limit {self.limit_text}"

    @property
    def clause(self) -> str:
        """The clause of the specification that defines the figure; empty if none does."""
        return "" if self.item.figure is None else clause_of(self.item.figure, self.item.part)

    @property
    def is_defined(self) -> bool:
        """Whether the specification defines the limited statistic of the figure."""
        figure, statistic = self.item.figure, self.item.statistic
        return figure is not None and defines(figure, self.item.part, statistic or "")

    @property
    def use(self) -> float | None:
        """Fraction of the limit that the value uses; above 1 the limit is missed."""
        value = self.item.value
        return None if value is None or not math.isfinite(value) else share_of_limit(self.item, value)

    def _with_unit(self, text: str) -> str:
        return f"{text} {self.unit.symbol}".rstrip()


def verdict_views(score: Score) -> Iterator[VerdictView]:
    """Yield the views of the verdicts of a score, in their order."""
    for place, item in enumerate(score.verdicts):
        yield VerdictView.of(item, f"verdicts.{place}", score)


def name_of(item: Verdict) -> str:
    """Return the name of a limited number: `position error over 5 m, mean + 3 sigma`."""
    if item.figure is None:  # a verdict without a limit in the limits file: failed calls, incomplete results
        return item.name.removesuffix("_min").replace("_", " ")
    return limited_name(item.figure, item.part, item.condition, item.statistic)


def limited_name(figure: str, part: str | None, condition: str | None, statistic: str | None) -> str:
    """Return the name of a number of the table of figures, from the titles of the catalogue."""
    words = [title_of(figure) + (f" over {label_of(condition)}" if condition else "")]
    if part not in WITHOUT_NAME:
        words.append((part or "").replace("_", " "))
    if statistic not in (None, "value"):
        words.append(limited_statistic_title(statistic or ""))
    return ", ".join(words)


def limited_statistic_title(statistic: str) -> str:
    """Return the displayed name of a limited statistic, which can be a tolerance bound."""
    return "tolerance bound" if statistic == BOUND else statistic_title(statistic)


def sign_of(item: Verdict) -> str:
    """Return the relation sign between a value and its limit."""
    return "≥" if item.is_lower_bound else "≤"


def unit_of(item: Verdict) -> Unit:
    """Return the display unit of a limit, its figure and its interval; fractions are in per cent."""
    if item.figure is None:  # a verdict without a limit in the limits file: the judged fraction, or a count
        return PERCENT if item.is_lower_bound else NONE
    unit = KINDS[item.figure].unit
    if unit == "bytes":
        return unit_of_memory_limit(item.limit)
    return unit_of_numbers(item.figure, item.part, unit, item.limit, item.value, *(item.interval or ()))


def unit_of_memory_limit(limit: float) -> Unit:
    """Return the unit in which a limit on memory, bytes, is a round number: decimal for 2e9, binary for 2**30."""
    if limit <= 0.0 or limit % MB.size:
        return MIB
    return MB if limit < GB.size else GB


def unit_of_numbers(figure: str, part: str | None, unit: str, *numbers: float | None) -> Unit:
    """Return the common display unit of numbers of a figure; `unit` is their unit in the table of figures."""
    if unit == "bytes":
        return MIB
    if unit == "1":
        return PERCENT if is_fraction(figure, part) else NONE
    return fitting(Unit(unit), *numbers)


def confidence_text(item: Verdict) -> str:
    """Return whether a verdict is certain, in words."""
    if item.proof is not None:
        return words_of(item.proof, item.state, item.n)
    text = {True: "yes", False: "no", None: ABSENT}[item.certain]
    return f"{text} (required)" if item.needs_certainty else text


def share_of_limit(item: Verdict, value: float) -> float:
    """Return the fraction of a limit that a value uses; for a lower bound, the limit divided by the value.

    The fraction is infinite for a limit of 0 that is exceeded, and for a value of 0 below a lower bound.
    """
    used, available = (item.limit, abs(value)) if item.is_lower_bound else (abs(value), item.limit)
    if available == 0.0:
        return math.inf if used else 0.0
    return used / available


def _count(item: Verdict, key: str, score: Score | None) -> Cell:
    if item.n is not None:
        return Cell.number(item.n, f"{key}.n")
    row = None if score is None else score.row_of(item)
    return Cell(ABSENT) if row is None or row.n is None else Cell.number(row.n, f"figures.{item.row}.n")


# ---- styles


def style_of(word: str) -> VerdictStyle:
    """Return the style of a verdict."""
    return STYLES.get(word, OPEN)


def verdict_cell(word: str, key: str = "") -> Cell:
    """Return the cell of a verdict with its style."""
    return Cell.verdict(word, style_of(word), key)
