"""The tables of a method under test: whose software it is, how it was run, how an external node behaved."""

from __future__ import annotations

from sfr_loc_map.metrics.score import ConventionRecord, ExternalScore, Score
from sfr_loc_map.report.score_cells import figure
from sfr_loc_map.tables.numbers import ABSENT, MIB, MILLISECOND, NONE, SECOND, Unit
from sfr_loc_map.tables.table import Cell, Column, Row, Table

UNTOLD = "not told"
LATENCY_NOTE = (
    "Latency: from publishing the last image of a pair to the receipt of its answer, with transport and waiting; it is "
    "no time per call."
)


def method_table(score: Score) -> Table | None:
    """Return whose figures these are and how its poses were converted, None where nothing was said."""
    rows: list[Row] = []
    if score.method is not None:
        rows += [
            (Cell.head("method"), Cell(score.method.name)),
            (Cell.head("version"), Cell(score.method.version or UNTOLD)),
            (Cell.head("kind"), Cell(score.method.kind.value)),
        ]
    if score.convention is not None:
        rows.append((Cell.head("converted"), Cell(convention_text(score.convention))))
    if not rows:
        return None
    return Table("method", "Method under test", (Column("of", words=True), Column("is", words=True)), tuple(rows))


def convention_text(convention: ConventionRecord) -> str:
    """Return in words how poses were converted before they were scored."""
    parts = [f"declared: {', '.join(convention.declared)}"] if convention.declared else []
    if convention.diagnosed is not None:
        fitted = ", numbers fitted to the truth" if convention.fitted else ""
        parts.append(f"by the diagnosis: {convention.diagnosed} (--apply-diagnosis{fitted})")
    return "; ".join(parts)


def external_table(score: Score) -> Table | None:
    """Return how an external node behaved, None where there was none."""
    node = score.external
    if node is None:
        return None
    columns = (Column("external node", words=True), Column("unit"), Column("value"))
    note = f"On {node.topic}, frames {node.frames or UNTOLD}. {LATENCY_NOTE}"
    note += f" Processes: {node.process.method}." if node.process is not None else ""
    note += f" It {node.ended}." if node.ended else ""
    return Table("external", f"External node: {node.task}", columns, tuple(_external_rows(node)), note)


def _external_rows(node: ExternalScore) -> list[Row]:
    counts = node.answers
    rows = [
        _row("pairs published", counts.pairs, "answers.pairs"),
        _row("answered", counts.answered, "answers.answered"),
        _row("missing", counts.missing, "answers.missing"),
        _row("late answers", counts.late, "answers.late"),
        _row("doubled answers", counts.doubled, "answers.doubled"),
        _row("answers of another stamp", counts.other_stamp, "answers.other_stamp"),
        _row("answers from another frame, left out", counts.other_frame, "answers.other_frame"),
        _row("answers that are not usable, left out", counts.not_usable, "answers.not_usable"),
    ]
    if node.latency_s is not None:
        for name in ("p50", "p95", "max"):
            rows.append(_row(f"latency {name}", getattr(node.latency_s, name), f"latency_s.{name}", MILLISECOND))
    if node.process is not None:
        rows.append(_row("processor time", node.process.cpu_s, "process.cpu_s", SECOND))
        rows.append(_row("peak resident memory", node.process.peak_rss_bytes, "process.peak_rss_bytes", MIB))
    return rows


def _row(title: str, value: float | int | None, key: str, unit: Unit = NONE) -> Row:
    return (Cell.head(title), Cell(unit.symbol or ABSENT), figure(value, f"external.{key}", unit))
