"""Clouds as files."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfr_loc_map.errors import InputError, MissingExtraError, OutputError
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.io.cloud_file import load_cloud, save_cloud

laspy = pytest.importorskip("laspy", reason="extra laz")


def random_cloud(count: int, seed: int = 0) -> PointCloud:
    rng = np.random.default_rng(seed)
    records = np.zeros(count, PointCloud.dtype())
    for name in ("x", "y", "z", "sigma", "intensity"):
        records[name] = rng.normal(size=count)
    records["u"], records["v"], records["pair"] = rng.integers(0, [65536, 65536, 256], (count, 3)).T
    return PointCloud.from_structured(records)


@given(st.integers(0, 20), st.integers(0, 5))
@pytest.mark.parametrize("suffix", [".ply", ".pcd", ".npz"])
def test_round_trip_is_exact(tmp_path_factory: pytest.TempPathFactory, suffix: str, count: int, seed: int) -> None:
    path, cloud = tmp_path_factory.mktemp("c") / f"c{suffix}", random_cloud(count, seed)
    save_cloud(path, cloud)
    loaded = load_cloud(path)
    assert loaded.cloud.to_structured().tobytes() == cloud.to_structured().tobytes()
    np.testing.assert_array_equal(loaded.xyz, cloud.xyz)


def test_files_are_what_others_expect(tmp_path: Path) -> None:
    cloud = random_cloud(3)
    for suffix in (".ply", ".pcd", ".npz"):
        save_cloud(tmp_path / f"c{suffix}", cloud)
    head, body = (tmp_path / "c.ply").read_bytes().split(b"end_header\n", 1)
    assert head.decode().splitlines()[:4] == [
        "ply",
        "format binary_little_endian 1.0",
        "element vertex 3",
        "property float x",
    ]
    assert np.frombuffer(body[:12], "<f4").tolist() == cloud.xyz[0].tolist()
    assert len(body) == 3 * (5 * 4 + 2 * 2 + 1)
    assert b"FIELDS x y z sigma intensity u v pair\n" in (tmp_path / "c.pcd").read_bytes()
    with np.load(tmp_path / "c.npz") as arrays:
        assert list(arrays.files) == ["x", "y", "z", "sigma", "intensity", "u", "v", "pair"]
        assert (arrays["u"].dtype, arrays["pair"].dtype) == (np.uint16, np.uint8)


@pytest.mark.parametrize(("count", "seed"), [(0, 0), (1, 1), (500, 2)])
@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_las_keeps_micrometres_and_all_fields(tmp_path: Path, suffix: str, count: int, seed: int) -> None:
    path, cloud = tmp_path / f"c{suffix}", random_cloud(count, seed)
    save_cloud(path, cloud)
    loaded = load_cloud(path).cloud
    np.testing.assert_allclose(loaded.xyz, cloud.xyz, atol=6e-7)
    for name in ("sigma", "intensity", "u", "v", "pair"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(cloud, name))
    foreign = laspy.read(path)
    assert [dim.name for dim in foreign.point_format.extra_dimensions] == ["sigma", "grey", "u", "v", "pair"]
    np.testing.assert_allclose(foreign.xyz, cloud.xyz, atol=6e-7)


def test_points_of_other_programs_and_broken_las(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    foreign = laspy.create(point_format=3, file_version="1.2")
    foreign.x, foreign.y, foreign.z = np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.25]])
    path = tmp_path / "c.laz"
    foreign.write(path)
    assert load_cloud(path).cloud is None
    assert load_cloud(path).xyz.tolist() == [[1.0, 3.0, 5.0], [2.0, 4.0, 6.25]]
    whole = path.read_bytes()
    table = int.from_bytes(whole[laspy.open(path).header.offset_to_point_data :][:8], "little")
    chunks = whole[: table + 4] + (2**31).to_bytes(4, "little") + whole[table + 8 :]
    points = whole[:107] + (2**31).to_bytes(4, "little") + whole[111:]
    records = whole[:100] + (2**32 - 1).to_bytes(4, "little") + whole[104:]
    for data, words in (
        (whole[:-40], "c.laz"),
        (points, "claims to hold"),
        (records, "records"),
        (chunks, "chunks"),
        (b"LASF", "header"),
    ):
        path.write_bytes(data)
        with pytest.raises(InputError, match=words):
            load_cloud(path)
    monkeypatch.setitem(sys.modules, "lazrs", None)
    with pytest.raises(MissingExtraError, match=r"LAS and LAZ need laspy .*: pip install 'sfr_loc_map\[laz\]'"):
        load_cloud(path)


@pytest.mark.parametrize(("fused", "stamps_ns"), [(True, (1, 2**62)), (False, ()), (None, None)])
@pytest.mark.parametrize("suffix", [".ply", ".pcd", ".npz", ".laz"])
def test_a_cloud_file_says_whether_it_is_fused_and_of_which_pairs(
    tmp_path: Path, suffix: str, fused: bool | None, stamps_ns: tuple[int, ...] | None
) -> None:
    path = tmp_path / f"c{suffix}"
    save_cloud(path, replace(random_cloud(3), fused=fused, pair_stamps_ns=stamps_ns))
    cloud = load_cloud(path).cloud
    assert (cloud.fused, cloud.pair_stamps_ns) == (fused, stamps_ns)
    if suffix == ".npz":
        with np.load(path) as arrays:
            assert arrays["fused"].tolist() is fused if fused is not None else "fused" not in arrays.files
    else:
        sign = {".ply": b"comment ", ".pcd": b"# ", ".laz": b""}[suffix]
        assert (sign + b"sfr fused " in path.read_bytes()) == (fused is not None)


def test_a_file_that_says_something_else_of_fusion_is_refused(tmp_path: Path) -> None:
    for name, sign in (("c.ply", b"comment"), ("c.pcd", b"#")):
        path = tmp_path / name
        save_cloud(path, replace(random_cloud(3), fused=True))
        path.write_bytes(path.read_bytes().replace(sign + b" sfr fused true", sign + b" sfr fused maybe"))
        with pytest.raises(InputError, match="must end in true or false"):
            load_cloud(path)
    save_cloud(tmp_path / "d.ply", replace(random_cloud(3), pair_stamps_ns=(5,)))
    for text, words in ((b"-5", "whole nanoseconds"), (b"9" * 30, "whole nanoseconds")):
        path = tmp_path / "e.ply"
        path.write_bytes((tmp_path / "d.ply").read_bytes().replace(b"stamps_ns 5", b"stamps_ns " + text))
        with pytest.raises(InputError, match=words):
            load_cloud(path)


def test_ply_of_others(tmp_path: Path) -> None:
    path = tmp_path / "c.ply"
    path.write_text(
        "ply\nformat ascii 1.0\ncomment x\nelement vertex 2\nproperty double z\nproperty uchar red\nproperty double x\n"
        "property double y\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        "3 255 1.00000000001 2\nnan 0 1 1\n3 0 1 1\n"
    )
    loaded = load_cloud(path)
    assert loaded.cloud is None
    assert loaded.xyz.tolist() == [[1.00000000001, 2, 3]]  # the point that is not finite is left out
    head = b"ply\nformat binary_big_endian 1.0\nelement vertex 1\n" + b"".join(
        b"property %s %s\n" % pair
        for pair in (
            (b"float64", b"x"),
            (b"int", b"pair"),
            (b"float", b"y"),
            (b"float", b"z"),
            (b"int32", b"u"),
            (b"short", b"v"),
        )
    )
    record = np.array([(1.5, 2, 2.5, 3.5, 700, 400)], ">f8,>i4,>f4,>f4,>i4,>i2").tobytes()
    path.write_bytes(head + b"end_header\n" + record)
    cloud = load_cloud(path).cloud
    assert (cloud.xyz.tolist(), int(cloud.u[0]), int(cloud.v[0]), int(cloud.pair[0])) == (
        [[1.5, 2.5, 3.5]],
        700,
        400,
        2,
    )
    assert np.isnan(cloud.sigma[0])
    assert cloud.fused is None


def test_pcd_of_others(tmp_path: Path) -> None:
    path = tmp_path / "c.pcd"
    head = "VERSION .7\nFIELDS x y z _ \nSIZE 4 4 4 1\nTYPE F F F U\nCOUNT 1 1 1 4\nWIDTH 2\nHEIGHT 2\nPOINTS 4\nDATA "
    numbers = np.arange(12.0).reshape(4, 3)
    path.write_text(head + "ascii\n" + "\n".join(" ".join(map(str, [*row, 0, 0, 0, 0])) for row in numbers) + "\n")
    cloud = load_cloud(path).cloud
    assert (cloud.u.tolist(), cloud.v.tolist(), cloud.pair.tolist()) == ([0, 1, 0, 1], [0, 0, 1, 1], [0] * 4)
    np.testing.assert_array_equal(cloud.xyz, numbers)
    assert cloud.fused is False  # one point a pixel of one image
    path.write_bytes(
        (head + "binary\n").encode() + b"".join(row.astype("<f4").tobytes() + b"\0\0\0\0" for row in numbers)
    )
    np.testing.assert_array_equal(load_cloud(path).xyz, numbers)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"u": [1.5]}, "field u must hold whole numbers"),
        ({"y": [1.0, 2.0]}, "differ in length"),
        ({"z": ["1.0"]}, "real numbers are needed"),
        ({"z": [1 + 2j]}, "real numbers are needed"),
        ({"z": np.array([None])}, "real numbers are needed"),
        ({"fused": [1.0]}, "needed"),
        ({"pair_stamps_ns": [1.5]}, "needed"),
    ],
)
def test_arrays_that_are_no_cloud_are_refused(tmp_path: Path, changes: dict, words: str) -> None:
    columns = {"x": [1.0], "y": [1.0], "z": [1.0], "u": [1], "v": [2], "pair": [0]}
    np.savez(tmp_path / "c.npz", **columns | changes)
    with pytest.raises(InputError, match=words):
        load_cloud(tmp_path / "c.npz")


def test_missing_files_and_other_endings(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"\.ply, \.pcd, \.npz"):
        save_cloud(tmp_path / "c.obj", random_cloud(1))
    with pytest.raises(InputError, match="No such file"):
        load_cloud(tmp_path / "none.ply")
    with pytest.raises(InputError, match=r"ends in '\.xyz'"):
        load_cloud(tmp_path / "c.xyz")


@pytest.mark.parametrize("suffix", [".npz", ".pcd"])
def test_absurd_coordinates_are_refused_and_infinite_ones_left_out(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"c{suffix}"
    for value, words in (("1e308", "coordinate of 1e.308 m"), ("inf", "")):
        if suffix == ".npz":
            np.savez(path, x=[1.0, float(value)], y=[1.0, 2.0], z=[1.0, 2.0])
        else:
            head = "FIELDS x y z\nSIZE 8 8 8\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 2\nHEIGHT 1\nPOINTS 2\nDATA ascii\n"
            path.write_text(f"{head}1 1 1\n{value} 2 2\n")
        if words:
            with pytest.raises(InputError, match=words):
                load_cloud(path)
        else:
            assert load_cloud(path).xyz.tolist() == [[1.0, 1.0, 1.0]]


PCD = "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 1\nHEIGHT 1\nPOINTS 1\nDATA ascii\n1 2 3\n"
PLY = (
    "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n1 2 3\n"
)


@pytest.mark.parametrize(
    ("name", "old", "new", "words"),
    [
        ("c.pcd", "WIDTH 1\nHEIGHT 1", "WIDTH -1\nHEIGHT -1", "'-1' is not a number"),
        ("c.pcd", "WIDTH 1", f"WIDTH {'9' * 5000}", "is not a number"),
        ("c.pcd", "1\nHEIGHT 1\nPOINTS 1", "900000000000\nHEIGHT 1\nPOINTS 900000000000", "bytes of text found"),
        ("c.pcd", "POINTS 1", "POINTS 7", "WIDTH and HEIGHT say 1"),
        ("c.pcd", "COUNT 1 1 1", "COUNT 1 1 999999999", "which is not read"),
        ("c.pcd", "TYPE F F F", "TYPE F F O", "TYPE O, SIZE 4"),
        ("c.pcd", "DATA ascii", "DATA binary_compressed", "binary_compressed"),
        ("c.pcd", "DATA ascii\n1 2 3", "DATA binary\n1234", "bytes found where 1 points"),
        ("c.pcd", PCD, "VERSION .7\n", "no PCD header"),
        ("c.ply", "vertex 1", "vertex -1", "'-1' is not a number"),
        ("c.ply", "vertex 1", "vertex 900000000000", "bytes of text found"),
        ("c.ply", "1 2 3\n", "1\n", "found where"),
        ("c.ply", "float z", "list uchar int z", "'list'"),
        ("c.ply", "ascii", "weird", "no known format"),
        ("c.ply", "element vertex", "element face", "'face'"),
        ("c.ply", PLY, "", "no PLY header"),
    ],
)
def test_broken_files(tmp_path: Path, name: str, old: str, new: str, words: str) -> None:
    head = PLY if name == "c.ply" else PCD
    (tmp_path / name).write_text(head)
    assert load_cloud(tmp_path / name).xyz.tolist() == [[1, 2, 3]]
    (tmp_path / name).write_text(head.replace(old, new))
    with pytest.raises(InputError, match=words) as caught:
        load_cloud(tmp_path / name)
    assert str(tmp_path) in str(caught.value)


@pytest.mark.parametrize("suffix", [".ply", ".pcd", ".npz"])
def test_cut_off_files(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"c{suffix}"
    save_cloud(path, random_cloud(50))
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(InputError, match=f"c{suffix}"):
        load_cloud(path)
