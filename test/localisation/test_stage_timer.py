import time

import pytest

from sfr_loc_map.localisation.stage_timer import StageTimer


def test_times_of_a_stage_are_summed_and_stages_stand_apart() -> None:
    timer = StageTimer()
    for _ in range(2):
        with timer("slow"):
            time.sleep(0.01)
    with timer("fast"):
        pass
    assert timer.seconds["slow"] >= 0.02 > timer.seconds["fast"] >= 0.0
    assert list(timer.seconds) == ["slow", "fast"]


def test_a_stage_that_fails_is_timed_too() -> None:
    timer = StageTimer()
    with pytest.raises(ValueError, match="broken"), timer("failing"):
        raise ValueError("broken")
    assert "failing" in timer.seconds
