"""`sfr suite`: run and evaluate many sources, configurations and faults."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Context, Option

from sfr_loc_map.atomic import write_text
from sfr_loc_map.cli.app import command_group, examples, propose
from sfr_loc_map.cli.options import HtmlOption, JsonOption, LenientOption, OverwriteOption, refuse_given
from sfr_loc_map.cli.output import (
    STANDARD_OUTPUT,
    check_suffix,
    claim_outputs,
    progress_bar,
    say,
    secondary_output,
    show,
    warn,
)
from sfr_loc_map.cli.verdict import not_judged
from sfr_loc_map.errors import FailedVerdictError, InputError
from sfr_loc_map.message_text import one_line
from sfr_loc_map.suffixes import HTML_SUFFIXES

if TYPE_CHECKING:
    from sfr_loc_map.suite.jobs.job import Job
    from sfr_loc_map.suite.jobs.job_outcome import JobOutcome
    from sfr_loc_map.suite.planning.specification import SuiteSpecification
    from sfr_loc_map.suite.run import Progress
    from sfr_loc_map.suite.statistics.summary import Summary
    from sfr_loc_map.suite.store import Store

group = command_group("Suites of many sources, configurations and faults. An interrupted suite is resumable.")

JunitOption = Annotated[Path | None, Option(metavar="F.xml", help="Write verdicts and failures as JUnit XML.")]
MlflowOption = Annotated[str | None, Option(metavar="URI", help="Log the suite as an MLflow run (extra mlflow).")]
OutOption = Annotated[Path, Option(metavar="DIR", help="Folder of the results; an existing folder is continued.")]
WorkersOption = Annotated[
    int | None,
    Option(min=1, metavar="N", help="Parallel jobs; default: the number of cores divided by the threads of a job."),
]
SchedulerOption = Annotated[
    str | None, Option(metavar="ADDR", help="Running Dask scheduler, for example tcp://host:8786.")
]
FolderArgument = Annotated[Path, Argument(metavar="DIR", help="Folder of a suite, made by sfr suite run.")]


@group.command(
    epilog=examples(
        "sfr suite run suite.yaml --out runs/today --workers 4",
        "sfr suite run suite.yaml --out runs/today --dry-run",
        "sfr suite run suite.yaml --out runs/today --retry-failed --json -",
    )
)
def run(
    context: Context,
    suite: Annotated[Path, Argument(metavar="SUITE.yaml", help="File with sources, faults, configurations, tasks.")],
    out: OutOption,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    dry_run: Annotated[
        bool, Option("--dry-run", help="List the jobs without running them. Remote sources are fetched.")
    ] = False,
    retry_failed: Annotated[bool, Option("--retry-failed", help="Repeat failed jobs.")] = False,
    json_path: JsonOption = None,
    junit: JunitOption = None,
    mlflow: MlflowOption = None,
    overwrite: OverwriteOption = False,
    lenient: LenientOption = False,
) -> None:
    """Run the unfinished jobs of a suite on Dask (extra suite). The same command continues an interrupted suite."""
    from sfr_loc_map.suite.planning.specification import load_specification
    from sfr_loc_map.suite.run import run_suite
    from sfr_loc_map.suite.store import Store

    propose("sfr", "suite", "report", out, why="rebuilds the page from the results")
    _refuse_workers_of(context, scheduler)
    if dry_run:
        of_result = ("json_path", "junit", "mlflow", "lenient")
        refuse_given(context, of_result, "has no effect with --dry-run, which has no result: omit it")
    claim_outputs(json_path, junit, inputs=(suite,), overwrite=overwrite)
    specification, store = load_specification(suite), Store(out)
    if dry_run:
        if _list_jobs(specification, store, workers, retry_failed=retry_failed):
            propose("sfr", "suite", "run", suite, "--out", out, why="run them")
        return
    with _progress() as progress:
        summary = run_suite(
            specification,
            store,
            workers=workers,
            scheduler=scheduler,
            retry_failed=retry_failed,
            say=_tell,
            progress=progress,
        )
    _present(summary, store, json_path, junit, mlflow, has_named_refusals=True, lenient=lenient)


def _list_jobs(specification: SuiteSpecification, store: Store, workers: int | None, *, retry_failed: bool) -> int:
    """Print the jobs that `sfr suite run` would run, and return their number."""
    from sfr_loc_map.suite.run import plan_run, slots_for

    with store.locked():
        planned = plan_run(specification, store, retry_failed=retry_failed)
    for text in planned.texts:
        _tell(text)
    for job in planned.jobs:
        say(f"{job.key}  {job.label}")
    count, total = len(planned.jobs), len(planned.plan.jobs)
    at_a_time = f", {min(slots_for(specification.settings, workers), count)} at a time" if count else ""
    say(f"{count} of {total} jobs to run{at_a_time}")
    return count


def _tell(text: str) -> None:
    say(f"sfr: {text}", err=True)


@contextmanager
def _progress() -> Iterator[Progress]:
    """Yield a function that shows finished jobs: on a bar in a terminal, otherwise one line per job."""
    with progress_bar("jobs") as bar:

        def advance(done: int, total: int, last: tuple[Job, JobOutcome] | None) -> None:
            if last is None:
                for task in bar.task_ids:  # bars of the previous batch of a search
                    bar.remove_task(task)
                bar.add_task("running", total=total)
                return
            bar.advance(bar.task_ids[-1])
            job, outcome = last
            if outcome.cause is not None:
                say(f"failed: {job.label}: {outcome.cause}", err=True)
            if bar.disable:
                say(f"{done} of {total} jobs", err=True)

        yield advance


def _refuse_workers_of(context: Context, scheduler: str | None) -> None:
    """Raise ConfigError if `--workers` is given with `--scheduler`."""
    if scheduler is not None:
        reason = "has no effect with --scheduler, because a running scheduler has its own workers: give one of them"
        refuse_given(context, ("workers",), reason)


@group.command(epilog=examples("sfr suite search search.yaml --out runs/search --workers 2"))
def search(
    context: Context,
    search: Annotated[Path, Argument(metavar="SEARCH.yaml", help="File with scenario, ranges, figure and limit.")],
    out: OutOption,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    at_random: Annotated[bool, Option("--random", help="Draw the points uniformly, for comparison.")] = False,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Search for the scenario with the smallest margin (extra search); exit code 1 if it misses the limit."""
    from sfr_loc_map.metrics.stored.score_json import to_plain
    from sfr_loc_map.suite.pages.search_page import search_tables
    from sfr_loc_map.suite.run import run_search
    from sfr_loc_map.suite.search.search import CASE
    from sfr_loc_map.suite.search.specification import load_search
    from sfr_loc_map.suite.store import Store

    propose("sfr", "suite", "run", out / CASE, "--out", out / "case", why="repeats the worst case")
    claim_outputs(json_path, inputs=(search,), overwrite=overwrite)
    _refuse_workers_of(context, scheduler)
    specification, store = load_search(search), Store(out)
    with _progress() as progress:
        record = run_search(
            specification,
            store,
            workers=workers,
            scheduler=scheduler,
            at_random=at_random,
            say=_tell,
            progress=progress,
        )
    show(to_plain(record), json_path, search_tables(record))
    for item in record.left_out:
        say(one_line(f"skipped: {item.point}: {item.reason}"), err=True)
    say(f"report: {store.folder / 'search.html'}", err=True)
    if record.found.fails:
        number, ratio = f"{record.figure} {record.statistic}", record.found.ratio
        worst = f"a drive has no {number}" if ratio is None else f"{number} is {ratio:.3g} times the limit"
        raise FailedVerdictError(
            f"at the worst point, {worst}; a reduced change of the scenario that still misses the limit is in "
            f"'{store.folder / CASE}'"
        )


@group.command(epilog=examples("sfr suite report runs/today --json summary.json"))
def report(
    folder: FolderArgument,
    json_path: JsonOption = None,
    junit: JunitOption = None,
    mlflow: MlflowOption = None,
    overwrite: OverwriteOption = False,
    lenient: LenientOption = False,
) -> None:
    """Rebuild the report page from the available results. While a run uses the suite, the report is only printed."""
    from sfr_loc_map.suite.pages.page import write_summary
    from sfr_loc_map.suite.statistics.summary import summarise

    propose("sfr report A B", why="compares with an earlier suite")
    claim_outputs(json_path, junit, inputs=(folder,), overwrite=overwrite)
    store = _open_store(folder)
    with store.locked_if_free() as is_locked:
        summary = summarise(store)
        if is_locked:
            write_summary(summary, store)
        else:
            warn(f"a run uses '{folder}' and writes the report when it ends: the report is only printed")
    _present(summary, store, json_path, junit, mlflow, is_written=is_locked, lenient=lenient)


@group.command(
    "plan", epilog=examples("sfr suite plan --prob 0.95 --confidence 0.95 --power 0.9", "sfr suite plan runs/today")
)
def plan(
    context: Context,
    folder: Annotated[
        Path | None, Argument(metavar="DIR", help="Folder of a suite, whose limits define the requirements.")
    ] = None,
    prob: Annotated[
        float | None, Option(metavar="P", help="Fraction of drives that must meet the limit; default: 0.9973.")
    ] = None,
    confidence: Annotated[float | None, Option(metavar="C", help="Confidence level; default: 0.9.")] = None,
    power: Annotated[float | None, Option(metavar="W", help="Probability that good drives pass; default: 0.9.")] = None,
    good: Annotated[
        float | None, Option(metavar="G", help="Acceptable fraction of failures; default: (1 - P) / 5.")
    ] = None,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Compute the number of independent drives required to prove a limit with a probability and a confidence."""
    from sfr_loc_map.metrics.judging.limits_file import terms_of
    from sfr_loc_map.suite.pages.tables import drive_count_table
    from sfr_loc_map.suite.statistics.drive_count import count_without_suite, drive_counts
    from sfr_loc_map.suite.statistics.summary import summarise

    claim_outputs(json_path, overwrite=overwrite)
    asked = {"prob": prob, "confidence": confidence, "power": power, "good": good}
    given = {name: value for name, value in asked.items() if value is not None}
    if folder is None:
        counts = [count_without_suite(terms_of({**given, "interpretation": "ensemble"}))]
    else:
        reason = "has no effect with a suite, because the limits of the suite define it: omit the option or the suite"
        refuse_given(context, asked, reason)
        summary = summarise(_open_store(folder))
        counts = list(drive_counts(summary.results, summary.limits))
    show(counts, json_path, [drive_count_table(counts)])


@group.command(epilog=examples("sfr suite history nights/* --html history.html"))
def history(
    folders: Annotated[
        list[Path], Argument(metavar="DIR", help="Folders of suites in chronological order, one for each night.")
    ],
    json_path: JsonOption = None,
    html: HtmlOption = None,
    overwrite: OverwriteOption = False,
    lenient: LenientOption = False,
) -> None:
    """Find the nights and the drives in which figures of a suite changed; a night is one run of the suite.

    The exit code is 1 if a figure became and stayed worse, or if a planned job has no result in the last night. The
    exit code is 3 if no figure could be tested.
    """
    from sfr_loc_map.suite.history.history import find_changes
    from sfr_loc_map.suite.history.night import read_nights
    from sfr_loc_map.suite.pages.history_page import history_table, render_history

    propose("sfr report A B", why="compares two of these nights in full")
    check_suffix(html, HTML_SUFFIXES)
    claim_outputs(json_path, html, inputs=folders, overwrite=overwrite)
    result = find_changes(read_nights(folders))
    if html is not None:
        with secondary_output():
            write_text(render_history(result), html)
    show(result.to_dict(), json_path, [history_table(result)])
    for change in result.worse:
        say(change.text, err=True)
    for label in result.without_result:
        say(one_line(f"no result in the last night: {label}"), err=True)
    failures = []
    if result.worse:
        failures.append(f"figures that got worse and did not recover: {len({item.figure for item in result.worse})}")
    if result.without_result:
        failures.append(f"jobs without a result in the last night: {len(result.without_result)}")
    if failures:
        raise FailedVerdictError(f"{'; '.join(failures)}; the messages above name them")
    not_judged([result.shortage] if result.shortage else [], lenient=lenient)


def _open_store(folder: Path) -> Store:
    """Return the folder of a suite; InputError if its plan was edited, or if the suite's file has changed since."""
    from sfr_loc_map.suite.store import Store

    if not (folder / "plan.json").is_file():
        raise InputError(f"'{folder}' is not a suite: plan.json is missing; give a folder made by sfr suite run")
    store = Store(folder)
    if store.plan.search:
        raise InputError(f"'{folder}' is the folder of a search, not of a suite: its results are in search.html")
    store.check_files()
    return store


def _present(
    summary: Summary,
    store: Store,
    json_path: str | None,
    junit: Path | None,
    mlflow: str | None,
    *,
    has_named_refusals: bool = False,
    is_written: bool = True,
    lenient: bool,
) -> None:
    """Print the tables and the verdict; raise an error if a limit was missed or not judged, or if a job failed.

    With `has_named_refusals`, the run has printed the refused sources of the plan, which are not repeated. The path of
    the page is printed only if `is_written`.
    """
    from sfr_loc_map.metrics.config import VerdictState
    from sfr_loc_map.suite.pages.export import log_to_mlflow, suite_junit
    from sfr_loc_map.suite.pages.tables import suite_tables
    from sfr_loc_map.suite.statistics.verdict_texts import verdict_texts_of

    if junit is not None:
        with secondary_output():
            write_text(suite_junit(summary), junit)
    if mlflow is not None:
        with secondary_output():
            say(f"MLflow run {log_to_mlflow(summary, store.folder, mlflow)}", err=True)
    show(summary.to_dict(), json_path, suite_tables(summary))
    if is_written:
        say(f"report: {store.folder / 'report.html'}", err=True)
    planned = store.plan.refusals
    for refusal in summary.refusals:
        if refusal not in planned:
            say(one_line(f"removed: {refusal.reason}"), err=True)
        elif not has_named_refusals:
            say(one_line(f"skipped: {refusal.reason}"), err=True)
    for failure in summary.failures:
        say(one_line(f"failed: {failure.label}: {failure.cause}: {failure.message}"), err=True)
    if summary.not_run:
        say(one_line(f"not run, because the limits are decided: {'; '.join(summary.not_run)}"), err=True)
    outcome = verdict_texts_of(summary)
    for text in (*outcome.incomplete, *outcome.without_drives):
        say(one_line(text), err=True)
    if summary.verdict is not None:
        counts = summary.counts
        reported = f"verdict: {summary.verdict}. {counts.done} of {counts.jobs} jobs have a result"
        say(reported, err=json_path == STANDARD_OUTPUT)
    if outcome.failures:
        raise FailedVerdictError("; ".join(outcome.failures))
    if outcome.without_result:
        raise InputError(f"{' and '.join(outcome.without_result)}; the messages above name them")
    # a suite that passes has no limit on a condition without drives, as for a score
    without_drives = () if summary.verdict is VerdictState.PASS else outcome.without_drives
    not_judged([*outcome.waiting, *outcome.incomplete, *outcome.undecided, *without_drives], lenient=lenient)
