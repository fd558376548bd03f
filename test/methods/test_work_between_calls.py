"""Attacks on the measurement of a method: work, files and memory outside of what the client sees of a call."""

import os
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

from helpers.made_scene import LOC_RIG, NAV_RIG, loc_pair, nav_pair, true_pose
from helpers.processes import wait_until
from sfr_loc_map.methods.isolated_localiser import IsolatedLocaliser
from sfr_loc_map.methods.isolated_mapper import IsolatedMapper
from sfr_loc_map.methods.registry import MethodLimits, find_method
from sfr_loc_map.suite_names import Task

CLASSES = """
import ctypes, mmap, os, shutil, socket, sys, threading, time
from contextlib import suppress
import numpy as np

WORK_S = 10.0

def of_caller(name):
    frame = sys._getframe()
    while name not in frame.f_locals:
        frame = frame.f_back
    return frame.f_locals[name]

class Standing:
    def __init__(self, rig, config):
        pass
    def process(self, pair):
        return np.eye(4)

class WorksLater(Standing):
    def process(self, pair):
        if not os.fork():
            end = time.thread_time() + WORK_S
            while time.thread_time() < end:
                pass
            os._exit(0)
        return np.eye(4)

class MapsLater(Standing):
    def __init__(self, rig, config):
        for number in range(20000):
            os.close(os.open(f"f{number}", os.O_CREAT | os.O_WRONLY))
    def map_pairs(self, pairs):
        from sfr_loc_map.geometry.cloud import PointCloud
        self.path = of_caller("order")["output"] + ".cloud.npy"
        self.cloud = PointCloud.empty()
        return self
    @property
    def warnings(self):  # read after the empty cloud is saved
        threading.Thread(target=self.work).start()
        return ()
    def work(self):
        records = np.load(self.path)
        np.save(self.path[:-4] + ".new.npy", np.zeros(9, records.dtype))
        time.sleep(0.05)  # the client holds the empty cloud
        os.rename(self.path[:-4] + ".new.npy", self.path)

class Drips(Standing):
    def process(self, pair):
        pipe, calls = of_caller("answers").fileno(), mmap.mmap(-1, 4096)
        dripping = os.fork()
        while not dripping:
            os.write(pipe, b" ")
            time.sleep(0.004)
        self.act()
        os.kill(dripping, 9)
        os.waitpid(dripping, 0)
        return np.eye(4)

class SleepsWhileDripping(Drips):
    def act(self):
        time.sleep(5)

class GrowsWhileDripping(Drips):
    def act(self):
        child = os.fork()
        if not child:
            held = b"1" * 500_000_000
            time.sleep(1)
            os._exit(0)
        os.waitpid(child, 0)

class Asks(Standing):
    def __init__(self, rig, config):
        self.path = config
    def process(self, pair):
        opened, libc = 0, ctypes.CDLL(None)
        with suppress(OSError), socket.socket(socket.AF_UNIX) as asking:
            asking.connect(self.path)
            opened += len(socket.recv_fds(asking, 1, 1)[1])
        with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM):
            opened += 1
        one, other = socket.socketpair()
        with suppress(OSError):
            opened += socket.send_fds(one, [b"x"], [os.memfd_create("hidden")])
        with suppress(OSError):
            one.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4_000_000)
            opened += 1
        opened += libc.shmget(0, 4096, 0o1600) >= 0 or libc.semget(0, 1, 0o1600) >= 0 or libc.msgget(0, 0o1600) >= 0
        opened += libc.mq_open(b"/sfr", os.O_CREAT | os.O_RDWR, 0o600, None) >= 0
        opened += libc.syscall(447, 0) >= 0  # memfd_secret
        one.send(b"x")
        self.statistics = {"opened": opened, "received": len(other.recv(9))}
        return np.eye(4)

class Marks(Standing):
    def process(self, pair):
        marked = 0
        with suppress(OSError):
            os.setxattr(__file__, "user.m", b"x")
            marked += 1
        os.chmod(__file__, 0o777)
        os.utime(__file__, (1, 1))
        copy = shutil.copy2(__file__, os.environ["HOME"] + "/copy.py")
        self.statistics = {"marked": marked, "copied": os.stat(copy).st_size}
        return np.eye(4)

class KeepsInSockets(Standing):
    pairs, held = (), 0
    def process(self, pair):
        self.pairs = [socket.socketpair() for _ in range(300)]
        for one, _ in self.pairs:
            one.setblocking(False)
            with suppress(BlockingIOError):
                while True:
                    self.held += one.send(bytes(32768))
        self.statistics = {"held": self.held}
        return np.eye(4)
"""


@pytest.fixture
def classes(tmp_path: Path) -> Path:
    path = tmp_path / "classes.py"
    path.write_text(CLASSES)
    return path


def localiser(
    classes: Path, name: str, limits: MethodLimits | None = None, config: str = "", **options: bool
) -> IsolatedLocaliser:
    method = find_method(f"{classes}:{name}", Task.LOCALISATION, config)
    return IsolatedLocaliser(method, LOC_RIG, true_pose(0), limits, hidden=(), **options)


def children_work() -> None:
    """Wait until the processes that this process has started have used half a second of processor time."""

    def worked_s() -> float:
        found = [child.cpu_times() for child in psutil.Process().children(recursive=True)]
        return sum(times.user + times.system for times in found)

    begin_s = worked_s()
    wait_until(lambda: worked_s() > begin_s + 0.5, "work between two calls")


def second_time(under_test: IsolatedLocaliser, pause: Callable[[], object] = children_work) -> float:
    """Return the time of a call, s, with a pause after the answer to the call before."""
    with under_test:
        under_test.localise(loc_pair(0))
        pause()
        _, call = under_test.localise(loc_pair(1))
    return call.usage.processing_time_s


def test_work_between_two_calls_is_part_of_the_second_call(classes: Path) -> None:
    """A child process works while the client prepares the next pair."""
    assert second_time(localiser(classes, "WorksLater")) >= 0.4


def test_a_method_that_receives_pairs_at_their_rate_may_work_between_its_calls(classes: Path) -> None:
    assert second_time(localiser(classes, "WorksLater", keeps_rate=True)) < 0.4


def test_a_pause_between_two_calls_of_an_idle_method_is_not_part_of_the_second_call(classes: Path) -> None:
    assert second_time(localiser(classes, "Standing"), lambda: time.sleep(0.8)) < 0.4


def test_a_cloud_that_is_replaced_after_the_answer_is_not_used(classes: Path) -> None:
    """The method maps while the client looks at 20000 files of the scratch folder."""
    method = find_method(f"{classes}:MapsLater", Task.MAPPING)
    with IsolatedMapper(method, NAV_RIG, hidden=()) as mapper:
        _, fused, call = mapper.map_set([nav_pair(0)])
    assert not call.finding
    assert len(fused.cloud) == 0


@pytest.mark.parametrize(
    ("name", "finding"), [("SleepsWhileDripping", "hanging"), ("GrowsWhileDripping", "out of memory")]
)
def test_bytes_that_trickle_on_the_pipe_do_not_stop_the_checks(classes: Path, name: str, finding: str) -> None:
    limits = MethodLimits(call_timeout_s=3.0, memory_mb=400)
    with localiser(classes, name, limits) as under_test:
        _, call = under_test.localise(loc_pair(0))
    assert call.finding.startswith(finding)


def test_a_method_reaches_no_other_process_and_leaves_no_memory_of_the_kernel(classes: Path, tmp_path: Path) -> None:
    """Another process offers an open file of the ground truth at a named socket."""
    truth = tmp_path / "truth.csv"
    truth.write_text("0, 1, 2")
    with socket.socket(socket.AF_UNIX) as offer, truth.open() as stream:
        path = str(tmp_path / "offer")
        offer.bind(path)
        offer.listen()

        def give() -> None:
            try:
                asking, _ = offer.accept()
            except OSError:
                return
            with asking:
                socket.send_fds(asking, [b"x"], [stream.fileno()])

        threading.Thread(target=give, daemon=True).start()
        with localiser(classes, "Asks", config=path) as under_test:
            _, call = under_test.localise(loc_pair(0))
        assert under_test.record.isolation.startswith("files, TCP, sockets, IPC")
    assert not call.finding
    assert (call.statistics["opened"], call.statistics["received"]) == (0.0, 1.0)


def test_metadata_of_files_cannot_carry_data_to_the_next_run(classes: Path) -> None:
    before = classes.stat()
    with localiser(classes, "Marks") as under_test:
        _, call = under_test.localise(loc_pair(0))
    after = classes.stat()
    assert not call.finding
    assert (call.statistics["marked"], call.statistics["copied"]) == (0.0, before.st_size)
    assert (after.st_mode, after.st_mtime_ns) == (before.st_mode, before.st_mtime_ns)
    assert not os.listxattr(classes)


def test_memory_in_the_buffers_of_sockets_counts(classes: Path) -> None:
    with localiser(classes, "KeepsInSockets") as under_test:
        _, call = under_test.localise(loc_pair(0))
    above_idle_bytes = call.usage.above_idle_bytes
    assert above_idle_bytes is not None
    assert above_idle_bytes >= call.statistics["held"] > 20_000_000


HELD = 200_000_000  #: Bytes.
TAKING = f"import builtins\nbuiltins.held = b'1' * {HELD}\n"
INDENTED = f"self.held = b'1' * {HELD}"


@pytest.mark.clause("4.2.2")
@pytest.mark.parametrize("place", ["import", "constructor", "warm_up", "start of the interpreter"])
def test_memory_that_a_method_takes_before_its_first_call_is_not_that_of_the_idle_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str
) -> None:
    """The memory counts, or the code that would take it does not run (a module that Python runs at its start)."""
    (tmp_path / "taking.py").write_text(
        f"""
import numpy as np
{TAKING if place == "import" else ""}
class Taking:
    def __init__(self, rig, config):
        {INDENTED if place == "constructor" else "pass"}
    def warm_up(self):
        {INDENTED if place == "warm_up" else "pass"}
    def process(self, pair):
        return np.eye(4)
"""
    )
    if place == "start of the interpreter":
        (tmp_path / "sitecustomize.py").write_text(TAKING)
    monkeypatch.chdir(tmp_path)
    for spec in ("taking:Taking", "taking.py:Taking"):
        with IsolatedLocaliser(find_method(spec, Task.LOCALISATION), LOC_RIG, true_pose(0), hidden=()) as under_test:
            _, call = under_test.localise(loc_pair(0))
        assert not call.finding
        usage = call.usage
        assert usage.peak_rss_bytes is not None
        assert usage.above_idle_bytes is not None
        assert usage.peak_rss_bytes - usage.above_idle_bytes < HELD
        assert (usage.above_idle_bytes > HELD) == (place != "start of the interpreter")
