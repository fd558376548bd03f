"""A table of figures that was edited while the raw values of its file were left: each edit is found and named."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace
from sfr_loc_map.metrics.stored.raw_values import fault_of_raw_values
from sfr_loc_map.metrics.stored.related_rows import fault_of_related_rows

from helpers.cli_result import Sfr
from helpers.made_scores import calls, cloud, drive
from sfr_loc_map.metrics.calls.call_score import score_calls, with_external
from sfr_loc_map.metrics.completeness.expected_items import answers_completeness
from sfr_loc_map.metrics.config import MapScoreConfig, TrajectoryScoreConfig
from sfr_loc_map.metrics.errors.map_score import score_map
from sfr_loc_map.metrics.errors.trajectory_score import score_trajectory
from sfr_loc_map.metrics.figures.details import Details
from sfr_loc_map.metrics.figures.records import AnswerCounts, ExternalScore
from sfr_loc_map.metrics.formulas import Statistics
from sfr_loc_map.metrics.judging.judge import judged_by
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.stored.score_json import to_json

LIMITS = {"trajectory": [{"condition": "distance=5", "position_p95_m": 1.0}]}


def scored(frames: int, side: int, *, bounded: bool = False) -> Score:
    """A score of a drive, a map and calls; of long ones every n-th value is kept."""
    kept = {("position", "distance=5")} if bounded else ()
    driven = score_trajectory(
        *drive(frames), TrajectoryScoreConfig(conditions=("distance=5",), spacing=1), kept_errors=kept
    )
    mapped, called = score_map(*cloud(side, 2), MapScoreConfig()), score_calls(calls(frames, 2))
    return Score(
        figures=(*driven.figures, *mapped.figures, *called.figures),
        association=driven.association,
        truth=driven.truth,
        details=Details(trajectory=driven.details, map=mapped.details, calls=dict(called.plots)),
        errors=driven.errors,
    )


def fault_of(score: Score) -> str | None:
    """The first contradiction of the figures of a score."""
    return fault_of_raw_values(score) or fault_of_related_rows(score)


def edited(score: Score, figure: str, statistic: str, factor: float, part: str | None) -> Score:
    rows = list(score.figures)
    place = next(n for n, row in enumerate(rows) if (row.figure, row.part) == (figure, part))
    rows[place] = replace(rows[place], **{statistic: factor * getattr(rows[place], statistic)})
    return replace(score, figures=tuple(rows))


@pytest.mark.parametrize("long", [False, True])
@pytest.mark.parametrize(
    ("figure", "part"), [("position", "pose"), ("chord", "pose"), ("point_error", None), ("localisation", None)]
)
@pytest.mark.parametrize("statistic", ["p50", "p95", "p99", "max", "mean"])
def test_a_statistic_that_was_made_smaller_contradicts_the_raw_values(
    figure: str, part: str | None, statistic: str, *, long: bool
) -> None:
    score = scored(5000, 200) if long else scored(300, 48)
    assert fault_of(score) is None
    thinned_mean = long and statistic == "mean" and figure != "localisation"
    problem = fault_of(edited(score, figure, statistic, 0.1 if long else 0.95, part))
    if thinned_mean:  # a sample bounds the mean by the root mean square alone
        assert fault_of(edited(score, figure, "rmse", 0.1, part)) is not None
    else:
        assert problem is not None
        assert problem.startswith(f"'{statistic}' of '{figure}"), problem


@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_the_slowest_call_contradicts_another_maximum_without_other_rows(factor: float) -> None:
    """The rows of the parts of the calls, which have the maximum, too, may be absent."""
    changed = edited(scored(6000, 48), "localisation", "max", factor, None)
    assert "its calls give" in (fault_of_raw_values(changed) or "")


@pytest.mark.parametrize("bounded", [False, True])
def test_an_interval_that_was_changed_contradicts_the_errors(*, bounded: bool) -> None:
    """The number of independent errors follows from the frames of all sub-trajectories, if the details have them."""
    score = scored(5000 if bounded else 300, 8, bounded=bounded)
    assert fault_of(score) is None
    for name in ("low95", "high95") if bounded else ("low95", "high95", "independent"):
        problem = fault_of(edited(score, "position", name, 1.01, "pose"))
        assert problem is not None
        assert problem.startswith(f"'{name}' of 'position")


@pytest.mark.parametrize("statistic", ["mean", "sigma"])
def test_an_axis_that_was_made_smaller_contradicts_the_position_error(statistic: str) -> None:
    """A suite pools the axes."""
    score = scored(300, 8)
    assert fault_of(score) is None
    problem = fault_of(edited(score, "position", statistic, 0.9, "x"))
    assert problem is not None
    assert "axes" in problem


@pytest.mark.parametrize("frames", [300, 5000])
def test_a_score_that_is_older_than_a_statistic_does_not_contradict_itself(frames: int) -> None:
    """A row without the statistic is accepted; a row without its number of values is not."""
    score = scored(frames, 48)
    older = replace(score, figures=tuple(replace(row, p99=None) for row in score.figures))
    assert fault_of(older) is None
    uncounted = replace(score, figures=tuple(replace(row, n=None) for row in score.figures))
    assert (fault_of(uncounted) or "").startswith("'n' of")


def test_a_limited_figure_keeps_all_errors_of_a_long_drive() -> None:
    """One part in a million is found, and a number of errors that is one less."""
    score = scored(5000, 48, bounded=True)
    assert fault_of(score) is None
    for statistic in ("p50", "p95", "max", "mean", "sigma"):
        assert fault_of(edited(score, "position", statistic, 1.0 - 1e-6, "pose")) is not None
    rows = [replace(row, n=(row.n or 0) - 1) if row.figure == "position" else row for row in score.figures]
    assert (fault_of(replace(score, figures=tuple(rows))) or "").startswith("'n' of 'position")


def test_counts_and_fractions_of_completeness_agree() -> None:
    score = scored(300, 48)
    for name in ("missing", "doubled", "poses_of_truth", "points_without_truth"):
        for part in ("count", None):
            rows = [
                replace(row, value=0.25) if (row.figure, row.part) == (name, part) else row for row in score.figures
            ]
            assert (fault_of(replace(score, figures=tuple(rows))) or "").startswith(f"'{name}'")


def test_the_calls_of_an_external_node_are_compared_with_its_statements_and_not_with_its_latencies() -> None:
    score = scored(300, 48)
    node = ExternalScore(
        task="localisation",
        topic="odometry",
        frames="world -> camera",
        answers=AnswerCounts(pairs=300, answered=300),
        latency_s=Statistics(n=300, mean=1.5, rmse=1.5, max=2.0),
    )
    external = with_external(score_calls(calls(300, 2)), node)
    others = [row for row in score.figures if row.subject not in ("calls", "memory")]
    of_answers = answers_completeness(node)
    score = replace(score, figures=(*others, *external.figures, *of_answers), external=node)
    assert fault_of(score) is None
    fewer = replace(node, answers=AnswerCounts(pairs=300, answered=299, missing=1))
    assert "answers of the node give" in (fault_of(replace(score, external=fewer)) or "")
    problem = fault_of(edited(score, "localisation", "max", 0.9, "stated"))
    assert problem is not None
    assert "localisation" in problem


def test_the_errors_of_each_limited_figure_of_a_drive_are_kept() -> None:
    assert parse_limits({**LIMITS, "timing": {"localisation_max_s": 1.0}}, "test").figures_with_all_errors == {
        ("position", "distance=5")
    }


def test_a_file_whose_table_was_edited_is_refused_by_the_report(tmp_path: Path, sfr: Sfr) -> None:
    """The verdicts follow from the edited table; the errors of its sub-trajectories do not."""
    path, limits = tmp_path / "s.json", parse_limits({**LIMITS, "minimum_independent": 1}, "test")
    good = judged_by(scored(300, 48), limits, partial=True)
    path.write_text(to_json(good))
    assert sfr("report", path, "-o", tmp_path / "page.html").code in (0, 3)
    path.write_text(to_json(judged_by(edited(good, "position", "p95", 0.01, "pose"), limits, partial=True)))
    done = sfr("report", path, "-o", tmp_path / "page.html", "--overwrite")
    assert done.code == 2
    assert "contradicts itself: 'p95' of 'position distance=5 pose' is" in done.err
