"""Trajectories as text: bit-identical, exact to the nanosecond, one error for each broken file."""

from __future__ import annotations

import tempfile
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_worlds import assert_same_trajectory

from sfr_loc_map.errors import InputError, OutputError
from sfr_loc_map.geometry.rotation import quat_normalised
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.text_table import check_order, parse_seconds, seconds_text
from sfr_loc_map.io.trajectory_file import (
    CSV_HEADER,
    TrajectoryFormat,
    load_trajectory,
    save_trajectory,
    trajectory_text,
)

finite = st.floats(allow_nan=False, allow_infinity=False, width=64).filter(lambda v: abs(v) <= 1e9)
unit = st.floats(0.1, 1.0)
poses = st.lists(
    st.tuples(st.integers(-(2**62), 2**63 - 1), st.tuples(finite, finite, finite), unit), min_size=1, max_size=5
)


def trajectory_of(items: list[tuple[int, tuple[float, float, float], float]]) -> Trajectory:
    stamps = np.array([s for s, _, _ in items], np.int64)
    return Trajectory(
        stamps, np.array([p for _, p, _ in items]), quat_normalised([[q, -0.0, q / 3, 1 - q] for *_, q in items])
    )


@given(poses)
@pytest.mark.parametrize("name", ["t.csv", "t.txt", "t.tum"])
def test_round_trip_to_the_bit(tmp_path_factory: pytest.TempPathFactory, name: str, items: list) -> None:
    path = tmp_path_factory.mktemp("t") / name
    save_trajectory(path, trajectory_of(items))
    assert_same_trajectory(load_trajectory(path), trajectory_of(items))


def test_csv_attitude_is_the_conjugate(tmp_path: Path) -> None:
    # RB turned by +90 deg about z in DS: ROS orientation (0, 0, s, s); a direction given in DS turns by -90 into RB.
    s = 0.5**0.5
    (tmp_path / "t.csv").write_text(f"{CSV_HEADER}\n5,1,2,3,0,0,{-s!r},{s!r}\n")
    (tmp_path / "t.txt").write_text(f"# t x y z qx qy qz qw\n0.000000005 1 2 3 0 0 {s!r} {s!r}\n")
    for name in ("t.csv", "t.txt"):
        read = load_trajectory(tmp_path / name)
        assert read.stamps_ns.tolist() == [5]
        np.testing.assert_allclose(read.pose(0).apply([1.0, 0, 0]), [1, 3, 3], atol=1e-15)


@pytest.mark.parametrize(
    ("text", "stamp_ns"),
    [
        ("1700000000.123456789", 1_700_000_000_123_456_789),  # a float would give ...123456768
        ("1403636579.763555527", 1_403_636_579_763_555_527),
        ("0", 0),
        ("7.", 7_000_000_000),
        (".5", 500_000_000),
        ("-1.000000001", -1_000_000_001),
        ("1.305031e+09", 1_305_031_000_000_000_000),
        ("1.0000000004999", 1_000_000_000),
        ("1.0000000005001", 1_000_000_001),
        ("9223372036.854775807", 2**63 - 1),
    ],
)
def test_seconds_are_exact(text: str, stamp_ns: int) -> None:
    assert parse_seconds(text) == stamp_ns


@given(st.integers(-(2**63), 2**63 - 1))
def test_seconds_text_inverts(stamp_ns: int) -> None:
    assert parse_seconds(seconds_text(stamp_ns)) == stamp_ns


@given(st.integers(0, 10), st.integers(0, 9), st.data())
def test_many_stamps_of_one_form_are_exact(whole: int, decimals: int, data: st.DataObject) -> None:
    digits = st.text("0123456789", min_size=whole, max_size=whole)
    rest = st.text("0123456789", min_size=decimals, max_size=decimals)
    texts = [f"{'8' if whole == 10 else ''}{data.draw(digits)[:9]}.{data.draw(rest)}" for _ in range(3)]
    texts = [text if text != "." else "0." for text in texts]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "t.txt"
        path.write_text("".join(f"{text} 1 2 3 0 0 0 1\n" for text in texts))
        found = load_trajectory(path).stamps_ns.tolist()
    assert found == [int(Decimal(text) * 10**9) for text in texts]


GOOD = "1.0 1 2 3 0 0 0 1"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no pose"),
        ("# only a comment\n\n", "no pose"),
        (f"# c\n{GOOD}\n2.0 nan 2 3 0 0 0 1\n", "line 3.*'nan' is not a finite"),
        (f"{GOOD}\n2.0 1 inf 3 0 0 0 1\n", "line 2.*'inf'"),
        (f"{GOOD}\n\n2.0 1 2 3 0 0 0\n", "line 3: 7 columns"),
        ("2.0 1 2 3 0 0 0 1 9\n", "line 1: 9 columns"),
        ("1 0 0 5 0 1 0 6 0 0 1 7\n", "12 columns"),
        (f"{GOOD}\n2.0 1 2 x 0 0 0 1\n", "line 2: 'x' is not a finite number"),
        (f"{GOOD}\nt 1 2 3 0 0 0 1\n", "line 2: stamp 't'"),
        (f"{GOOD}\nnan 1 2 3 0 0 0 1\n", "line 2: stamp 'nan'"),
        (f"{GOOD}\n9999999999.0 1 2 3 0 0 0 1\n", "line 2: stamp"),
        ("9999999999.0 1 2 3 0 0 0 1\n", "line 1: stamp"),
        ("1700000000000000000 1 2 3 0 0 0 1\n", "line 1: stamp .* nanoseconds"),
        ("1.0/ 1 2 3 0 0 0 1\n", "line 1: stamp"),
        (f"{GOOD}\n99999999999.0 1 2 3 0 0 0 1\n", "line 2: stamp"),
        (f"{GOOD}\n2.0 1 2 3 0 0 0 0\n", "line 2: the quaternion .* is not a rotation"),
        (f"{GOOD}\n2.0 1e308 2 3 0 0 0 1\n", "line 2: the position is absurd"),
        (f"{GOOD}\n2.0 1 2 3 0 0 0 2\n", "line 2: the quaternion .* is not a rotation"),
        (f"{GOOD}\n2_0.0 1 2 3 0 0 0 1\n", "line 2: stamp '2_0.0'"),
        (f"{GOOD}\n\u0662.0 1 2 3 0 0 0 1\n", "line 2: stamp"),
        (f"{GOOD}\n2.0 1_0 2 3 0 0 0 1\n", "line 2: '1_0' is not a finite number"),
        (f"{'9' * 5000} 1 2 3 0 0 0 1\n", "line 1: stamp"),
        ("9" * 100_000, "a line of more than 64000 bytes"),
        ("\x00\udcff\udcfe binary", "line 1: "),
    ],
)
def test_broken_tum(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "t.txt").write_text(text, encoding="utf-8", errors="surrogateescape")
    with pytest.raises(InputError, match=words) as caught:
        load_trajectory(tmp_path / "t.txt")
    assert "\n" not in str(caught.value)
    assert str(tmp_path) in str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("stamp_ns,x\n1,2\n", "line 1 is 'stamp_ns,x'"),
        (f"{CSV_HEADER}\n", "no pose"),
        (f"{CSV_HEADER}\n1.5,1,2,3,0,0,0,1\n", "line 2: stamp '1.5' is not whole"),
        (f"{CSV_HEADER}\n1,1,2,3,0,0,0,1\n2,1,2,3,0,0,0\n", "line 3: 7 columns"),
        (f"{CSV_HEADER}\n1,1,,3,0,0,0,1\n", "line 2: '' is not a finite number"),
        (f"{CSV_HEADER}\n1,1,nan,3,0,0,0,1\n", "line 2: 'nan'"),
        (f"{CSV_HEADER}\n1_0,1,2,3,0,0,0,1\n", "line 2: stamp '1_0' is not whole"),
        (f"{CSV_HEADER}\n{'9' * 400},1,2,3,0,0,0,1\n", "line 2: stamp '9+' is not whole"),
        (f"{CSV_HEADER}\n1,-1e308,2,3,0,0,0,1\n", "line 2: the position is absurd"),
        (GOOD, "the header"),
    ],
)
def test_broken_csv(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(InputError, match=words):
        load_trajectory(tmp_path / "t.csv")


def test_windows_lines_and_tabs(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_bytes(f"\ufeff{CSV_HEADER}\r\n1,1,2,3,0,0,0,1\r\n".encode())
    (tmp_path / "t.txt").write_bytes(b"\xef\xbb\xbf" + GOOD.replace(" ", "\t  ").encode() + b"  \r\n")
    assert load_trajectory(tmp_path / "t.csv").positions.tolist() == [[1, 2, 3]]
    assert load_trajectory(tmp_path / "t.txt").stamps_ns.tolist() == [10**9]


def test_estimates_come_as_they_are(tmp_path: Path) -> None:
    stamps = np.array([3, 1, 1], np.int64)
    unordered = Trajectory(stamps, np.arange(9.0).reshape(3, 3), np.tile([0.0, 0, 0, 1.001], (3, 1)))
    save_trajectory(tmp_path / "t.csv", unordered)
    assert_same_trajectory(load_trajectory(tmp_path / "t.csv"), unordered)


def test_order() -> None:
    check_order([1, 1, 2], "x", strict=False)
    with pytest.raises(InputError, match=r"stamp 1 \(entry 2\)"):
        check_order([1, 1, 2], "x", strict=True)
    with pytest.raises(InputError, match=r"stamp 1 \(entry 3\) goes back behind 2"):
        check_order([1, 2, 1], "x", strict=False)


def test_missing_file_and_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nope.txt"):
        load_trajectory(tmp_path / "nope.txt")
    with pytest.raises(InputError, match="it is a folder"):
        load_trajectory(tmp_path)
    with pytest.raises(OutputError, match="no folder"):
        save_trajectory(tmp_path / "nope" / "t.csv", Trajectory.empty())


@pytest.mark.slow
def test_long_files_keep_every_bit(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    count = 100_000
    long = Trajectory(
        np.arange(count) * 10**8, rng.normal(size=(count, 3)), quat_normalised(rng.normal(size=(count, 4)))
    )
    (tmp_path / "t.txt").write_text(trajectory_text(long, TrajectoryFormat.TUM))
    read = load_trajectory(tmp_path / "t.txt")
    assert np.array_equal(read.stamps_ns, long.stamps_ns)
    assert np.array_equal(read.positions, long.positions)
    assert np.array_equal(read.quats_xyzw, long.quats_xyzw)


def test_lines_of_all_forms_are_read_alike(tmp_path: Path) -> None:
    stamps = ["0", "9.5", "1.25", "10.5", "100.125", "1e3", "1700000000.123456789", "1700000001.5", "9.123456789"]
    ends = ["\n", "\r\n", "\n# comment\n", "\n\n", "\n  \n"]
    text = "".join(f"{stamp} {i} 2 3 0 0 0 1{ends[i % len(ends)]}" for i, stamp in enumerate(stamps))
    path = tmp_path / "t.tum"
    path.write_bytes(text.encode())
    found = load_trajectory(path)
    assert found.stamps_ns.tolist() == [parse_seconds(stamp) for stamp in stamps]
    assert found.positions[:, 0].tolist() == list(range(len(stamps)))
    path.write_text(text + "5 1 2\n")
    with pytest.raises(InputError, match=rf"line {len(text.splitlines()) + 1}: 3 columns"):
        load_trajectory(path)


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_lines_of_a_csv_may_end_in_any_way(tmp_path: Path, end: str) -> None:
    text = end.join((CSV_HEADER, "5,1,2,3,0,0,0,1", "6,1,2,4,0,0,0,1", ""))
    (tmp_path / "t.csv").write_bytes(text.encode())
    assert load_trajectory(tmp_path / "t.csv").stamps_ns.tolist() == [5, 6]
