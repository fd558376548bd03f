"""Recordings: what was flushed is read by any reader, whatever comes then."""

import errno
import os
import resource
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from rosbags.highlevel import AnyReader

from sfr_loc_map.errors import OutputError
from sfr_loc_map.io.bag import recorder
from sfr_loc_map.io.bag.bag import Bag
from sfr_loc_map.io.bag.encoding import TYPESTORE
from sfr_loc_map.io.bag.recorder import BagRecorder

STRING = "std_msgs/msg/String"


def raw(number: int, size: int = 20) -> bytes:
    message = TYPESTORE.types[STRING](f"{number:06d}".ljust(size, "x"))
    return bytes(TYPESTORE.serialize_cdr(message, STRING))


def started(path: Path, *, zstd: bool = False) -> tuple[BagRecorder, Any]:
    bag = BagRecorder(path, zstd=zstd).__enter__()
    text, _ = TYPESTORE.generate_msgdef(STRING, ros_version=2)
    return bag, bag.add_topic("/words", STRING, text, TYPESTORE.hash_rihs01(STRING), [])


def read(path: Path) -> list[bytes]:
    """Return the messages, the same by our reader and by the library's."""
    ours = [message for *_, message in Bag(path).raw_messages(["words"])]
    with AnyReader(list(path.glob("*.mcap"))) as reader:
        assert ours == [bytes(message) for _, _, message in reader.messages()]
    return ours


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "x.mcap"


@pytest.mark.parametrize("zstd", [False, True])
def test_what_was_flushed_is_read_by_any_reader_while_the_recording_goes_on(path: Path, zstd: bool) -> None:
    bag, topic = started(path, zstd=zstd)
    for number in range(12):
        bag.write(topic, 1000 - number, raw(number))  # a clock that goes back must not hide what comes
        if number % 4 == 3:
            bag.flush()
            bag.flush()
            assert read(path) == [raw(n) for n in range(number + 1)]
            assert not Bag(path).unfinished
    bag.__exit__(None, None, None)
    assert read(path) == [raw(n) for n in range(12)]
    with AnyReader([path]) as reader:
        assert reader.message_count == bag.count == 12


def test_a_failed_synchronisation_ends_the_recording(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(recorder, "SYNC_S", 0.001)
    monkeypatch.setattr(os, "fdatasync", fail)
    bag, topic = started(path)
    bag._syncing.join(10.0)
    with pytest.raises(OutputError, match="stopped after 0 messages: Input/output error"):
        bag.write(topic, 0, raw(0))
    bag.__exit__(OutputError, OutputError(), None)


@pytest.fixture
def file_limit() -> Iterator[None]:
    before, handler = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)
    signal.signal(signal.SIGXFSZ, handler)


def limit_files(size: int) -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))


@pytest.mark.parametrize(("limit", "least_flushed"), [(5000, 0), (20_500, 9), (41_000, 27)])
def test_when_the_disk_is_full_all_that_was_flushed_stays(
    path: Path, file_limit: None, limit: int, least_flushed: int
) -> None:
    bag, topic = started(path)
    bag.flush()
    limit_files(limit)  # the system writes up to it, then fails
    flushed = 0

    def fill() -> None:
        nonlocal flushed
        for number in range(100):
            bag.write(topic, number, raw(number, 1000))
            if number % 3 == 2:
                bag.flush()
                flushed = number + 1

    with pytest.raises(OutputError, match=f"{path}' stopped after [0-9]+ messages: File too large; at most"):
        fill()
    bag.__exit__(OutputError, OutputError(), None)
    limit_files(resource.RLIM_INFINITY)
    assert flushed >= least_flushed
    if flushed:
        assert read(path) == [raw(n, 1000) for n in range(flushed)]
    assert next(path.glob("*.mcap")).stat().st_size <= limit
