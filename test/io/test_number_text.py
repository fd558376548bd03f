"""Numbers read in machine code have the bits that Python gives them."""

import random
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io import trajectory_file
from sfr_loc_map.io.number_text import parse_rows
from sfr_loc_map.io.trajectory_file import load_trajectory, save_trajectory


def read(words: list[str]) -> list[float]:
    rows = [words[k : k + 7] for k in range(0, len(words), 7)]
    rows[-1] += ["0"] * (7 - len(rows[-1]))
    got = parse_rows("\n".join("1 " + " ".join(row) for row in rows).encode(), comma=False, decimal_stamps=False)
    assert got is not None
    return got[1].ravel()[: len(words)].tolist()


def bits(values: list[float]) -> list[bytes]:
    return [struct.pack("<d", value) for value in values]


@settings(max_examples=300, deadline=None)
@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=40))
def test_any_double_reads_back(values: list[float]) -> None:
    words = [repr(value) for value in values]
    assert bits(read(words)) == bits(values)


def test_random_decimals_have_the_bits_of_python() -> None:
    rng = random.Random(1)
    words = []
    for _ in range(30_000):
        digits = "".join(rng.choice("0123456789") for _ in range(rng.randint(1, 22)))
        point = rng.randint(0, len(digits))
        word = rng.choice(["", "-"]) + digits[:point] + "." + digits[point:]
        words.append(word + rng.choice(["", "", f"e{rng.randint(-70, 70)}", f"E+{rng.randint(0, 30):02d}"]))
    words += [f"{(2 * rng.getrandbits(52) + 2**53 + 1) * 2**k}" for k in range(1, 8) for _ in range(200)]  # middles
    for first in range(0, len(words), 50):  # many that need Python in one table are refused
        some = words[first : first + 50]
        assert bits(read(some)) == bits([float(word) for word in some])


@pytest.mark.parametrize(
    "line",
    [
        "1 2 3 4 5 6 7",
        "1 2 3 4 5 6 7 8 9",
        "1 2 3 4 5 6 7 x",
        "1 2 3 4 5 6 7 nan",
        "1  2 3 4 5 6 7 8",
        "1 2 3 4 5 6 7 1e",
        "1.5 2 3 4 5 6 7 8",
    ],
)
def test_other_forms_are_left_to_the_slow_reader(line: str) -> None:
    assert parse_rows(line.encode(), comma=False, decimal_stamps=False) is None


def test_stamps_are_exact() -> None:
    text = b"# t x\n1700000000.123456789 0 0 0 0 0 0 1\n\n0.5 0 0 0 0 0 0 1\r\n7 0 0 0 0 0 0 1\n-1.25 0 0 0 0 0 0 1"
    got = parse_rows(text, comma=False, decimal_stamps=True)
    assert got is not None
    assert got[0].tolist() == [1700000000123456789, 500000000, 7000000000, -1250000000]


@pytest.mark.parametrize("name", ["t.csv", "t.tum"])
def test_both_readers_agree(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(2)
    stamps = 1_700_000_000_000_000_000 + np.arange(3000) * 33_333_333
    quats = rng.normal(0, 1, (3000, 4))
    save_trajectory(tmp_path / name, Trajectory(stamps, rng.normal(0, 100, (3000, 3)), quats))
    read_by = []
    for limit in (0, 10**9):
        monkeypatch.setattr(trajectory_file, "LARGE_BYTES", limit)
        read_by.append(load_trajectory(tmp_path / name))
    fast, slow = read_by
    assert np.array_equal(fast.stamps_ns, slow.stamps_ns)
    assert np.array_equal(fast.positions, slow.positions)
    assert np.array_equal(fast.quats_xyzw, slow.quats_xyzw)
    assert np.array_equal(fast.stamps_ns, stamps)
