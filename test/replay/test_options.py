"""Options of a replay that the options of the command determine."""

import pytest

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.replay.options import node_under_test
from sfr_loc_map.scoring.inputs import Correction
from sfr_loc_map.suite_names import Task


def frames_of(task: Task, frames: str) -> str | None:
    options = {"answers": "", "command": "", "watch": "", "timeout_s": 5.0, "correction": Correction()}
    node = node_under_test(task, frames=frames, **options)
    assert node is not None
    return node.frames


@pytest.mark.parametrize(
    ("task", "text", "frames"),
    [
        (Task.LOCALISATION, "odom,base_link", "odom -> base_link"),
        (Task.LOCALISATION, " odom , base_link ", "odom -> base_link"),
        (Task.LOCALISATION, "", None),
        (Task.MAPPING, "map", "map"),
        (Task.MAPPING, " map ", "map"),
        (Task.MAPPING, "", None),
    ],
)
def test_required_frames_are_written_as_answers_state_them(task: Task, text: str, frames: str | None) -> None:
    assert frames_of(task, text) == frames


@pytest.mark.parametrize("task", Task)
@pytest.mark.parametrize("text", ["odom", "a,b", "a,b,c", "a,", ",b", ",", " "])
def test_frames_that_no_answer_can_have_are_refused(task: Task, text: str) -> None:
    possible = {Task.LOCALISATION: "a,b", Task.MAPPING: "odom"}
    if text == possible[task]:
        assert frames_of(task, text)
        return
    with pytest.raises(ConfigError, match=r"^'--frames .* is required with --external"):
        frames_of(task, text)
