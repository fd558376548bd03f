"""What a user is told of pairs that are lost or degraded."""

from __future__ import annotations

from sfr_loc_map.localisation.estimate import StateReason, TrackingState
from sfr_loc_map.pipeline.call_stats import CallRecord
from sfr_loc_map.pipeline.offline import CAUSES, states_text, tracking_warning


def calls(*states: tuple[TrackingState, StateReason | None, int]) -> list[CallRecord]:
    return [
        CallRecord(0, 0.1, state.value, None, None, reason=reason.value if reason is not None else "")
        for state, reason, count in states
        for _ in range(count)
    ]


GOOD = (TrackingState.TRACKING, None, 44)


def test_many_lost_pairs_name_the_cause_and_the_next_command() -> None:
    records = calls(
        GOOD,
        (TrackingState.LOST, StateReason.UNTEXTURED_IMAGES, 16),
        (TrackingState.LOST, StateReason.NO_STEREO, 36),
        (TrackingState.DEGRADED, StateReason.NO_STEREO, 4),
    )
    assert states_text(records) == "52 lost, 4 degraded"
    text = tracking_warning(records, "data/")
    assert text == (
        "52 lost, 4 degraded of 100 pairs; 40 of them because left and right are not a stereo pair of the rig: equal, "
        "swapped, or of different moments (no_stereo): look with sfr doctor data/"
    )


def test_few_lost_pairs_are_no_warning_and_every_reason_has_words() -> None:
    assert states_text(calls(GOOD)) == "0 lost"
    assert tracking_warning(calls(GOOD), "data/") is None
    assert tracking_warning(calls((TrackingState.TRACKING, None, 40), (TrackingState.LOST, None, 2)), "d") is None
    assert "the reason is not known" in str(tracking_warning(calls((TrackingState.LOST, None, 3)), "d"))
    assert set(CAUSES) == set(StateReason)
