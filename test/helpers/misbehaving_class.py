"""Classes under test that misbehave: the first word of the configuration selects how, and at which call."""

from __future__ import annotations

import ctypes
import fcntl
import hashlib
import json
import os
import signal
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState

MB = 1_000_000
STAND, BLOCK = np.eye(4), bytes(20 * MB)
TRUTH = "groundtruth.csv"


def work() -> None:
    """Compute for 0.35 s of processor time."""
    end = time.thread_time() + 0.35
    while time.thread_time() < end:
        pass


class Lazy:
    """A pose that takes its time to be one."""

    def __init__(self, before: Callable[[], None]) -> None:
        self.before = before

    def __array__(self, *_: Any, **__: Any) -> Any:
        self.before()
        return STAND


class Misbehaving:
    """A stationary localiser, except for the misbehaviour that its configuration names."""

    version = "0"

    def __init__(self, rig: Any, config: str) -> None:
        word, _, self.text = config.partition("\n")
        self.act: Callable[[Any], Any] = getattr(self, word)
        self.calls, self.held, self.statistics, self.work = 0, [], {}, threading.Semaphore(0)

    def process(self, pair: Any) -> Any:
        self.calls += 1
        return self.act(pair)

    @property
    def eighth(self) -> bool:
        return self.calls == 8

    # ---- answers

    def stand(self, pair: Any) -> Any:
        return STAND

    def raises(self, pair: Any) -> Any:
        return 1 / 0 if self.eighth else STAND

    def nan(self, pair: Any) -> Any:
        return STAND * np.nan if self.eighth else STAND

    def shape(self, pair: Any) -> Any:
        return np.eye(3) if self.eighth else STAND

    def stamp(self, pair: Any) -> Any:
        pose = Transform(np.eye(3), np.zeros(3))
        return PoseEstimate(pair.stamp_ns + self.eighth, pose, np.eye(6), TrackingState.TRACKING)

    def poses(self, pair: Any) -> Any:
        return np.reshape(json.loads(self.text)[self.calls - 1], (4, 4))

    def garbage(self, pair: Any) -> Any:
        for place in range(3, 20) if self.eighth else ():
            with suppress(OSError):
                os.write(place, b"all is well\n")
        return STAND

    def floods(self, pair: Any) -> Any:
        for place in range(3, 20) if self.eighth else ():
            with suppress(OSError):
                for _ in range(300):
                    os.write(place, b"x" * 100_000)
        return STAND

    # ---- its process

    def exits(self, pair: Any) -> Any:
        if self.eighth:
            os._exit(0)
        return STAND

    def aborts(self, pair: Any) -> Any:
        if self.eighth:
            os.abort()
        return STAND

    def hangs(self, pair: Any) -> Any:
        time.sleep(60.0 if self.eighth else 0.0)
        return STAND

    def kills(self, pair: Any) -> Any:
        """End who asks, by its number."""
        os.kill(os.getppid(), signal.SIGKILL)
        return STAND

    # ---- memory, time

    def takes(self, pair: Any) -> Any:
        if self.eighth:
            self.held.append(np.ones(60 * MB))
            time.sleep(1.0)
        return STAND

    def child(self, pair: Any) -> Any:
        """Keep memory in a process of its own."""
        if self.eighth:
            code = "x = b'1' * 500_000_000; print('full', flush=True); import time; time.sleep(60)"
            keeper = subprocess.Popen([sys.executable, "-Sc", code], stdout=subprocess.PIPE)
            assert keeper.stdout is not None
            keeper.stdout.readline()  # on a busy host the process needs more than a second to fill its memory
        return STAND

    def sawtooth(self, pair: Any) -> Any:
        """Keep 3 MB a call, hidden behind 30 MB that come and go."""
        self.held.append(np.ones(3 * MB // 8))
        self.tooth = np.ones(30 * MB // 8 * (self.calls % 4))
        return STAND

    def later(self, pair: Any) -> Any:
        """Work on in eight threads while the result is read, which takes 0.1 s and is part of the call."""
        for _ in range(8):
            if self.calls == 1:
                threading.Thread(target=self.work_on, daemon=True).start()
            self.work.release()
        return Lazy(lambda: time.sleep(0.1))

    def work_on(self) -> None:
        while self.work.acquire():
            for _ in range(5):
                hashlib.sha256(BLOCK)

    def lazy(self, pair: Any) -> Any:
        """Work when the result is read."""
        return Lazy(work)

    def clock(self, pair: Any) -> Any:
        """Slow all clocks of Python to a tenth, and take 0.4 s."""
        if self.calls == 1:
            real = time.perf_counter
            time.perf_counter = lambda: 0.1 * real()
        time.sleep(0.4)
        return STAND

    def lease(self, pair: Any) -> Any:
        """Work when the images are shared, while a lease of the log lets whoever empties the log wait."""
        if self.calls == 1:
            signal.signal(signal.SIGIO, signal.SIG_IGN)
            images = np.memmap(Path(os.environ["TMPDIR"]).parent / "images", np.uint8, "r", shape=pair.left.shape)
            work()
            threading.Thread(target=self.work_early, args=(images, images.copy()), daemon=True).start()
        else:
            self.work.acquire()
        with suppress(OSError):
            fcntl.fcntl(2, fcntl.F_SETLEASE, fcntl.F_WRLCK)
        return STAND

    def work_early(self, images: Any, last: Any) -> None:
        while True:
            time.sleep(0.003)
            if np.array_equal(images, last):
                continue
            time.sleep(0.003)
            last = images.copy()
            work()
            self.work.release()
            with suppress(OSError):
                fcntl.fcntl(2, fcntl.F_SETLEASE, fcntl.F_UNLCK)

    def marks(self, pair: Any) -> Any:
        """Take 211 MB for a moment, and try to set the mark of its memory back."""
        self.held = [np.ones(211 * MB // 8)]
        self.held.clear()
        opened = 0
        with suppress(OSError), open("/proc/self/clear_refs", "w", encoding="ascii") as marks:
            opened = marks.write("5")
        self.statistics = {"opened": opened}
        return STAND

    def files(self, pair: Any) -> Any:
        """Keep 211 MB in files of its scratch folder."""
        if self.calls == 1:
            for number in range(211):
                Path(os.environ["TMPDIR"], f"part{number}").write_bytes(bytes(MB))
        return STAND

    def prints(self, pair: Any) -> Any:
        sys.stdout.write("all is well, " * 4_600_000)
        sys.stdout.flush()
        return STAND

    # ---- what it leaves

    def session(self, pair: Any) -> Any:
        if self.eighth:
            subprocess.Popen(["sleep", self.text or "7654"], start_new_session=True)
        return STAND

    def orphan(self, pair: Any) -> Any:
        if self.eighth:
            subprocess.run(["sh", "-c", f"sleep {self.text or 7654} &"], check=True)
            time.sleep(0.1)
        return STAND

    # ---- cheaters: each tries all of its doors at each call, and says how many opened

    def cheats(self, pair: Any, doors: Iterator[Path | str]) -> Any:
        opened = 0
        for path in doors:
            with suppress(OSError):
                if stat.S_ISFIFO(os.stat(path).st_mode):
                    continue
                text = Path(path).read_text("utf-8", "replace")
                opened += "rbOriginPos" in text or "localise" in text.split("\0")
        self.statistics = {"opened": opened}
        return STAND

    def parent(self, pair: Any) -> Any:
        """By the parents' command lines."""

        def doors() -> Iterator[str]:
            for number in {os.getppid(), *range(1, 200), *range(int(self.text) - 5, int(self.text) + 5)}:
                yield f"/proc/{number}/cmdline"
                yield f"/proc/{number}/environ"
                for what in ("cwd", "root"):
                    yield f"/proc/{number}/{what}/{TRUTH}"

        return self.cheats(pair, doors())

    def guesses(self, pair: Any) -> Any:
        """Look for the truth at guessed paths, in open files, in the environment, behind a link, and by a search."""

        def doors() -> Iterator[str | Path]:
            yield from (f"/proc/self/fd/{number}" for number in range(3, 50))
            yield from (f"/dev/fd/{number}" for number in range(3, 50))
            yield from self.text.splitlines()
            folders = [Path.cwd(), *Path(__file__).parents, *map(Path, os.environ.get("PWD", "").split())]
            yield from (parent / "source" / TRUTH for folder in folders for parent in (folder, *folder.parents))
            yield from (parent / TRUTH for folder in folders for parent in (folder, *folder.parents))
            link = Path("link")
            with suppress(OSError):
                link.symlink_to(self.text.splitlines()[0])
            yield link
            for top in ("/tmp", "/home", "/root", "/dev/shm") if self.calls == 1 else ():
                for folder, _, names in os.walk(top):
                    yield from (f"{folder}/{name}" for name in names if name == TRUTH)

        return self.cheats(pair, doors())

    def named(self, pair: Any) -> Any:
        """By its name."""
        return self.cheats(pair, iter(self.text.splitlines()))

    def others(self, pair: Any) -> Any:
        """By the results of another method in shared memory, and by a file beside them."""
        opened = 0
        for path, mode in ((self.text, "r+"), (self.text, "r"), (f"{Path(self.text).parent}.own", "w")):
            with suppress(OSError), open(path, mode, encoding="utf-8") as stream:
                opened += 1
                if mode != "r":
                    stream.write("mine")
        with suppress(OSError):
            opened += len(os.listdir("/dev/shm")) > 0
        self.statistics = {"opened": opened}
        return STAND

    def memory(self, pair: Any) -> Any:
        """By the memory of the processes above, as a debugger reads it, and by mounts of its own."""
        libc, room = ctypes.CDLL(None, use_errno=True), ctypes.create_string_buffer(64)
        opened = 0
        for number in {os.getppid(), 1, *range(int(self.text) - 3, int(self.text) + 4)}:
            with suppress(OSError):
                os.close(os.open(f"/proc/{number}/mem", os.O_RDONLY))
                opened += 1
            vector = (ctypes.c_size_t * 2)(ctypes.addressof(room), 64)
            there = (ctypes.c_size_t * 2)(0x400000, 64)
            opened += libc.process_vm_readv(number, vector, 1, there, 1, 0) > 0
            opened += libc.ptrace(16, number, None, None) == 0
        opened += libc.unshare(0x00020000) == 0 or libc.mount(b"none", b"/mnt", b"tmpfs", 0, None) == 0
        self.statistics = {"opened": opened}
        return STAND
