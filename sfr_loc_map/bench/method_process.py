"""Processes of methods: images in a shared file, orders and answers as lines of JSON."""

from __future__ import annotations

import json
import os
import selectors
import subprocess
import time
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from sfr_loc_map.bench.reference_methods import ReferenceMethod
from sfr_loc_map.errors import BenchError
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig

ANSWER_TIMEOUT_S = 900.0
"""Longest wait for an answer; some dense matchers take minutes."""
EXIT_TIMEOUT_S = 10.0
CAMERA = ("width", "height", "fx", "fy", "cx", "cy", "baseline_m")


class SharedImages:
    """A file with the current pair."""

    def __init__(self, path: Path, rig: StereoRig) -> None:
        """Make the file for pairs of a rig."""
        self.path = path
        self._array = np.memmap(path, np.uint8, "w+", shape=(2, rig.height, rig.width))

    def show(self, pair: StereoPair) -> None:
        """Put a pair into the file."""
        self._array[0], self._array[1] = pair.left, pair.right
        self._array.flush()


class MethodProcess:
    """A method's process, warmed up and waiting once constructed.

    Attributes:
        method: The method.
        version: Version that it reports.
        idle_bytes: Its resident memory after warm-up.
    """

    def __init__(
        self, method: ReferenceMethod, rig: StereoRig, images: SharedImages, setup: Mapping[str, Any], folder: Path
    ) -> None:
        """Start it and wait until it is warmed up.

        Args:
            method: The method.
            rig: Rig of the images.
            images: File of the pairs.
            setup: Sent to every worker of this benchmark.
            folder: Folder of its log.

        Raises:
            BenchError: If it does not start; the message has its last log line.
        """
        self.method = method
        self._log = folder / f"{method.name}.log"
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                method.command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, bufsize=0
            )
        self._rest = b""
        camera = {name: getattr(rig, name) for name in CAMERA}
        try:
            hello = self.ask(camera | {"images": str(images.path)} | dict(setup) | dict(method.setup))
        except BenchError:
            self.close()
            raise
        self.version, self.idle_bytes = str(hello["version"]), hello["idle_bytes"]

    def ask(self, order: Mapping[str, Any]) -> dict[str, Any]:
        """Send an order and return the answer.

        Raises:
            BenchError: If the process has ended or does not answer.
        """
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(order).encode() + b"\n")
        except OSError:
            self._fail("has ended")
        answer: dict[str, Any] = json.loads(self._line())
        return answer

    def _line(self) -> bytes:
        assert self._process.stdout is not None
        end = time.monotonic() + ANSWER_TIMEOUT_S
        with selectors.DefaultSelector() as selector:
            selector.register(self._process.stdout, selectors.EVENT_READ)
            while b"\n" not in self._rest:
                if not selector.select(max(0.0, end - time.monotonic())):
                    self._fail(f"has not answered for {ANSWER_TIMEOUT_S:g} s")
                data = os.read(self._process.stdout.fileno(), 65536)
                if not data:
                    self._fail("has ended")
                self._rest += data
        line, _, self._rest = self._rest.partition(b"\n")
        return line

    def _fail(self, what: str) -> None:
        lines = self._log.read_text("utf-8", "replace").split("\n")
        last = next((line.strip() for line in reversed(lines) if line.strip()), "its log is empty")
        raise BenchError(f"method {self.method.name} {what}: {last[:300]}")

    def close(self) -> None:
        """End the process."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        try:
            self._process.wait(EXIT_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._process.stdout.close()

    def __enter__(self) -> MethodProcess:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the process."""
        if error is not None:
            self._process.kill()
        self.close()
