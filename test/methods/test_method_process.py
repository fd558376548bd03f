"""What the calls of a method tell of it: a leak, and times that are not those that were measured."""

import os
from pathlib import Path

from sfr_loc_map.methods.method_process import LEAK_CALLS, MB, is_misstated, leak_in
from sfr_loc_map.methods.process_tree import bytes_of_files, bytes_of_unnamed_files


def test_a_growth_over_all_calls_is_a_leak_and_a_saw_tooth_is_none() -> None:
    tooth = [90 * MB * (number % 4) for number in range(LEAK_CALLS)]
    assert not leak_in(tooth)
    assert leak_in([level + 2 * number * MB for number, level in enumerate(tooth)]).startswith("leaking")


def test_a_window_that_fills_and_then_stays_flat_is_no_leak() -> None:
    """The memory of our own localiser without a warm-up: libraries and a window of 30 keyframes, then 0.1 MB."""
    filling = [165 * MB + min(number, 30) * 1_300_000 + number // 40 * MB // 10 for number in range(210)]
    windows = range(LEAK_CALLS, len(filling) + 1)
    assert not any(leak_in(filling[last - LEAK_CALLS : last]) for last in windows)
    leaking = [level + 2 * MB * max(number - 40, 0) for number, level in enumerate(filling)]
    assert any(leak_in(leaking[last - LEAK_CALLS : last]) for last in windows)


def test_a_transfer_of_the_result_is_no_misstatement() -> None:
    assert not is_misstated(measured_s=0.9, stated_s=0.1, calls=20)  # one delayed call
    assert not is_misstated(measured_s=26.0, stated_s=16.0, calls=20)  # less than half of the calls
    assert not is_misstated(measured_s=2.0, stated_s=0.008, calls=400)  # a fast method in a long drive
    assert is_misstated(measured_s=1.6, stated_s=0.16, calls=20)
    assert is_misstated(measured_s=0.10, stated_s=3.00, calls=20)


def test_memory_in_files_without_a_name_counts_once(tmp_path: Path) -> None:
    """A file of `memfd_create` that is open twice, and a deleted file; a file with a name counts in its folder."""
    before = bytes_of_unnamed_files([os.getpid()])
    memory, named = os.memfd_create("state"), tmp_path / "scratch"
    again = os.dup(memory)
    with named.open("wb") as stream:
        os.write(memory, bytes(3 * MB))
        stream.write(bytes(2 * MB))
        stream.flush()
        os.fsync(stream.fileno())
        assert 0 <= bytes_of_unnamed_files([os.getpid()]) - before - 3 * MB < MB
        named.unlink()
        assert 0 <= bytes_of_unnamed_files([os.getpid()]) - before - 5 * MB < MB
    os.close(memory)
    os.close(again)
    assert bytes_of_unnamed_files([os.getpid()]) == before


def test_images_count_only_beyond_their_size(tmp_path: Path) -> None:
    images = tmp_path / "images"
    images.write_bytes(bytes(3 * MB))
    os.sync()
    assert bytes_of_files(tmp_path, images, 4 * MB) == 0
    assert MB <= bytes_of_files(tmp_path, images, 2 * MB) < 2 * MB
    assert bytes_of_files(tmp_path, tmp_path / "other", 4 * MB) >= 3 * MB
