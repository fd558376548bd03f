"""The publishers of the answers belong to the measured process, and remain those of the first answer."""

from __future__ import annotations

import itertools
from types import SimpleNamespace
from typing import Any, cast

import pytest

from sfr_loc_map.replay import publisher_check
from sfr_loc_map.replay.publisher_check import CHECK_PERIOD_S, PublisherCheck

MEASURED, OTHER = (1,) * 12, (3,) * 12


class Graph:
    """The participants of the publishers of a topic, which a test changes; each has another publisher at each look."""

    def __init__(self, *ids: tuple[int, ...]) -> None:
        self.ids = ids
        self.numbers = itertools.count()

    def get_publishers_info_by_topic(self, topic: str) -> list[Any]:
        """Return the publishers."""
        return [SimpleNamespace(endpoint_gid=[*gid, 0, 0, next(self.numbers), 3]) for gid in self.ids]


def check_of(graph: Graph, *, is_watched: bool = True) -> PublisherCheck:
    watch = SimpleNamespace(has_publishers=lambda ids: ids <= {MEASURED}) if is_watched else None
    return PublisherCheck(cast("Any", SimpleNamespace(ros_node=graph)), "poses", cast("Any", watch))


@pytest.mark.parametrize("is_watched", [True, False])
@pytest.mark.parametrize(("before", "at_answer"), list(itertools.product([(), (MEASURED,), (OTHER,)], repeat=2)))
def test_the_publishers_of_the_first_answer_decide_whether_the_process_is_measured(
    before: tuple[tuple[int, ...], ...], at_answer: tuple[tuple[int, ...], ...], is_watched: bool
) -> None:
    graph = Graph(*before)
    check = check_of(graph, is_watched=is_watched)
    assert check.is_measured == (not is_watched or OTHER not in before)
    graph.ids = at_answer
    check.note_answer()
    assert check.is_measured == (not is_watched or OTHER not in at_answer)
    graph.ids = (OTHER,)
    check.note_answer()
    assert check.is_measured == (not is_watched or OTHER not in at_answer), "later answers do not decide"


@pytest.mark.parametrize("later", [(), (OTHER,), (MEASURED, OTHER), (MEASURED,)])
def test_a_publisher_that_disappears_or_appears_after_the_first_answer_is_a_change(
    monkeypatch: pytest.MonkeyPatch, later: tuple[tuple[int, ...], ...]
) -> None:
    now = SimpleNamespace(s=100.0)
    monkeypatch.setattr(publisher_check.time, "monotonic", lambda: now.s)
    graph = Graph()
    check = check_of(graph)
    graph.ids = (MEASURED,)
    assert not check.have_changed(), "no answer was received"
    check.note_answer()
    assert not check.have_changed()
    graph.ids = later
    assert not check.have_changed(), "checked once per period"
    now.s += CHECK_PERIOD_S
    assert check.have_changed() == (later != (MEASURED,))
