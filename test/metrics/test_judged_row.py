"""Which row is judged does not depend on the order of the rows."""

import numpy as np
import pytest
from msgspec.structs import replace

from helpers.made_scores import whole_score
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.metrics.config import Reading
from sfr_loc_map.metrics.figures.row_part import POOLED
from sfr_loc_map.metrics.figures.rows import figure_row
from sfr_loc_map.metrics.judging.judge import judged_by
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.metrics.score.score import Score

LIMITS = {
    "trajectory": [{"condition": "distance=5", "position_p95_m": 1.0, "attitude_mean_plus_3sigma_deg": 1.0}],
    "map": {"point_error_p95_m": 1.0, "coverage_min": 0.5},
    "timing": {"localisation_p95_s": 1.0},
    "memory": {"mapping_peak_bytes": 1.0},
}


@pytest.mark.parametrize("reading", [Reading.POSE, Reading.DISPLACEMENT])
def test_verdicts_are_of_the_reading_that_is_judged_whatever_the_order_of_rows(reading: Reading) -> None:
    score = whole_score()
    assert score.association is not None
    score = replace(score, association=replace(score.association, reading=reading))
    limits = parse_limits(LIMITS, "test")
    score = judged_by(score, limits)
    expected = [(item.name, item.part, item.value) for item in score.verdicts]
    assert {part for name, part, _ in expected if name.startswith(("position_", "attitude_"))} == {str(reading)}
    assert {part for name, part, _ in expected if name.startswith(("point", "coverage", "localisation"))} == {None}
    rng = np.random.default_rng(1)
    for _ in range(20):
        figures = list(score.figures)
        rng.shuffle(figures)  # type: ignore[arg-type]
        shuffled = judged_by(replace(score, figures=tuple(figures)), limits)
        assert [(item.name, item.part, item.value) for item in shuffled.verdicts] == expected
        assert shuffled.figure("position", condition="distance=5") == score.judged_row("position")


def test_rows_over_all_drives_are_judged_where_there_is_no_reading() -> None:
    rows = [figure_row("position", "distance=5", part, n=3, mean=0.1) for part in ("x", POOLED, "y")]
    found = Score(figures=tuple(rows)).judged_row("position")
    assert found is rows[1]
    assert Score(figures=(rows[0],)).judged_row("position") is None


def test_a_figure_that_has_parts_alone_is_not_guessed() -> None:
    rows = [figure_row("peak", part=part, value=1.0) for part in ("localisation", "target localisation")]
    score = Score(figures=tuple(rows))
    with pytest.raises(
        ConfigError, match=r"'peak' has no row .*: give part=, one of localisation, target localisation"
    ):
        score.figure("peak")
    assert score.figure("peak", part="target localisation") is rows[1]
    assert score.figure("peak", part="mapping") is None
    assert score.number("position", "mean") is None


@pytest.mark.parametrize(("absent", "state"), [(0.0, "pass"), (0.5, "incomplete")])
def test_a_figure_of_a_part_that_is_not_complete_does_not_pass(absent: float, state: str) -> None:
    """Half of the mapping pairs have no point in the cloud: the error of the other half passes nothing."""
    rows = (
        figure_row("point_error", n=100, mean=0.01, sigma=0.01, p95=0.02),
        figure_row("judged", part="map", n=2, value=1.0 - absent),
        figure_row("pairs_without_cloud", n=2, value=absent),
    )
    score = judged_by(Score(figures=rows), parse_limits({"map": {"point_error_p95_m": 1.0}}, "test"))
    assert [item.state for item in score.verdicts if item.name == "point_error_p95_m"] == [state]
    assert score.verdict == state


@pytest.mark.parametrize(
    ("figure", "share", "state"),
    [
        ("points_without_truth", 0.01, "pass"),
        ("points_without_truth", 0.05, "incomplete"),
        ("pixels_without_point", 0.5, "pass"),
        ("pixels_without_point", 0.51, "incomplete"),
    ],
)
def test_a_share_of_a_map_may_be_absent(figure: str, share: float, state: str) -> None:
    """One point in a hundred may lack a truth, and half of the true pixels may lack a point."""
    rows = (
        figure_row("point_error", n=100, mean=0.01, sigma=0.01, p95=0.02),
        figure_row("judged", part="map", n=2, value=1.0),
        figure_row(figure, n=100, value=share),
    )
    limits = parse_limits({"map": {"point_error_p95_m": 1.0}}, "test")
    assert judged_by(Score(figures=rows), limits).verdict == state


def test_a_limit_without_a_figure_keeps_the_others_from_a_pass() -> None:
    rows = (
        figure_row("point_error", n=100, mean=0.01, sigma=0.01, p95=0.02),
        figure_row("judged", part="map", n=2, value=1.0),
    )
    limits = parse_limits({"map": {"point_error_p95_m": 1.0, "point_error_p99_m": 1.0}}, "test")
    assert judged_by(Score(figures=rows), limits).verdict == "not enough data"


@pytest.mark.parametrize(
    ("part", "figure", "share"),
    [("drive", "missing", 0.005), ("drive", "images_without_truth", 0.005), ("map", "points_not_finite", 0.001)],
)
def test_the_least_shortfall_is_incomplete(part: str, figure: str, share: float) -> None:
    limits = parse_limits({"completeness": {"lost_max_share": 1.0}}, "test")
    for value, verdict in ((0.0, "pass"), (share, "incomplete")):
        rows = (
            figure_row("lost", n=1000, value=0.0),
            figure_row("judged", part=part, n=1000, value=1.0 - value),
            figure_row(figure, n=1000, value=value),
        )
        assert judged_by(Score(figures=rows), limits).verdict == verdict
