"""`sfr report`: pages and tables of one score, several scores, two suites, or trajectories."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Context, Option

from sfr_loc_map.atomic import write_text
from sfr_loc_map.cli.app import app, examples, propose, propose_again, propose_page
from sfr_loc_map.cli.options import (
    Align,
    JsonOption,
    LenientOption,
    OverwriteOption,
    of_panels,
    option_names,
    refuse_given,
    refuse_others,
)
from sfr_loc_map.cli.output import STANDARD_OUTPUT, check_suffix, claim_outputs, say, secondary_output, show, warn
from sfr_loc_map.cli.verdict import conclude_all, not_judged, say_deviations, write_junit
from sfr_loc_map.configuration.parameters import build
from sfr_loc_map.errors import ConfigError, FailedVerdictError
from sfr_loc_map.message_text import counted
from sfr_loc_map.metrics.config import AlignedErrorConfig
from sfr_loc_map.suffixes import HTML_SUFFIXES, suffix_of

if TYPE_CHECKING:
    from sfr_loc_map.metrics.score.score import Score

FORMATS = (*HTML_SUFFIXES, ".md", ".csv")
DOCUMENTS = "Test report of scores"
DRAWN = "Page of trajectories"


class ResultKind(StrEnum):
    """Kind of the given results, as stated in the message about an option that does not apply."""

    SCORES = "scores"
    SUITES = "suites"
    TRAJECTORIES = "trajectories"


ALIGNED = AlignedErrorConfig()  #: Default settings of the distance to the truth.
OF_PAGE = ("results", "output", "json_path", "overwrite")
OF_TEST_REPORT = ("title", "evidence")
OF_HEADING = ("number", "issue")  #: In the test report and in the control document.

# ---- options of this command

ResultsArgument = Annotated[
    list[Path],
    Argument(metavar="RESULT...", help="Scores (*.json); two folders of suites; or trajectories and sources."),
]
OutputOption = Annotated[
    Path | None,
    Option(
        "-o",
        "--output",
        metavar="F",
        help="*.html; for one score also *.md, *.csv; default: report.html beside the score.",
    ),
]
TestReportOption = Annotated[
    Path | None,
    Option(metavar="T.html", rich_help_panel=DOCUMENTS, help="Write the test report of the scores for signature."),
]
TitleOption = Annotated[str, Option(metavar="TEXT", rich_help_panel=DOCUMENTS, help="Title of the test report.")]
NumberOption = Annotated[str, Option(metavar="TEXT", rich_help_panel=DOCUMENTS, help="Number of the test report.")]
IssueOption = Annotated[
    str, Option(metavar="TEXT", rich_help_panel=DOCUMENTS, help="Issue (revision) of the test report.")
]
JunitOption = Annotated[
    Path | None, Option(metavar="F.xml", rich_help_panel=DOCUMENTS, help="Write the verdicts as JUnit XML.")
]
ControlOption = Annotated[
    Path | None,
    Option(metavar="F.csv", rich_help_panel=DOCUMENTS, help="Write the verification control document (close-out)."),
]
EvidenceOption = Annotated[
    list[Path] | None,
    Option(
        metavar="E.json",
        rich_help_panel=DOCUMENTS,
        help="Evidence for the test report: JSON of sfr check, suite.json with a budget, search.json.",
    ),
]
TruthOption = Annotated[
    Path | None,
    Option(metavar="TRUTH", rich_help_panel=DRAWN, help="True trajectory; the distance to the truth is drawn, too."),
]
AlignOption = Annotated[Align, Option(rich_help_panel=DRAWN, help="Alignment of each trajectory with the truth.")]
MaxDifferenceOption = Annotated[
    float,
    Option(metavar="S", rich_help_panel=DRAWN, help="Maximum difference between the stamps of estimate and truth."),
]


@app.command(
    epilog=examples(
        "sfr report out/report.json -o page.html",
        "sfr report out/report.json -o tables.md",
        "sfr report before.json after.json -o comparison.html",
        "sfr report runs/before runs/after -o comparison.html",
        "sfr report estimate.csv other.tum --truth data/ -o paths.html",
    )
)
def report(
    context: Context,
    results: ResultsArgument,
    output: OutputOption = None,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
    lenient: LenientOption = False,
    test_report: TestReportOption = None,
    title: TitleOption = "",
    number: NumberOption = "",
    issue: IssueOption = "",
    junit: JunitOption = None,
    control: ControlOption = None,
    evidence: EvidenceOption = None,
    truth: TruthOption = None,
    align: AlignOption = "none",
    max_difference: MaxDifferenceOption = ALIGNED.max_difference,
) -> None:
    """Write a page of results: one score, a comparison of scores or of two suites, or a plot of trajectories.

    The exit code is the verdict of the scores or suites: 1 if a limit is missed, 3 if something could not be judged.
    """
    check_suffix(output, FORMATS)
    check_suffix(test_report, HTML_SUFFIXES)
    check_suffix(control, (".csv",))
    kind = _kind_of(results)
    refuse_others(context, _options_of(context, kind), f"does not apply to {kind}: omit it")
    has_documents = any(path is not None for path in (test_report, junit, control))
    _check_partners(context, test_report, control, truth, has_documents=has_documents)
    if kind is ResultKind.SCORES and len(results) == 1 and output is None and not has_documents:
        output = results[0].with_name("report.html")
    read = (*results, *(evidence or ()), truth)
    claim_outputs(json_path, output, test_report, junit, control, inputs=read, overwrite=overwrite)
    match kind:
        case ResultKind.SCORES:
            scores = _read_scores(results, are_compared=len(results) > 1 and not has_documents)
            if has_documents:
                _write_documents(scores, (title, number, issue), evidence or (), test_report, junit, control)
            elif len(scores) == 1 and output is not None:
                _write_score(next(iter(scores.values())), output, json_path)
            else:
                _compare_scores(results, list(scores.values()), output, json_path)
            say_deviations(list(scores.values()), err=json_path == STANDARD_OUTPUT)
            conclude_all(scores, requires_common_verdict=has_documents, lenient=lenient)
        case ResultKind.SUITES:
            _compare_suites(results, output, json_path, lenient=lenient)
        case ResultKind.TRAJECTORIES:
            settings = {"align": align, "max_difference": max_difference}
            config = build(AlignedErrorConfig, settings, origin="", called=option_names(context))
            _draw(results, truth, config, output)


def _kind_of(results: Sequence[Path]) -> ResultKind:
    """Return the kind of results; raise ConfigError if the results are of several kinds."""
    others = [path for path in results if suffix_of(path) != ".json"]
    if not others:
        return ResultKind.SCORES
    for path in results:
        if suffix_of(path) == ".json":
            raise ConfigError(f"'{path}' is a score, but '{others[0]}' is not: give only scores, or no scores")
    suites = [path for path in results if (path / "plan.json").is_file()]
    if not suites:
        return ResultKind.TRAJECTORIES
    for path in results:
        if path not in suites:
            raise ConfigError(
                f"'{suites[0]}' is a suite, but '{path}' is not, because it has no plan.json: give only suites, or no "
                "suites"
            )
    return ResultKind.SUITES


def _options_of(context: Context, kind: ResultKind) -> tuple[str, ...]:
    """Return the arguments and options that apply to a kind of results."""
    match kind:
        case ResultKind.SCORES:
            return (*OF_PAGE, *of_panels(context, DOCUMENTS), "lenient")
        case ResultKind.SUITES:
            return (*OF_PAGE, "lenient")
        case ResultKind.TRAJECTORIES:
            return ("results", "output", "overwrite", *of_panels(context, DRAWN))


def _check_partners(
    context: Context, test_report: Path | None, control: Path | None, truth: Path | None, *, has_documents: bool
) -> None:
    """Raise ConfigError if an option is given without the option that it requires, or with one that excludes it."""
    if has_documents:
        pages = ("output", "json_path")
        refuse_given(context, pages, "is not written with --test-report, --junit or --control: omit it")
    if test_report is None:
        refuse_given(context, OF_TEST_REPORT, "is shown in the test report: give --test-report T.html, too")
    if test_report is None and control is None:
        reason = "is shown in the test report: give --test-report T.html or --control F.csv, too"
        refuse_given(context, OF_HEADING, reason)
    if truth is None:
        refuse_given(context, ("align", "max_difference"), "compares with the ground truth: give --truth TRUTH, too")


def _read_scores(paths: list[Path], *, are_compared: bool) -> dict[str, Score]:
    """Return the scores of files, each judged by its limits; a score whose limits are unavailable has a caveat.

    A score with an input that was changed since has a caveat, and no pass unless scores `are_compared`. The keys are
    the files. ConfigError if a file is given twice.
    """
    from sfr_loc_map.metrics.judging.several_scores import each_by_its_limits
    from sfr_loc_map.metrics.stored.score_json import load_score
    from sfr_loc_map.scoring.provenance import limits_not_seen, with_changed_inputs

    scores = []
    for path in paths:
        if paths.count(path) > 1:
            raise ConfigError(f"'{path}' is given {paths.count(path)} times: give each score once")
        loaded = load_score(path)
        score = loaded
        if (unseen := limits_not_seen(score, str(path))) is not None:
            score = score.with_caveat(unseen)
        score = with_changed_inputs(score, str(path), is_judged=not are_compared)
        for text in score.warnings[len(loaded.warnings) :]:
            warn(text)
        scores.append(score)
    return dict(zip(map(str, paths), each_by_its_limits(scores), strict=True))


def _write_score(score: Score, page: Path, json_path: str | None) -> None:
    """Write the page of one score, or its tables as Markdown or CSV, and its JSON if requested."""
    from sfr_loc_map.metrics.stored.score_json import to_dict
    from sfr_loc_map.report.page import render_page
    from sfr_loc_map.report.score_tables import score_markdown, score_tables
    from sfr_loc_map.tables.formats import to_csv

    if suffix_of(page) == ".md":
        text = score_markdown(score)
    elif suffix_of(page) == ".csv":
        text = to_csv(score_tables(score))
    else:
        text = render_page(score)
    write_text(text, page)
    if json_path is not None:
        show(to_dict(score), json_path, ())
    say(f"report: {page}", err=json_path is not None)
    if suffix_of(page) in HTML_SUFFIXES:
        propose_page(page)


def _write_documents(
    scores: dict[str, Score],
    heading: tuple[str, str, str],
    evidence: Sequence[Path],
    test_report: Path | None,
    junit: Path | None,
    control: Path | None,
) -> None:
    """Write the test report, the JUnit file and the control document, each if requested.

    `heading` has the title, the number and the issue of the test report. The evidence is read before a file is written,
    because invalid evidence is refused.
    """
    from sfr_loc_map.evidence.report_evidence import read_evidence
    from sfr_loc_map.report.test_report import render_test_report

    found = read_evidence(evidence)
    in_order = list(scores.values())
    if junit is not None:
        with secondary_output():
            write_junit(in_order, junit)
    if test_report is not None:
        with secondary_output():
            write_text(render_test_report(in_order, *heading, found), test_report)
            say(f"test report: {test_report}")
            propose_page(test_report, ", print it for the signatures")
    if control is not None:
        with secondary_output():
            _, number, issue = heading
            _write_control_document(scores, control, (number, issue))


def _write_control_document(scores: dict[str, Score], control: Path, report: tuple[str, str]) -> None:
    """Write the verification control document; `report` has the number and the issue of the test report."""
    from sfr_loc_map.report.control_document import control_csv

    number, issue = report
    parts = [f"test report {number}"] if number else []
    parts += [f"issue {issue}"] if issue else []
    write_text(control_csv(scores, ", ".join(parts)), control)
    say(f"verification control document: {control}")


def _compare_scores(paths: list[Path], scores: list[Score], page: Path | None, json_path: str | None) -> None:
    """Compare scores of the same data, of one method or of several, paired by sub-trajectory."""
    from sfr_loc_map.metrics.comparison import compare_scores
    from sfr_loc_map.report.comparison import FIRST_TABLES, comparison_tables, summary_of
    from sfr_loc_map.report.methods_page import methods_plots, methods_tables, names_of
    from sfr_loc_map.report.page import render_overview
    from sfr_loc_map.report.summary import Banner

    check_suffix(page, HTML_SUFFIXES)
    names = names_of(paths, scores)
    result = compare_scores(scores, names)
    tables = [*methods_tables(scores, names), *comparison_tables(result)]
    if page is not None:
        banner, plots = Banner.without_verdict(*summary_of(result)), methods_plots(scores, names)
        write_text(render_overview("Comparison of scores", banner, tables, plots, FIRST_TABLES), page)
        propose_page(page)
    else:
        propose_again("-o comparison.html", why="the same as a page with figures")
    shown = [table for table in tables if table.name != "provenance"]  # too wide for a terminal; the page has it
    show(result.to_dict(), json_path, shown)


def _compare_suites(folders: list[Path], page: Path | None, json_path: str | None, *, lenient: bool) -> None:
    """Compare two suites over their common drives: better, worse, or no difference shown.

    As for scores, the error that is raised corresponds to the verdicts of both suites.
    """
    from sfr_loc_map.metrics.config import VerdictState
    from sfr_loc_map.report.page import render_overview
    from sfr_loc_map.report.summary import Banner
    from sfr_loc_map.suite.pages.tables import comparison_tables
    from sfr_loc_map.suite.statistics.comparison import compare_suites
    from sfr_loc_map.suite.statistics.summary import summarise
    from sfr_loc_map.suite.statistics.verdict_texts import verdict_texts_of
    from sfr_loc_map.suite.store import Store

    if len(folders) != 2:
        what = "sfr suite report makes the page of one" if len(folders) == 1 else "sfr suite history takes several"
        raise ConfigError(f"{counted(len(folders), 'suite')} given: exactly two are compared; {what}")
    check_suffix(page, HTML_SUFFIXES)
    summaries = reference, compared = [summarise(Store(folder)) for folder in folders]
    result = compare_suites(reference, compared, (str(folders[0]), str(folders[1])))
    tables = comparison_tables(result)
    if page is not None:
        write_text(render_overview("Comparison of suites", Banner.without_verdict("tables", ""), tables), page)
        propose_page(page)
    else:
        propose("sfr", "suite", "history", *folders, why="when and where the figures got worse")
    show(result.to_dict(), json_path, tables)
    failures: list[str] = []
    reasons: list[str] = []
    for folder, summary in zip(folders, summaries, strict=True):
        outcome = verdict_texts_of(summary)
        failures += [f"{folder}: {text}" for text in outcome.failures]
        if summary.verdict is not VerdictState.PASS and summary.is_judged:
            open_texts = (*outcome.without_result, *outcome.waiting, *outcome.incomplete, *outcome.undecided)
            reasons += [f"{folder}: {text}" for text in open_texts]
    if failures:
        raise FailedVerdictError("; ".join(failures))
    not_judged(reasons, lenient=lenient)


def _draw(paths: list[Path], truth: Path | None, config: AlignedErrorConfig, page: Path | None) -> None:
    """Draw trajectories from above and in height; with a truth, also their distance to the truth."""
    from sfr_loc_map.report.path_plot import curves_of, save_path_html
    from sfr_loc_map.scoring.load_trajectories import load_trajectories

    if page is None or suffix_of(page) not in HTML_SUFFIXES:
        raise ConfigError("trajectories are drawn on a page: give -o PAGE.html")
    poses, true_poses = load_trajectories(paths, truth)
    curves = curves_of(poses, true_poses, config)
    save_path_html(curves, page)
    say(f"figures of {', '.join(curve.name for curve in curves)}: {page}", err=True)
    propose("sfr score EST TRUTH    # the figures, with limits a verdict")
