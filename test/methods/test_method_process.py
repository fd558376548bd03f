"""Failures of the process of a method: invalid replies, a slow start and too many starts."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from helpers.made_scene import LOC_RIG, NAV_RIG, loc_pair, nav_pair, true_pose
from sfr_loc_map.calls.call_findings import findings_of
from sfr_loc_map.methods import call_monitor, scratch_folder
from sfr_loc_map.methods.child.loop import Answer
from sfr_loc_map.methods.isolated_localiser import IsolatedLocaliser
from sfr_loc_map.methods.isolated_mapper import IsolatedMapper
from sfr_loc_map.methods.method_call import MethodCall, MethodFailureError
from sfr_loc_map.methods.method_process import MethodProcess, Returned
from sfr_loc_map.methods.registry import MethodLimits, find_method
from sfr_loc_map.metrics.calls.call_meter import CallUsage
from sfr_loc_map.metrics.figures.records import CallFinding, FindingKind
from sfr_loc_map.suite_names import Task

CLASSES = """
import json, os, time
from contextlib import suppress
import numpy as np

class Replying:
    def __init__(self, rig, config):
        pass
    def process(self, pair):
        for place in range(3, 20):
            with suppress(OSError):
                os.write(place, b'{"fault": "bad weather"}\\n')

class Idle:
    def __init__(self, rig, config):
        pass
    def process(self, pair):
        pass

class Surplus:
    def __init__(self, rig, config):
        self.line = json.dumps({"seconds": 0.0, "result": {"T_ds_rb": None}, **json.loads(config)}) + "\\n"
    def process(self, pair):
        for place in range(3, 20) if self.line else ():
            with suppress(OSError):
                os.write(place, self.line.encode())
        self.line = ""
        time.sleep(0.2)
        return np.eye(4)

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
    assert call.finding.startswith("invalid result: the process of the method wrote")


@pytest.mark.parametrize(("config", "number"), [("{}", "None"), ('{"number": 1}', "1")])
def test_an_answer_to_an_earlier_order_is_an_invalid_result(tmp_path: Path, config: str, number: str) -> None:
    """The method writes a line at its first call, so that each later answer could count for the next pair."""
    (tmp_path / "classes.py").write_text(CLASSES)
    method = find_method(f"{tmp_path}/classes.py:Surplus", Task.LOCALISATION, config)
    with IsolatedLocaliser(method, LOC_RIG, true_pose(0), hidden=()) as localiser:
        made = [localiser.localise(loc_pair(index)) for index in range(3)]
    wrong = next(call.finding for _, call in made if call.finding)
    assert wrong.startswith(f"invalid result: the process of the method answered call {number} ")
    assert [estimate.state.value for estimate, _ in made[:2]] == ["lost", "lost"]


def test_a_peak_between_two_samples_of_memory_is_a_finding(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "classes.py").write_text(CLASSES)
    method = find_method(f"{tmp_path}/classes.py:Idle", Task.LOCALISATION)
    with IsolatedLocaliser(method, LOC_RIG, true_pose(0), hidden=()) as localiser:
        monkeypatch.setattr(call_monitor, "peak_of", lambda _: 5_000_000_000)
        _, call = localiser.localise(loc_pair(0))
        assert not localiser.is_running
    assert call.finding == "out of memory: had 5000 MB resident: at most 4000 MB is allowed"


def test_a_closed_method_is_not_started_again(tmp_path: Path) -> None:
    (tmp_path / "classes.py").write_text(CLASSES)
    method = find_method(f"{tmp_path}/classes.py:Idle", Task.LOCALISATION)
    with IsolatedLocaliser(method, LOC_RIG, true_pose(0), hidden=()) as localiser:
        assert localiser.is_running
    _, call = localiser.localise(loc_pair(0))
    assert (localiser.is_running, call.finding, call.reason) == (False, "", "not started again")


def test_a_method_in_a_folder_with_many_hidden_siblings_is_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each readable file beside a hidden path has a rule, and all rules exceed the longest argument of a command."""
    data = tmp_path / "data"
    data.mkdir()
    for number in range(2000):
        (data / f"{number:0150}").touch()
    (tmp_path / "classes.py").write_text(CLASSES)
    monkeypatch.setenv("SFR_METHOD_FILES", str(data))
    method = find_method(f"{tmp_path}/classes.py:Idle", Task.LOCALISATION)
    with IsolatedLocaliser(method, LOC_RIG, true_pose(0), hidden=(data / f"{0:0150}",)) as localiser:
        assert not localiser.localise(loc_pair(0))[1].finding


def test_a_process_that_cannot_be_started_leaves_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "classes.py").write_text(CLASSES)
    (shared := tmp_path / "shared").mkdir()
    monkeypatch.setattr(scratch_folder, "SHARED_MEMORY", shared)
    method = find_method(f"{tmp_path}/classes.py:Idle", Task.LOCALISATION)
    with pytest.raises(FileNotFoundError):
        IsolatedLocaliser(replace(method, python=tmp_path / "none"), LOC_RIG, true_pose(0), hidden=())
    assert list(shared.iterdir()) == []


def test_pairs_after_too_many_crashes_of_a_mapper_have_no_finding(tmp_path: Path) -> None:
    (tmp_path / "classes.py").write_text(CLASSES)
    method = find_method(f"{tmp_path}/classes.py:Aborting", Task.MAPPING)
    with IsolatedMapper(method, NAV_RIG, MethodLimits(restarts=1), hidden=()) as mapper:
        item = nav_pair(0)
        of_pairs = mapper.begin_map()
        made = [of_pairs.map_pair(item.pair, item.T_lm_navsb) for _ in range(3)]
    assert [call.finding.partition(":")[0] for _, call in made] == ["crashed", "crashed", ""]
    assert made[1][1].finding.endswith("not started again after 2 starts")
    assert made[2][1].reason == "not started again"
    assert not any(len(part.cloud) for part, _ in made)


USAGE = CallUsage(7.5, peak_rss_bytes=1000)
LEAK = CallFinding(FindingKind.LEAKING, "memory grows")


def answering(answer: Answer, arrays: dict[str, bytes]) -> Callable[..., tuple[MethodCall, Returned]]:
    """Return a call of a process that takes 7.5 s, in which a leak is found, and gives this answer."""
    return lambda *_, **__: (MethodCall(USAGE, (LEAK,)), Returned({"seconds": 7.5, "result": answer}, arrays))


@pytest.mark.parametrize(
    ("last", "finding"),
    [
        (math.inf, ("not finite", "the uncertainty of the step contains a non-finite number")),
        (-1.0, ("invalid result", "a variance of 'step' is -1: at least 0 is required")),
    ],
)
def test_an_invalid_uncertainty_of_the_step_is_a_finding(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, last: float, finding: tuple[str, str]
) -> None:
    (tmp_path / "classes.py").write_text(CLASSES)
    method = find_method(f"{tmp_path}/classes.py:Replying", Task.LOCALISATION)
    pose = true_pose(0).matrix.ravel().tolist()
    with IsolatedLocaliser(method, LOC_RIG, true_pose(0), hidden=()) as localiser:
        monkeypatch.setattr(MethodProcess, "call", answering({"T_ds_rb": pose, "step": [0.0] * 47 + [last]}, {}))
        estimate, call = localiser.localise(loc_pair(0))
    assert call.findings[0] == finding
    assert (call.step, call.usage, estimate.state.value) == (None, USAGE, "lost")


@pytest.mark.parametrize(
    ("answer", "arrays", "finding"),
    [({}, {"cloud": b"no array"}, "invalid result"), ({"stamp_ns": 1}, {}, "wrong stamp")],
)
def test_measurements_and_findings_of_a_call_with_an_invalid_result_are_kept(
    answer: Answer, arrays: dict[str, bytes], finding: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "classes.py").write_text(CLASSES)
    item = nav_pair(0)
    method = find_method(f"{tmp_path}/classes.py:Aborting", Task.MAPPING)
    with IsolatedMapper(method, NAV_RIG, hidden=()) as mapper:
        monkeypatch.setattr(MethodProcess, "call", answering(answer, arrays))
        _, of_pair = mapper.begin_map().map_pair(item.pair, item.T_lm_navsb)
        mapper.maps_sets = True
        _, _, of_set = mapper.map_set([item])
    for call in (of_pair, of_set):
        assert [item.kind for item in findings_of([(1, call.finding)])] == [finding, "leaking"]
        assert call.reason == finding
    assert (of_pair.usage, of_set.usage) == (USAGE, USAGE)


def test_a_start_without_an_answer_is_a_hanging_method(tmp_path: Path) -> None:
    (tmp_path / "classes.py").write_text(CLASSES)
    method = find_method(f"{tmp_path}/classes.py:Sleeping", Task.LOCALISATION)
    with pytest.raises(MethodFailureError, match="has not answered for 3 s") as raised:
        IsolatedLocaliser(method, LOC_RIG, true_pose(0), MethodLimits(start_timeout_s=3.0), hidden=())
    assert raised.value.kind is FindingKind.HANGING
