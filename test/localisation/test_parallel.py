import threading

import numpy as np
import pytest

from sfr_loc_map.localisation.parallel import BACKGROUND, FEWEST, both, in_halves


def test_both_sides_are_done_by_two_threads() -> None:
    meet = threading.Barrier(2, timeout=10.0)  # breaks where one thread does both, one after the other

    def side(number: int) -> tuple[int, str]:
        meet.wait()
        return number, threading.current_thread().name

    left, right = both(side, (1,), (2,))
    assert (left[0], right[0]) == (1, 2)
    assert left[1] != right[1]


@pytest.mark.parametrize("count", [0, 1, FEWEST - 1, FEWEST, FEWEST + 1])
def test_halves_are_the_whole_in_order(count: int) -> None:
    random = np.random.default_rng(count)
    a, b = random.normal(size=(count, 3)), random.normal(size=count)
    np.testing.assert_array_equal(in_halves(lambda x, y: x * y[:, None], a, b), a * b[:, None])


def test_background_work_may_use_both_threads_and_passes_errors_on() -> None:
    assert BACKGROUND.submit(both, abs, (-1,), (-2,)).result(10.0) == (1, 2)
    with pytest.raises(ZeroDivisionError):
        BACKGROUND.submit(lambda: 1 // 0).result(10.0)
