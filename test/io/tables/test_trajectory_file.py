"""Trajectories as files: bit-identical, exact to the nanosecond, every format detected, one error for a broken file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.made_worlds import assert_same_trajectory
from sfr_loc_map.errors import InputError, OutputError
from sfr_loc_map.geometry.rotation import matrix_from_rotvec, quat_from_matrix, quat_normalised
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.tables.pose_columns import CSV_HEADER, TrajectoryFormat
from sfr_loc_map.io.tables.trajectory_file import read_trajectory_file
from sfr_loc_map.io.tables.trajectory_writer import EUROC_HEADER, save_trajectory

finite = st.floats(-1e9, 1e9)
poses = st.lists(
    st.tuples(st.integers(-(2**62), 2**62 - 1), st.tuples(finite, finite, finite), st.floats(0.1, 1.0)),
    min_size=1,
    max_size=5,
    unique_by=lambda item: item[0],
)
FILES = {"t.csv": "csv", "t.tum": "tum", "t.txt": "tum", "t.kitti": "kitti", "t.euroc.csv": "euroc"}
GOOD = "1.0 1 2 3 0 0 0 1"


def curve(count: int = 30) -> Trajectory:
    """Return a drive in a curve: forward, to the left and slightly up."""
    angle = np.linspace(0.0, 1.2, count)
    positions = np.column_stack((5 * np.sin(angle), 5 - 5 * np.cos(angle), 0.1 * angle))
    quats = np.array([quat_from_matrix(matrix_from_rotvec([0.02 * a, -0.01, a])) for a in angle])
    stamps = 1_700_000_000_123_456_789 + np.arange(count, dtype=np.int64) * 100_000_001
    return Trajectory(stamps, positions, quats)


@given(poses)
@pytest.mark.parametrize("name", ["t.csv", "t.txt", "t.tum"])
def test_round_trip_to_the_bit(tmp_path_factory: pytest.TempPathFactory, name: str, items: list) -> None:
    path = tmp_path_factory.mktemp("t") / name
    quats = quat_normalised([[q, -0.0, q / 3, 1 - q] for *_, q in items])
    trajectory = Trajectory(np.array([s for s, _, _ in items], np.int64), np.array([p for _, p, _ in items]), quats)
    save_trajectory(path, trajectory)
    assert_same_trajectory(read_trajectory_file(path).trajectory, trajectory)


@pytest.mark.parametrize("name", FILES)
def test_what_is_written_is_read_and_detected(tmp_path: Path, name: str) -> None:
    truth = curve()
    save_trajectory(tmp_path / name, truth)
    found = read_trajectory_file(tmp_path / name)
    assert found.format is TrajectoryFormat(FILES[name])
    assert np.array_equal(found.trajectory.stamps_ns, truth.stamps_ns)
    assert np.abs(found.trajectory.positions - truth.positions).max() < 1e-15
    assert np.abs((found.trajectory.quats_xyzw * truth.quats_xyzw).sum(axis=1)) == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize("separator", ["\f", "\v", "\x85", "\u2028"])
def test_a_separator_in_a_comment_before_the_rows_does_not_hide_a_pose(tmp_path: Path, separator: str) -> None:
    rows = "".join(f"{k}.0 {k} 2 3 0 0 0 1\n" for k in range(20))
    (tmp_path / "t.txt").write_text(f"# drive of{separator}Monday\n{rows}", encoding="utf-8")
    assert len(read_trajectory_file(tmp_path / "t.txt").trajectory) == 20


def test_csv_attitude_is_the_conjugate(tmp_path: Path) -> None:
    # RB turned by +90 deg about z in DS: ROS orientation (0, 0, s, s); a direction given in DS turns by -90 into RB.
    s = 0.5**0.5
    (tmp_path / "t.csv").write_text(f"{CSV_HEADER}\n5,1,2,3,0,0,{-s!r},{s!r}\n")
    (tmp_path / "t.txt").write_text(f"# t x y z qx qy qz qw\n0.000000005 1 2 3 0 0 {s!r} {s!r}\n")
    for name in ("t.csv", "t.txt"):
        read = read_trajectory_file(tmp_path / name).trajectory
        assert read.stamps_ns.tolist() == [5]
        np.testing.assert_allclose(read.pose(0).apply([1.0, 0, 0]), [1, 3, 3], atol=1e-15)


KITTI = "1 0 0 0 0 1 0 0 0 0 1"


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("t.txt", f"{GOOD}\n9999999999.0 1 2 3 0 0 0 1\n", "line 2: stamp"),
        ("t.txt", f"{GOOD}\n2.0 1e308 2 3 0 0 0 1\n", "line 2: the position is implausible"),
        ("t.txt", "9" * 100_000, "a line of more than 64000 bytes"),
        ("t.kitti", f"{KITTI} 0\n{KITTI}\n", "line 2 has 11 columns: 12"),
        ("t.kitti", f"9{KITTI[1:]} 0", "12 columns and no header, and fits no layout of"),
        ("t.euroc.csv", f"{EUROC_HEADER}\n1,0,0,0,1,0,0,0\n5,0,0,0,1,0\n", "line 3 has 6 columns: 8"),
        ("t.euroc.csv", f"{EUROC_HEADER}\n5,0,0,0,1,1,1,1\n", "line 2: the quaternion .* is not a rotation"),
    ],
)
def test_a_broken_file_is_one_error(tmp_path: Path, name: str, text: str, words: str) -> None:
    (tmp_path / name).write_text(text, encoding="utf-8", errors="surrogateescape")
    with pytest.raises(InputError, match=f"^[^\n]*{tmp_path / name}[^\n]*{words}[^\n]*$"):
        read_trajectory_file(tmp_path / name)


def test_kitti_poses_have_optical_axes_in_the_file(tmp_path: Path) -> None:
    ahead = Trajectory(np.array([0, 10**9]), np.array([[0.0, 0, 0], [2.0, 0.5, 0.25]]), np.tile([0.0, 0, 0, 1], (2, 1)))
    save_trajectory(tmp_path / "t.kitti", ahead)
    last = [float(word) for word in (tmp_path / "t.kitti").read_text().splitlines()[1].split()]
    assert [last[3], last[7], last[11]] == [-0.5, -0.25, 2.0], "x right, y down, z forward"
    assert (tmp_path / "t.times.txt").read_text() == "0.000000000\n1.000000000\n"


def test_positions_without_attitude_are_no_kitti_poses(tmp_path: Path) -> None:
    positions = Trajectory(np.array([0, 10**9]), np.eye(3)[:2], np.zeros((2, 4)))
    with pytest.raises(OutputError, match=r"t.kitti': the trajectory has no attitudes"):
        save_trajectory(tmp_path / "t.kitti", positions)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("number", "numbers_of"), [("", "line"), ("7 ", "frame")])
def test_poses_without_stamps_name_what_is_numbered(tmp_path: Path, number: str, numbers_of: str) -> None:
    file = tmp_path / "poses.txt"
    file.write_text(f"{number}1 0 0 0 0 1 0 0 0 0 1 0\n")
    assert read_trajectory_file(file).stamps == f"{numbers_of} numbers, 1 s apart"


@pytest.mark.parametrize("has_times", [True, False])
@pytest.mark.parametrize(("row", "number"), [(0, "-1"), (7, "6.5"), (12, "0.000000001")])
def test_frame_numbers_that_are_negative_or_not_whole_are_refused(
    tmp_path: Path, row: int, number: str, has_times: bool
) -> None:
    file, numbers = tmp_path / "poses.txt", [str(k) for k in range(20)]
    if has_times:
        (tmp_path / "times.txt").write_text("".join(f"{0.1 * k:.1f}\n" for k in range(20)))
    file.write_text("".join(f"{k} {k} 1 2\n" for k in numbers))
    assert len(read_trajectory_file(file, "frame,x,y,z").trajectory) == 20
    numbers[row] = number
    file.write_text("".join(f"{k} {k} 1 2\n" for k in numbers))
    with pytest.raises(InputError, match=f"line {row + 1}: the frame number is"):
        read_trajectory_file(file, "frame,x,y,z")


def test_stamps_of_kitti_poses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    poses, times = tmp_path / "poses" / "07.txt", tmp_path / "sequences" / "07" / "times.txt"
    poses.parent.mkdir()
    times.parent.mkdir(parents=True)
    save_trajectory(poses, curve(5), TrajectoryFormat.KITTI)
    (tmp_path / "poses" / "07.times.txt").unlink()
    alone = read_trajectory_file(poses)
    assert alone.by_index
    assert alone.trajectory.stamps_ns.tolist() == [k * 10**9 for k in range(5)]
    times.write_text("0.0\n0.1\n0.2\n0.3\n4e-1\n")
    monkeypatch.chdir(poses.parent)
    for path in (poses, Path(poses.name)):
        assert read_trajectory_file(path).trajectory.stamps_ns.tolist() == [k * 10**8 for k in range(5)]
    times.write_text("0.0\n")
    with pytest.raises(InputError, match="1 times for 5 poses"):
        read_trajectory_file(poses)


@pytest.mark.parametrize("skipped", ["not a pose", " ".join(["nan"] * 12)])
def test_a_skipped_line_of_kitti_poses_keeps_the_stamps_of_the_later_lines(tmp_path: Path, skipped: str) -> None:
    file, drive = tmp_path / "t.kitti", curve(20)
    save_trajectory(file, drive)
    lines = file.read_text().splitlines()
    lines[4] = skipped
    file.write_text("\n".join(lines) + "\n")
    read = read_trajectory_file(file).trajectory
    kept = np.delete(np.arange(20), 4)
    assert read.stamps_ns.tolist() == drive.stamps_ns[kept].tolist()
    np.testing.assert_allclose(read.positions, drive.positions[kept], atol=1e-12)
    (tmp_path / "t.times.txt").unlink()
    assert read_trajectory_file(file).trajectory.stamps_ns.tolist() == (kept * 10**9).tolist()


def test_the_detected_columns_of_a_table_without_a_header_are_named(tmp_path: Path) -> None:
    (tmp_path / "t.txt").write_text("".join(f"0.{k} {k} 0 0\n" for k in range(5)))
    assert "t.txt: t x y z, 5 positions" in read_trajectory_file(tmp_path / "t.txt").text


UNITS = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("name", ["sec", "stamp.sec", "t"])
@pytest.mark.parametrize("place", ["header", "line of units", "columns"])
def test_a_unit_applies_to_each_name_of_a_stamp(tmp_path: Path, place: str, name: str, unit: str) -> None:
    key = "t" if name == "t" else "sec"
    lines = {"header": [f"{name} [{unit}],x,y,z"], "line of units": [f"{name},x,y,z", f"{unit},m,m,m"], "columns": []}[
        place
    ]
    step = 100 if UNITS[unit] >= 1e-3 else round(0.1 / UNITS[unit])
    lines += [f"{step * k},{k},0,0" for k in range(20)]
    (tmp_path / "t.csv").write_text("\n".join(lines) + "\n")
    read = read_trajectory_file(tmp_path / "t.csv", f"{key}[{unit}],x,y,z" if place == "columns" else "")
    assert read.trajectory.stamps_ns.tolist() == [round(step * k * UNITS[unit] * 1e9) for k in range(20)]


@pytest.mark.parametrize(("unit", "is_read"), [("s", True), ("ms", False), ("m", False)])
def test_only_whole_seconds_have_a_column_of_their_fraction(tmp_path: Path, unit: str, is_read: bool) -> None:
    rows = "".join(f"{k},5,{k},0,0\n" for k in range(20))
    (tmp_path / "t.csv").write_text(f"sec [{unit}],nsec,x,y,z\n{rows}")
    if is_read:
        assert read_trajectory_file(tmp_path / "t.csv").trajectory.stamps_ns[1] == 10**9 + 5
        return
    with pytest.raises(InputError, match="unit of sec"):
        read_trajectory_file(tmp_path / "t.csv")


@pytest.mark.parametrize("before", ["", "\n", "\n \n", "\ufeff", "\ufeff\n"])
def test_blank_lines_before_the_header_of_the_suite_hide_no_pose(tmp_path: Path, before: str) -> None:
    save_trajectory(tmp_path / "t.csv", curve(3))
    text = (tmp_path / "t.csv").read_text()
    (tmp_path / "t.csv").write_text(before + text, encoding="utf-8")
    read = read_trajectory_file(tmp_path / "t.csv")
    assert read.format is TrajectoryFormat.CSV
    assert len(read.trajectory) == 3


def text_of(stamps_s: np.ndarray) -> str:
    return "".join(f"{stamp:.6f} {k} 2 3 0 0 0 1\n" for k, stamp in enumerate(stamps_s.tolist()))


@pytest.mark.parametrize("second_s", [(0.05, 20.05), (0.0, 20.0), (3.0, 8.0), (-5.0, 12.0)])
@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("begin_s", [0.0, -100.0])
def test_two_runs_of_the_same_time_in_one_table_are_refused(
    tmp_path: Path, second_s: tuple[float, float], direction: int, begin_s: float
) -> None:
    stamps_s = begin_s + np.concatenate((np.arange(0.0, 20.0, 0.1), np.arange(*second_s, 0.1)))
    (tmp_path / "t.txt").write_text(text_of(stamps_s[::direction]))
    with pytest.raises(InputError, match=r"t.txt' line [0-9]+: .* one run"):
        read_trajectory_file(tmp_path / "t.txt")


@pytest.mark.parametrize(("period_s", "begin_s"), [(0.1, 0.05), (0.3, 0.02)])
def test_two_bodies_with_stamps_of_their_own_are_refused(tmp_path: Path, period_s: float, begin_s: float) -> None:
    of_first, of_second = np.arange(0.0, 20.0, 0.1), np.arange(begin_s, 20.0, period_s)
    rows = [(s, f"{s:.3f},A,{s},0,0") for s in of_first] + [(s, f"{s:.3f},B,{s},3,0") for s in of_second]
    (tmp_path / "t.csv").write_text("t,name,x,y,z\n" + "\n".join(row for _, row in sorted(rows)) + "\n")
    with pytest.raises(InputError, match="typically 3 m away: the poses of one body are required"):
        read_trajectory_file(tmp_path / "t.csv")


@pytest.mark.parametrize("case", ["noise", "rounded noise", "rounded drive", "spikes"])
def test_noise_and_few_spikes_are_no_second_body(tmp_path: Path, case: str) -> None:
    rng = np.random.default_rng(2)
    positions = rng.normal(0.0, 0.05, (300, 2)) if "noise" in case else np.column_stack((np.arange(300), np.zeros(300)))
    if case == "rounded noise":
        positions = np.round(positions, 1)
    if case == "rounded drive":
        positions = np.round(0.002 * positions + rng.normal(0.0, 0.02, (300, 2)), 1)
    if case == "spikes":
        positions[::12, 1] = 20.0
    rows = "".join(f"{0.1 * k:.1f},{x},{y},0\n" for k, (x, y) in enumerate(positions.tolist()))
    (tmp_path / "t.csv").write_text(f"t,x,y,z\n{rows}")
    assert len(read_trajectory_file(tmp_path / "t.csv").trajectory) == 300


@pytest.mark.parametrize("form", ["{:g}", "{:.0f}"])
def test_stamps_with_too_few_digits_are_refused(tmp_path: Path, form: str) -> None:
    stamps_s = 1_700_000_000.0 + np.arange(0.0, 20.0, 0.1)
    (tmp_path / "t.txt").write_text("".join(f"{form.format(s)} {k} 2 3 0 0 0 1\n" for k, s in enumerate(stamps_s)))
    with pytest.raises(InputError, match=r"different stamps is [0-9]+ for 200 poses"):
        read_trajectory_file(tmp_path / "t.txt")


@pytest.mark.parametrize("unit", [1_000, 1])
def test_fractions_without_leading_zeros_are_refused(tmp_path: Path, unit: int) -> None:
    rng = np.random.default_rng(1)
    stamps_ns = np.arange(200) * 37_000_000 + rng.integers(0, 1_000_000, 200)
    lines = [f"{ns // 10**9 + 1_700_000_000}.{ns % 10**9 // unit} {ns} 2 3 0 0 0 1\n" for ns in stamps_ns.tolist()]
    (tmp_path / "t.txt").write_text("".join(lines))
    with pytest.raises(InputError, match="no leading zeros"):
        read_trajectory_file(tmp_path / "t.txt")


def test_few_fractions_without_leading_zeros_are_refused_because_the_stamps_decrease(tmp_path: Path) -> None:
    stamps_ns = np.arange(20) * 96_789_123 + 12_345_678
    lines = [f"{ns // 10**9 + 1_700_000_000}.{ns % 10**9} {ns} 2 3 0 0 0 1\n" for ns in stamps_ns.tolist()]
    (tmp_path / "t.txt").write_text("".join(lines))
    with pytest.raises(InputError, match="no leading zeros"):
        read_trajectory_file(tmp_path / "t.txt")


def test_tabs_and_spaces_may_separate_the_columns_of_one_table(tmp_path: Path) -> None:
    (tmp_path / "t.txt").write_text("".join(f"{k / 10}\t{k} 2 3\t0 0 0 1\n" for k in range(20)))
    assert read_trajectory_file(tmp_path / "t.txt").trajectory.positions[19].tolist() == [19.0, 2.0, 3.0]


@pytest.mark.parametrize("step_s", [0.1, 0.037, 0.05, 1 / 3])
def test_decimals_as_python_writes_them_are_read(tmp_path: Path, step_s: float) -> None:
    stamps_s = [1_700_000_000.0 + k * step_s for k in range(100)]
    (tmp_path / "t.txt").write_text("".join(f"{stamp} {k} 2 3 0 0 0 1\n" for k, stamp in enumerate(stamps_s)))
    assert len(read_trajectory_file(tmp_path / "t.txt").trajectory) == len(stamps_s)


def test_times_in_milliseconds_are_refused(tmp_path: Path) -> None:
    save_trajectory(tmp_path / "t.kitti", curve())
    (tmp_path / "t.times.txt").write_text("".join(f"{100 * k}\n" for k in range(30)))
    with pytest.raises(InputError, match="seconds are required"):
        read_trajectory_file(tmp_path / "t.kitti")


RUN_S = np.arange(0.0, 20.0, 0.1)
READABLE_S = {
    "upwards": RUN_S,
    "downwards": RUN_S[::-1],
    "shuffled": np.random.default_rng(1).permutation(RUN_S),
    "the second half first": np.roll(RUN_S, 100),
    "stray stamps": np.insert(RUN_S, [60, 61, 120], [1e6, 3.05, 0.0]),
    "repeated stamps": np.repeat(RUN_S, 2),
    "pairs of rows exchanged": RUN_S.reshape(-1, 2)[:, ::-1].reshape(-1),
}


@pytest.mark.parametrize("case", READABLE_S)
def test_one_run_in_any_order_is_read(tmp_path: Path, case: str) -> None:
    (tmp_path / "t.txt").write_text(text_of(READABLE_S[case]))
    assert len(read_trajectory_file(tmp_path / "t.txt").trajectory) == len(READABLE_S[case])


def test_rows_that_are_shorter_than_their_header_are_named_as_such(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("t,x,y,z\n" + "".join(f"{k},1,{k}\n" for k in range(5)))
    with pytest.raises(InputError, match="names 4 columns, but the rows have at most 3"):
        read_trajectory_file(tmp_path / "t.csv")


def test_only_nanoseconds_are_announced_as_euroc(tmp_path: Path) -> None:
    for unit, is_euroc in (("ns", True), ("s", False)):
        step = 100_000_000 if is_euroc else 1
        rows = "".join(f"{step * k},1,{k},2,1,0,0,0\n" for k in range(5))
        (tmp_path / "t.csv").write_text(f"t [{unit}],x,y,z,qw,qx,qy,qz\n{rows}")
        assert ("EuRoC" in read_trajectory_file(tmp_path / "t.csv").text) == is_euroc


@pytest.mark.parametrize("form", ["comment above", "further column", "other order", "named columns"])
def test_attitudes_of_the_suite_are_conjugated_wherever_their_columns_are(tmp_path: Path, form: str) -> None:
    truth, path = curve(), tmp_path / "t.csv"
    save_trajectory(path, truth)
    cells = [line.split(",") for line in path.read_text().splitlines()]
    columns = ""
    if form == "further column":
        cells = [[*row, "sigma" if not number else "0.1"] for number, row in enumerate(cells)]
    if form == "other order":
        cells = [[*row[4:], *row[:4]] for row in cells]
    if form == "named columns":
        cells[0][1:4] = ["A", "B", "C"]
        quats = ",".join(f"q{axis}=att_q_DsToRb_{number}" for number, axis in enumerate("xyzw", 1))
        columns = f"t=stamp_ns,x=A,y=B,z=C,{quats}"
    comments = ["# drive 12"] if form == "comment above" else []
    path.write_text("\n".join([*comments, *map(",".join, cells)]) + "\n")
    assert_same_trajectory(read_trajectory_file(path, columns).trajectory, truth)


@pytest.mark.parametrize("rows_of_truth", [30, 29])
def test_poses_without_stamps_are_paired_by_the_numbers_of_their_rows(tmp_path: Path, rows_of_truth: int) -> None:
    truth = curve()
    save_trajectory(tmp_path / "t.tum", truth)
    lines = (tmp_path / "t.tum").read_text().splitlines()
    lines[21] = f"{lines[21].split()[0]} nan nan nan 0 0 0 1"
    (tmp_path / "t.tum").write_text("\n".join(lines[: 1 + rows_of_truth]) + "\n")
    save_trajectory(tmp_path / "e.kitti", truth)
    (tmp_path / "e.times.txt").unlink()
    lines = (tmp_path / "e.kitti").read_text().splitlines()
    lines[10] = " ".join(["nan"] * 12)
    (tmp_path / "e.kitti").write_text("\n".join(lines) + "\n")
    declared, estimate = read_trajectory_file(tmp_path / "t.tum"), read_trajectory_file(tmp_path / "e.kitti")
    if rows_of_truth < len(truth):
        with pytest.raises(InputError, match=r"30 rows .* 29 rows"):
            estimate.with_stamps_of(declared)
        return
    found = estimate.with_stamps_of(declared).trajectory
    kept = np.delete(np.arange(len(truth)), [10, 20])
    assert np.array_equal(found.stamps_ns, truth.stamps_ns[kept])
    assert np.abs(found.positions - truth.positions[kept]).max() < 1e-12


UNIT_COMMENTS = [
    "positions in feet",
    "units: ft",
    "position in um",
    "Translation: mm",
    "length_unit=mm",
    "x, y, z [mm]",
]


@pytest.mark.parametrize("columns", ["", "t=#1[s],x=#2,y=#3,z=#4"])
@pytest.mark.parametrize("comment", UNIT_COMMENTS)
def test_a_comment_with_another_unit_than_metres_is_refused(tmp_path: Path, comment: str, columns: str) -> None:
    body = "".join(f"{0.1 * k:.1f},{k},2,3\n" for k in range(20))
    (tmp_path / "t.csv").write_text(f"# {comment}\nt,x,y,z\n{body}")
    with pytest.raises(InputError, match="states the unit"):
        read_trajectory_file(tmp_path / "t.csv", columns)


@pytest.mark.parametrize("is_named", [False, True])
@pytest.mark.parametrize(
    ("title", "metres"),
    [
        ("X mm", 0.001),
        ("X/mm", 0.001),
        ("Xmm", 0.001),
        ("X_cm", 0.01),
        ("X (metres)", 1.0),
        ("X_ft", None),
        ("X [feet]", None),
        ("X in", None),
        ("X um", None),
    ],
)
def test_a_unit_in_a_title_is_converted_or_refused(
    tmp_path: Path, title: str, metres: float | None, is_named: bool
) -> None:
    titles = [title.replace("X", axis) for axis in "XYZ"]
    body = "".join(f"{0.1 * k:.1f},{k},2,3\n" for k in range(20))
    (tmp_path / "t.csv").write_text(f"t,{','.join(titles)}\n{body}")
    named = (f"{axis}={each}" for axis, each in zip("xyz", titles, strict=True))
    columns = ",".join(("t=#1[s]", *named)) if is_named else ""
    if metres is None:
        with pytest.raises(InputError, match="not supported"):
            read_trajectory_file(tmp_path / "t.csv", columns)
        return
    found = read_trajectory_file(tmp_path / "t.csv", columns).trajectory
    assert found.positions[5] == pytest.approx([5 * metres, 2 * metres, 3 * metres])


@pytest.mark.parametrize(("fraction", "unit_ns"), [("stamp_nsec", 1), ("stamp_usec", 1000), ("stamp_nanosec", 1)])
def test_seconds_and_their_fraction_are_one_stamp(tmp_path: Path, fraction: str, unit_ns: int) -> None:
    body = "".join(f"{1700000000 + k // 4},{k % 4 * 250_000_000 // unit_ns},{k},2,3\n" for k in range(20))
    (tmp_path / "t.csv").write_text(f"stamp_sec,{fraction},x,y,z\n{body}")
    found = read_trajectory_file(tmp_path / "t.csv").trajectory
    assert np.diff(found.stamps_ns).tolist() == [250_000_000] * 19
