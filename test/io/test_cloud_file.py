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
    assert loaded.cloud is not None
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
    assert loaded is not None
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
    assert cloud is not None
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
    columns = {"x": [1.0], "y": [1.0], "z": [1.0], "u": [1], "v": [2], "pair": [0]}
    for name, value in (("fused", [1.0]), ("pair_stamps_ns", [1.5])):
        np.savez(tmp_path / "c.npz", **columns, **{name: value})
        with pytest.raises(InputError, match="needed"):
            load_cloud(tmp_path / "c.npz")
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
    assert cloud is not None
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
    assert cloud is not None
    assert (cloud.u.tolist(), cloud.v.tolist(), cloud.pair.tolist()) == ([0, 1, 0, 1], [0, 0, 1, 1], [0] * 4)
    np.testing.assert_array_equal(cloud.xyz, numbers)
    assert cloud.fused is False  # one point a pixel of one image
    path.write_bytes(
        (head + "binary\n").encode() + b"".join(row.astype("<f4").tobytes() + b"\0\0\0\0" for row in numbers)
    )
    np.testing.assert_array_equal(load_cloud(path).xyz, numbers)


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("c.ply", b"", "no PLY header"),
        ("c.ply", b"ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nend_header\n1\n", "found where"),
        ("c.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n", "no field y, z"),
        ("c.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty list uchar int x\nend_header\n1\n", "'list'"),
        ("c.ply", b"ply\nformat weird 1.0\nelement vertex 1\nend_header\n", "no known format"),
        ("c.ply", b"ply\nformat ascii 1.0\nelement face 1\nend_header\n", "'face'"),
        ("c.pcd", b"VERSION .7\n", "no PCD header"),
        ("c.pcd", b"FIELDS x\nSIZE 4\nTYPE F\nWIDTH 1\nHEIGHT 1\nDATA binary_compressed\n", "binary_compressed"),
        ("c.pcd", b"FIELDS x\nSIZE 4\nTYPE F\nWIDTH 9\nHEIGHT 1\nDATA binary\n1234", "4 bytes found where 9 points"),
        ("c.npz", b"PK nonsense", "cannot be read"),
        ("c.xyz", b"", "ends in '.xyz'"),
    ],
)
def test_broken_files(tmp_path: Path, name: str, data: bytes, words: str) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError, match=words) as caught:
        load_cloud(tmp_path / name)
    assert str(tmp_path) in str(caught.value)


PCD_HEAD = (
    "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 1\nHEIGHT 1\nPOINTS 1\nDATA ascii\n1 2 3\n"
)
PLY_HEAD = (
    "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n1 2 3\n"
)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("WIDTH 1\nHEIGHT 1", "WIDTH -1\nHEIGHT -1", "'-1' is not a number"),
        ("WIDTH 1", "WIDTH 1_0", "'1_0' is not a number"),
        ("WIDTH 1", f"WIDTH {'9' * 5000}", "is not a number"),
        ("WIDTH 1\nHEIGHT 1\nPOINTS 1", "WIDTH 900000000000\nHEIGHT 1\nPOINTS 900000000000", "bytes of text found"),
        ("POINTS 1", "POINTS 7", "WIDTH and HEIGHT say 1"),
        ("COUNT 1 1 1", "COUNT 1 1 999999999", "which is not read"),
        ("COUNT 1 1 1", "COUNT 1 1 0", "which is not read"),
        ("TYPE F F F", "TYPE F F O", "TYPE O, SIZE 4"),
        ("SIZE 4 4 4", "SIZE 4 4 3", "TYPE F, SIZE 3"),
        ("vertex 1", "vertex -1", "'-1' is not a number"),
        ("vertex 1", "vertex 900000000000", "bytes of text found"),
        ("vertex 1", f"vertex {'9' * 5000}", "is not a number"),
    ],
)
def test_headers_whose_numbers_are_none_are_refused(tmp_path: Path, old: str, new: str, words: str) -> None:
    name, head = ("c.ply", PLY_HEAD) if old.startswith("vertex") else ("c.pcd", PCD_HEAD)
    (tmp_path / name).write_text(head)
    assert load_cloud(tmp_path / name).xyz.tolist() == [[1, 2, 3]]
    (tmp_path / name).write_text(head.replace(old, new))
    with pytest.raises(InputError, match=words):
        load_cloud(tmp_path / name)


@pytest.mark.parametrize("values", [["1.0"], [1 + 2j], [b"1"], [None]])
def test_arrays_that_are_no_real_numbers_are_refused(tmp_path: Path, values: list[object]) -> None:
    np.savez(tmp_path / "c.npz", x=[1.0], y=[1.0], z=np.array(values))
    with pytest.raises(InputError, match="real numbers are needed"):
        load_cloud(tmp_path / "c.npz")


def test_cut_off_files(tmp_path: Path) -> None:
    for suffix in (".ply", ".pcd", ".npz"):
        path = tmp_path / f"c{suffix}"
        save_cloud(path, random_cloud(50))
        path.write_bytes(path.read_bytes()[:-200])
        with pytest.raises(InputError, match=f"c{suffix}"):
            load_cloud(path)


def test_pixels_must_be_whole_and_endings_known(tmp_path: Path) -> None:
    np.savez(tmp_path / "c.npz", x=[1.0], y=[1.0], z=[1.0], u=[1.5], v=[2.0], pair=[0])
    with pytest.raises(InputError, match="field u must hold whole numbers"):
        load_cloud(tmp_path / "c.npz")
    np.savez(tmp_path / "d.npz", x=[1.0], y=[1.0, 2.0], z=[1.0])
    with pytest.raises(InputError, match="differ in length"):
        load_cloud(tmp_path / "d.npz")
    with pytest.raises(OutputError, match=r"\.ply, \.pcd, \.npz"):
        save_cloud(tmp_path / "c.obj", random_cloud(1))
    with pytest.raises(InputError, match="No such file"):
        load_cloud(tmp_path / "none.ply")


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
