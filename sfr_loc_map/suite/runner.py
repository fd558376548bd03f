"""Runs the tasks of a suite that are not done yet, on this machine, and keeps each result as it comes."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from sfr_loc_map.suite.claim import execute_once
from sfr_loc_map.suite.execution import Bounds, Outcome, close_fork_server
from sfr_loc_map.suite.plan import Plan, make_plan
from sfr_loc_map.suite.specification import SuiteSettings, SuiteSpecification
from sfr_loc_map.suite.store import Store
from sfr_loc_map.suite.task import Task

OnOutcome = Callable[[Task, Outcome], None]


class Executor(Protocol):
    """Runs tasks somewhere."""

    def run(self, tasks: Sequence[Task], bounds: Bounds, store: Store, on_outcome: OnOutcome) -> None:
        """Run tasks; call `on_outcome` in this thread with each as it is done."""
        ...


@dataclass(frozen=True, slots=True)
class Selection:
    """Which tasks of a plan are run.

    Attributes:
        only: Begin of the key of the one task to run again, done or not; empty for all that are not done.
        retry_failed: Whether tasks that failed before are tried again.
    """

    only: str = ""
    retry_failed: bool = False

    def of(self, plan: Plan, store: Store) -> list[Task]:
        """Return the tasks to run."""
        if self.only:
            return [task for task in plan.tasks if task.key.startswith(self.only)]
        return [
            task
            for task in plan.tasks
            if not store.is_done(task.key) and (self.retry_failed or not store.has_failed(task.key))
        ]


class LocalExecutor:
    """Runs tasks on this machine, a few at a time, each in a process of its own and on cores of its own."""

    def __init__(self, workers: int) -> None:
        """Set how many tasks run at a time; tasks that are timed run one after the other."""
        self._workers = workers

    def run(self, tasks: Sequence[Task], bounds: Bounds, store: Store, on_outcome: OnOutcome) -> None:
        """Run tasks; where this thread is interrupted, what runs is ended and nothing else begins."""
        todo: queue.SimpleQueue[Task] = queue.SimpleQueue()
        done: queue.SimpleQueue[tuple[Task, Outcome | BaseException]] = queue.SimpleQueue()
        for task in tasks:
            todo.put(task)
        stop = threading.Event()
        slots = 1 if any(task.alone for task in tasks) else self._workers

        def work(slot: int) -> None:
            while not stop.is_set():
                try:
                    task = todo.get_nowait()
                except queue.Empty:
                    break
                try:
                    done.put((task, execute_once(task, replace(bounds, slot=slot), store.folder, store.cache, stop)))
                except BaseException as error:
                    done.put((task, error))
            close_fork_server()

        threads = [threading.Thread(target=work, args=(slot,), daemon=True) for slot in range(slots)]
        for thread in threads:
            thread.start()
        try:
            for _ in tasks:
                task, outcome = done.get()
                if isinstance(outcome, BaseException):
                    raise outcome
                on_outcome(task, outcome)
        finally:
            stop.set()
            for thread in threads:
                thread.join()


def plan_suite(specification: SuiteSpecification, store: Store) -> Plan:
    """Return the tasks of a suite, and take them into its folder."""
    plan = make_plan(specification, store.facts_of)
    store.plan(plan.tasks, specification.path)
    return plan


def run_tasks(
    tasks: Sequence[Task],
    settings: SuiteSettings,
    store: Store,
    executor: Executor,
    on_outcome: OnOutcome,
    *,
    again: bool = False,
) -> None:
    """Run tasks and keep what comes of each.

    Args:
        tasks: The tasks.
        settings: Limits of each.
        store: Folder of the suite.
        executor: Where they run.
        on_outcome: Called with each that is done and kept.
        again: Whether tasks are run that have a result.
    """

    def keep(task: Task, outcome: Outcome) -> None:
        store.save(task, outcome)
        on_outcome(task, outcome)

    bounds = Bounds(memory_bytes=settings.memory_mb * 10**6, timeout_s=settings.timeout_s, again=again)
    try:
        executor.run(tasks, bounds, store, keep)
    finally:
        store.flush()
