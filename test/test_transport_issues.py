"""The graph states one reason if a topic has no received message."""

from __future__ import annotations

import pytest

from sfr_loc_map.issues import Cause
from sfr_loc_map.message_types import COMPRESSED, IMAGE
from sfr_loc_map.transport_issues import UNKNOWN_NAME, Publisher, Reliability, silence_of

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


@pytest.mark.parametrize(
    ("node", "heard", "is_transport"),
    [
        ("/camera", (), True),
        ("/camera", ("/other",), True),
        ("/camera", ("/camera",), False),
        (UNKNOWN_NAME, (UNKNOWN_NAME,), True),
    ],
)
def test_a_silent_publisher_from_which_messages_are_received_is_not_blamed_on_the_transport(
    node: str, heard: tuple[str, ...], is_transport: bool
) -> None:
    found = silence_of("/loc/left/image_rect", (IMAGE,), (Publisher(node, IMAGE),), heard=heard)
    assert found.cause is Cause.SILENT
    assert ("/dev/shm" in found.fix) == is_transport
