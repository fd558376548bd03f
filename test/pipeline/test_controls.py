import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfr_loc_map.pipeline.controls import Controls
from sfr_loc_map.pipeline.message_stream import Message, Pacer, PairTracker, start_at


def message(topic: str, stamp_ns: int) -> Message:
    return Message(topic, "", stamp_ns, b"")


class FakeClock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


def test_messages_are_due_by_their_stamps_each_task_from_its_own_first() -> None:
    clock, controls = FakeClock(), Controls(rate=2.0)
    pacer = Pacer(controls, clock)
    assert pacer.wait_s(message("loc/left/image_rect", 5_000_000_000)) == 0
    assert pacer.wait_s(message("loc/left/image_rect", 6_000_000_000)) == pytest.approx(0.5)
    clock.now += 0.4
    assert pacer.wait_s(message("loc/left/image_rect", 6_000_000_000)) == pytest.approx(0.1)
    assert pacer.wait_s(message("nav/left/image_rect", 99)) == 0


def test_after_a_pause_a_step_or_another_rate_the_next_message_is_due_at_once() -> None:
    clock, controls = FakeClock(), Controls(rate=1.0)
    pacer = Pacer(controls, clock)
    pacer.wait_s(message("loc/x", 0))
    controls.pause()
    pacer.wait_s(message("loc/x", 10**10))
    controls.resume()
    assert pacer.wait_s(message("loc/x", 10**10)) == 0
    assert pacer.wait_s(message("loc/x", 2 * 10**10)) == 10
    controls.rate = 10.0
    assert pacer.wait_s(message("loc/x", 2 * 10**10)) == 0
    assert pacer.wait_s(message("loc/x", 3 * 10**10)) == 1
    controls.step()
    assert pacer.wait_s(message("loc/x", 3 * 10**10)) == 0
    assert not controls.held


def test_keys() -> None:
    controls = Controls(rate=1.0, position_s=7.0)
    controls.key(" ")
    assert controls.held
    controls.key("right")
    controls.key("s")
    assert controls.steps == 2
    controls.key(" ")
    assert (controls.paused, controls.steps) == (False, 0)
    controls.key("left")
    assert controls.seek_s == 2.0
    controls.position_s = 3.0
    controls.key("left")
    assert controls.seek_s == 0.0
    controls.key("f")
    assert controls.seek_s == 8.0
    controls.key("up")
    assert controls.rate == pytest.approx(1.1)
    controls.key("down")
    controls.key("l")
    assert controls.rate == pytest.approx(1.0)
    assert controls.loop
    controls.key("?")
    assert not controls.stopped
    controls.key("q")
    assert controls.stopped
    assert controls.interrupted


def test_a_pair_is_complete_with_both_images_and_for_mapping_its_pose() -> None:
    pairs = PairTracker()
    assert pairs.add(message("loc/left/camera_info", 1)) is None
    assert pairs.add(message("loc/left/image_rect", 1)) is None
    assert pairs.add(message("loc/right/image_rect", 2)) is None
    assert pairs.add(message("loc/right/image_rect/compressed", 1)) == ("loc", 1)
    for topic in ("nav/pose", "nav/right/image_rect"):
        assert pairs.add(message(topic, 1)) is None
    assert pairs.add(message("nav/left/image_rect", 1)) == ("nav", 1)


@given(st.lists(st.integers(0, 100), min_size=1, max_size=30), st.floats(0, 12))
def test_from_a_position_on_comes_what_is_not_before_it_and_the_first_camera_info(
    tenths: list[int], offset_s: float
) -> None:
    stamps = sorted(10**9 + t * 10**8 for t in tenths)
    whole = [message("loc/left/camera_info", stamps[0])] + [message("loc/left/image_rect", s) for s in stamps]
    positions: list[float] = []
    rest = list(start_at(iter(whole), offset_s, positions.append))
    assert rest[0] == whole[0]
    assert rest[1:] == [m for m in whole[1:] if (m.stamp_ns - stamps[0]) * 1e-9 >= offset_s]
    assert all(t >= offset_s for t in positions)


def test_nothing_is_sought_after_the_last_pair() -> None:
    controls = Controls(end_s=12.0, position_s=9.0)
    controls.key("f")  # 5 s on
    controls.seek(12.1)
    assert controls.seek_s is None
    controls.seek(12.0)
    assert controls.next_start_s() == 12.0
