"""`sfr check` over a small drive: the five runs, what they compare, and that a broken one is found."""

from __future__ import annotations

import pytest

from helpers.loc_drive import drive
from helpers.made_scene import LOC_RIG
from sfr_loc_map.errors import InputError
from sfr_loc_map.evidence.check import check_drive, check_table
from sfr_loc_map.evidence.variants import PairsInMemory, Run
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.metrics.config import Condition
from sfr_loc_map.metrics.score import Score


def test_a_drive_agrees_with_itself_and_every_comparison_is_a_row() -> None:
    sequence = PairsInMemory(LOC_RIG, drive(40))
    condition = Condition.parse("frames=5")
    found = check_drive(sequence, LocalisationConfig(), [condition], 40)
    assert found.result in ("consistent", "inconsistent")
    names = ["forward - backward", "forward - every second pair", "left half - right half"]
    assert [item.name for item in found.agreements] == names
    score = Score(figures=found.figures)
    for item in found.agreements:
        assert len(item.windows.squares) >= 3
        row = score.figure("error_at_least", part=item.name)
        assert row.value == pytest.approx(0.5 * score.figure("difference", part=item.name).rmse)
        assert row.value < 0.05
    assert [row[0].text for row in check_table(found).rows] == names
    again = check_drive(sequence, LocalisationConfig(), [condition], 40, [Run("ours", found.forward.estimates)])
    assert again.result == found.result
    same = Score(figures=again.figures).figure("difference", part="forward - ours")
    assert same.max == pytest.approx(0.0, abs=1e-12)


def test_a_short_drive_is_refused() -> None:
    with pytest.raises(InputError, match="at least 20"):
        check_drive(PairsInMemory(LOC_RIG, drive(10)), LocalisationConfig(), [Condition.parse("frames=5")], 40)
