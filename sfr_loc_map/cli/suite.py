"""`sfr suite`: many sources, configurations and faults in one go, and what follows from them all."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sfr_loc_map.cli.app import App, examples, help_without_command, propose
from sfr_loc_map.cli.options import HtmlOption, JsonOption, LenientOption, OverwriteOption
from sfr_loc_map.cli.output import HTML_SUFFIXES, check_outputs, check_suffix, say, show, write_text
from sfr_loc_map.cli.suite_progress import progress
from sfr_loc_map.cli.verdict import not_judged
from sfr_loc_map.errors import ConfigError, FailedVerdictError, InputError, InterruptedRunError
from sfr_loc_map.inputs import one_line

if TYPE_CHECKING:
    from sfr_loc_map.suite.runner import Executor
    from sfr_loc_map.suite.store import Store
    from sfr_loc_map.suite.summary import Summary

app = App(help="Suites of runs: many sources, configurations and faults, resumed where they stopped.")
app.callback(invoke_without_command=True)(help_without_command)

FolderArgument = Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a suite, as made by sfr suite run.")]


@app.command(
    epilog=examples(
        "sfr suite run suite.yaml --out runs/today --workers 4",
        "sfr suite run suite.yaml --out runs/today --dry-run",
        "sfr suite run suite.yaml --out runs/today --retry-failed --json -",
    )
)
def run(
    suite: Annotated[Path, typer.Argument(metavar="SUITE.yaml", help="Sources, faults, configurations, tasks.")],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder of the results; continued if it is there.")],
    workers: Annotated[int | None, typer.Option(min=1, metavar="N", help="Tasks at a time; one a core.")] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDR", help="Running Dask scheduler, as tcp://host:8786 (extra [suite])."),
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would be done and what it would cost.")] = False,
    only: Annotated[str, typer.Option(metavar="KEY", help="Run this one task again, done or not.")] = "",
    retry_failed: Annotated[bool, typer.Option("--retry-failed", help="Try again what failed before.")] = False,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
    lenient: LenientOption = False,
) -> None:
    """Run what is not done yet. Interrupted, it goes on where it was; done work is never done twice."""
    from sfr_loc_map.suite.runner import Selection, plan_suite, run_tasks
    from sfr_loc_map.suite.specification import load_specification
    from sfr_loc_map.suite.store import Store

    check_outputs(json_path, overwrite=overwrite)
    specification = load_specification(suite)
    store = Store(out)
    with store.locked():
        plan = plan_suite(specification, store)
        for refusal in plan.refusals:
            say(f"sfr: warning: left out: {refusal.reason}", err=True)
        tasks = Selection(only, retry_failed).of(plan, store)
        if only and not tasks:
            raise ConfigError(f"'--only {only}': no task has this key; see the index of '{out}'")
        executor, places = _executor(workers, scheduler, specification.settings.threads)
        if dry_run:
            _say_plan(store, [task.key for task in tasks], len(plan.tasks), places)
            return propose("sfr", "suite", "run", suite, "--out", out, why="run them")
        interrupted = False
        try:
            with progress(len(tasks)) as advance:
                run_tasks(tasks, specification.settings, store, executor, advance, again=bool(only))
        except KeyboardInterrupt:
            interrupted = True
        finally:  # whatever ended it, the suite reports what it has
            from sfr_loc_map.suite.page import write_summary  # its imports take as long as all of the start
            from sfr_loc_map.suite.summary import summarise

            summary = summarise(store, plan.refusals)
            write_summary(summary, store.folder)
    if interrupted:
        done = f"{summary.done} of {summary.tasks} tasks are done and reported"
        raise InterruptedRunError(f"interrupted: {done}; the same command goes on")
    _present(summary, store, json_path, lenient=lenient)


@app.command(epilog=examples("sfr suite report runs/today --json summary.json"))
def report(
    folder: FolderArgument,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
    lenient: LenientOption = False,
) -> None:
    """Write the report page again from the results that are there."""
    from sfr_loc_map.suite.page import write_summary
    from sfr_loc_map.suite.summary import summarise

    check_outputs(json_path, overwrite=overwrite)
    store = open_store(folder)
    summary = summarise(store)
    write_summary(summary, store.folder)
    _present(summary, store, json_path, lenient=lenient)


@app.command(epilog=examples("sfr suite compare runs/before runs/after --html comparison.html"))
def compare(
    first: Annotated[Path, typer.Argument(metavar="A", help="Folder of the suite that is the reference.")],
    other: Annotated[Path, typer.Argument(metavar="B", help="Folder of the suite that is compared with it.")],
    json_path: JsonOption = None,
    html: HtmlOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Compare two suites over the drives that both have: better, worse, or no difference shown."""
    from sfr_loc_map.report.page import render_tables
    from sfr_loc_map.suite.comparison import compare_suites
    from sfr_loc_map.suite.comparison_tables import comparison_tables
    from sfr_loc_map.suite.summary import summarise

    check_suffix(html, HTML_SUFFIXES)
    check_outputs(json_path, html, overwrite=overwrite)
    reference, compared = (summarise(open_store(folder)) for folder in (first, other))
    result = compare_suites(reference, compared, (str(first), str(other)))
    tables = comparison_tables(result)
    if html is not None:
        write_text(render_tables("Comparison of suites", tables), html)
    show(json.dumps(result.to_dict(), allow_nan=False) + "\n", json_path, tables)


def open_store(folder: Path) -> Store:
    """Return the folder of a suite that has run.

    Raises:
        InputError: If it is none.
    """
    from sfr_loc_map.suite.store import Store

    if not (folder / "index.sqlite").is_file():
        raise InputError(f"'{folder}' is not a folder of a suite: sought index.sqlite; give one made by sfr suite run")
    return Store(folder)


def _executor(workers: int | None, scheduler: str | None, threads: int) -> tuple[Executor, int]:
    """Return what runs the tasks, and how many at a time."""
    from sfr_loc_map.suite.runner import LocalExecutor
    from sfr_loc_map.suite.store import available_cores

    if scheduler is not None and workers is not None:
        raise ConfigError("'--workers' and '--scheduler': give one of them; a running scheduler has its own workers")
    if scheduler is not None:
        from sfr_loc_map.suite.dask_runner import DaskExecutor

        dask = DaskExecutor(scheduler)
        return dask, dask.places
    count = workers or max(1, available_cores() // threads)
    return LocalExecutor(count), count


def _say_plan(store: Store, keys: list[str], total: int, places: int) -> None:
    """Say what would be done, and what it would cost by what like tasks have cost."""
    entries = {entry.task.key: entry for entry in store.entries()}
    known: dict[str, list[float]] = {}
    for entry in entries.values():
        if entry.seconds is not None:
            known.setdefault(entry.task.kind, []).append(entry.seconds)
    for key in keys:
        say(f"{key}  {entries[key].task.label}")
    like = [known.get(entries[key].task.kind, []) for key in keys]
    cost = "cost not known before a like task has run"
    if all(like):
        cost = f"about {sum(sum(times) / len(times) for times in like) / places:.0f} s, {places} at a time"
    say(f"{len(keys)} of {total} tasks to run, {cost}")


def _present(summary: Summary, store: Store, json_path: str | None, *, lenient: bool) -> None:
    """Print the tables and say how it ended.

    Raises:
        FailedVerdictError: If a limit was missed.
        InputError: If a task failed or a source could not be read.
        NotJudgedError: If a limit could not be judged, and `lenient` is not given.
    """
    from sfr_loc_map.metrics.config import VerdictState
    from sfr_loc_map.suite.tables import suite_tables

    show(json.dumps(summary.to_dict(), allow_nan=False) + "\n", json_path, suite_tables(summary))
    say(f"report: {store.folder / 'report.html'}", err=True)
    for failure, again in zip(summary.failures, summary.again, strict=True):
        last = failure.attempts[-1]
        say(one_line(f"failed: {failure.label}: {last.cause}: {last.message}"), err=True)
        if again:
            say(f"  again: {again}", err=True)
    verdicts = [(group, item) for group in summary.groups for item in group.verdicts]
    missed = sum(item.state is VerdictState.FAIL for _, item in verdicts)
    if missed:
        raise FailedVerdictError(f"{missed} of {len(verdicts)} limits over all drives missed")
    if summary.failed or summary.refusals:
        count = summary.failed + len(summary.refusals)
        raise InputError(f"{count} tasks or sources failed: each is named above")
    undecided = [(group, item) for group, item in verdicts if item.state is VerdictState.NOT_ENOUGH_DATA]
    reasons = [f"{item.metric} of {group.task}, {group.configuration}: not enough data" for group, item in undecided]
    not_judged(reasons, lenient=lenient)
