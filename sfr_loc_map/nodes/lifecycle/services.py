"""Answers to service calls that the worker gives."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.executors import Executor
from rclpy.task import Future

from sfr_loc_map.errors import SfrError
from sfr_loc_map.nodes.lifecycle.endpoints import Answer
from sfr_loc_map.nodes.lifecycle.worker import Worker


def answer_by(worker: Worker, work: Callable[[], str], executor: Executor | None, otherwise: str) -> Future:
    """Let the worker do something and return the answer to come.

    Args:
        worker: The worker.
        work: Returns the message of success; an `SfrError` is that of a failure.
        executor: Of the node that awaits the answer; it is woken.
        otherwise: Message of any other failure.
    """
    future = Future(executor=executor)
    future.add_done_callback(lambda _: executor.wake() if executor is not None else None)

    def job() -> None:
        answer: Answer = (False, otherwise)
        try:
            answer = (True, work())
        except SfrError as error:
            answer = (False, str(error))
        finally:
            future.set_result(answer)

    worker.enqueue(job)
    return future
