"""Findings on the calls of a method: a leak, misstated times, invalid replies, a slow start and too many starts."""

from pathlib import Path

import pytest

from helpers.made_scene import LOC_RIG, NAV_RIG, loc_pair, nav_pair, true_pose
from sfr_loc_map.inputs import Task
from sfr_loc_map.methods.isolated_localiser import IsolatedLocaliser
from sfr_loc_map.methods.isolated_mapper import IsolatedMapper
from sfr_loc_map.methods.method_process import LEAK_CALLS, MB, MethodFailureError, is_misstated, leak_in
from sfr_loc_map.methods.registry import MethodLimits, find_method
from sfr_loc_map.metrics.records import FindingKind

CLASSES = """
import os, time
from contextlib import suppress

class Replying:
    def __init__(self, rig, config):
        pass
    def process(self, pair):
        for place in range(3, 20):
            with suppress(OSError):
                os.write(place, b'{"fault": "bad weather"}\\n')

class Aborting:
    def __init__(self, rig, config):
        pass
    def process(self, pair, T_lm_navsb, index):
        os.abort()

class Sleeping:
    def __init__(self, rig, config):
        time.sleep(60)
    def process(self, pair):
        pass
"""


def test_a_growth_over_all_calls_is_a_leak_and_a_saw_tooth_is_none() -> None:
    tooth = [90 * MB * (number % 4) for number in range(LEAK_CALLS)]
    assert not leak_in(tooth)
    assert leak_in([level + 2 * number * MB for number, level in enumerate(tooth)]).startswith("leaking")


def test_a_window_that_fills_and_then_stays_flat_is_no_leak() -> None:
    """The memory of our own localiser without a warm-up: libraries and a window of 30 keyframes, then 0.1 MB."""
    filling = [165 * MB + min(number, 30) * 1_300_000 + number // 40 * MB // 10 for number in range(210)]
    windows = range(LEAK_CALLS, len(filling) + 1)
    assert not any(leak_in(filling[last - LEAK_CALLS : last]) for last in windows)
    leaking = [level + 2 * MB * max(number - 40, 0) for number, level in enumerate(filling)]
    assert any(leak_in(leaking[last - LEAK_CALLS : last]) for last in windows)


def test_a_transfer_of_the_result_is_no_misstatement() -> None:
    assert not is_misstated(measured_s=0.9, stated_s=0.1, calls=20)  # one delayed call
    assert not is_misstated(measured_s=26.0, stated_s=16.0, calls=20)  # less than half of the calls
    assert not is_misstated(measured_s=2.0, stated_s=0.008, calls=400)  # a fast method in a long drive
    assert is_misstated(measured_s=1.6, stated_s=0.16, calls=20)
    assert is_misstated(measured_s=0.10, stated_s=3.00, calls=20)


def test_a_reply_with_an_unknown_fault_is_an_invalid_result(tmp_path: Path) -> None:
    (tmp_path / "classes.py").write_text(CLASSES)
    method = find_method(f"{tmp_path}/classes.py:Replying", Task.LOCALISATION)
    with IsolatedLocaliser(method, LOC_RIG, true_pose(0), hidden=()) as localiser:
        _, call = localiser.localise(loc_pair(0))
    assert call.finding.startswith("invalid result: invalid answer of the adapter")


def test_pairs_after_too_many_crashes_of_a_mapper_have_no_finding(tmp_path: Path) -> None:
    (tmp_path / "classes.py").write_text(CLASSES)
    method = find_method(f"{tmp_path}/classes.py:Aborting", Task.MAPPING)
    with IsolatedMapper(method, NAV_RIG, MethodLimits(restarts=1), hidden=()) as mapper:
        item = nav_pair(0)
        made = [mapper.map_pair(item.pair, item.T_lm_navsb, index) for index in range(3)]
    assert [call.finding.partition(":")[0] for _, call in made] == ["crashed", "crashed", ""]
    assert made[1][1].finding.endswith("not started again after 2 starts")
    assert made[2][1].reason == "not started again"
    assert not any(len(part.cloud) for part, _ in made)


def test_a_start_without_an_answer_is_a_hanging_method(tmp_path: Path) -> None:
    (tmp_path / "classes.py").write_text(CLASSES)
    method = find_method(f"{tmp_path}/classes.py:Sleeping", Task.LOCALISATION)
    with pytest.raises(MethodFailureError, match="has not answered for 3 s") as raised:
        IsolatedLocaliser(method, LOC_RIG, true_pose(0), MethodLimits(start_timeout_s=3.0), hidden=())
    assert raised.value.kind is FindingKind.HANGING
