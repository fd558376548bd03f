"""`sfr suite`: many sources, configurations and faults in one go, and what follows from them all."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from sfr_loc_map.atomic import write_text
from sfr_loc_map.cli.app import command_group, examples, propose
from sfr_loc_map.cli.options import HtmlOption, JsonOption, LenientOption, OverwriteOption
from sfr_loc_map.cli.output import HTML_SUFFIXES, STANDARD_OUTPUT, check_outputs, check_suffix, progress_bar, say, show
from sfr_loc_map.cli.verdict import not_judged
from sfr_loc_map.errors import ConfigError, FailedVerdictError, InputError, InterruptedRunError
from sfr_loc_map.inputs import one_line
from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.judging.proof import words_of
from sfr_loc_map.metrics.score_json import json_line
from sfr_loc_map.signals import hold

if TYPE_CHECKING:
    from distributed import Client

    from sfr_loc_map.suite.running.cluster import SuiteWorkers
    from sfr_loc_map.suite.running.job import Job
    from sfr_loc_map.suite.running.specification import SuiteSettings
    from sfr_loc_map.suite.running.store import Store
    from sfr_loc_map.suite.statistics.summary import Summary

app = command_group("Suites of runs: many sources, configurations and faults, resumed where they stopped.")

JunitOption = Annotated[Path | None, Option(metavar="F.xml", help="Write verdicts and failures as JUnit XML.")]
MlflowOption = Annotated[str | None, Option(metavar="URI", help="Log the suite as a run of MLflow (extra mlflow).")]
FolderArgument = Annotated[Path, Argument(metavar="DIR", help="Folder of a suite, as made by sfr suite run.")]


@app.command(
    epilog=examples(
        "sfr suite run suite.yaml --out runs/today --workers 4",
        "sfr suite run suite.yaml --out runs/today --dry-run",
        "sfr suite run suite.yaml --out runs/today --retry-failed --json -",
    )
)
def run(
    suite: Annotated[Path, Argument(metavar="SUITE.yaml", help="Sources, faults, configurations, tasks.")],
    out: Annotated[Path, Option(metavar="DIR", help="Folder of the results; an existing one is continued.")],
    workers: Annotated[int | None, Option(min=1, metavar="N", help="Parallel tasks; default: one per core.")] = None,
    scheduler: Annotated[
        str | None, Option(metavar="ADDR", help="Running Dask scheduler, for example tcp://host:8786.")
    ] = None,
    dry_run: Annotated[
        bool, Option("--dry-run", help="List the tasks without running them. Remote sources are fetched.")
    ] = False,
    retry_failed: Annotated[bool, Option("--retry-failed", help="Repeat failed tasks.")] = False,
    json_path: JsonOption = None,
    junit: JunitOption = None,
    mlflow: MlflowOption = None,
    overwrite: OverwriteOption = False,
    lenient: LenientOption = False,
) -> None:
    """Run what is not done yet, on Dask (extra suite). After an interruption the same command continues."""
    from sfr_loc_map.suite.running.plan import make_plan
    from sfr_loc_map.suite.running.specification import load_specification
    from sfr_loc_map.suite.running.store import Store

    propose("sfr", "suite", "report", out, why="its page again, from the results")
    check_outputs(json_path, junit, inputs=(suite,), overwrite=overwrite)
    _refuse_both(workers, scheduler)
    specification = load_specification(suite)
    settings, store = specification.settings, Store(out)
    with store.locked():
        planned, refusals = make_plan(specification, store.facts_of, store.cache)
        if not dry_run:
            store.plan(planned, refusals, specification.limits, specification.files)
        for refusal in refusals:
            say(f"sfr: warning: left out: {refusal.reason}", err=True)
        wanted = ("waiting", "failed") if retry_failed else ("waiting",)
        jobs = [job for job in planned if store.state(job.key) in wanted]
        if settings.stop_when_decided:  # in the order in which a sequential test takes the drives
            jobs.sort(key=lambda job: (job.drive, job.key))
        places = min(workers or max(1, _cores() // settings.threads), max(1, len(jobs)))
        if dry_run:
            for job in jobs:
                say(f"{job.key}  {job.label}")
            say(f"{len(jobs)} of {len(planned)} tasks to run, {places} at a time")
            return propose("sfr", "suite", "run", suite, "--out", out, why="run them")
        interrupted = False
        try:
            if jobs:
                with _workers(store, settings, places, scheduler) as (client, at_work):
                    _run_jobs(jobs, store, settings, client, at_work)
        except KeyboardInterrupt:
            interrupted = True
        finally:  # whatever ended it, the suite reports what it has
            hold()
            from sfr_loc_map.suite.pages.page import write_summary  # its imports take as long as all of the start
            from sfr_loc_map.suite.statistics.summary import summarise

            summary = summarise(store)
            write_summary(summary, store)
    if interrupted:
        done = f"{summary.counts['done']} of {summary.tasks} tasks are done and reported"
        raise InterruptedRunError(f"interrupted: {done}; the same command continues")
    _present(summary, store, json_path, junit, mlflow, lenient=lenient)


def _refuse_both(workers: int | None, scheduler: str | None) -> None:
    if scheduler is not None and workers is not None:
        raise ConfigError("'--workers' and '--scheduler': give one of them; a running scheduler has its own workers")


def _cores() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def _workers(
    store: Store, settings: SuiteSettings, places: int, scheduler: str | None
) -> Iterator[tuple[Client, SuiteWorkers]]:
    """Yield a client of Dask and its workers; what they did is kept in the folder."""
    from sfr_loc_map.suite.running.cluster import SuiteWorkers, connected

    with connected(settings, workers=places, scheduler=scheduler) as client:
        at_work = SuiteWorkers(client, lambda text: say(f"sfr: warning: {one_line(text)}", err=True), settings.wait_s)
        try:
            yield client, at_work
        finally:
            store.add_workers(list(at_work.records.values()))


def _run_jobs(
    jobs: Sequence[Job], store: Store, settings: SuiteSettings, client: Client, at_work: SuiteWorkers
) -> None:
    """Run jobs and keep what comes of each; show a bar on a terminal, a line each elsewhere."""
    from sfr_loc_map.suite.running.cluster import run_jobs
    from sfr_loc_map.suite.statistics.summary import summarise

    with ExitStack() as stack:
        bar = stack.enter_context(progress_bar("tasks"))
        outcomes = stack.enter_context(closing(run_jobs(client, jobs, settings.timeout_s, store.cache, at_work)))
        shown = bar.add_task("running", total=len(jobs))
        for done, (job, outcome) in enumerate(outcomes, 1):
            store.save(job, outcome)
            bar.advance(shown)
            if outcome.cause is not None:
                say(f"failed: {job.label}: {outcome.cause}", err=True)
            if bar.disable:
                say(f"{done} of {len(jobs)} tasks", err=True)
            if settings.stop_when_decided and summarise(store).is_decided:
                say(f"decided after {done} of {len(jobs)} tasks: the others are not needed", err=True)
                break


@app.command(epilog=examples("sfr suite search search.yaml --out runs/search --workers 2"))
def search(
    search: Annotated[Path, Argument(metavar="SEARCH.yaml", help="Scenario, ranges, figure with its limit.")],
    out: Annotated[Path, Option(metavar="DIR", help="Folder of the results; an existing one is continued.")],
    workers: Annotated[int | None, Option(min=1, metavar="N", help="Parallel tasks; default: one per core.")] = None,
    scheduler: Annotated[
        str | None, Option(metavar="ADDR", help="Running Dask scheduler, for example tcp://host:8786.")
    ] = None,
    at_random: Annotated[bool, Option("--random", help="Choose uniform points, for a comparison.")] = False,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Search the scenario with the least margin (extra search); exit code 1 if one misses the limit."""
    from sfr_loc_map.suite.pages.search_page import render_search, search_tables
    from sfr_loc_map.suite.running.store import Store
    from sfr_loc_map.suite.search.run import CASE, case_file, run_search
    from sfr_loc_map.suite.search.specification import load_search

    propose("sfr", "suite", "run", out / CASE, "--out", out / "case", why="the found case again")
    check_outputs(json_path, inputs=(search,), overwrite=overwrite)
    _refuse_both(workers, scheduler)
    specification, store = load_search(search), Store(out)
    running = specification.running
    places = workers or max(1, _cores() // running.threads)
    with store.locked(), ExitStack() as stack:
        connection = cache(lambda: stack.enter_context(_workers(store, running, places, scheduler)))  # if any run waits
        result = run_search(
            specification, store, lambda jobs: _run_jobs(jobs, store, running, *connection()), at_random=at_random
        )
    write_text(json_line(result.to_dict()), store.folder / "search.json")
    write_text(render_search(result), store.folder / "search.html")
    write_text(case_file(result), store.folder / CASE)
    show(result.to_dict(), json_path, search_tables(result))
    for point, reason in result.left_out.items():
        say(one_line(f"left out: {result.named(point)}: {reason}"), err=True)
    say(f"report: {store.folder / 'search.html'}", err=True)
    if result.found.fails:
        raise FailedVerdictError(f"the worst case is {result.case.ratio:.3g} times the limit: {store.folder / CASE}")


@app.command(epilog=examples("sfr suite report runs/today --json summary.json"))
def report(
    folder: FolderArgument,
    json_path: JsonOption = None,
    junit: JunitOption = None,
    mlflow: MlflowOption = None,
    overwrite: OverwriteOption = False,
    lenient: LenientOption = False,
) -> None:
    """Write the report page again from the results that are there."""
    from sfr_loc_map.suite.pages.page import write_summary
    from sfr_loc_map.suite.statistics.summary import summarise

    propose("sfr report A B", why="against an earlier one")
    check_outputs(json_path, junit, inputs=(folder,), overwrite=overwrite)
    store = _open_store(folder)
    summary = summarise(store)
    write_summary(summary, store)
    _present(summary, store, json_path, junit, mlflow, lenient=lenient)


@app.command(epilog=examples("sfr suite plan --prob 0.95 --confidence 0.95 --power 0.9", "sfr suite plan runs/today"))
def plan(
    folder: Annotated[Path | None, Argument(metavar="DIR", help="Folder of a suite: plan for its limits.")] = None,
    prob: Annotated[
        float | None, Option(metavar="P", help="Fraction of drives that must meet the limit; 0.9973.")
    ] = None,
    confidence: Annotated[float | None, Option(metavar="C", help="Confidence of the statement; 0.9.")] = None,
    power: Annotated[float | None, Option(metavar="W", help="Probability that good drives pass; 0.9.")] = None,
    good: Annotated[float | None, Option(metavar="G", help="Acceptable fraction of failures; (1 - P) / 5.")] = None,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Say how many independent drives a requirement with a share and a confidence needs."""
    from sfr_loc_map.metrics.judging.bound_terms import terms_of
    from sfr_loc_map.suite.statistics.drive_count import count_without_runs, drive_counts, plan_table
    from sfr_loc_map.suite.statistics.summary import summarise

    check_outputs(json_path, overwrite=overwrite)
    asked = {"prob": prob, "confidence": confidence, "power": power, "good": good}
    given = {name: value for name, value in asked.items() if value is not None}
    if folder is None:
        terms, problem = terms_of({**given, "interpretation": "ensemble"})
        if problem is not None:
            raise ConfigError(problem)
        counts = [count_without_runs(terms)]
    elif given:
        raise ConfigError(f"'--{next(iter(given))}' and a suite: the limits of the suite state it; omit one of them")
    else:
        store = _open_store(folder)
        counts = list(drive_counts(summarise(store).drives, store.limits))
    show([asdict(count) for count in counts], json_path, [plan_table(counts)])


@app.command(epilog=examples("sfr suite history nights/* --html history.html"))
def history(
    folders: Annotated[list[Path], Argument(metavar="DIR", help="Folders of suites, in the order of time.")],
    json_path: JsonOption = None,
    html: HtmlOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Find the nights at which figures changed, and the drives; exit code 1 if one is worse and stayed so."""
    from sfr_loc_map.suite.pages.page import render_history
    from sfr_loc_map.suite.pages.tables import history_tables
    from sfr_loc_map.suite.statistics.history import Night, find_changes

    propose("sfr report A B", why="two of these nights in full")
    check_suffix(html, HTML_SUFFIXES)
    check_outputs(json_path, html, inputs=folders, overwrite=overwrite)
    result = find_changes([Night.read(folder) for folder in folders])
    if html is not None:
        write_text(render_history(result), html)
    show(result.to_dict(), json_path, history_tables(result))
    for change in result.worse:
        say(change.text, err=True)
    if result.worse:
        raise FailedVerdictError(f"{len(result.worse)} figures became worse and stayed so: each is named above")


def _open_store(folder: Path) -> Store:
    from sfr_loc_map.suite.running.store import Store

    if not (folder / "plan.json").is_file():
        raise InputError(f"'{folder}' is not a folder of a suite: sought plan.json; give one made by sfr suite run")
    store = Store(folder)
    for path in store.check_files():
        say(f"sfr: warning: '{path}' is not there: that the plan has its tasks and limits was not checked", err=True)
    return store


def _present(
    summary: Summary, store: Store, json_path: str | None, junit: Path | None, mlflow: str | None, *, lenient: bool
) -> None:
    """Print the tables and say how it ended: raise an error if a limit was missed, a job failed, or is not judged."""
    from sfr_loc_map.suite.pages.export import log_to_mlflow, suite_junit
    from sfr_loc_map.suite.pages.tables import suite_tables

    if junit is not None:
        write_text(suite_junit(summary), junit)
    if mlflow is not None:
        say(f"MLflow run {log_to_mlflow(summary, store.folder, mlflow)}", err=True)
    show(summary.to_dict(), json_path, suite_tables(summary))
    say(f"report: {store.folder / 'report.html'}", err=True)
    for refusal in store.left_over():
        say(one_line(f"left out: {refusal.reason}"), err=True)
    for failure in summary.failures:
        say(one_line(f"failed: {failure.label}: {failure.cause}: {failure.message}"), err=True)
    verdicts = [(group, item) for group in summary.groups for item in group.verdicts]
    incomplete = [
        f"incomplete: {item.missed_by} of {group.drives} drives of {group.task}, {group.configuration}"
        + ("" if item.value is None else f"; the worst covers {100.0 * item.value:.4g} %")
        for group, item in verdicts
        if item.state is VerdictState.INCOMPLETE
    ]
    for text in incomplete:
        say(text, err=True)
    if summary.verdict is not None:
        counts = summary.counts
        reported = f"verdict: {summary.verdict}. {counts['done']} of {counts['tasks']} tasks have a result"
        say(reported, err=json_path == STANDARD_OUTPUT)
    if missed := sum(item.state is VerdictState.FAIL for _, item in verdicts):
        judged = sum(item.state is not VerdictState.INCOMPLETE for _, item in verdicts)
        raise FailedVerdictError(f"{missed} of {judged} limits over all drives missed")
    if count := len(summary.failures) + len(summary.refusals):
        raise InputError(f"{count} tasks or sources failed: each is named above")
    undecided = [
        f"{item.name} of {group.task}, {group.configuration}: "
        + (item.state.value if item.proof is None else words_of(item.proof, item.state))
        for group, item in verdicts
        if item.state in (VerdictState.NOT_ENOUGH_DATA, VerdictState.NOT_JUDGED)
    ]
    is_open = summary.waiting and verdicts and not summary.is_decided
    waiting = [f"{summary.waiting} of {summary.tasks} tasks have no result yet"] if is_open else []
    not_judged([*waiting, *incomplete, *undecided], lenient=lenient)
