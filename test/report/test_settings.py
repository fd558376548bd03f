"""Settings that differ from their defaults: which they are, and their texts."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from helpers.made_scores import whole_score
from sfr_loc_map.configuration.parameters import flatten
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.figures.records import Provenance
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.stored.score_json import to_plain
from sfr_loc_map.report.deviations import deviations_of
from sfr_loc_map.report.settings import setting_text
from sfr_loc_map.report.summary import run_facts

DEFAULTS = to_plain(flatten(ScoreConfig()))


def with_settings(settings: dict[str, object]) -> Score:
    return replace(whole_score(), provenance=Provenance(version="9.9", configuration=settings))


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1e-6, "1e-06"),
        (1.0000001e-6, "1.0000001e-06"),
        (5.0, "5"),
        (10, "10"),
        (True, "True"),
        (None, "unknown"),
        ("pose", "pose"),
        ([0.5, None, "a"], "0.5, unknown, a"),
    ],
)
def test_different_values_have_different_texts(value: object, text: str) -> None:
    assert setting_text(value) == text


@pytest.mark.parametrize(
    ("settings", "header", "deviations"),
    [
        (DEFAULTS, "defaults", 0),
        (
            DEFAULTS | {"trajectory.association.tolerance_s": 1.0000001e-6},
            "trajectory.association.tolerance_s 1.0000001e-06",
            1,
        ),
        ({"trajectory.spacing": 10}, "other settings unknown", 1),
        ({"map.range_edges_m": [0.0, 4.5]}, "map.range_edges_m 0, 4.5; other settings unknown", 2),
    ],
)
def test_the_header_and_the_deviations_name_the_same_settings(
    settings: dict[str, object], header: str, deviations: int
) -> None:
    score = with_settings(settings)
    assert dict(run_facts(score))["Configuration"] == header
    assert len([text for text in deviations_of(score) if "etting" in text and "default" in text]) == deviations
