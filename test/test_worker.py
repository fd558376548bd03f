"""The worker of a node: order, items dropped under overload, and errors of the fault handler."""

import threading

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfr_loc_map.worker import MAX_WAITING_BYTES, Overload, Worker


class Held:
    """A worker whose thread is kept busy until it is let go."""

    def __init__(self, overload: Overload, room: int) -> None:
        self.done: list[int] = []
        self.worker = Worker("tried", overload, room, pytest.fail)
        self.gate, begun = threading.Event(), threading.Event()
        self.worker.enqueue(lambda: (begun.set(), self.gate.wait(60)))
        assert begun.wait(60)

    def finish(self) -> list[int]:
        self.gate.set()
        self.worker.wait_idle()
        self.worker.stop()
        return self.done


# True: droppable; the reference is a plain list worked on by the rule in words.
@settings(max_examples=60)
@given(kinds=st.lists(st.booleans(), max_size=20), room=st.integers(1, 5), newest=st.booleans())
def test_what_is_done_is_in_order_and_what_is_dropped_is_counted(kinds: list[bool], room: int, newest: bool) -> None:
    held = Held(Overload.NEWEST if newest else Overload.ALL, room)
    for number, droppable in enumerate(kinds):
        enqueue = held.worker.enqueue_droppable if droppable else held.worker.enqueue
        enqueue(lambda number=number: held.done.append(number))
    kept = [number for number, droppable in enumerate(kinds) if droppable][-(1 if newest else room) :]
    expected = [number for number, droppable in enumerate(kinds) if not droppable or number in kept]
    assert held.worker.waiting == len(kept)
    assert held.worker.dropped == sum(kinds) - len(kept)
    assert held.finish() == expected


def test_of_what_is_large_the_oldest_is_dropped_and_nothing_that_is_small() -> None:
    held = Held(Overload.ALL, 100)
    third = MAX_WAITING_BYTES // 3
    for number, size in enumerate((third, 0, third, 0, third, third, 0, 2 * third, 2 * MAX_WAITING_BYTES, 1, 0)):
        held.worker.enqueue_droppable(lambda number=number: held.done.append(number), size)
    assert held.worker.dropped == 6
    assert held.finish() == [1, 3, 6, 9, 10]  # 8, larger than all room, waited alone until 9 came


def test_the_worker_continues_after_an_exception_of_the_fault_handler(capsys: pytest.CaptureFixture[str]) -> None:
    def fail(error: Exception, is_droppable: bool) -> None:
        raise RuntimeError("the handler has failed") from error

    worker, done = Worker("tried", Overload.ALL, 1, fail), threading.Event()
    worker.enqueue(lambda: int("x"))
    worker.enqueue(done.set)
    assert done.wait(10)
    worker.wait_idle()
    worker.stop()
    assert "the handler has failed" in capsys.readouterr().err
