"""The publishers of the answers belong to the measured process, and remain those of the first answer."""

from __future__ import annotations

import itertools
from types import SimpleNamespace
from typing import Any, cast

import pytest

from sfr_loc_map.replay.external import publisher_check
from sfr_loc_map.replay.external.publisher_check import CHECK_PERIOD_S, PublisherCheck

MEASURED, OTHER = (1,) * 12, (3,) * 12


class Graph:
    """The participants of the publishers of a topic, which a test changes; each has another publisher at each look."""

    def __init__(self, *ids: tuple[int, ...]) -> None:
        self.ids = ids
        self.running = set[tuple[int, ...]]()  # publishers whose process is known to run
        self.numbers = itertools.count()

    def get_publishers_info_by_topic(self, topic: str) -> list[Any]:
        """Return the publishers."""
        return [SimpleNamespace(endpoint_gid=[*gid, 0, 0, next(self.numbers), 3]) for gid in self.ids]


def check_of(graph: Graph, *, is_watched: bool = True) -> PublisherCheck:
    watch = SimpleNamespace(
        has_publishers=lambda ids: ids <= {MEASURED}, runs_publishers=lambda ids: ids <= graph.running
    )
    watch = watch if is_watched else None
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


@pytest.mark.parametrize("is_running", [False, True])
@pytest.mark.parametrize(
    ("later", "is_restart"), [((), True), ((OTHER,), True), ((MEASURED, OTHER), None), ((MEASURED,), False)]
)
def test_a_publisher_that_is_replaced_after_the_first_answer_is_a_restart(
    monkeypatch: pytest.MonkeyPatch, later: tuple[tuple[int, ...], ...], is_restart: bool | None, is_running: bool
) -> None:
    """An additional publisher is a restart unless the first process is known to run; it may be outside the watched."""
    now = SimpleNamespace(s=100.0)
    monkeypatch.setattr(publisher_check.time, "monotonic", lambda: now.s)
    graph = Graph()
    check = check_of(graph)
    graph.ids = (MEASURED,)
    check.update()
    assert not check.have_restarted, "no answer was received"
    check.note_answer()
    check.update()
    assert not check.have_restarted
    graph.ids = later
    graph.running = {MEASURED} if is_running else set()
    check.update()
    assert not check.have_restarted, "checked once per period"
    now.s += CHECK_PERIOD_S
    check.update()
    assert check.have_restarted == (not is_running if is_restart is None else is_restart)
    assert check.is_measured == (is_restart is not None or not is_running)


def test_a_publisher_that_is_discovered_after_its_first_answer_is_no_restart(monkeypatch: pytest.MonkeyPatch) -> None:
    now = SimpleNamespace(s=100.0)
    monkeypatch.setattr(publisher_check.time, "monotonic", lambda: now.s)
    graph = Graph()
    check = check_of(graph)
    check.note_answer()
    for ids, is_restart in (((), False), ((MEASURED,), False), ((OTHER,), True)):
        graph.ids = ids
        now.s += CHECK_PERIOD_S
        check.update()
        assert check.have_restarted == is_restart
