"""`sfr report`, `sfr compare`, `sfr plot`: pages, tables and figures of what has been scored or estimated."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from sfr_loc_map.cli.app import app, examples, propose
from sfr_loc_map.cli.options import Align, OutputOptions, OverwriteOption
from sfr_loc_map.cli.output import HTML_SUFFIXES, check_outputs, check_suffix, say, show
from sfr_loc_map.config import build
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.io.atomic import write_text
from sfr_loc_map.io.bag_files import is_bag
from sfr_loc_map.metrics.config import AlignedErrorConfig

if TYPE_CHECKING:
    from sfr_loc_map.metrics.score import Score


FORMATS = (*HTML_SUFFIXES, ".md", ".csv")


@app.command(
    epilog=examples("sfr report out/report.json -o page.html", "sfr report out/report.json -o tables.md"),
    hint="sfr compare A.json B.json    # which of two runs is better",
)
def report(
    scores: Annotated[
        list[Path], Argument(metavar="SCORE.json", help="Score, as sfr score --json or sfr replay write.")
    ],
    output: Annotated[
        Path | None, Option("-o", "--output", metavar="F", help="*.html, *.md or *.csv; report.html beside the score.")
    ] = None,
    test_report: Annotated[
        Path | None, Option(metavar="T.html", help="Write the test report of one score or several, to be signed.")
    ] = None,
    title: Annotated[str, Option(metavar="TEXT", help="Title of the test report.")] = "",
    junit: Annotated[Path | None, Option(metavar="F.xml", help="Write the verdicts as JUnit XML.")] = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Make the report page, or tables, of a score; or the test report of several."""
    from sfr_loc_map.report.page import load_score, render_page
    from sfr_loc_map.report.score_tables import score_markdown, score_tables
    from sfr_loc_map.report.tables import to_csv
    from sfr_loc_map.report.test_report import junit as junit_of
    from sfr_loc_map.report.test_report import render_test_report

    if test_report is not None or junit is not None:
        if output is not None:
            raise ConfigError(f"'-o {output}' is the page of one score: leave it out beside '--test-report', '--junit'")
        check_suffix(test_report, HTML_SUFFIXES)
        check_outputs(test_report, junit, overwrite=overwrite)
        all_scores = [load_score(path) for path in scores]
        if junit is not None:
            write_text(junit_of({f"score {n}": score for n, score in enumerate(all_scores, 1)}), junit)
        if test_report is not None:
            write_text(render_test_report(all_scores, title), test_report)
            say(f"test report: {test_report}")
            propose(f"open {test_report} in a browser, print it for the signatures")
        return
    if len(scores) != 1:
        raise ConfigError(f"'{scores[1]}': a page is of one score; --test-report takes several, sfr compare compares")
    score = scores[0]
    output = score.with_name("report.html") if output is None else output
    check_suffix(output, FORMATS)
    loaded = load_score(score)
    check_outputs(output, overwrite=overwrite)
    if output.suffix == ".md":
        text = score_markdown(loaded)
    else:
        text = to_csv(score_tables(loaded)) if output.suffix == ".csv" else render_page(loaded)
    write_text(text, output)
    say(f"report: {output}")
    if output.suffix in HTML_SUFFIXES:
        propose(f"open {output} in a browser")


@app.command(
    epilog=examples(
        "sfr compare before.json after.json --html comparison.html",
        "sfr compare ours.json opencv.json node/report.json --html methods.html",
    ),
    hint="sfr compare A.json B.json --html comparison.html    # the same as a page with figures",
)
def compare(
    scores: Annotated[
        list[Path],
        Argument(metavar="A.json B.json ...", help="Scores of sfr score --json; the first is the reference."),
    ],
    output: OutputOptions,
) -> None:
    """Compare scores of the same data, of one method or of several, paired by sub-trajectory."""
    from sfr_loc_map.metrics.comparison import compare_scores
    from sfr_loc_map.report.comparison import comparison_tables, methods_figures, methods_tables, summary_of
    from sfr_loc_map.report.page import load_score, render_overview

    output.check()
    loaded = [load_score(path) for path in scores]
    names = _names(scores, loaded)
    result = compare_scores(loaded, names)
    tables = [*methods_tables(loaded, names), *comparison_tables(result)]
    if output.html is not None:
        heading, text = summary_of(result)
        figures = methods_figures(loaded, names)
        page = render_overview("Comparison of scores", None, text, tables, figures, heading=heading)
        write_text(page, output.html)
        propose(f"open {output.html} in a browser")
    shown = [table for table in tables if table.name != "provenance"]  # too wide for a terminal; the page has it
    show(result.to_dict(), output.json_path, shown)


def _names(paths: list[Path], scores: list[Score]) -> list[str]:
    """Return the methods' names where they tell the scores apart, otherwise names or paths of the files."""
    methods = [score.method.name.rpartition("/")[2] for score in scores if score.method is not None]
    for names in (methods, [path.name for path in paths], [str(path) for path in paths]):
        if len(set(names)) == len(paths):
            return names
    return [f"{number}: {path}" for number, path in enumerate(paths, 1)]


@app.command(
    epilog=examples(
        "sfr plot estimate.csv other.tum --truth data/ -o paths.html",
        "sfr plot 00.kitti --truth poses/00.txt --align se3 -o paths.html",
        "sfr plot estimate.csv -o path.html",
    ),
    hint="sfr score EST TRUTH    # the figures, with limits a verdict",
)
def plot(
    trajectories: Annotated[
        list[Path], Argument(metavar="T...", help="Trajectories: csv, TUM, KITTI, EuRoC, bags, sources with truth.")
    ],
    output: Annotated[Path, Option("-o", "--output", metavar="X.html", help="The page.")],
    truth: Annotated[
        Path | None, Option(metavar="TRUTH", help="True trajectory: also the distance of each to it.")
    ] = None,
    align: Annotated[Align, Option(help="Alignment of each with the truth.")] = "none",
    max_difference: Annotated[
        float, Option(metavar="S", help="Longest difference of the stamps of estimate and truth.")
    ] = 0.01,
    overwrite: OverwriteOption = False,
) -> None:
    """Draw trajectories from above, in height and, with --truth, their distance to it, for a quick look."""
    from sfr_loc_map.io.bag import Bag
    from sfr_loc_map.io.registry import read_truth
    from sfr_loc_map.report.path_figure import curves_of, save_path_html
    from sfr_loc_map.scoring.score_run import load_drive, load_estimates

    check_suffix(output, HTML_SUFFIXES)
    check_outputs(output, overwrite=overwrite)
    config = build(AlignedErrorConfig, {"align": align, "max_difference_s": max_difference}, origin="options")
    names = [path.name if sum(path.name == item.name for item in trajectories) == 1 else path for path in trajectories]
    poses, true_poses = {}, None
    for name, path in zip(map(str, names), trajectories, strict=True):
        is_source = path.is_dir()
        if is_bag(path):  # its truth is drawn where it has no estimates and nothing is compared
            is_source = truth is None and not Bag(path).matches("localisation/odometry")
        if truth is not None and not is_source:  # poses without stamps have those of the truth
            drive = load_drive(path, truth)
            poses[name], true_poses = drive.estimates.trajectory, true_poses or drive.truth
        else:
            poses[name] = read_truth(path) if is_source else load_estimates(path).trajectory
    if truth is not None and true_poses is None:
        true_poses = read_truth(truth)
    curves = curves_of(poses, true_poses, config)
    save_path_html(curves, output)
    say(f"{', '.join(curve.name for curve in curves)}: {output}", err=True)
