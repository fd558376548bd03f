"""Trajectories as other programs write them: by the commands, each form gives the poses that were written."""

from __future__ import annotations

import bz2
import gzip
import json
import lzma
import re
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from helpers.cli_result import Sfr
from helpers.pose_tables import COUNT, drive, rows, seconds
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.rotation import matrix_from_quat, matrix_from_rotvec, quat_from_matrix, quat_normalised
from sfr_loc_map.geometry.stereo import OPTICAL_IN_BODY
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.stamps.time_units import UnitOrigin
from sfr_loc_map.io.tables.pose_columns import CSV_HEADER
from sfr_loc_map.io.tables.trajectory_file import read_trajectory_file
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory, trajectory_text
from sfr_loc_map.io.truth.config import TruthConfig
from sfr_loc_map.io.truth.read import truth_of_file
from sfr_loc_map.message_stamps import NS_PER_S


def matrices(poses: Trajectory) -> np.ndarray:
    rotations = matrix_from_quat(poses.quats_xyzw)
    return np.concatenate((rotations, poses.positions[:, :, None]), axis=2).reshape(-1, 12)


def matrices_by_columns(poses: Trajectory, last_row: tuple[float, ...] = ()) -> np.ndarray:
    with_row = [np.vstack([row.reshape(3, 4), np.reshape(last_row, (-1, 4))]) for row in matrices(poses)]
    return np.array([matrix.T.reshape(-1) for matrix in with_row])


def whole(poses: Trajectory, unit_ns: int = 1) -> list[int]:
    return [stamp // unit_ns for stamp in poses.stamps_ns.tolist()]


def with_nan(poses: Trajectory) -> str:
    lines = trajectory_text(poses, read_as("tum")).splitlines()
    return "\n".join([*lines[:1], *(f"{float(k)} NaN nan -nan(ind) NaN 0 0 1" for k in range(20)), *lines[1:]])


def read_as(name: str) -> object:
    from sfr_loc_map.io.tables.pose_columns import TrajectoryFormat

    return TrajectoryFormat(name)


TUM_ROWS = "".join(f"{0.1 * k:.1f} {0.1 * k} 2 3 0 0 0 1\n" for k in range(20))
DEGREES = "".join(f"{0.1 * k:.1f} {48 + 1e-6 * k:.7f} {11 + 2e-6 * k:.7f} 500\n" for k in range(20))
POSE = ("tx", "ty", "tz", "qx", "qy", "qz", "qw")
COVARIANCE = "Pr11 Pr12 Pr13 Pr22 Pr23 Pr33 Pt11 Pt12 Pt13 Pt22 Pt23 Pt33"
POSE_NAMES = "x,y,z,qx,qy,qz,qw"
WXYZ = [3, 0, 1, 2]


def moments(poses: Trajectory, form: str) -> list[str]:
    """Return the stamps as dates and times of day, UTC."""
    return [datetime.fromtimestamp(stamp / NS_PER_S, UTC).strftime(form) for stamp in poses.stamps_ns.tolist()]


FORMS: dict[str, Callable[[Trajectory], str]] = {
    "header behind a comment sign": lambda p: rows(
        whole(p), p.positions, p.quats_xyzw, header="#timestamp,tx,ty,tz,qx,qy,qz,qw"
    ),
    "microseconds by a unit": lambda p: rows(
        whole(p, 1000), p.positions, p.quats_xyzw, header="#timestamp [us],tx,ty,tz,qx,qy,qz,qw"
    ),
    "milliseconds by their magnitude": lambda p: rows(
        whole(p, 10**6), p.positions, p.quats_xyzw, header="timestamp,x,y,z,qx,qy,qz,qw"
    ),
    "columns of any order": lambda p: rows(
        p.quats_xyzw[:, WXYZ], whole(p), 1000.0 * p.positions, header="q_w,q_x,q_y,q_z,time_ns,x [mm],y [mm],z [mm]"
    ),
    "comments before the header": lambda p: (
        "".join(f"% comment {k}\n" for k in range(13))
        + rows(
            seconds(p),
            p.positions,
            p.quats_xyzw[:, WXYZ],
            separator=", ",
            header="% UNIX time, x-enu(m), y-enu(m), z-enu(m), "
            "orientation.w, orientation.x, orientation.y, orientation.z",
        )
    ),
    "seconds and nanoseconds": lambda p: rows(
        [stamp // NS_PER_S for stamp in whole(p)],
        [stamp % NS_PER_S for stamp in whole(p)],
        p.positions,
        p.quats_xyzw,
        header="#sec,nsec,x,y,z,qx,qy,qz,qw",
    ),
    "seconds and nanoseconds without a header": lambda p: rows(
        [stamp // NS_PER_S for stamp in whole(p)], [stamp % NS_PER_S for stamp in whole(p)], p.positions, p.quats_xyzw
    ),
    "rostopic echo": lambda p: rows(
        [stamp + 7 for stamp in whole(p)],
        range(COUNT),
        whole(p),
        ["world"] * COUNT,
        p.positions,
        p.quats_xyzw,
        header="%time,field.header.seq,field.header.stamp,field.header.frame_id,field.pose.position.x,"
        "field.pose.position.y,field.pose.position.z,field.pose.orientation.x,field.pose.orientation.y,"
        "field.pose.orientation.z,field.pose.orientation.w",
    ),
    "stamps and matrices": lambda p: rows(whole(p), matrices(p)),
    "tabs": lambda p: rows(seconds(p), p.positions, p.quats_xyzw, separator="\t"),
    "commas": lambda p: rows(seconds(p), p.positions, p.quats_xyzw),
    "semicolons and decimal commas": lambda p: rows(
        seconds(p), p.positions, p.quats_xyzw, separator=";", header="t[s];x[m];y[m];z[m];qx;qy;qz;qw"
    ).replace(".", ","),
    "spaces and decimal commas": lambda p: rows(seconds(p), p.positions, p.quats_xyzw, separator=" ").replace(".", ","),
    "commas and decimal commas in quotes": lambda p: "\n".join(
        '"' + line.replace(";", '","').replace(".", ",") + '"'
        for line in rows(seconds(p), p.positions, p.quats_xyzw, separator=";").splitlines()
    ),
    "nanoseconds with decimals": lambda p: rows(
        [f"{stamp}.000000" for stamp in whole(p)], p.positions, p.quats_xyzw, separator=" "
    ),
    "whole nanoseconds": lambda p: rows(whole(p), p.positions, p.quats_xyzw, separator=" "),
    "nanoseconds of a clock that starts at 0": lambda p: rows(
        [stamp - whole(p)[0] for stamp in whole(p)], p.positions, p.quats_xyzw, separator=" "
    ),
    "covariances behind the pose": lambda p: rows(
        seconds(p),
        p.positions,
        p.quats_xyzw,
        np.full((COUNT, 12), 1e-4),
        separator=" ",
        header=f"# timestamp(s) {' '.join(POSE)} {COVARIANCE}",
    ),
    "more columns without a header": lambda p: rows(
        seconds(p), p.positions, p.quats_xyzw, np.full((COUNT, 6), 1e-4), separator=" "
    ),
    "twelve columns that are not a matrix": lambda p: rows(
        seconds(p), p.positions, p.quats_xyzw, np.full((COUNT, 4), 1e-4), separator=" "
    ),
    "a header of more names than columns": lambda p: rows(
        seconds(p), p.positions, p.quats_xyzw, separator=" ", header=f"# timestamp(s) {' '.join(POSE)} {COVARIANCE}"
    ),
    "a label before the names": lambda p: rows(
        seconds(p),
        p.positions,
        p.quats_xyzw,
        np.zeros((COUNT, 6)),
        separator=" ",
        header=f"# format: timestamp {' '.join(POSE)} Ptx Pty Ptz Prx Pry Prz",
    ),
    "numbers of the rows that the header does not name": lambda p: rows(
        [f'"{k + 1}"' for k in range(COUNT)],
        seconds(p),
        p.positions,
        p.quats_xyzw,
        separator=" ",
        header=f'"timestamp" {" ".join(POSE)}',
    ),
    "seconds and microseconds": lambda p: rows(
        [stamp // NS_PER_S for stamp in whole(p)],
        [stamp % NS_PER_S // 1000 for stamp in whole(p)],
        p.positions,
        p.quats_xyzw,
        header="secs,usecs,x,y,z,qx,qy,qz,qw",
    ),
    "seconds and nanoseconds with units": lambda p: rows(
        [stamp // NS_PER_S for stamp in whole(p)],
        [stamp % NS_PER_S for stamp in whole(p)],
        p.positions,
        p.quats_xyzw,
        header="sec [s],nsec [nanoseconds],x,y,z,qx,qy,qz,qw",
    ),
    "a line of units below the header": lambda p: rows(
        seconds(p), 1000.0 * p.positions, p.quats_xyzw, header="time,x,y,z,qx,qy,qz,qw\n(s),(mm),(mm),(mm),-,-,-,-"
    ),
    "a line of units without that of time": lambda p: rows(
        seconds(p), 1000.0 * p.positions, p.quats_xyzw, header="time,x,y,z,qx,qy,qz,qw\n-,mm,mm,mm,-,-,-,-"
    ),
    "comments of C between the rows": lambda p: rows(
        seconds(p), p.positions, p.quats_xyzw, separator=" ", header="// t x y z qx qy qz qw"
    ).replace("1700000002.0", "// the next block\n1700000002.0"),
    "a separator after the last number": lambda p: rows(seconds(p), p.positions, p.quats_xyzw).replace("\n", ",\n"),
    "stamps and 4 x 4 matrices": lambda p: rows(
        seconds(p), matrices(p), np.tile([0.0, 0.0, 0.0, 1.0], (COUNT, 1)), separator=" "
    ),
    "stamps and 3 x 4 matrices, column by column": lambda p: rows(seconds(p), matrices_by_columns(p), separator=" "),
    "stamps and 4 x 4 matrices, column by column": lambda p: rows(
        seconds(p), matrices_by_columns(p, (0.0, 0.0, 0.0, 1.0)), separator=" "
    ),
    "a name before the stamp": lambda p: rows(
        [f"P{k}" for k in range(COUNT)], seconds(p), p.positions, p.quats_xyzw, header="point,t,x,y,z,qx,qy,qz,qw"
    ),
    "dates in a column of their own": lambda p: rows(
        moments(p, "%Y-%m-%d"), moments(p, "%H:%M:%S.%f"), p.positions, p.quats_xyzw, header=f"date,time,{POSE_NAMES}"
    ),
    "dates of a German spreadsheet": lambda p: (
        rows(
            moments(p, "%d|%m|%Y;%H:%M:%S.%f"),
            p.positions,
            p.quats_xyzw,
            separator=";",
            header=f"Date;Time;{POSE_NAMES.replace(',', ';')}",
        )
        .replace(".", ",")
        .replace("|", ".")
    ),
    "dates in a column of their own between tabs": lambda p: rows(
        moments(p, "%Y-%m-%d\t%H:%M:%S.%f"),
        p.positions,
        p.quats_xyzw,
        separator="\t",
        header="\t".join(("Date", "Time", *POSE_NAMES.split(","))),
    ),
    "dates with slashes between spaces": lambda p: rows(
        moments(p, "%Y/%m/%d %H:%M:%S.%f"), p.positions, p.quats_xyzw, separator="  ", header="% GPST x y z qx qy qz qw"
    ),
    "lines without values": with_nan,
    "a broken line": lambda p: trajectory_text(p, read_as("tum")) + "1700000100.0 1 2",
}


@pytest.mark.parametrize("form", FORMS)
def test_each_form_is_read_as_it_was_written(tmp_path: Path, sfr: Sfr, form: str) -> None:
    poses = drive()
    (tmp_path / "theirs.txt").write_text(FORMS[form](poses))
    done = sfr("convert", tmp_path / "theirs.txt", tmp_path / "ours.csv")
    assert done.code == 0, done.err
    found = read_trajectory_file(tmp_path / "ours.csv").trajectory
    shift = 1_700_000_000 * NS_PER_S if "starts at 0" in form else 0
    assert (found.stamps_ns + shift).tolist() == poses.stamps_ns.tolist()
    np.testing.assert_allclose(found.positions, poses.positions, atol=1e-12)
    assert np.abs((found.quats_xyzw * poses.quats_xyzw).sum(axis=1)) == pytest.approx(1.0, abs=1e-12)
    left_out = {"lines without values": "20 lines without values", "a broken line": "1 invalid line skipped"}
    assert left_out.get(form, "") in done.err


HEADERS_OF_POSITIONS = {
    "Point,Date,Time,E,N,H": "P1,%Y-%m-%d,%H:%M:%S.%f",
    "Date\tTime\tx\ty\tz": "%Y-%m-%d\t%H:%M:%S.%f",
    "Time,Easting,Northing,Altitude": "%Y-%m-%dT%H:%M:%S.%f",
    "UTC Time,X Position,Y Position,Z Position": "%Y-%m-%d %H:%M:%S.%f",
    "% GPST,e-baseline(m),n-baseline(m),u-baseline(m)": "%Y/%m/%d %H:%M:%S.%f",
}


@pytest.mark.parametrize("header", HEADERS_OF_POSITIONS)
def test_positions_at_dates_are_read_by_their_names(tmp_path: Path, header: str) -> None:
    poses = drive()
    stamps, separator = moments(poses, HEADERS_OF_POSITIONS[header]), "\t" if "\t" in header else ","
    (tmp_path / "t.csv").write_text(rows(stamps, poses.positions, separator=separator, header=header))
    found = read_trajectory_file(tmp_path / "t.csv").trajectory
    assert found.stamps_ns.tolist() == poses.stamps_ns.tolist()
    assert found.positions.tolist() == poses.positions.tolist()


@pytest.mark.parametrize("encoding", ["utf-8", "cp1252"])
def test_the_titles_of_a_spreadsheet_in_german_name_columns(tmp_path: Path, encoding: str) -> None:
    """The message quotes the line of the titles, not the title of the sheet above, and its names are accepted."""
    poses = drive()
    titles = "Punkt;Datum;Zeit;Rechtswert;Hochwert;Höhe"
    table = rows(moments(poses, "P1;%d.%m.%Y;%H:%M:%S.%f"), poses.positions, separator=";", header=titles)
    (tmp_path / "t.csv").write_bytes(f"Messung Süd;;;;;\r\n{table}".encode(encoding))
    with pytest.raises(InputError, match=f"line 2 is '{titles}'"):
        read_trajectory_file(tmp_path / "t.csv")
    columns = "t=Zeit[utc],x=Rechtswert,y=Hochwert,z=Höhe"
    found = read_trajectory_file(tmp_path / "t.csv", columns).trajectory
    assert found.stamps_ns.tolist() == poses.stamps_ns.tolist()
    assert found.positions.tolist() == poses.positions.tolist()


def test_a_heading_in_place_of_a_height_is_found_also_at_dates(tmp_path: Path) -> None:
    lines = planar_rows(1.0).splitlines()
    dates = (f"2026-05-04T10:22:{0.1 * k:05.2f},{','.join(line.split(',')[1:])}" for k, line in enumerate(lines))
    (tmp_path / "t.csv").write_text("t,e,n,h\n" + "\n".join(dates) + "\n")
    with pytest.raises(InputError, match="the heading of the path in radians"):
        read_trajectory_file(tmp_path / "t.csv")


def test_numbered_matrices_take_the_stamps_of_the_other_side(tmp_path: Path, sfr: Sfr) -> None:
    poses = drive()
    save_trajectory(tmp_path / "truth.csv", poses)
    (tmp_path / "poses.txt").write_text(rows(range(COUNT), matrices(poses), separator=" "))
    done = sfr("score", tmp_path / "poses.txt", tmp_path / "truth.csv", "--condition", "distance=2")
    assert done.code == 0, done.err
    assert "pose by pose" in done.err


AMBIGUOUS = {
    "scalar first or last": lambda p: rows(whole(p), p.positions, p.quats_xyzw),
    "names of a tracker": lambda p: rows(whole(p), p.positions, p.quats_xyzw, header="Frame,TX,TY,TZ,RX,RY,RZ,RW"),
    "seconds or milliseconds": lambda p: rows(range(COUNT), p.positions, p.quats_xyzw, header="t,x,y,z,qx,qy,qz,qw"),
}


@pytest.mark.parametrize("side", ["estimate", "truth"])
@pytest.mark.parametrize("case", AMBIGUOUS)
def test_what_can_be_read_in_two_ways_is_asked_and_the_answer_is_one_option(
    tmp_path: Path, sfr: Sfr, case: str, side: str
) -> None:
    poses = drive()
    step = NS_PER_S if case == "seconds or milliseconds" else 500_000_000
    stamps = np.arange(COUNT, dtype=np.int64) * step + (0 if step == NS_PER_S else poses.stamps_ns[0])
    save_trajectory(tmp_path / "plain.csv", Trajectory(stamps, poses.positions, poses.quats_xyzw))
    (tmp_path / "theirs.csv").write_text(AMBIGUOUS[case](poses))
    files = [tmp_path / "theirs.csv", tmp_path / "plain.csv"]
    words = ["score", *(files if side == "estimate" else files[::-1]), "--condition", "distance=2"]
    refused = sfr(*words)
    assert refused.code == 2
    assert f"--columns '{side}:" in refused.err
    columns = {
        "scalar first or last": "t[ns],x,y,z,qx,qy,qz,qw",
        "names of a tracker": "t=Frame[ns],x=TX,y=TY,z=TZ,qx=RX,qy=RY,qz=RZ,qw=RW",
        "seconds or milliseconds": "t=t[s],x=x[m],y=y,z=#4,qx=qx,qy=qy,qz=qz,qw=qw",
    }[case]
    done = sfr(*words, "--columns", f"{side}:{columns}")
    assert done.code == 0, done.err


def planar_rows(heading_scale: float) -> str:
    """Return rows `t x y heading` of a path that turns by 80 deg."""
    headings = np.linspace(0.0, 1.4, COUNT)
    return rows(
        [f"{0.1 * k:.1f}" for k in range(COUNT)], np.sin(headings), 1.0 - np.cos(headings), heading_scale * headings
    )


TRACKER = "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z\n"
REFUSED = {
    "names that occur twice": (f"{TRACKER}1,0.5,0,0,0,1,7,8,9\n", "", "line 1: columns #3 and #7 are both 'X'"),
    "complete stamps as fractions": ("sec,nsec,x,y,z\n1,1000000005,0,0,0\n", "", "line 2: the fraction of a second"),
    "a complete stamp and its fraction": (
        "t,nsec,x,y,z\n1700000000.25,250000000,0,0,0\n",
        "",
        "line 2: the column of seconds contains 1700000000.250000000, although another column",
    ),
    "a part of a matrix": ("1.5,2,3,4,5\n", "t[s],x,y,z,m11", "only the columns m11 of a matrix: either m11, m12"),
    "a part of a quaternion": (
        "t,x,y,z,qx,qy,qz\n1.5,2,3,4,0,0,0\n",
        "",
        "only the columns qx, qy, qz of a quaternion",
    ),
    "unknown units below the header without a unit of time": (
        "t,x,y,z\n-,ft,ft,ft\n1.5,2,3,4\n",
        "",
        "the unit of x is 'ft'",
    ),
    "an unknown unit": ("t [s],x [ft],y [ft],z [ft]\n1,2,3,4\n", "", "the unit of x is 'ft'"),
    "an unknown unit below the header": ("t,x,y,z\n(s),(ft),(ft),(ft)\n1.5,2,3,4\n", "", "the unit of x is 'ft'"),
    "a unit for two of three columns": ("t_s,x_mm,y_mm,z\n1,2,3,4\n", "", "x is in mm, but z has no unit"),
    "rows of 4 x 4 matrices": ("1 0 0 5\n0 1 0 5\n0 0 1 5\n0 0 0 1\n" * 5, "", "fits no layout of"),
    "a gap in the given columns": ("1,2,3,4,5\n", "t[s],,x,y,z", "no column for ''"),
    "a column number of 0": ("1,2,3,4\n", "t=#1[s],x=#0,y=#2,z=#3", "no column for 'x=#0'"),
    "a column given twice": ("a,b,c,d\n1,2,3,4\n", "t=a[s],x=b,y=c,z=d,x=d", "names x twice"),
    "separators of thousands": (
        "t;x;y;z\n0.5;1,000.5;2.5;3.5\n",
        "",
        "'1,000.5' and '1,000.5': the comma may separate",
    ),
    "separators of thousands after the lines from which the columns are detected": (
        "t;x;y;z\n" + "".join(f"{0.1 * k:.1f};999.5;2.5;3.5\n" for k in range(6000)) + "600.0;1,000;2.5;3.5\n",
        "",
        "'1,000' and '999.5': the comma may separate",
    ),
    "whole numbers with separators of thousands": (
        "t[s];x[mm];y[mm];z[mm]\n0,5;1,000;5;2,000\n",
        "",
        "'1,000' and '5': the comma may separate",
    ),
    "millimetres with separators of thousands": (
        "t[s];x[mm];y[mm];z[mm]\n0.5;100,050;200,000;50,000\n",
        "",
        "'100,050' in mm: the comma may separate",
    ),
    "columns that the header does not name": ("time,x,y,z\n0.1,7,1,2,3\n0.2,8,2,3,4\n", "", "4 names, .* 5 columns"),
    "two positions": ("t[s],x,y,z,px,py,pz\n1,2,3,4,5,6,7\n", "", "several positions: x y z and px py pz"),
    "a height downwards beside x and y": ("t[s],x,y,down\n1,2,3,4\n", "", "z not found"),
    "decimals of milliseconds": (
        "time,x,y,z\n0.25,1,2,3\n100.25,1,2,3\n200.25,1,2,3\n",
        "",
        "the unit of the stamps 0.25, 100.25, 200.25 is ambiguous",
    ),
    "decimals of milliseconds at 120 Hz": (
        "time,x,y,z\n" + "".join(f"{k / 0.12:.3f},1,2,3\n" for k in range(20)),
        "",
        "the unit of the stamps 0.000, 8.333, 16.667 is ambiguous",
    ),
    "days": (
        "time,x,y,z\n" + "".join(f"{45000 + k / 864000:.12f},{k},2,3\n" for k in range(20)),
        "",
        "the unit of the stamps 45000.000000000000, .* is ambiguous",
    ),
    "milliseconds as TUM": (
        "".join(f"{100 * k} {k} 2 3 0 0 0 1\n" for k in range(20)),
        "",
        "the unit of the stamps 0, 100, 200 is ambiguous",
    ),
    "units in the titles and below them": (
        "t[s],x[m],y[m],z[m]\ns,mm,mm,mm\n1,2,3,4\n",
        "",
        "m by its title .* mm by the",
    ),
    "a unit in a comment": ("# positions in mm\nt[s],x,y,z\n1,2,3,4\n", "", "line 1 states the unit mm"),
    "a unit in a comment before TUM": (
        "# t x y z qx qy qz qw, lengths: millimetres\n" + TUM_ROWS,
        "",
        "line 1 states the unit mm, .*qw'",
    ),
    "a unit in a comment before given columns": (
        "# unit: cm\n" + TUM_ROWS,
        "t[s],x,y,z,qx,qy,qz,qw",
        "line 1 states the unit cm",
    ),
    "microseconds as nanoseconds": (
        "time_ns,x,y,z\n" + "".join(f"{1_700_000_000_000_000 + 100_000 * k},{k},2,3\n" for k in range(20)),
        "",
        "100000 ns apart, but would be times of a clock if they were 1000 times as large",
    ),
    "seconds as nanoseconds": (
        "time_ns,x,y,z\n" + "".join(f"{1_700_000_000 + 0.1 * k:.1f},{k},2,3\n" for k in range(20)),
        "",
        r"times of a clock if they were 1e\+09 times as large",
    ),
    "seconds since a start as milliseconds": (
        "time [ms],x,y,z\n" + "".join(f"{0.1 * k:.1f},{k},2,3\n" for k in range(20)),
        "",
        "the stamps are 100000 ns apart, but at least 500000 ns",
    ),
    "milliseconds in the csv of the suite": (
        CSV_HEADER + "\n" + "".join(f"{1_700_000_000_000 + 100 * k},{k},2,3,0,0,0,1\n" for k in range(20)),
        "",
        "100 ns apart, but would be times of a clock",
    ),
    "latitude and longitude": ("time,latitude,longitude,altitude\n1.5,48.1,11.5,500\n", "", "line 1 names latitude"),
    "latitude and longitude in a comment": ("# t[s] Lat[deg] Lon[deg] h\n" + DEGREES, "", "line 1 names latitude"),
    "latitude and longitude without names": (DEGREES, "", "latitude and longitude in degrees"),
    "two bodies": (
        "".join(f"{0.1 * k:.1f} {0.1 * k} {b} 0 0 0 0 1\n" for k in range(20) for b in (0, 3)),
        "",
        "line 2 and 19 more have the stamp of another line, .* typically 3 m apart",
    ),
    "positions without stamps": ("1 2 3\n" * 9, "", "a stamp and three coordinates are required"),
    "headings in radians in place of heights": (planar_rows(1.0), "", "the heading of the path in radians"),
    "headings in a column h": (
        "t,e,n,h\n" + planar_rows(1.0).replace(" ", ","),
        "",
        "the heading of the path in radians",
    ),
    "times of day as one number": (
        "t,x,y,z\n" + "".join(f"{101558.5 + 0.5 * k + 40.0 * (k > 2):.1f},{k},2,3\n" for k in range(20)),
        "",
        "hhmmss",
    ),
    "headings in degrees in place of heights": (planar_rows(180.0 / np.pi), "", "the heading of the path in degrees"),
    "times of day": ("time,x,y,z\n10:22:01.25,1,2,3\n", "", "line 1 is 'time,x,y,z', line 2 is '10:22:01.25,1,2,3'"),
    "a text without rows": ('{"poses": []}\n', "", """has no pose: .* line 1 is '{"poses": \\[\\]}'"""),
}


def test_rows_that_are_written_twice_and_a_stationary_body_are_read(tmp_path: Path) -> None:
    noise = np.random.default_rng(1).normal(0.0, 0.004, (40, 3))
    still = "".join(f"{0.1 * (k // 2):.1f} {48 + x} {11 + y} {z}\n" for k, (x, y, z) in enumerate(noise.tolist()))
    for text, count in ((still, 40), (TUM_ROWS, 20)):
        doubled = text if text is still else "".join(f"{line}\n{line}\n" for line in text.splitlines())
        (tmp_path / "t.txt").write_text(doubled)
        assert len(read_trajectory_file(tmp_path / "t.txt").trajectory) == (count if text is still else 2 * count)


@pytest.mark.parametrize("separator", [";", "\t", ","])
def test_the_csv_of_the_suite_is_read_as_a_spreadsheet_writes_it(tmp_path: Path, separator: str) -> None:
    poses = drive()
    lines = trajectory_text(poses).splitlines()
    quoted = lines[0].replace(",", '","')
    lines[0] = f'"{quoted}"'
    text = "\r\n".join(line.replace(",", separator) for line in lines)
    (tmp_path / "t.csv").write_bytes(("\ufeff" + text).encode())
    found = read_trajectory_file(tmp_path / "t.csv")
    assert found.format is read_as("csv")
    assert found.trajectory.quats_xyzw.tolist() == poses.quats_xyzw.tolist()


def level_path(heading_deg: float, *, is_camera: bool = False) -> Trajectory:
    """Return a nearly level drive of a body, or of a camera with z forward, at headings around `heading_deg`."""
    headings = np.radians(heading_deg + np.linspace(-20.0, 20.0, COUNT))
    steps = np.stack((np.cos(headings), np.sin(headings), 0.0 * headings), axis=1) * 0.1
    axes = OPTICAL_IN_BODY if is_camera else np.eye(3)
    attitudes = [
        matrix_from_rotvec([0.0, 0.0, heading]) @ matrix_from_rotvec([0.02, -0.03, 0.0]) for heading in headings
    ]
    quats = np.array([quat_from_matrix(attitude @ axes) for attitude in attitudes])
    return Trajectory(drive().stamps_ns, np.cumsum(steps, axis=0), quats)


def tum_rows(poses: Trajectory, order: tuple[int, ...]) -> str:
    seconds = [f"{stamp_ns / NS_PER_S:.6f}" for stamp_ns in poses.stamps_ns.tolist()]
    return rows(seconds, poses.positions, poses.quats_xyzw[:, order], separator=" ")


@pytest.mark.parametrize("heading_deg", range(0, 360, 30))
def test_a_level_drive_with_the_scalar_first_and_without_a_header_is_refused(tmp_path: Path, heading_deg: int) -> None:
    (tmp_path / "wxyz.txt").write_text(tum_rows(level_path(heading_deg), (3, 0, 1, 2)))
    with pytest.raises(InputError, match="scalar of the quaternions is first"):
        read_trajectory_file(tmp_path / "wxyz.txt")


@pytest.mark.parametrize("heading_deg", range(0, 360, 30))
@pytest.mark.parametrize("kind", ["body", "camera", "sorted downwards", "positions of a tracker"])
def test_a_drive_with_the_scalar_last_is_read_at_every_heading(tmp_path: Path, heading_deg: int, kind: str) -> None:
    poses = level_path(heading_deg, is_camera=kind == "camera")
    if kind == "positions of a tracker":
        poses = Trajectory(poses.stamps_ns, poses.positions, np.tile([0.0, 0.0, 0.0, 1.0], (COUNT, 1)))
    lines = tum_rows(poses, (0, 1, 2, 3)).splitlines(keepends=True)
    (tmp_path / "xyzw.txt").write_text("".join(lines[::-1] if kind == "sorted downwards" else lines))
    assert len(read_trajectory_file(tmp_path / "xyzw.txt").trajectory) == COUNT


LAST, FIRST = (0, 1, 2, 3), (3, 0, 1, 2)
NAMES_OF = {LAST: "qx,qy,qz,qw", FIRST: "qw,qx,qy,qz"}
AXES = {
    "z down": np.diag([1.0, -1.0, -1.0]),
    "backwards": np.diag([-1.0, -1.0, 1.0]),
    "y forward": np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    "x up, z forward": np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]]),
}


@pytest.mark.parametrize("heading_deg", [30, 60, 120, 150, 210, 240, 300, 330])
@pytest.mark.parametrize("is_camera", [False, True])
@pytest.mark.parametrize("order", NAMES_OF)
def test_a_header_with_the_other_order_of_quaternions_is_refused(
    tmp_path: Path, order: tuple[int, ...], is_camera: bool, heading_deg: int
) -> None:
    poses = level_path(heading_deg, is_camera=is_camera)
    for names in NAMES_OF:
        numbers = rows(seconds(poses), poses.positions, poses.quats_xyzw[:, order])
        (tmp_path / "t.csv").write_text(f"t,x,y,z,{NAMES_OF[names]}\n{numbers}")
        if names == order:
            assert len(read_trajectory_file(tmp_path / "t.csv").trajectory) == COUNT
        elif not is_camera:
            with pytest.raises(InputError, match="has a header that names its columns, and its attitudes are"):
                read_trajectory_file(tmp_path / "t.csv")
            given = read_trajectory_file(tmp_path / "t.csv", f"t[s],x,y,z,{NAMES_OF[order]}")
            np.testing.assert_allclose(given.trajectory.quats_xyzw, poses.quats_xyzw, atol=1e-12)


@pytest.mark.parametrize("heading_deg", range(0, 360, 30))
@pytest.mark.parametrize("order", NAMES_OF)
@pytest.mark.parametrize("axes", AXES)
def test_a_header_with_the_attitudes_of_a_body_with_any_axes_is_read(
    tmp_path: Path, axes: str, order: tuple[int, ...], heading_deg: int
) -> None:
    poses = level_path(heading_deg)
    attitudes = matrix_from_quat(poses.quats_xyzw) @ AXES[axes]
    quats = np.array([quat_from_matrix(attitude) for attitude in attitudes])
    numbers = rows(seconds(poses), poses.positions, quats[:, order])
    (tmp_path / "t.csv").write_text(f"t,x,y,z,{NAMES_OF[order]}\n{numbers}")
    assert len(read_trajectory_file(tmp_path / "t.csv").trajectory) == COUNT


@pytest.mark.filterwarnings("error")
def test_a_huge_position_does_not_affect_the_order_of_quaternions(tmp_path: Path) -> None:
    lines = tum_rows(level_path(40), (0, 1, 2, 3)).splitlines(keepends=True)
    stamp, _, *others = lines[5].split()
    lines[5] = " ".join((stamp, "1.7e308", *others)) + "\n"
    (tmp_path / "huge.txt").write_text("".join(lines))
    assert len(read_trajectory_file(tmp_path / "huge.txt").trajectory) == COUNT - 1


@pytest.mark.parametrize("case", REFUSED)
def test_a_table_that_cannot_be_understood_is_refused_by_what_was_found(tmp_path: Path, case: str) -> None:
    text, columns, words = REFUSED[case]
    (tmp_path / "theirs.csv").write_text(text)
    with pytest.raises(InputError, match=f"^'{tmp_path}/theirs.csv'[^\n]*{words}[^\n]*$"):
        read_trajectory_file(tmp_path / "theirs.csv", columns)


STILL = np.tile(np.eye(4).reshape(-1), (COUNT, 1))
MOMENTS = [f"2026-05-04T10:22:{0.1 * number:05.2f}" for number in range(COUNT)]
ADVISED = {
    "seconds in two columns": lambda p: (
        "# wxyz\n"
        + rows([ns // NS_PER_S for ns in whole(p)], [ns % NS_PER_S for ns in whole(p)], p.positions, p.quats_xyzw)
    ),
    "a height downwards": lambda p: rows(range(COUNT), p.positions, header="t,north,east,down"),
    "a unit of a height downwards": lambda p: "# lengths: mm\n" + rows(seconds(p), p.positions, header="t,n,e,down"),
    "4 x 4 matrices": lambda p: rows(seconds(p), STILL, separator=" "),
    "dates and a unit": lambda p: "# lengths: mm\n" + rows(MOMENTS, p.positions, header="t,x,y,z"),
    "the scalar first beside covariances": lambda p: rows(
        seconds(p),
        level_path(30.0).positions,
        level_path(30.0).quats_xyzw[:, WXYZ],
        np.full((COUNT, 12), 1e-4),
        separator=" ",
        header=f"# timestamp(s) {' '.join(POSE)} {COVARIANCE}",
    ),
}


@pytest.mark.parametrize("case", ADVISED)
def test_the_columns_that_an_error_recommends_are_accepted(tmp_path: Path, case: str) -> None:
    (tmp_path / "theirs.csv").write_text(ADVISED[case](drive()))
    with pytest.raises(InputError) as refused:
        read_trajectory_file(tmp_path / "theirs.csv")
    options = re.findall("--columns '([^']*)'", str(refused.value))
    assert options
    for columns in options:
        read = read_trajectory_file(tmp_path / "theirs.csv", columns.replace("UNIT", "s"))
        assert len(read.trajectory) == COUNT


def test_an_inferred_unit_of_stamps_is_reported(tmp_path: Path) -> None:
    (tmp_path / "theirs.csv").write_text("time,x,y,z\n" + "".join(f"{k / 10:.1f},1,2,3\n" for k in range(20)))
    found = read_trajectory_file(tmp_path / "theirs.csv")
    assert found.columns is not None
    assert (found.columns.units["t"], found.columns.unit_origin) == ("s", UnitOrigin.INFERRED)
    assert found.is_announced


@pytest.mark.parametrize(
    ("pack", "words"),
    [(gzip.compress, "compressed by gzip"), (bz2.compress, "compressed by bzip2"), (lzma.compress, "compressed by xz")],
)
def test_a_compressed_table_is_named_as_such(tmp_path: Path, pack: Callable[[bytes], bytes], words: str) -> None:
    (tmp_path / "theirs.csv").write_bytes(pack(b"t,x,y,z\n1.0,2,3,4\n" * 99))
    with pytest.raises(InputError, match=f"{words}: decompress it first"):
        read_trajectory_file(tmp_path / "theirs.csv")


@pytest.mark.parametrize(("encoding", "words"), [("utf-16", "UTF-16: save it in UTF-8"), ("utf-32-be", "binary file")])
def test_a_file_that_is_no_text_is_refused_as_such(tmp_path: Path, encoding: str, words: str) -> None:
    (tmp_path / "theirs.csv").write_text("t,x,y,z\n1.0,2,3,4\n", encoding=encoding)
    with pytest.raises(InputError, match=words):
        read_trajectory_file(tmp_path / "theirs.csv")


@pytest.mark.parametrize(
    ("header", "columns"),
    [
        ("t[s],x,y,px,py,pz", (0, 3, 4, 5)),
        ("t[s],north,east,down", (0, 2, 1, 3)),
        ("t[s],xned,yned,zned", (0, 2, 1, 3)),
        ("t[s],x,y,height", (0, 1, 2, 3)),
    ],
)
def test_a_position_consists_of_columns_that_belong_together(
    tmp_path: Path, header: str, columns: tuple[int, ...]
) -> None:
    numbers = ",".join(str(number + 1) for number in range(header.count(",") + 1))
    (tmp_path / "theirs.csv").write_text(f"{header}\n{numbers}\n")
    found = read_trajectory_file(tmp_path / "theirs.csv").trajectory
    _, x, y, z = (column + 1.0 for column in columns)
    upward = -1.0 if header.endswith(("down", "zned")) else 1.0
    assert found.positions.tolist() == [[x, y, upward * z]]


def test_the_header_of_given_columns_is_below_a_title(tmp_path: Path) -> None:
    text = "Total Station Export;;;;\nZeit;Rechts;Hoch;Hoehe;Code\n(s);(m);(m);(m);\n0,5;1,25;2,5;3,0;A\n"
    (tmp_path / "station.csv").write_text(text)
    found = read_trajectory_file(tmp_path / "station.csv", "t=Zeit[s],x=Rechts,y=Hoch,z=Hoehe")
    assert found.trajectory.positions.tolist() == [[1.25, 2.5, 3.0]]


GIVEN = {"by name": "t=Zeit,x=Ost,y=Nord,z=Oben", "by number": "t=#1,x=#2,y=#3,z=#4", "in order": "t,x,y,z"}
UNIT_PLACES = {
    "title": "Zeit [s],Ost [mm],Nord [mm],Oben [mm]\n",
    "suffix of the title": "Zeit_s,Ost_mm,Nord_mm,Oben_mm\n",
    "word in the title": "Zeit (seconds),Ost (Millimetres),Nord [millimeters],Oben [mm]\n",
    "line of units": "Zeit,Ost,Nord,Oben\ns,mm,mm,mm\n",
}


def with_units(columns: str, t: str, length: str) -> str:
    return ",".join(f"{item}[{t if item.startswith('t') else length}]" for item in columns.split(","))


@pytest.mark.parametrize("place", UNIT_PLACES)
@pytest.mark.parametrize("columns", GIVEN)
def test_given_columns_have_the_units_of_the_file_and_no_others(tmp_path: Path, columns: str, place: str) -> None:
    file = tmp_path / "x.csv"
    file.write_text(f"{UNIT_PLACES[place]}1,1000,2000,3000\n2,1000,2000,3500\n")
    for given in (GIVEN[columns], with_units(GIVEN[columns], "s", "mm")):
        found = read_trajectory_file(file, given)
        np.testing.assert_allclose(found.trajectory.positions[1], (1.0, 2.0, 3.5))
        assert found.trajectory.stamps_ns[1] == 2 * NS_PER_S
        assert "unit of the positions: mm" in found.text
    for t, length, key in (("s", "m", "x"), ("ms", "mm", "t")):
        with pytest.raises(InputError, match=f"the unit of {key} is .* by --columns and .*: one unit is required"):
            read_trajectory_file(file, with_units(GIVEN[columns], t, length))


def test_the_unit_of_another_column_is_none_of_the_position(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text("t[s],x,y,z,sigma [mm],range (cm)\n1,2,3,4,5,6\n")
    assert read_trajectory_file(tmp_path / "x.csv").trajectory.positions.tolist() == [[2.0, 3.0, 4.0]]


def test_a_suffix_of_another_quantity_is_no_unit_if_a_unit_is_given(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text("t,pos_s,pos_d,h\n1,2,3,4\n")
    found = read_trajectory_file(tmp_path / "x.csv", "t=t[s],x=pos_s[m],y=pos_d[m],z=h[m]")
    assert found.trajectory.positions.tolist() == [[2.0, 3.0, 4.0]]


def test_a_truth_and_a_conversion_require_poses_with_stamps(tmp_path: Path, sfr: Sfr) -> None:
    (tmp_path / "poses.txt").write_text(rows(matrices(drive()), separator=" "))
    done = sfr("convert", tmp_path / "poses.txt", tmp_path / "poses.csv")
    assert done.code == 2
    assert "poses.txt' has no stamps" in done.err
    with pytest.raises(InputError, match=r"poses\.txt' has no stamps .*poses\.times\.txt"):
        truth_of_file(tmp_path, TruthConfig(source=str(tmp_path / "poses.txt")))


@pytest.mark.parametrize("item", ["t=Zeit[s]", "t=Zeit", "t=zeit [s]"])
def test_a_column_is_named_as_it_stands_in_the_header(tmp_path: Path, item: str) -> None:
    poses = drive()
    place = tmp_path / "x.csv"
    place.write_text(rows(seconds(poses), poses.positions, separator=";", header="Zeit[s];Rechts;Hoch;Höhe"))
    found = read_trajectory_file(place, f"{item},x=Rechts,y=Hoch,z=Höhe[m]").trajectory
    assert found.stamps_ns.tolist() == poses.stamps_ns.tolist()
    assert not found.has_attitude


def test_covariances_of_columns_give_a_nees(tmp_path: Path) -> None:
    from sfr_loc_map.scoring.load_trajectories import load_drive

    poses = drive()
    save_trajectory(tmp_path / "truth.csv", poses)
    (tmp_path / "estimate.txt").write_text(FORMS["covariances behind the pose"](poses))
    covariance = load_drive(tmp_path / "estimate.txt", tmp_path / "truth.csv").estimates.covariance
    assert covariance is not None
    np.testing.assert_allclose(covariance[0], 1e-4 * np.kron(np.eye(2), np.ones((3, 3)))[np.triu_indices(6)])


@pytest.mark.parametrize(("invalid", "correlation"), [(0, 0.9e-4), (COUNT, 1.1e-4), (3, 1.1e-4)])
def test_covariances_that_are_not_positive_semi_definite_are_ignored_and_counted(
    tmp_path: Path, invalid: int, correlation: float
) -> None:
    poses = drive()
    upper = np.zeros((COUNT, 12))
    upper[:, [0, 3, 5, 6, 9, 11]] = 1e-4
    upper[: invalid or COUNT, 7] = correlation
    header = f"# timestamp(s) {' '.join(POSE)} {COVARIANCE}"
    table = rows(seconds(poses), poses.positions, poses.quats_xyzw, upper, separator=" ", header=header)
    (tmp_path / "estimate.txt").write_text(table)
    found = read_trajectory_file(tmp_path / "estimate.txt")
    assert len(found.trajectory) == COUNT
    assert (found.covariance is None) == (invalid == COUNT)
    assert (f"not positive semi-definite: {invalid}" in found.text) == (invalid > 0)
    if found.covariance is not None:
        assert np.isnan(found.covariance[:, 0, 0]).sum() == invalid


# ---- poses that cannot be true


@pytest.mark.parametrize("comment", ["# quaternions are qw qx qy qz", "# pose: position, then attitude (wxyz)"])
@pytest.mark.parametrize("side", ["estimate", "truth"])
def test_a_comment_that_names_another_order_of_quaternions_is_asked_about(
    tmp_path: Path, sfr: Sfr, comment: str, side: str
) -> None:
    poses = drive()
    save_trajectory(tmp_path / "plain.csv", poses)
    table = rows(seconds(poses), poses.positions, poses.quats_xyzw[:, WXYZ], separator=" ")
    (tmp_path / "theirs.txt").write_text(f"{comment}\n{table}")
    files = [tmp_path / "theirs.txt", tmp_path / "plain.csv"]
    words = ["score", *(files if side == "estimate" else files[::-1]), "--condition", "distance=2"]
    refused = sfr(*words)
    assert refused.code == 2
    assert "line 1 states that quaternions have the scalar first" in refused.err
    columns = "t[s],x,y,z,qw,qx,qy,qz"
    assert f"--columns '{side}:{columns}'" in refused.err
    done = sfr(*words, "--columns", f"{side}:{columns}", "--json", "-")
    assert done.code == 0, done.err
    errors = [row["max"] for row in json.loads(done.out)["figures"] if row["figure"] == "attitude" and "max" in row]
    assert max(errors) < 1e-6


PLACEHOLDERS = {"identity": [0.0, 0.0, 0.0, 1.0], "turned": [0.0, 0.0, 0.6, 0.8], "of both signs": [0.5, 0.5, 0.5, 0.5]}
PLACEHOLDERS |= {name: [0.0, 0.0, 0.0, 1.0] for name in ("after a start", "with noise", "of a matrix")}


@pytest.mark.parametrize("name", PLACEHOLDERS)
def test_an_attitude_that_never_changes_along_a_turning_path_is_none(
    tmp_path: Path, sfr: Sfr, caplog: pytest.LogCaptureFixture, name: str
) -> None:
    poses = drive()
    quats = np.tile(PLACEHOLDERS[name], (COUNT, 1))
    if name == "of both signs":
        quats[::3] *= -1.0
    elif name == "after a start":
        quats[:3] = poses.quats_xyzw[:3]
    elif name == "with noise":
        quats = quat_normalised(quats + 1e-4 * np.random.default_rng(0).normal(size=quats.shape))
    save_trajectory(tmp_path / "e.csv", poses)
    truth = Trajectory(poses.stamps_ns, poses.positions, quats)
    save_trajectory(tmp_path / "t.tum", truth)
    if name == "of a matrix":
        (tmp_path / "t.tum").write_text(rows(seconds(poses), matrices(truth), separator=" "))
    done = sfr("score", tmp_path / "e.csv", tmp_path / "t.tum", "--condition", "distance=2", "--json", "-")
    assert done.code == 0, done.err
    assert caplog.text.count("same attitude although the path turns") == 1
    assert "the truth has only positions" in done.err
    kept = sfr("score", tmp_path / "e.csv", tmp_path / "t.tum", "--set", "truth.attitude=yes")
    assert "the truth has only positions" not in kept.err


@pytest.mark.parametrize("noise_m", [0.0, 0.005])
def test_a_rover_that_mostly_stands_keeps_its_attitudes(
    tmp_path: Path, sfr: Sfr, caplog: pytest.LogCaptureFixture, noise_m: float
) -> None:
    poses = drive()
    kept = np.append(np.arange(COUNT), np.full(20 * COUNT, COUNT - 1))
    stamps_ns = poses.stamps_ns[0] + np.arange(len(kept)) * (poses.stamps_ns[1] - poses.stamps_ns[0])
    noise = noise_m * np.random.default_rng(0).normal(size=(len(kept), 3))
    truth = Trajectory(stamps_ns, poses.positions[kept] + noise, poses.quats_xyzw[kept])
    save_trajectory(tmp_path / "t.csv", truth)
    done = sfr("score", tmp_path / "t.csv", tmp_path / "t.csv", "--condition", "distance=2")
    assert "the truth has only positions" not in done.err
    assert not caplog.text


def test_an_attitude_that_never_changes_along_a_line_is_one(
    tmp_path: Path, sfr: Sfr, caplog: pytest.LogCaptureFixture
) -> None:
    poses = drive()
    there_and_back = np.column_stack((np.abs(np.linspace(-6.0, 6.0, COUNT)), np.zeros(COUNT), np.zeros(COUNT)))
    straight = Trajectory(poses.stamps_ns, there_and_back, np.tile(PLACEHOLDERS["turned"], (COUNT, 1)))
    save_trajectory(tmp_path / "t.csv", straight)
    done = sfr("score", tmp_path / "t.csv", tmp_path / "t.csv", "--condition", "distance=2")
    assert done.code == 0, done.err
    assert not caplog.text


@pytest.mark.parametrize("wrong", ["far away", "at the origin", "often at the origin", "stamp 0", "stamp of 1970"])
def test_few_poses_that_cannot_be_true_are_left_out_and_counted(
    tmp_path: Path, sfr: Sfr, caplog: pytest.LogCaptureFixture, wrong: str
) -> None:
    poses = drive()
    positions, stamps = poses.positions + np.array([50.0, 20.0, 0.0]), poses.stamps_ns.copy()
    rows_wrong = [0] if "stamp" in wrong else [*range(5, 60, 4)] if "often" in wrong else [10, 11, 40]
    if wrong == "far away":
        positions[rows_wrong] = [2.7e6, 0.0, 0.0]
    elif wrong == "often at the origin":
        positions[rows_wrong] = 0.0
    elif wrong == "at the origin":
        positions[rows_wrong] = 0.0
        stamps = stamps[0] + (stamps - stamps[0]) // 10  # at 20 Hz
    else:
        stamps[rows_wrong] = 0 if wrong == "stamp 0" else 5 * NS_PER_S
    truth = Trajectory(stamps, positions, poses.quats_xyzw)
    save_trajectory(tmp_path / "t.csv", truth)
    good = np.setdiff1d(np.arange(COUNT), rows_wrong)
    save_trajectory(tmp_path / "e.csv", Trajectory(stamps[good], positions[good], poses.quats_xyzw[good]))
    done = sfr("score", tmp_path / "e.csv", tmp_path / "t.csv", "--condition", "distance=2", "--partial")
    assert done.code == 0, done.err
    assert f"{len(rows_wrong)} of 60 poses" in caplog.text


PLANAR = {
    "height, roll and pitch of zero": ((0.0, 0.0, 0.0), (0, 0), ("horizontal", "heading")),
    "a height of a floor": ((0.0, 0.0, 0.35), (0, 0), ("horizontal", "heading")),
    "roll and pitch of zero on a slope": ((0.0, 0.0, 0.0), (0, 1), ("position", "heading")),
    "a height of zero beside attitudes": ((0.0, 0.0, 0.0), (1, 0), ("horizontal", "attitude", "heading")),
}


@pytest.mark.parametrize("case", PLANAR)
def test_what_a_planar_truth_does_not_know_is_said_and_not_judged(
    tmp_path: Path, sfr: Sfr, caplog: pytest.LogCaptureFixture, case: str
) -> None:
    """The estimate is right, on a slope: 1.2 m of height, 6 deg of roll and 11 deg of pitch."""
    poses, ((x, y, z), (has_tilt, has_height), judged) = drive(), PLANAR[case]
    positions = poses.positions if has_height else poses.positions * [1.0, 1.0, 0.0] + [x, y, z]
    headings = np.arctan2(*matrix_from_quat(poses.quats_xyzw)[:, [1, 0], 0].T)
    level = np.column_stack((0 * headings, 0 * headings, np.sin(headings / 2), np.cos(headings / 2)))
    noise = 1e-3 * np.random.default_rng(5).normal(size=(COUNT, 3))
    quats = poses.quats_xyzw + 1e-5 * np.random.default_rng(6).normal(size=(COUNT, 4))  # exact ones count as copies
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    save_trajectory(tmp_path / "e.csv", Trajectory(poses.stamps_ns, poses.positions + noise, quats))
    save_trajectory(tmp_path / "t.csv", Trajectory(poses.stamps_ns, positions, poses.quats_xyzw if has_tilt else level))
    limits = tmp_path / "limits.yaml"
    keys = ("position_max_m", "horizontal_max_m", "attitude_max_deg", "heading_max_deg")
    limits.write_text(
        "minimum_independent: 2\ntrajectory:\n  - condition: distance=2\n"
        + "".join(f"    {key}: 0.01\n" for key in keys)
    )
    words = ("score", tmp_path / "e.csv", tmp_path / "t.csv", "--limits", limits, "--json", "-")
    done = sfr(*words)
    assert done.code == 3, done.err
    verdicts = {item["figure"]: item["verdict"] for item in json.loads(done.out)["verdicts"]}
    assert {name for name, verdict in verdicts.items() if verdict == "pass"} == {*judged}, done.err
    assert "fail" not in verdicts.values()
    assert caplog.text.count("truth.unknown=none") == 1
    assert "the truth has no " in done.err
    if "position" not in judged:
        assert "the truth has no heights: set a limit on the figure 'horizontal' instead" in done.err
    assert sfr(*words, "--set", "truth.unknown=none").code == 1
