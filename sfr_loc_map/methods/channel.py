"""Messages to and from the process of a method: one line of JSON each, through its standard input and output."""

from __future__ import annotations

import json
import os
import select
import time
from collections.abc import Callable
from typing import TypeVar

import msgspec

from sfr_loc_map.methods.child.loop import Order, Setup
from sfr_loc_map.methods.child.supervisor import Rules
from sfr_loc_map.methods.method_call import MethodFailureError
from sfr_loc_map.metrics.figures.records import FindingKind

CHECK_S = 0.05  #: Period of the checks while an answer is awaited.
LONGEST_ANSWER = 16_000_000  #: Bytes.

T = TypeVar("T")


class ClosedChannelError(Exception):
    """The process has closed its end of the channel."""


class Channel:
    """The pipes of a process."""

    def __init__(self, orders: int, answers: int) -> None:
        """Use the descriptors of the process's standard input and output."""
        os.set_blocking(orders, False)  # a method that does not read must not delay the timeout
        self._orders, self._answers = orders, answers
        self._unread = b""

    def exchange(
        self, message: Rules | Setup | Order | None, kind: type[T], timeout_s: float, check: Callable[[], object]
    ) -> T:
        """Send a message and return the answer; `check` is called periodically meanwhile, and may raise an error.

        Without a message, the next line of the process is awaited. MethodFailureError if the answer is late or not of
        this kind.
        """
        request = b"" if message is None else json.dumps(message).encode() + b"\n"
        line = self._answer(request, timeout_s, check)
        try:
            return msgspec.convert(json.loads(line), kind)
        except (ValueError, RecursionError) as error:
            text = (
                f"the process of the method wrote {line[:80]!r} in place of an answer ({error}): the method must not "
                "write to the pipe of the answers"
            )
            raise MethodFailureError(FindingKind.INVALID_RESULT, text, ended=True) from error

    def _answer(self, request: bytes, timeout_s: float, check: Callable[[], object]) -> bytes:
        """Send a request, and return the next line of the output.

        Check and timeout depend on the clock only, whatever the method reads or writes meanwhile.
        """
        streams = select.poll()
        streams.register(self._answers, select.POLLIN)
        if request:
            streams.register(self._orders, select.POLLOUT)
        now_s = time.monotonic()
        end_s, check_s = now_s + timeout_s, now_s + CHECK_S
        while request or b"\n" not in self._unread:
            now_s = time.monotonic()
            if now_s >= check_s:
                check()
                check_s = time.monotonic() + CHECK_S
            if now_s > end_s:
                text = f"has not answered for {timeout_s:g} s"
                raise MethodFailureError(FindingKind.HANGING, text, ended=True)
            ready = dict(streams.poll(1000 * max(check_s - now_s, 0.0)))
            if self._orders in ready:
                request = self._send(request)
                if not request:
                    streams.unregister(self._orders)
            if self._answers in ready:
                self._receive()
        line, _, self._unread = self._unread.partition(b"\n")
        return line

    def _send(self, request: bytes) -> bytes:
        """Write as much of a request as the pipe accepts; return the rest."""
        try:
            return request[os.write(self._orders, request) :]
        except BlockingIOError:
            return request
        except OSError as error:
            raise ClosedChannelError from error

    def _receive(self) -> None:
        data = os.read(self._answers, 65536)
        if not data:
            raise ClosedChannelError
        self._unread += data
        if len(self._unread) > LONGEST_ANSWER:
            text = f"answered more than {LONGEST_ANSWER // 1_000_000} MB"
            raise MethodFailureError(FindingKind.INVALID_RESULT, text, ended=True)
