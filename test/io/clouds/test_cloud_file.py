"""Clouds as files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.io.clouds.cloud_file import load_cloud, save_cloud
from sfr_loc_map.io.convert import convert_cloud


def random_cloud(count: int, seed: int = 0, pairs: int = 256) -> PointCloud:
    rng = np.random.default_rng(seed)
    records = np.zeros(count, PointCloud.dtype())
    for name in ("x", "y", "z", "sigma", "intensity"):
        records[name] = rng.normal(size=count)
    records["sigma"] = np.abs(records["sigma"])
    records["u"], records["v"], records["pair"] = rng.integers(0, [65536, 65536, pairs], (count, 3)).T
    return PointCloud.from_structured(records)


@given(st.integers(0, 20), st.integers(0, 5), st.sampled_from([(True, (-5, 2**62 - 1)), (False, (7,)), (None, None)]))
@pytest.mark.parametrize("suffix", [".ply", ".pcd", ".npz"])
def test_round_trip_keeps_all(
    tmp_path_factory: pytest.TempPathFactory, suffix: str, count: int, seed: int, said: tuple
) -> None:
    path = tmp_path_factory.mktemp("c") / f"c{suffix}"
    cloud = replace(random_cloud(count, seed, len(said[1] or ()) or 256), fused=said[0], pair_stamps_ns=said[1])
    save_cloud(path, cloud)
    loaded = load_cloud(path)
    assert (loaded.cloud.fused, loaded.cloud.pair_stamps_ns) == said
    np.testing.assert_allclose(loaded.xyz, cloud.xyz, rtol=0, atol=0)
    for name in ("sigma", "intensity", "u", "v", "pair"):
        np.testing.assert_array_equal(getattr(loaded.cloud, name), getattr(cloud, name))


def test_files_are_what_others_expect(tmp_path: Path) -> None:
    cloud = replace(random_cloud(3), fused=True)
    for suffix in (".ply", ".pcd", ".npz"):
        save_cloud(tmp_path / f"c{suffix}", cloud)
    head, body = (tmp_path / "c.ply").read_bytes().split(b"end_header\n", 1)
    begin = b"ply\nformat binary_little_endian 1.0\ncomment sfr fused true\nelement vertex 3\nproperty float x\n"
    assert head.startswith(begin)
    assert np.frombuffer(body[:12], "<f4").tolist() == cloud.xyz[0].tolist()
    assert len(body) == 3 * (5 * 4 + 2 * 2 + 1)
    assert b"FIELDS x y z sigma intensity u v pair\n" in (tmp_path / "c.pcd").read_bytes()
    with np.load(tmp_path / "c.npz") as arrays:
        assert list(arrays.files) == ["x", "y", "z", "sigma", "intensity", "u", "v", "pair", "fused"]
        assert (arrays["u"].dtype, arrays["pair"].dtype) == (np.uint16, np.uint8)


@pytest.mark.parametrize("suffix", [".ply", ".pcd", ".npz"])
def test_the_positions_of_a_cloud_without_pixels_are_converted(
    tmp_path: Path, suffix: str, caplog: pytest.LogCaptureFixture
) -> None:
    lines = ["ply", "format ascii 1.0", "element vertex 3"]
    lines += ["property double x", "property float y", "property float z", "property uchar red"]
    (tmp_path / "a.ply").write_text("\n".join([*lines, "end_header", "0.1 1 2 7", "nan 1 1 8", "-3 4e3 5.5 9", ""]))
    assert convert_cloud(tmp_path / "a.ply", tmp_path / f"b{suffix}") == 2
    assert "only their positions are written" in caplog.text
    loaded = load_cloud(tmp_path / f"b{suffix}")
    assert loaded.cloud is None
    assert loaded.xyz.tolist() == [[0.1, 1.0, 2.0], [-3.0, 4000.0, 5.5]]


def test_ply_of_others(tmp_path: Path) -> None:
    path = tmp_path / "c.ply"
    path.write_text(
        "ply\nformat ascii 1.0\ncomment x\nelement vertex 2\nproperty double z\nproperty uchar red\nproperty double x\n"
        "property double y\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        "3 255 1.00000000001 2\nnan 0 1 1\n3 0 1 1\n"
    )
    assert load_cloud(path).cloud is None
    assert load_cloud(path).xyz.tolist() == [[1.00000000001, 2, 3]]  # the point that is not finite is left out
    fields = ("float64 x", "int pair", "float y", "float z", "int32 u", "short v")
    head = "".join(f"property {field}\n" for field in fields)
    record = np.array([(1.5, 2, 2.5, 3.5, 700, 400)], ">f8,>i4,>f4,>f4,>i4,>i2").tobytes()
    path.write_bytes(f"ply\nformat binary_big_endian 1.0\nelement vertex 1\n{head}end_header\n".encode() + record)
    cloud = load_cloud(path).cloud
    assert (cloud.xyz.tolist(), cloud.fused) == ([[1.5, 2.5, 3.5]], None)
    assert (int(cloud.u[0]), int(cloud.v[0]), int(cloud.pair[0])) == (700, 400, 2)
    assert np.isnan(cloud.sigma[0])


@pytest.mark.filterwarnings("error")
def test_pcd_of_others(tmp_path: Path) -> None:
    path = tmp_path / "c.pcd"
    head = "VERSION .7\nFIELDS x y z _ \nSIZE 4 4 4 1\nTYPE F F F U\nCOUNT 1 1 1 4\nWIDTH 2\nHEIGHT 2\nPOINTS 4\nDATA "
    numbers = np.arange(12.0).reshape(4, 3)
    path.write_text(
        head + "ascii\n" + "\n# sensor 1\n \n".join(" ".join(map(str, [*row, 0, 0, 0, 0])) for row in numbers) + "\n"
    )
    cloud = load_cloud(path).cloud
    assert (cloud.u.tolist(), cloud.v.tolist(), cloud.pair.tolist()) == ([0, 1, 0, 1], [0, 0, 1, 1], [0] * 4)
    np.testing.assert_array_equal(cloud.xyz, numbers)
    assert cloud.fused is False  # one point a pixel of one image
    path.write_bytes((head + "binary\n").encode() + b"".join(row.astype("<f4").tobytes() + bytes(4) for row in numbers))
    np.testing.assert_array_equal(load_cloud(path).xyz, numbers)


PCD = "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 1\nHEIGHT 1\nPOINTS 1\nDATA ascii\n1 2 3\n"
PROPERTIES = "property float x\nproperty float y\nproperty float z\nend_header\n1 2 3\n"
PLY = f"ply\nformat ascii 1.0\ncomment sfr pair_stamps_ns 5\nelement vertex 1\n{PROPERTIES}"


@pytest.mark.parametrize(
    ("whole", "old", "new", "words"),
    [
        (PCD, "1\nHEIGHT 1\nPOINTS 1", "900000000000\nHEIGHT 1\nPOINTS 900000000000", "bytes of text: "),
        (PCD, "POINTS 1", "POINTS 7", "WIDTH and HEIGHT give 1"),
        (PCD, "DATA ascii\n1 2 3", "DATA binary_compressed\n1234", "has [45] bytes: at least the 8 bytes"),
        (PCD, "COUNT 1 1 1", "COUNT 1 1 999999999", "which is not supported"),
        (PCD, "DATA ascii\n1 2 3", "DATA binary\n1234", "bytes: 1 points"),
        (PLY, "vertex 1", "vertex -1", "'-1' is not a count"),
        (PLY, "1 2 3\n", "1\n", "are required"),
        (PLY, "1 2 3\n", "# 1 2 3\n", "point 1 has 0 numbers: 3 are required"),
        (PLY, "1 2 3\n", "1 2 3 4\n", "point 1 has 4 numbers: 3 are required"),
        (PLY, "float z\nend_header\n1 2 3", "list uchar int z\nend_header\n1 2 0", "no field z"),
        (PLY, "float z\nend_header\n1 2 3", "float z\nproperty list uchar int n\nend_header\n1 2 1_0 0", "1_0"),
        (PLY, "stamps_ns 5", "stamps_ns 5.5", "is not an integer number of nanoseconds"),
        (PLY, "pair_stamps_ns 5", "fused maybe", "true or false is required"),
    ],
)
def test_broken_files(tmp_path: Path, whole: str, old: str, new: str, words: str) -> None:
    path = tmp_path / ("c.ply" if whole is PLY else "c.pcd")
    path.write_text(whole)
    assert load_cloud(path).xyz.tolist() == [[1, 2, 3]]
    path.write_text(whole.replace(old, new))
    with pytest.raises(InputError, match=f"{path}.*{words}"):
        load_cloud(path)


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ("1 2 3 1 5 9\n1 2 3 0\n", "line 9 has 6 numbers: 5 are required"),
        ("1 2 3 0\n\n1 2 3\n", "line 11 has 3 numbers: 4 are required"),
        ("1 2 3 2 5\n1 2 3 0\n", "line 9 has 5 numbers: 6 are required"),
    ],
)
def test_a_row_with_another_number_of_values_than_its_list_is_refused(tmp_path: Path, rows: str, words: str) -> None:
    properties = "property float x\nproperty float y\nproperty float z\nproperty list uchar int k\n"
    (tmp_path / "c.ply").write_text(f"ply\nformat ascii 1.0\nelement vertex 2\n{properties}end_header\n{rows}")
    with pytest.raises(InputError, match=words):
        load_cloud(tmp_path / "c.ply")
