"""The graph states one reason if a topic has no received message."""

from __future__ import annotations

import pytest

from sfr_loc_map.issues import Cause
from sfr_loc_map.message_types import COMPRESSED, IMAGE
from sfr_loc_map.transport_issues import Publisher, Reliability, silence_of

BEST_EFFORT, RELIABLE = Reliability.BEST_EFFORT, Reliability.RELIABLE
CASES = {
    "nobody": ([], BEST_EFFORT, Cause.NO_PUBLISHER),
    "another type": ([Publisher("/a", COMPRESSED)], BEST_EFFORT, Cause.WRONG_TYPE),
    "another type besides": ([Publisher("/a", COMPRESSED), Publisher("/b", IMAGE)], BEST_EFFORT, Cause.SILENT),
    "less reliability": ([Publisher("/a", IMAGE, BEST_EFFORT)], RELIABLE, Cause.QOS),
    "less reliability of one": ([Publisher("/a", IMAGE, BEST_EFFORT), Publisher("/b", IMAGE)], RELIABLE, Cause.SILENT),
    "nothing arrives": ([Publisher("/a", IMAGE)], BEST_EFFORT, Cause.SILENT),
}


@pytest.mark.parametrize("case", CASES)
def test_one_reason_is_reported(case: str) -> None:
    publishers, requested, cause = CASES[case]
    found = silence_of("/loc/left/image_rect", (IMAGE,), publishers, requested)
    assert found.cause is cause
    assert found.fix


def test_a_silent_topic_beside_topics_that_arrive_is_not_blamed_on_the_transport() -> None:
    publishers = (Publisher("/camera", IMAGE),)
    alone, beside_others = (
        silence_of("/loc/left/image_rect", (IMAGE,), publishers, transport_works=works) for works in (False, True)
    )
    assert alone.cause is beside_others.cause is Cause.SILENT
    assert ("/dev/shm" in alone.fix, "/dev/shm" in beside_others.fix) == (True, False)
