"""Tables of the registered methods, of a comparison of methods, and of a benchmark of faults."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

from sfr_loc_map.bench.fault_benchmark import SILENT_RATIO, FaultBenchmark, FaultEntry
from sfr_loc_map.bench.figure_rows import FigureRow
from sfr_loc_map.bench.method_benchmark import MethodBenchmark
from sfr_loc_map.methods.registry import OURS_IN_TABLES
from sfr_loc_map.tables.model import MILLIMETRE, NONE, PERCENT, Cell, Column, Row, Table, Unit

HEADS = (Column("", words=True), Column("", words=True))
"""Columns of the name of a method or fault, and of its version or error report."""
FAULT_COLUMNS: tuple[tuple[Column, Callable[[FaultEntry], float | None]], ...] = (
    (Column("pairs"), lambda entry: entry.pairs),
    (Column("position", MILLIMETRE), lambda entry: entry.position_m),
    (Column("heading", Unit("deg")), lambda entry: entry.heading_deg),
    (Column("tracking"), lambda entry: entry.stated.tracking),
    (Column("degraded"), lambda entry: entry.stated.degraded),
    (Column("lost"), lambda entry: entry.stated.lost),
    (Column("compared"), lambda entry: entry.stated.compared),
    (Column("position error / 3 sigma"), lambda entry: entry.stated.position_ratio),
    (Column("attitude error / 3 sigma"), lambda entry: entry.stated.attitude_ratio),
    (Column("step error / 3 sigma"), lambda entry: entry.stated.step_ratio),
    (Column(f"ratio above {SILENT_RATIO:g}", PERCENT), lambda entry: entry.stated.beyond_share),
    (Column("vertical disparity", Unit("px")), lambda entry: entry.vertical_offset_px),
    (Column("disparity bias", Unit("px")), lambda entry: entry.disparity_offset_px),
)
"""Columns of the table of faults, each with its value in an entry."""


def registered_methods_table(methods: Sequence[Mapping[str, str | None]]) -> Table:
    """Return the registered methods under test with task, version and kind, as `listed_methods` returns them."""
    keys = ("task", "name", "version", "kind", "about")
    rows = tuple(tuple(Cell(item[key] or "-") for key in keys) for item in methods)
    columns = tuple(Column(title, words=True) for title in ("task", "method", "version", "kind", ""))
    return Table("methods", "Methods", columns, rows)


def methods_table(benchmark: MethodBenchmark) -> Table:
    """Return a comparison of methods: a row per method, then a row per ratio of our method to another."""
    ours = benchmark.entries[OURS_IN_TABLES].medians
    columns = {row.keys: row.column for row in ours if row.column is not None}

    def cells(figures: Iterable[FigureRow], *, are_ratios: bool = False) -> list[Cell]:
        values = {row.keys: row.value for row in figures}
        return [
            Cell.number(values.get(keys), unit=NONE if are_ratios else column.unit, undefined="")
            for keys, column in columns.items()
        ]

    rows: list[Row] = [
        (Cell.head(name), Cell(entry.version), *cells(entry.medians)) for name, entry in benchmark.entries.items()
    ]
    rows += [
        (Cell.head(f"{OURS_IN_TABLES} / {name}"), Cell(""), *cells(figures, are_ratios=True))
        for name, figures in benchmark.ratios.items()
    ]
    return Table(benchmark.kind, benchmark.title, (*HEADS, *columns.values()), tuple(rows))


def faults_table(benchmark: FaultBenchmark) -> Table:
    """Return a benchmark of faults: a row per fault."""
    rows: list[Row] = []
    for fault, entry in benchmark.entries.items():
        values = [Cell.number(value(entry), unit=column.unit, undefined="") for column, value in FAULT_COLUMNS]
        rows.append((Cell.head(fault), Cell(entry.stated.error_report.value), *values))
    title = f"Localisation with faults, {benchmark.condition}: mean + 3 sigma; largest errors of tracking pairs"
    return Table("faults", title, (*HEADS, *(column for column, _ in FAULT_COLUMNS)), tuple(rows))
