"""The clause of each figure is the one that defines it in the document, or none."""

import re

import pytest

from sfr_loc_map.metrics.figures import catalogue
from sfr_loc_map.metrics.figures.catalogue import (
    CATALOGUE,
    CLAUSES_OF_MEMORY,
    KINDS,
    OF_SUB_TRAJECTORIES,
    STANDARD_DEVIATION,
    TOTAL,
    clause_of,
    defines,
    statistic_title,
)
from sfr_loc_map.metrics.figures.row_part import RowPart
from sfr_loc_map.metrics.figures.rows import NUMBERS
from sfr_loc_map.metrics.formulas import QUANTILES, STATISTICS
from sfr_loc_map.metrics.judging.limited import EXPANSION
from sfr_loc_map.suite.search.specification import CHOICES

CLAUSES = {
    # "the Cartesian difference between the estimated displacement and the actual displacement"
    ("position", "pose"): "4.2.3.1",
    # "the magnitude of the shortest-path rotation between the estimated and actual attitude"
    ("attitude", "pose"): "4.2.3.2",
    # "measured in degrees about the vertical axis of the global frame"
    ("heading", "pose"): "4.2.3.3",
    # sub-trajectories that the document does not choose
    ("position", "moving"): "",
    ("heading", "other frames"): "",
    ("attitude", "5 m"): "",
    ("position", "0.5 m"): "",
    ("position", "pooled"): "4.2.3.1",
    # "for each point in the point cloud"
    ("point_error", None): "4.3.4",
    # "elapsed on the target hardware (GR740 development board) between the processing API being invoked and the
    # function returning with an estimate": neither the time of another host, nor that of a stage
    ("localisation", None): "",
    ("localisation", "target"): "4.2.1",
    ("localisation", "target align"): "",
    ("localisation", "first call"): "",
    ("mapping_call", "target"): "4.3.1",
    ("mapping_call", None): "",
    ("mapping", "target"): "",
    ("fusion", "target"): "",
    # "The supplier shall propose a suitable methodology": on whatever host
    ("peak", "localisation"): "4.2.2",
    ("peak", "target localisation"): "4.2.2",
    ("peak", "mapping_call"): "4.3.2",
    ("peak", "target mapping_call"): "4.3.2",
    ("above_idle", "mapping_call"): "4.3.2",
    # of a stage of the call
    ("peak", "target mapping"): "",
    ("above_idle", "fusion"): "",
    ("heap_peak", "target localisation"): "4.2.2",
    # not in the document
    ("coverage", None): "",
    ("lost", None): "",
    ("judged", None): "",
    ("chord", "pose"): "",
    ("nees", "pose"): "",
    ("ape", "translation"): "",
}


@pytest.mark.clause("4.2.1", "4.2.2", "4.2.3.1", "4.2.3.2", "4.2.3.3", "4.3.1", "4.3.2", "4.3.4")
@pytest.mark.parametrize(("figure", "part"), CLAUSES)
def test_clause_of_a_figure(figure: str, part: str | None) -> None:
    assert clause_of(figure, RowPart.of(part)) == CLAUSES[figure, part]


def test_every_clause_of_the_catalogue_has_a_text() -> None:
    used = {kind.clause for kind in CATALOGUE} | set(CLAUSES_OF_MEMORY.values()) | {*OF_SUB_TRAJECTORIES}
    assert used - {""} | {STANDARD_DEVIATION} == set(catalogue.CLAUSES)


def test_every_list_of_statistics_follows_the_columns_of_the_table() -> None:
    """Quantiles have their percentage, a search can be about each statistic, and each has its error of the truth."""
    assert {*QUANTILES} == {name for name in STATISTICS if re.fullmatch(r"p\d+(_\d+)?", name)}
    assert all(int(name[1:3]) == int(percent) for name, percent in QUANTILES.items())
    assert set(CHOICES) == {*STATISTICS, "value"}
    assert set(EXPANSION) == set(STATISTICS)


def test_the_catalogue_names_each_figure_once_and_statistics_that_exist() -> None:
    assert len(KINDS) == len(CATALOGUE)
    for kind in CATALOGUE:
        assert {*kind.shown, *kind.compared, *kind.tested} <= set(NUMBERS), kind.name


def test_a_quantile_is_named_by_its_percentage(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(QUANTILES, "p997", 99.7)
    assert [statistic_title(name) for name in ("p95", "p997", TOTAL)] == ["p95", "p99.7", "mean + 3 sigma"]


def test_the_document_defines_mean_and_sigma_of_its_figures_and_no_bound_or_direction() -> None:
    assert defines("position", RowPart("pose"), "mean_plus_3sigma")
    assert defines("localisation", RowPart("target"), "p95")
    for figure, part, statistic in (
        ("position", "pose", "p95"),
        ("position", "pose", "bound"),
        ("position", "along", "mean"),
        ("point_error", None, "mean_plus_3sigma"),
        ("chord", "pose", "mean"),
    ):
        assert not defines(figure, RowPart.of(part), statistic), (figure, part, statistic)
