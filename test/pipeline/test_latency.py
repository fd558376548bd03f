import pytest

from sfr_loc_map.pipeline.reception import MessageTimes, latencies

S, MS = 1_000_000_000, 1_000_000
NOW = 1_800_000_000 * S


def test_each_part_is_taken_from_the_slowest_message() -> None:
    receipts = (MessageTimes(NOW - 50 * MS, NOW - 45 * MS), MessageTimes(NOW - 48 * MS, NOW - 40 * MS))
    found = latencies(receipts, NOW - 60 * MS, NOW, NOW)
    assert found == pytest.approx(
        {"latency_transport_s": 0.008, "latency_receive_to_publish_s": 0.040, "latency_stamp_to_publish_s": 0.060}
    )


@pytest.mark.parametrize("apart_s", [61, -1])
def test_clocks_that_do_not_agree_give_no_figure(apart_s: int) -> None:
    sent = NOW - apart_s * S
    found = latencies((MessageTimes(sent, NOW - 5 * MS),), sent, NOW, NOW)
    assert found == pytest.approx({"latency_receive_to_publish_s": 0.005})


def test_simulated_time_counts_for_the_stamp_alone() -> None:
    found = latencies((MessageTimes(NOW - 2 * MS, NOW - MS),), 7 * S, NOW, 7 * S + 30 * MS)
    assert found["latency_stamp_to_publish_s"] == pytest.approx(0.030)
    assert found["latency_receive_to_publish_s"] == pytest.approx(0.001)


def test_what_the_middleware_does_not_know_is_left_out() -> None:
    info = {"source_timestamp": 0, "received_timestamp": 5}
    assert MessageTimes.of(info) == MessageTimes(None, 5)
    assert MessageTimes.of({}) == MessageTimes(None, None)
    assert latencies((MessageTimes(None, None),), 0, NOW, NOW) == {}
    assert latencies((MessageTimes(None, NOW), MessageTimes(NOW, NOW)), 0, NOW, NOW) == {
        "latency_receive_to_publish_s": 0.0,
        "latency_transport_s": 0.0,
    }


def test_clocks_that_are_rounded_differently_give_zero() -> None:
    assert latencies((MessageTimes(NOW + 1000, NOW),), 0, NOW, NOW)["latency_transport_s"] == 0.0
