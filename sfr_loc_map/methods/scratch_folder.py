"""The folder of a method's process: the shared images, the log, and the arrays of the answers."""

from __future__ import annotations

import mmap
import os
import shutil
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, suppress
from pathlib import Path
from typing import BinaryIO, Self

import numpy as np

from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.inputs import read_bytes
from sfr_loc_map.mapping.config import MAX_PAIRS
from sfr_loc_map.process_tree import bytes_of_files

SHARED_MEMORY = Path("/dev/shm")
LONGEST_LINE = 300  #: Characters of a line of the log in a message.


class ScratchFolder(AbstractContextManager["ScratchFolder"]):
    """A temporary folder, in memory if the system has shared memory. The method can write any file to this folder.

    `images` is the file of the images, `log` that of the error output, and `work` the working directory of the method.
    Arrays of an answer are at `output` plus a suffix for their kind.
    """

    def __init__(self, height: int, width: int) -> None:
        """Make the folder with room for the images `(height, width)` of `MAX_PAIRS` pairs."""
        shared = SHARED_MEMORY if os.access(SHARED_MEMORY, os.W_OK) else None
        self._is_in_memory = shared is not None  # whether the files of the folder use memory
        with ExitStack() as resources:
            self.path = Path(tempfile.mkdtemp(prefix="sfr_method_", dir=shared))
            resources.callback(shutil.rmtree, self.path, ignore_errors=True)
            self.images = self.path / "images"
            self.log = self.path / "log"
            self.work = self.path / "work"
            self.output = str(self.path / "result")
            self.work.mkdir()
            # open in this process, so that the kernel grants the method no lease on the log
            self._log: BinaryIO = resources.enter_context(self.log.open("w+b", buffering=0))
            self._pixels = np.asarray(np.memmap(self.images, np.uint8, "w+", shape=(MAX_PAIRS, 2, height, width)))
            self._resources = resources.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Remove the folder."""
        self._resources.close()

    def begin_call(self) -> None:
        """Empty the log, which then has the output of one call, for the message after a crash."""
        self._log.truncate(0)

    def share(self, pairs: Sequence[StereoPair]) -> None:
        """Write the images of the pairs of a call."""
        for number, pair in enumerate(pairs):
            self._pixels[number] = pair.left, pair.right

    def last_log_line(self) -> str:
        """Return the end of the log."""
        self._log.seek(0)
        text = self._log.read().decode("utf-8", "replace")
        lines = [line.strip() for line in text.splitlines() if line.strip()]
        return (lines or ["its log is empty"])[-1][:LONGEST_LINE]

    def remove_arrays(self, suffixes: Iterable[str]) -> None:
        """Remove the files of the arrays of an earlier answer."""
        for suffix in suffixes:
            with suppress(OSError):  # the method may have made a folder of this name, which is then no valid array
                self._array_file(suffix).unlink()

    def arrays(self, limits: Mapping[str, int]) -> tuple[dict[str, bytes], str]:
        """Return the contents of the files with the arrays, by suffix, and the reason why a file cannot be read.

        `limits` are the largest sizes by suffix, bytes. A larger file is not read, and a missing file is omitted. The
        reason is empty if all existing files were read.
        """
        contents: dict[str, bytes] = {}
        unreadable = ""
        for suffix, limit in limits.items():
            try:
                contents[suffix] = read_bytes(self._array_file(suffix), limit)
            except FileNotFoundError:
                continue
            except (OSError, ValueError) as error:
                unreadable = unreadable or f"the {suffix} cannot be read: {error}"
        return contents, unreadable

    def _array_file(self, suffix: str) -> Path:
        return Path(f"{self.output}.{suffix}.npy")

    def memory_bytes(self) -> int:
        """Return the memory of the files that the method can write. The resident memory of processes excludes it.

        OSError if a file cannot be examined.
        """
        if not self._is_in_memory:
            return 0
        whole_pages = -(-self._pixels.nbytes // mmap.PAGESIZE) * mmap.PAGESIZE
        return bytes_of_files(self.path, self.images, whole_pages)
