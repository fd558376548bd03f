"""The tables of a suite, of a comparison of suites, and of the required numbers of drives."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from operator import attrgetter
from typing import NamedTuple

from sfr_loc_map.metrics.conditions import label_of
from sfr_loc_map.metrics.config import CallKind, VerdictState
from sfr_loc_map.metrics.figures.catalogue import KINDS, TOTAL, statistic_title
from sfr_loc_map.metrics.figures.row_part import COUNT
from sfr_loc_map.metrics.figures.rows import Figure
from sfr_loc_map.metrics.figures.subjects import Scope, Subject
from sfr_loc_map.metrics.score.verdict import counts_of
from sfr_loc_map.report.verdict_view import VerdictView, verdict_cell
from sfr_loc_map.suite.jobs.job import SHORT_KEY
from sfr_loc_map.suite.jobs.job_outcome import WorkerRecord
from sfr_loc_map.suite.statistics.budget import Budget, BudgetRow, row_with_fraction
from sfr_loc_map.suite.statistics.common_deviations import CommonDeviation
from sfr_loc_map.suite.statistics.comparison import CountComparison, FigureComparison, SuiteComparison, SuiteState
from sfr_loc_map.suite.statistics.drive_count import DriveCount
from sfr_loc_map.suite.statistics.figures import map_error_of
from sfr_loc_map.suite.statistics.group_verdicts import GroupVerdict
from sfr_loc_map.suite.statistics.groups import Group
from sfr_loc_map.suite.statistics.scored_job import ScoredJob
from sfr_loc_map.suite.statistics.summary import JobCounts, ReplacedTruth, Summary
from sfr_loc_map.tables.model import MIB, MILLIMETRE, MILLISECOND, PERCENT, Column, Table, Unit, fitting, number
from sfr_loc_map.tables.typed import RowColumn, heads, intervals, numbers, table_of, words

PAGES = "pages"  #: Folder of the pages of single results, beside the page of the suite.
MAX_PAGES = 200  #: Maximum number of pages of results. `sfr report` makes pages of the other scores.
FIRST_TABLES = (
    "verdicts",
    "failures",
    "deviations",
    "counts",
    "groups",
)  #: Tables above the plots of the page of a suite.
DECIDED = "the sequential tests decided all limits before this job"
SUITE_JSON = "suite.json"


def suite_tables(summary: Summary) -> list[Table]:
    """Return the tables of a suite: verdicts, failures, budgets, counts, pooled errors, results, workers."""
    pages = {result.job.key for result in linked(summary)}
    maps = worst_maps_first(summary.results)
    of_first = "Errors over the sub-trajectories of the first condition."
    tables = (
        verdict_table(summary),
        table_of("failures", "Jobs without a result", FAILURES, failure_rows(summary)),
        *budget_tables(summary.budgets),
        table_of("deviations", "Deviations of the results", DEVIATIONS, summary.deviations),
        table_of("counts", "Jobs", COUNTS, [CountRow(summary.counts, len(summary.refusals))]),
        group_table(summary.groups),
        copies_table(summary.copies),
        table_of("truths", "Ground truth in place of that of the recording", TRUTHS, summary.replaced_truths),
        pooled_table(summary.groups),
        result_table("maps", "Maps, the worst first", maps, pages, Subject.MAP),
        result_table(
            "trajectories", "Trajectories, the worst first", worst_first(summary), pages, Subject.TRAJECTORY, of_first
        ),
        table_of(
            "workers",
            "Workers",
            WORKERS,
            summary.workers,
            "Workers with different code were excluded and received no jobs.",
        ),
    )
    return [table for table in tables if table.rows]


class VerdictRow(NamedTuple):
    """A verdict over the drives of a group."""

    group: Group
    item: GroupVerdict
    view: VerdictView


VERDICTS: tuple[RowColumn[VerdictRow], ...] = (
    RowColumn(Column("verdict", words=True), lambda row: verdict_cell(row.item.state.value)),
    heads("group", lambda row: row.group.key.text, link=lambda row: SUITE_JSON),
    words("figure", lambda row: row.view.title),
    words("unit", lambda row: row.view.unit.symbol),
    RowColumn(Column("value"), lambda row: row.view.value),
    RowColumn(Column("limit"), lambda row: row.view.limit),
    RowColumn(Column("margin"), lambda row: row.view.margin),
    RowColumn(Column("95 % interval"), lambda row: row.view.interval),
    words("of", lambda row: row.item.over),
    RowColumn(Column("n"), lambda row: row.view.count),
    numbers("drives that miss it", lambda row: row.item.missed_by),
    words("shown by", lambda row: None if row.item.proof is None else row.view.confidence),
)


def verdict_table(summary: Summary) -> Table:
    """Return the verdicts over all drives, worst first."""
    rows = [
        VerdictRow(group, item, VerdictView.of(item, f"groups.{index}.verdicts.{index_in_group}"))
        for index, group in enumerate(summary.groups)
        for index_in_group, item in enumerate(group.verdicts)
    ]
    rows.sort(key=lambda row: row.item.state.rank)
    note = "Pooled: the sub-trajectories of all drives are one sample. Worst drive: for figures that cannot be pooled."
    return table_of("verdicts", "Verdicts over all drives", VERDICTS, rows, note)


class FailureRow(NamedTuple):
    """A job without a result, or a refused source."""

    label: str
    cause: str
    message: str
    key: str = ""  #: Key of a failed job; empty if there is no file.


FAILURES: tuple[RowColumn[FailureRow], ...] = (
    heads("job", lambda row: row.label),
    words("cause", lambda row: row.cause),
    words("message", lambda row: row.message),
    words("result", lambda row: row.key[:SHORT_KEY], link=lambda row: f"failures/{row.key}.json" if row.key else ""),
)


def failure_rows(summary: Summary) -> Iterator[FailureRow]:
    """Yield the failed jobs, the refused sources, and the jobs that were not needed."""
    for failure in summary.failures:
        yield FailureRow(failure.label, failure.cause, failure.message, failure.key)
    for refusal in summary.refusals:
        yield FailureRow(refusal.name, "source refused", refusal.reason)
    for label in summary.not_run:
        yield FailureRow(label, "not run", DECIDED)


class CountRow(NamedTuple):
    """Numbers of jobs and of refused sources."""

    jobs: JobCounts
    refused: int


COUNTS: tuple[RowColumn[CountRow], ...] = (
    numbers("jobs", lambda row: row.jobs.jobs),
    numbers("done", lambda row: row.jobs.done),
    numbers("failed", lambda row: row.jobs.failed),
    numbers("waiting", lambda row: row.jobs.waiting),
    numbers("sources refused", lambda row: row.refused),
)


class GroupRow(NamedTuple):
    """A group with its number in the plots."""

    number: int
    group: Group

    @property
    def has_frames(self) -> bool:
        """Whether the group has trajectories; maps have no frames."""
        return bool(self.group.figures)


GROUPS: tuple[RowColumn[GroupRow], ...] = (
    numbers("number", lambda row: row.number),
    heads("task", lambda row: row.group.task, link=lambda row: SUITE_JSON),
    words("configuration", lambda row: row.group.configuration),
    words("faults", lambda row: row.group.alteration or "none"),
    numbers("results", lambda row: row.group.results),
    numbers("frames", lambda row: row.group.matched if row.has_frames else None),
    numbers("lost", lambda row: row.group.lost if row.has_frames else None),
)


def group_table(groups: Sequence[Group]) -> Table:
    """Return the groups of a suite."""
    rows = [GroupRow(index, group) for index, group in enumerate(groups, 1)]
    note = "The results of a group have the same task, configuration and faults."
    return table_of("groups", "Groups", GROUPS, rows, note)


COPIES: tuple[RowColumn[Sequence[str]], ...] = (
    heads("drive", lambda names: names[0]),
    numbers("sources", len),
    words("copies or parts", lambda names: ", ".join(names[1:])),
)


def copies_table(copies: Sequence[Sequence[str]]) -> Table:
    """Return the sources that are copies or parts of one drive."""
    note = (
        "The ground truths of these sources, and their first images if they have images, show one drive, or the ground "
        "truth of one source continues that of another one. The sources count as one drive in intervals, tests and "
        "numbers of drives. Only the errors of the worst source are pooled."
    )
    return table_of("copies", "Sources that are copies or parts of one drive", COPIES, copies, note)


DEVIATIONS: tuple[RowColumn[CommonDeviation], ...] = (
    heads("deviation", lambda row: row.text),
    numbers("results", lambda row: row.results),
    words("result", lambda row: row.of),
)


TRUTHS: tuple[RowColumn[ReplacedTruth], ...] = (
    heads("source", lambda row: row.source),
    words("ground truth (truth.source)", lambda row: row.path),
)


class PooledRow(NamedTuple):
    """A pooled figure of a group."""

    group: Group
    figure: Figure

    @property
    def unit(self) -> Unit:
        """Displayed unit."""
        return fitting(Unit(self.figure.unit), self.figure.mean_plus_3sigma)


POOLED: tuple[RowColumn[PooledRow], ...] = (
    heads("group", lambda row: row.group.key.text, link=lambda row: SUITE_JSON),
    words("over", lambda row: label_of(row.figure.condition)),
    words("error", lambda row: row.figure.figure),
    numbers("mean", lambda row: row.figure.mean, attrgetter("unit")),
    numbers("sigma", lambda row: row.figure.sigma, attrgetter("unit")),
    numbers("mean + 3 sigma", lambda row: row.figure.mean_plus_3sigma, attrgetter("unit")),
    intervals("95 % interval", lambda row: row.figure.interval, attrgetter("unit")),
    words("unit", lambda row: row.unit.symbol),
    numbers("sub-trajectories", lambda row: row.figure.n),
    numbers("drives", lambda row: row.figure.independent),
)


def pooled_table(groups: Sequence[Group]) -> Table:
    """Return the pooled errors of all groups."""
    rows = [PooledRow(group, figure) for group in groups for figure in group.figures if figure.figure != "chord"]
    note = "95 % interval of mean + 3 sigma by resampling whole drives; at least five drives are required."
    return table_of("pooled", "Errors over the sub-trajectories of all drives", POOLED, rows, note)


def _by_axis(title: str, of: Callable[[BudgetRow], tuple[float, ...] | None]) -> Iterator[RowColumn[BudgetRow]]:
    def value_of(row: BudgetRow, axis: int) -> float | None:
        values = of(row)
        return values[axis] if values else None

    for number_of_axis, name in enumerate("xyz"):
        yield numbers(f"{title}, {name}", partial(value_of, axis=number_of_axis), MILLIMETRE)


BUDGET: tuple[RowColumn[BudgetRow], ...] = (
    heads("source of error", lambda row: row.source),
    numbers("fraction alone", lambda row: row.alone.value, PERCENT),
    intervals("95 % interval", lambda row: row.alone.ci95, PERCENT),
    numbers("fraction removed", lambda row: row.removed.value, PERCENT),
    intervals("95 % interval", lambda row: row.removed.ci95, PERCENT),
    numbers("interaction", lambda row: row.interaction.value, PERCENT),
    intervals("95 % interval", lambda row: row.interaction.ci95, PERCENT),
    *_by_axis("mean", lambda row: row.mean_m),
    *_by_axis("sigma", lambda row: row.sigma_m),
)


def budget_tables(budgets: Sequence[Budget]) -> list[Table]:
    """Return a table for each error budget: sources by decreasing fraction, the rest, and the sum."""
    tables = []
    for index, budget in enumerate(budgets, 1):
        rows = [
            *sorted(budget.rows, key=lambda row: row.alone.value or 0.0, reverse=True),
            row_with_fraction("not named in the budget", budget.rest),
            row_with_fraction("sum", budget.total),
        ]
        note = (
            f"Fractions of the mean square position error over {label_of(budget.condition)}; {budget.drives} drives, "
            f"{budget.left_out} skipped because a variant has no result. Mean and sigma: effect of the source alone."
        )
        rms = "unknown" if budget.rms_m is None else number(budget.rms_m, unit=MILLIMETRE) + " mm"
        title = f"Error budget, {budget.configuration}: root mean square {rms}"
        tables.append(table_of(f"budget-{index}", title, BUDGET, rows, note))
    return tables


def worst_first(summary: Summary) -> list[ScoredJob]:
    """Return the results with a trajectory in the order of decreasing mean + 3 sigma of position.

    A result without this figure, for example of a lost drive, is before the others.
    """
    trajectories = [result for result in summary.results if result.score.association is not None]
    return sorted(trajectories, key=lambda result: _rank(result.position_m), reverse=True)


def worst_maps_first(results: Sequence[ScoredJob]) -> list[ScoredJob]:
    """Return the results with a map in the order of decreasing error. A map without an error is before the others."""
    maps = [result for result in results if result.score.has(Subject.MAP)]
    return sorted(maps, key=lambda result: _rank(map_error_of(result.score)), reverse=True)


def _rank(error: float | None) -> float:
    return math.inf if error is None else error


def linked(summary: Summary) -> list[ScoredJob]:
    """Return the results that have their own page: the worst trajectories and the worst maps.

    If there are too many results, trajectories and maps have up to half of the pages each. If one of the two needs
    fewer pages, the other gets the rest.
    """
    trajectories = worst_first(summary)
    maps = [result for result in worst_maps_first(summary.results) if result.score.association is None]
    chosen_maps = maps[: max(MAX_PAGES // 2, MAX_PAGES - len(trajectories))]
    return trajectories[: MAX_PAGES - len(chosen_maps)] + chosen_maps


def result_table(
    name: str, title: str, results: Sequence[ScoredJob], pages: set[str], subject: Subject, note: str = ""
) -> Table:
    """Return a table with a row per result: the compared errors of the first condition, and the resources."""

    def page_of(row: ScoredJob) -> str:
        return f"{PAGES}/{row.job.key}.html" if row.job.key in pages else ""

    def group_of(row: ScoredJob) -> str:
        return f"{row.job.group.text}, repeat {row.job.repeat}" if row.job.repeat else row.job.group.text

    columns: list[RowColumn[ScoredJob]] = [
        heads("source", lambda row: row.job.source.name, link=page_of),
        words("group", group_of),
        *_compared_errors(subject),
        *(OF_MAPS if subject is Subject.MAP else OF_TRAJECTORIES),
        numbers("limits missed", lambda row: counts_of(row.score.on_limits).missed),
        words("result", lambda row: row.job.key[:SHORT_KEY], link=lambda row: f"results/{row.job.key}.json"),
    ]
    return table_of(name, title, columns, results, note)


OF_MAPS: tuple[RowColumn[ScoredJob], ...] = (numbers("coverage", lambda row: row.score.number("coverage"), PERCENT),)
OF_TRAJECTORIES: tuple[RowColumn[ScoredJob], ...] = (
    numbers("covered", lambda row: row.score.number("judged", part=Scope.DRIVE), PERCENT),
    numbers("n", lambda row: row.score.number("position", "n")),
    numbers("lost", lambda row: row.score.number("lost", part=COUNT)),
    numbers("call p95", lambda row: row.score.number("localisation", "p95", part=None), MILLISECOND),
    numbers("peak", lambda row: row.score.number("peak", part=CallKind.LOCALISATION), MIB),
)
"""Columns of maps and of trajectories to the right of the compared errors."""


def _compared_errors(subject: Subject) -> Iterator[RowColumn[ScoredJob]]:
    for kind in KINDS.values():
        if TOTAL not in kind.compared or kind.subject is not subject:
            continue
        for statistic in kind.compared:
            yield _error(
                f"{kind.name.replace('_', ' ')}, {statistic_title(statistic)}", kind.name, statistic, kind.unit
            )


def _error(title: str, figure: str, statistic: str, unit: str) -> RowColumn[ScoredJob]:
    return numbers(title, lambda row: row.score.number(figure, statistic), shown_unit(unit))


def shown_unit(unit: str) -> Unit:
    """Return the unit in which errors are displayed: mm for errors in m, otherwise the given unit."""
    return MILLIMETRE if unit == "m" else Unit(unit)


WORKERS: tuple[RowColumn[WorkerRecord], ...] = (
    heads("worker", lambda row: row.worker),
    words("host", lambda row: row.host),
    words("version", lambda row: row.version),
    words("code", lambda row: row.code),
    numbers("jobs done", lambda row: row.done),
    words("set aside", lambda row: row.set_aside),
)
COMPARISON: tuple[RowColumn[FigureComparison], ...] = (
    heads("group", lambda row: row.group),
    words("figure", lambda row: row.figure),
    numbers("drives", lambda row: row.drives),
    numbers("without it, first", lambda row: row.without[0]),
    numbers("without it, other", lambda row: row.without[1]),
    numbers("ratio", lambda row: row.ratio),
    intervals("95 % interval", lambda row: row.ci95),
    numbers("p", lambda row: row.p),
    numbers("p, corrected", lambda row: row.p_corrected),
    words("the other is", lambda row: row.outcome),
    numbers("largest ratio", lambda row: None if row.worst.log is None else math.exp(row.worst.log)),
    words("at", lambda row: row.worst.label),
)


COMPARED_COUNTS: tuple[RowColumn[CountComparison], ...] = (
    heads("group", lambda row: row.group),
    words("count", lambda row: row.figure),
    numbers("results", lambda row: row.results),
    numbers("first", lambda row: row.first),
    numbers("other", lambda row: row.other),
)


COMPARED_SUITES: tuple[RowColumn[SuiteState], ...] = (
    heads("suite", lambda row: row.name),
    words("verdict", lambda row: None if row.verdict is None else row.verdict.value),
    numbers("jobs and sources without a result", lambda row: row.without_result),
    numbers("deviations", lambda row: len(row.deviations)),
)


class SuiteDeviation(NamedTuple):
    """A deviation of one of several suites."""

    suite: str
    item: CommonDeviation


DEVIATIONS_OF_SUITES: tuple[RowColumn[SuiteDeviation], ...] = (
    heads("deviation", lambda row: row.item.text),
    words("suite", lambda row: row.suite),
    numbers("results", lambda row: row.item.results),
    words("result", lambda row: row.item.of),
)


def comparison_tables(result: SuiteComparison) -> list[Table]:
    """Return the tables of a comparison of suites: ratios, counts of frames, the suites, and their deviations."""
    note = (
        "Ratio: mean + 3 sigma (or the cost) of the second suite divided by that of the first, as geometric mean over "
        "the drives. Below 1, the second suite is better. "
        "A drive without the figure in one suite counts in the test as the largest change of all drives. "
        f"Corrected for {len(result.figures)} comparisons (Holm). Results in only one suite: "
        f"{result.left_out[0]} in the first, {result.left_out[1]} in the second."
    )
    title = f"{result.names[1]} relative to {result.names[0]}, {result.common} results in both"
    summed = "Sums over the common results for which both suites have the count."
    deviations = [SuiteDeviation(suite.name, item) for suite in result.suites for item in suite.deviations]
    tables = (
        table_of("comparison", title, COMPARISON, result.figures, note),
        table_of("counts", "Lost, degraded and missing frames", COMPARED_COUNTS, result.counts, summed),
        table_of("suites", "Compared suites", COMPARED_SUITES, result.suites),
        table_of("deviations", "Deviations of the results", DEVIATIONS_OF_SUITES, deviations),
    )
    return [table for table in tables if table.rows]


NO_NUMBER = "no number"  #: Text if no number of drives is enough.
DRIVE_COUNTS: tuple[RowColumn[DriveCount], ...] = (
    heads("requirement", lambda row: row.text),
    numbers("without a failure", lambda row: row.without_failure),
    numbers("fixed number", lambda row: row.fixed),
    numbers("may fail", lambda row: row.allowed),
    numbers("sequential, expected", lambda row: row.sequential),
    numbers("sequential, no failure", lambda row: row.sequential_at_none),
)
OBSERVED_DRIVES: tuple[RowColumn[DriveCount], ...] = (
    numbers("drives", lambda row: row.drives),
    numbers("failed", lambda row: row.failures),
    numbers("at the observed rate", lambda row: row.at_the_rate_seen, undefined=NO_NUMBER),
    numbers("if normal", lambda row: row.if_normal, undefined=NO_NUMBER),
    RowColumn(
        Column("sequential test", words=True), lambda row: verdict_cell(row.state or VerdictState.NOT_ENOUGH_DATA)
    ),
)
"""Further columns of the table of the required numbers of drives, if a suite with limits is given."""


def drive_count_table(counts: Sequence[DriveCount]) -> Table:
    """Return the required numbers of drives as a table."""
    has_suite = any(count.drives is not None for count in counts)
    columns = (*DRIVE_COUNTS, *(OBSERVED_DRIVES if has_suite else ()))
    note = (
        "Numbers of independent drives. A fixed number of drives is judged at the end and passes with at most the "
        "failures in 'may fail'. The sequential test is judged after each drive and has the same risks."
    )
    return table_of("drives", "Number of drives", columns, counts, note)
