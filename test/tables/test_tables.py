"""One table, four renderers: exact values kept, every text shown as it is."""

import io
import re
from dataclasses import replace

import pytest
from msgspec import structs
from rich.console import Console

from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.figures.subjects import Subject
from sfr_loc_map.metrics.score.verdict import Verdict
from sfr_loc_map.report.verdict_view import VerdictView, verdict_cell
from sfr_loc_map.tables.formats import to_csv, to_html, to_markdown, to_rich
from sfr_loc_map.tables.model import METRE, MIB, MILLISECOND, Cell, Column, Table, Unit, fitting, number

HOSTILE = "</td><script>alert('1')</script> a | b [red]"
TABLE = Table(
    "times",
    "Time | of [bold]calls",
    (Column("call", words=True), Column("p50", MILLISECOND), Column("95 % interval"), Column("verdict", words=True)),
    (
        (
            Cell.head(HOSTILE),
            Cell.number(0.0123456, "timing.p50", MILLISECOND),
            Cell.interval((1.0, 2.5), "timing.ci95"),
            verdict_cell("pass"),
        ),
        (Cell.head("none"), Cell.number(None, "timing.p95", MILLISECOND), Cell.interval(None), verdict_cell("open")),
    ),
    "A * note.",
)


def test_numbers_have_four_digits_and_their_unit() -> None:
    values = (0.000123456, 12345.6, 1.5e7, 7, 2_292_689, None, -0.5)
    assert [number(value) for value in values] == ["0.0001235", "12346", "1.5e+07", "7", "2292689", "unknown", "-0.5"]
    assert [number(value) for value in (9999.6, 9999.4, 9999999.6, -9999.96)] == ["10000", "9999", "1e+07", "-10000"]
    assert [number(value, signed=True) for value in (0.25, -0.25, 20000.0, 3)] == ["+0.25", "-0.25", "+20000", "+3"]
    assert [number(500 * 2**20, unit=unit) for unit in (MIB, Unit("byte"))] == ["500", "524288000"]

    suits = ((METRE, 0.003, None), (METRE, 0.003, -1.5), (Unit("s"), 1.8, 0.04), (Unit("s"), 12.0), (Unit("deg"), 0.1))
    assert [fitting(unit, *values).symbol for unit, *values in suits] == ["mm", "m", "ms", "s", "deg"]


def test_markdown() -> None:
    lines = to_markdown([TABLE], "All").splitlines()
    assert lines[:3] == ["# All", "", "## Time \\| of \\[bold\\]calls"]
    assert lines[4:6] == ["| call | p50, ms | 95 % interval | verdict |", "| --- | --- | --- | --- |"]
    assert lines[6] == (
        "| \\</td\\>\\<script\\>alert('1')\\</script\\> a \\| b \\[red\\] | 12.35 | 1 to 2.5 | ✔ pass |"
    )
    assert lines[7] == "| none | unknown | - | ? open |"
    assert lines[9] == "A \\* note."


def test_a_cell_without_a_key_names_no_key_and_a_marked_cell_of_words_has_one_class() -> None:
    marked = replace(Cell.number(0.5), mark="best")
    cells = (Cell.head("none"), marked, Cell.interval((1.0, 2.5)))
    table = Table("t", "T", (Column("a"), Column("b", words=True), Column("c")), (cells,))
    (row,) = re.findall("<td.*?</td>", to_html(table).partition("<tbody>")[2])[:1]
    assert row.startswith('<td class="words best" data-value="0.5" title="0.5">')
    assert to_csv([table]).splitlines() == ["table,row,column,key,value"]


def terminal(table: Table) -> str:
    console = Console(file=io.StringIO(), width=200, color_system=None)
    console.print(to_rich(table))
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def test_no_renderer_lets_markup_controls_and_surrogates_through() -> None:
    shown = terminal(TABLE)
    for text in ("Time | of [bold]calls", HOSTILE, "12.35", "1 to 2.5", "A * note."):
        assert text in shown
    escape = "\x1b]0;title\x07\udc80"
    cells = (Cell.head(escape), Cell(escape, 1.0, "key"), verdict_cell(escape))
    table = Table("t", escape, (Column(escape), Column("b"), Column(escape)), (cells,), escape)
    for text in (terminal(table), to_markdown([table]), to_html(table), to_csv([table])):
        assert r"\x1b" in text
        assert not {"\x1b", "\x07", "\udc80"} & set(text)


@pytest.mark.parametrize(
    ("link", "url"), [("a b/ü.html", "a%20b/%C3%BC.html"), ("\udce9.html", "%E9.html"), ("\ud800.html", "%3F.html")]
)
def test_a_link_to_a_file_of_any_name_is_a_url(link: str, url: str) -> None:
    table = Table("t", "T", (Column("a"),), ((Cell("x", link=link),),))
    assert f'href="{url}"' in to_html(table)


@pytest.mark.parametrize("count", [1, 3])
def test_a_row_has_a_cell_for_each_column(count: int) -> None:
    with pytest.raises(ValueError, match=f"a row of {count} cells: 2 are required"):
        Table("t", "T", (Column("a"), Column("b")), ((Cell("x"),) * count,))


@pytest.mark.parametrize("value", [0.0200004, 0.020003, 0.0200049, 0.02 + 1e-12])
def test_a_value_that_misses_its_limit_is_not_shown_as_the_limit(value: float) -> None:
    missed = Verdict(
        name="position_mean_m",
        row=None,
        subject=Subject.TRAJECTORY,
        figure="position",
        statistic="mean",
        limit=0.02,
        value=value,
        state=VerdictState.FAIL,
    )
    view, met = VerdictView.of(missed), VerdictView.of(structs.replace(missed, value=0.02))
    assert float(view.value.text) > float(view.limit.text.split()[-1])
    assert met.comparison == "20 mm, limit ≤ 20 mm"
