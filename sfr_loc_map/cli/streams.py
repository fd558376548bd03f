"""Standard output and standard error that may break without a word on the work.

A reader that leaves (`| head`) or a log on a full disk must neither lose the outputs of a command nor change its exit
code: what nobody reads is dropped. Standard output on a full disk is an error all the same, since it is an output.
"""

from __future__ import annotations

import io
import os
import sys
from typing import TYPE_CHECKING

from sfr_loc_map.errors import OutputError

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

STDERR = 2


class TolerantFile(io.FileIO):
    """A standard stream that drops what nobody takes.

    Attributes:
        broken: Whether it does.
        reader_needed: Whether a command ends when its reader leaves, as one without another output.
    """

    broken = False
    reader_needed = False

    def write(self, data: ReadableBuffer, /) -> int:
        """Write, or drop where the reader has left.

        Raises:
            BrokenPipeError: If the reader has left and is needed.
            OutputError: Once, if standard output cannot be written for another reason.
        """
        count = memoryview(data).nbytes
        if count and not self.broken:  # typer tries a stream with nothing, and takes no notice of an error
            try:
                return super().write(data)
            except OSError as error:
                self._break(error)
        return count

    def _break(self, error: OSError) -> None:
        if isinstance(error, BrokenPipeError) and self.reader_needed:
            raise error
        self.broken = True
        if self.fileno() != STDERR and not isinstance(error, BrokenPipeError):
            raise OutputError(f"cannot write standard output: {error.strerror}; check the space where it goes")


def tolerate_breaks() -> None:
    """Make standard output and standard error such streams; what stands in their place (a test's) stays."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # closed; the descriptor is taken, so that no output gets it and the words of a library
            setattr(sys, name, open(os.open(os.devnull, os.O_WRONLY), "w", encoding="utf-8"))  # noqa: SIM115
        elif stream is getattr(sys, f"__{name}__") and isinstance(stream, io.TextIOWrapper):
            setattr(sys, name, _tolerant(stream))


def _tolerant(stream: io.TextIOWrapper) -> io.TextIOWrapper:
    """Return a stream of the same descriptor and encoding."""
    stream.flush()
    raw = TolerantFile(stream.fileno(), "w", closefd=False)
    unbuffered = isinstance(stream.buffer, io.RawIOBase)
    return io.TextIOWrapper(
        raw if unbuffered else io.BufferedWriter(raw),
        encoding=stream.encoding,
        errors=stream.errors,
        line_buffering=stream.line_buffering,
        write_through=stream.write_through,
    )
