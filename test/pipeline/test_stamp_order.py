import pytest

from sfr_loc_map.inputs import JUMP_BACK_NS
from sfr_loc_map.pipeline.reception import jumped_back


@pytest.mark.parametrize(
    ("back_ns", "jumped"), [(-JUMP_BACK_NS, False), (0, False), (JUMP_BACK_NS - 1, False), (JUMP_BACK_NS, True)]
)
def test_a_second_back_is_a_new_run(back_ns: int, jumped: bool) -> None:
    assert jumped_back(5 * JUMP_BACK_NS, 5 * JUMP_BACK_NS - back_ns) is jumped
