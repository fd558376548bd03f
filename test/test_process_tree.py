"""Memory of files that no process has mapped: files without a name, and files of the scratch folder."""

import ctypes
import mmap
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from sfr_loc_map.methods.call_monitor import MB
from sfr_loc_map.process_tree import ProcessTree, bytes_of_files, bytes_of_nameless_files

CLONE_FILES = 0x400
WITHOUT_FIRST_THREAD = """
import ctypes, os, threading, time

def hold():
    held = b"x" * 100_000_000
    memory = os.memfd_create("state")
    os.write(memory, held)
    while open(f"/proc/{os.getpid()}/stat").read().split()[2] != "Z":
        time.sleep(0.01)
    print("held", flush=True)
    time.sleep(60)

threading.Thread(target=hold).start()
ctypes.CDLL(None).syscall(EXIT, 0)  # ends only the first thread
"""
EXIT_CALLS = {"x86_64": 60, "aarch64": 93}  #: Number of the system call `exit`.


def test_memory_in_files_without_a_name_counts_once(tmp_path: Path) -> None:
    """A file of `memfd_create` that is open twice, and a deleted file; a file with a name counts in its folder."""
    before = bytes_of_nameless_files([os.getpid()])
    memory, named = os.memfd_create("state"), tmp_path / "scratch"
    again = os.dup(memory)
    with named.open("wb") as stream:
        os.write(memory, bytes(3 * MB))
        stream.write(bytes(2 * MB))
        stream.flush()
        os.fsync(stream.fileno())
        assert 0 <= bytes_of_nameless_files([os.getpid()]) - before - 3 * MB < MB
        named.unlink()
        assert 0 <= bytes_of_nameless_files([os.getpid()]) - before - 5 * MB < MB
    os.close(memory)
    os.close(again)
    assert bytes_of_nameless_files([os.getpid()]) == before


def test_shared_memory_counts_when_its_pages_are_not_resident() -> None:
    before = bytes_of_nameless_files([os.getpid()])
    with mmap.mmap(-1, 3 * MB) as memory:
        memory[:] = b"x" * len(memory)
        memory.madvise(mmap.MADV_DONTNEED)
        assert 0 <= bytes_of_nameless_files([os.getpid()]) - before - 3 * MB < MB
    assert bytes_of_nameless_files([os.getpid()]) == before


def test_files_in_the_own_table_of_a_thread_count() -> None:
    before = bytes_of_nameless_files([os.getpid()])
    filled, counted = threading.Event(), threading.Event()

    def keep() -> None:
        ctypes.CDLL(None).unshare(CLONE_FILES)
        memory = os.memfd_create("state")
        os.write(memory, bytes(3 * MB))
        filled.set()
        counted.wait(60)

    keeping = threading.Thread(target=keep)
    keeping.start()
    assert filled.wait(60)
    assert 0 <= bytes_of_nameless_files([os.getpid()]) - before - 3 * MB < MB
    counted.set()
    keeping.join()


def test_memory_of_a_process_whose_first_thread_has_ended_counts() -> None:
    code = WITHOUT_FIRST_THREAD.replace("EXIT", str(EXIT_CALLS[os.uname().machine]))
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == b"held\n"
            usage = ProcessTree(process.pid).usage()
        finally:
            process.kill()
    assert usage.rss_bytes > 200 * MB  # resident memory and the file


def test_a_file_that_cannot_be_examined_is_an_error(tmp_path: Path) -> None:
    place = os.open(tmp_path, os.O_RDONLY)
    for _ in range(20):
        os.mkdir("d" * 250, dir_fd=place)
        inner = os.open("d" * 250, os.O_RDONLY, dir_fd=place)
        os.close(place)
        place = inner
    os.close(os.open("table", os.O_CREAT, dir_fd=place))
    os.close(place)
    with pytest.raises(OSError, match="too long"):
        bytes_of_files(tmp_path, tmp_path / "images", 0)


def test_images_count_only_beyond_their_size(tmp_path: Path) -> None:
    images = tmp_path / "images"
    images.write_bytes(bytes(3 * MB))
    os.sync()
    assert bytes_of_files(tmp_path, images, 4 * MB) == 0
    assert MB <= bytes_of_files(tmp_path, images, 2 * MB) < 2 * MB
    assert bytes_of_files(tmp_path, tmp_path / "other", 4 * MB) >= 3 * MB
