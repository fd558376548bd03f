"""How far a suite is: a bar on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from sfr_loc_map.cli.output import progress_bar, say

if TYPE_CHECKING:
    from sfr_loc_map.suite.execution import Outcome
    from sfr_loc_map.suite.runner import OnOutcome
    from sfr_loc_map.suite.task import Task

LINE_EVERY_S = 20.0


@contextmanager
def progress(total: int) -> Iterator[OnOutcome]:
    """Yield what is to be called with each task that is done; failures are named at once."""
    begin = last = time.monotonic()
    done = failed = 0
    with progress_bar("tasks") as bar:
        shown = bar.add_task("running", total=total)

        def advance(task: Task, outcome: Outcome) -> None:
            nonlocal last, done, failed
            done += 1
            failed += not outcome.done
            bar.advance(shown)
            if not outcome.done:
                say(f"failed: {task.label}: {outcome.failures[-1].cause}", err=True)
            now = time.monotonic()
            if bar.disable and (now - last > LINE_EVERY_S or done == total):
                last = now
                left = (now - begin) / done * (total - done)
                say(f"{done} of {total} tasks, {failed} failed, about {left:.0f} s left", err=True)

        yield advance
