"""Comparison of several scores of the same data: paired differences, runs side by side, and their summary.

`methods_page` makes the tables and plots of the compared methods.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from sfr_loc_map.metrics.comparison import SIGNIFICANT, Comparison, Outcome, PairedDifference
from sfr_loc_map.metrics.conditions import label_of
from sfr_loc_map.metrics.figures.catalogue import title_of
from sfr_loc_map.report.verdict_view import limited_name, unit_of_numbers
from sfr_loc_map.tables.model import ABSENT, NONE, Cell, Column, Row, Table, Unit, fitting

FIRST_TABLES = ("pairs", "methods")  #: Tables above the plots of a page.
DIFFERENT = (Outcome.WORSE, Outcome.BETTER)
UNDECIDED = frozenset((Outcome.NOT_ENOUGH_DATA, Outcome.INCOMPLETE))  #: Outcomes without a test of the difference.


def comparison_tables(result: Comparison) -> list[Table]:
    """Return the tables of a comparison: pairs of sub-trajectories, runs side by side."""
    tables = [_pairs_table(result), _runs_table(result)]
    return [table for table in tables if table.rows]


def _pairs_table(result: Comparison) -> Table:
    rows: list[Row] = []
    for pair in result.pairs:
        unit = fitting(Unit(pair.unit), pair.first, pair.other)
        row = (
            Cell.head(f"{title_of(pair.figure)}, {unit.symbol}, over {label_of(pair.condition)}"),
            Cell(pair.name),
            optional_cell(pair.first, unit),
            optional_cell(pair.other, unit),
            optional_cell(pair.difference, unit, signed=True),
            Cell.interval(pair.ci95, unit=unit, signed=True),
            Cell.number(pair.count),
            optional_cell(pair.p_corrected),
            Cell(_outcome_word(result, pair)),
        )
        rows.append(row)
    columns = (
        Column("figure", words=True),
        Column("method", words=True),
        Column(result.names[0]),
        Column("other"),
        Column("difference"),
        Column("95 % interval"),
        Column("n"),
        Column("p, corrected"),
        Column("outcome", words=True),
    )
    title = f"Mean + 3 sigma, compared with {result.names[0]}, paired by sub-trajectory"
    note = f"A method is better or worse if p is at most {SIGNIFICANT} and the interval excludes zero. "
    note += f"p: p-value of the difference, corrected for {sum(pair.p is not None for pair in result.pairs)} "
    note += "comparisons (Holm)."
    note += "".join(_sample_notes(result))
    return Table("pairs", title, columns, tuple(rows), note)


def _outcome_word(result: Comparison, pair: PairedDifference) -> str:
    """Return the outcome of a difference, with the names of the scores that are incomplete."""
    if pair.outcome is not Outcome.INCOMPLETE:
        return pair.outcome.value
    return f"{pair.outcome.value}: {', '.join(result.incomplete_scores(pair.name))}"


def _sample_notes(result: Comparison) -> Iterator[str]:
    """Yield a sentence for each condition over which scores contain only a sample of the sub-trajectories."""
    samples = {pair.condition: pair.every for pair in result.pairs if pair.every > 1}
    for condition, every in samples.items():
        yield f" Over {label_of(condition)}, one in {every} sub-trajectories is compared: the scores contain no others."


def _runs_table(result: Comparison) -> Table:
    rows: list[Row] = []
    for item in result.side_by_side:
        unit = unit_of_numbers(item.figure, item.part, item.unit, *item.values)
        name = Cell.head(limited_name(item.figure, item.part, item.condition, item.statistic))
        rows.append((name, Cell(unit.symbol), *(optional_cell(value, unit) for value in item.values)))
    title = "Runs side by side (not paired, without an interval)"
    columns = (Column("figure", words=True), Column("unit", words=True), *map(Column, result.names))
    incomplete = [
        f"{name} is incomplete: {text}."
        for name, text in zip(result.names, result.incomplete, strict=True)
        if text is not None
    ]
    return Table("runs", title, columns, tuple(rows), " ".join(incomplete))


def optional_cell(value: float | int | None, unit: Unit = NONE, *, signed: bool = False) -> Cell:
    """Return a number as a cell; `-` if it is unknown."""
    return Cell.number(value, unit=unit, undefined=ABSENT, signed=signed)


def summary_of(result: Comparison) -> tuple[str, str]:
    """Return a heading and a text that compare the other scores with the reference, worse scores first."""
    outcomes: dict[str, dict[Outcome, list[str]]] = {}  # figures by name of the score and outcome
    for pair in result.pairs:
        figures = outcomes.setdefault(pair.name, {}).setdefault(pair.outcome, [])
        figures.append(f"{pair.figure} over {label_of(pair.condition)}")
    ordered = sorted(outcomes.items(), key=lambda item: Outcome.WORSE not in item[1])
    sentences = [f"{name}: {_outcome_text(figures, result.incomplete_scores(name))}." for name, figures in ordered]
    sentences.append(f"{len(result.names)} scores of the same data; the reference is {result.names[0]}.")
    counts = {word: sum(word in figures for figures in outcomes.values()) for word in DIFFERENT}
    heading = ", ".join(f"{count} of {len(outcomes)} {word}" for word, count in counts.items() if count)
    if not heading:
        is_tested = any(outcome not in UNDECIDED for figures in outcomes.values() for outcome in figures)
        heading = "no difference shown" if is_tested else "no paired comparison"
    return heading, " ".join(sentences)


def _outcome_text(figures: Mapping[Outcome, Sequence[str]], incomplete: Sequence[str]) -> str:
    """Return in which figures a score differs, or why no difference is shown.

    `incomplete` are the names of the incomplete scores of the comparison.
    """
    texts = [f"{word} in {', '.join(figures[word])}" for word in DIFFERENT if word in figures]
    if Outcome.INCOMPLETE in figures:
        verb = "is" if len(incomplete) == 1 else "are"
        undecided = ", ".join(figures[Outcome.INCOMPLETE])
        texts.append(f"undecided in {undecided}, because {' and '.join(incomplete)} {verb} incomplete")
    if Outcome.NOT_ENOUGH_DATA in figures:
        texts.append(f"{Outcome.NOT_ENOUGH_DATA} in {', '.join(figures[Outcome.NOT_ENOUGH_DATA])}")
    return "; ".join(texts) or "no difference is certain"
