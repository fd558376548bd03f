import os
import resource
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from rosbags.highlevel import AnyReader

from sfr_loc_map.errors import OutputError
from sfr_loc_map.io.bag import TYPESTORE, Bag
from sfr_loc_map.io.bag_writer import BagRecorder

STRING = "std_msgs/msg/String"


def raw(number: int, size: int = 20) -> bytes:
    message = TYPESTORE.types[STRING](f"{number:06d}".ljust(size, "x"))
    return bytes(TYPESTORE.serialize_cdr(message, STRING))


def started(path: Path, *, zstd: bool = False) -> tuple[BagRecorder, object]:
    bag = BagRecorder(path, zstd=zstd).__enter__()
    text, _ = TYPESTORE.generate_msgdef(STRING, ros_version=2)
    return bag, bag.add_topic("/words", STRING, text, TYPESTORE.hash_rihs01(STRING), [])


def ours(path: Path) -> list[bytes]:
    return [message for *_, message in Bag(path).raw_messages(["words"])]


def theirs(path: Path) -> list[bytes]:
    (file,) = path.glob("*.mcap")
    with AnyReader([file]) as reader:
        return [bytes(message) for _, _, message in reader.messages()]


@pytest.mark.parametrize("zstd", [False, True])
def test_what_was_flushed_is_read_by_any_reader_while_the_recording_goes_on(tmp_path: Path, zstd: bool) -> None:
    path = tmp_path / "x.mcap"
    bag, topic = started(path, zstd=zstd)
    for number in range(12):
        bag.write(topic, 1000 - number, raw(number))  # a clock that goes back must not hide what comes
        if number % 4 == 3:
            bag.flush()
            bag.flush()
            expected = [raw(n) for n in range(number + 1)]
            assert ours(path) == theirs(path) == expected
            assert not Bag(path).unfinished
    bag.__exit__(None, None, None)
    assert ours(path) == theirs(path) == expected
    with AnyReader([path]) as reader:
        assert reader.message_count == 12
    assert bag.count == 12


def test_an_error_leaves_what_was_flushed(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    bag, topic = started(path)
    bag.write(topic, 1, raw(1))
    bag.flush()
    bag.write(topic, 2, raw(2))
    bag.__exit__(RuntimeError, RuntimeError(), None)
    assert ours(path) == theirs(path) == [raw(1)]


def test_large_chunks_are_written_without_a_flush(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sfr_loc_map.io.bag_writer.CHUNK_BYTES", 3_000_000)
    path = tmp_path / "x.mcap"
    bag, topic = started(path)
    for number in range(5):
        bag.write(topic, number, raw(number, 1_100_000))
    assert ours(path) == [raw(n, 1_100_000) for n in range(3)]
    bag.__exit__(None, None, None)
    assert len(ours(path)) == 5


def test_what_is_there_is_not_written_over(tmp_path: Path) -> None:
    (tmp_path / "x").write_text("dear")
    with pytest.raises(OutputError, match="it exists; choose another name"):
        BagRecorder(tmp_path / "x")
    with pytest.raises(OutputError, match="cannot record to"), BagRecorder(tmp_path / "x" / "y"):
        pass


@pytest.fixture
def file_limit() -> Iterator[None]:
    before, handler = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)
    signal.signal(signal.SIGXFSZ, handler)


@pytest.mark.parametrize("limit", [5000, 20_500, 41_000])
def test_when_the_disk_is_full_all_that_was_flushed_stays(tmp_path: Path, file_limit: None, limit: int) -> None:
    path = tmp_path / "x.mcap"
    bag, topic = started(path)
    bag.flush()
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))  # the system writes up to it, then fails
    flushed: list[int] = []

    def fill() -> None:
        for number in range(100):
            bag.write(topic, number, raw(number, 1000))
            if number % 3 == 2:
                bag.flush()
                flushed[:] = range(number + 1)

    with pytest.raises(OutputError, match=f"{path}' broke off after [0-9]+ messages: File too large; all but"):
        fill()
    bag.__exit__(OutputError, OutputError(), None)
    resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    if flushed:
        assert ours(path) == theirs(path) == [raw(n, 1000) for n in flushed]
    assert os.stat(next(path.glob("*.mcap"))).st_size <= limit


def test_a_disk_that_is_full_at_the_end_costs_the_index_only(tmp_path: Path, file_limit: None) -> None:
    path = tmp_path / "x.mcap"
    bag, topic = started(path)
    bag.write(topic, 1, raw(1))
    bag.flush()
    size = next(path.glob("*.mcap")).stat().st_size
    resource.setrlimit(resource.RLIMIT_FSIZE, (size + 10, resource.RLIM_INFINITY))
    with pytest.raises(OutputError, match="broke off after 1 messages"):
        bag.__exit__(None, None, None)
    resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    assert ours(path) == theirs(path) == [raw(1)]
