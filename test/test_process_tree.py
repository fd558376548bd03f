"""Memory of files that no process has mapped: files without a name, and files of the scratch folder."""

import mmap
import os
from pathlib import Path

import pytest

from sfr_loc_map.methods.call_monitor import MB
from sfr_loc_map.process_tree import bytes_of_files, bytes_of_nameless_files


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
