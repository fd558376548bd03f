"""Failures of the process of a method: invalid replies, a slow start and too many starts."""

import math
from collections.abc import Callable
from pathlib import Path

import pytest

from helpers.made_scene import LOC_RIG, NAV_RIG, loc_pair, nav_pair, true_pose
from sfr_loc_map.methods.child.loop import Answer
from sfr_loc_map.methods.isolated_localiser import IsolatedLocaliser
from sfr_loc_map.methods.isolated_mapper import IsolatedMapper
from sfr_loc_map.methods.method_call import MethodCall, MethodFailureError
from sfr_loc_map.methods.method_process import MethodProcess
from sfr_loc_map.methods.registry import MethodLimits, find_method
from sfr_loc_map.metrics.calls.call_meter import CallUsage
from sfr_loc_map.metrics.table.records import FindingKind
from sfr_loc_map.suite_names import Task

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


USAGE = CallUsage(7.5, peak_rss_bytes=1000)


def answering(answer: Answer, arrays: dict[str, bytes]) -> Callable[..., tuple[MethodCall, Answer, dict[str, bytes]]]:
    """Return a call of a process that takes 7.5 s and gives this answer."""
    return lambda *_, **__: (MethodCall(USAGE), answer, arrays)


def test_a_non_finite_uncertainty_of_the_step_is_a_finding(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "classes.py").write_text(CLASSES)
    method = find_method(f"{tmp_path}/classes.py:Replying", Task.LOCALISATION)
    pose = true_pose(0).matrix.ravel().tolist()
    with IsolatedLocaliser(method, LOC_RIG, true_pose(0), hidden=()) as localiser:
        monkeypatch.setattr(MethodProcess, "call", answering({"T_ds_rb": pose, "step": [0.0] * 47 + [math.inf]}, {}))
        estimate, call = localiser.localise(loc_pair(0))
    assert call.finding == "not finite: the uncertainty of the step contains a non-finite number"
    assert (call.step, call.usage, estimate.state.value) == (None, USAGE, "lost")


@pytest.mark.parametrize(
    ("answer", "arrays", "finding"),
    [({}, {"cloud": b"no array"}, "invalid result"), ({"stamp_ns": 1}, {}, "wrong stamp")],
)
def test_time_and_memory_of_a_call_of_a_mapper_with_an_invalid_result_are_kept(
    answer: Answer, arrays: dict[str, bytes], finding: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "classes.py").write_text(CLASSES)
    item = nav_pair(0)
    method = find_method(f"{tmp_path}/classes.py:Aborting", Task.MAPPING)
    with IsolatedMapper(method, NAV_RIG, hidden=()) as mapper:
        monkeypatch.setattr(MethodProcess, "call", answering(answer, arrays))
        _, of_pair = mapper.map_pair(item.pair, item.T_lm_navsb, 0)
        _, _, of_set = mapper.map_set([item])
    assert [call.finding.partition(":")[0] for call in (of_pair, of_set)] == [finding] * 2
    assert (of_pair.usage, of_set.usage) == (USAGE, USAGE)


def test_a_start_without_an_answer_is_a_hanging_method(tmp_path: Path) -> None:
    (tmp_path / "classes.py").write_text(CLASSES)
    method = find_method(f"{tmp_path}/classes.py:Sleeping", Task.LOCALISATION)
    with pytest.raises(MethodFailureError, match="has not answered for 3 s") as raised:
        IsolatedLocaliser(method, LOC_RIG, true_pose(0), MethodLimits(start_timeout_s=3.0), hidden=())
    assert raised.value.kind is FindingKind.HANGING
