"""Clouds as other programs write them: by the commands, each form gives the points that were written."""

from __future__ import annotations

import gzip
import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from helpers.cli_result import Sfr
from helpers.made_scene import NAV_RIG, nav_pair
from helpers.made_worlds import World
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.io.clouds.cloud_file import load_cloud, save_cloud
from sfr_loc_map.io.layouts.folder import FolderWriter

COUNT = 50
POINTS = np.random.default_rng(3).normal(0.0, 2.0, (COUNT, 3)).astype("<f4")
VERTEX = "property float x\nproperty float y\nproperty float z\n"


def compressed(data: bytes) -> bytes:
    """Return LZF: the last three bytes again are a copy, all else literals."""
    out, literals, at = bytearray(), bytearray(), 0

    def flush() -> None:
        for start in range(0, len(literals), 32):
            part = literals[start : start + 32]
            out.extend([len(part) - 1, *part])
        literals.clear()

    while at < len(data):
        before = data.rfind(data[at : at + 3], max(0, at - 8000), at + 2) if at + 3 <= len(data) else -1
        if 0 <= before < at:
            length = 3
            while length < 264 and at + length < len(data) and data[before + length] == data[at + length]:
                length += 1
            flush()
            distance = at - before - 1
            high = min(length - 2, 7)
            out.extend([high << 5 | distance >> 8, *([length - 9] if high == 7 else []), distance & 255])
            at += length
        else:
            literals.append(data[at])
            at += 1
    flush()
    return bytes(out)


def ply(elements: str, body: bytes, kind: str = "binary_little_endian") -> bytes:
    return f"ply\nformat {kind} 1.0\ncomment made by another program\n{elements}end_header\n".encode() + body


def pcd(body: bytes, data: str, size: str = "WIDTH 50\nHEIGHT 1") -> bytes:
    head = f"VERSION 0.7\nFIELDS x y z _\nSIZE 4 4 4 1\nTYPE F F F U\nCOUNT 1 1 1 4\n{size}\n"
    return f"{head}VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 50\nDATA {data}\n".encode() + body


def with_list(lengths: Callable[[int], int]) -> bytes:
    parts = []
    for k, xyz in enumerate(POINTS):
        length = lengths(k)
        parts.append(xyz[:1].tobytes() + bytes([length]) + np.arange(length, dtype="<i4").tobytes() + xyz[1:].tobytes())
    return b"".join(parts)


LIST = "property float x\nproperty list uchar int hits\nproperty float y\nproperty float z\n"
TEXT = "\n".join(" ".join(map(repr, row)) for row in POINTS.astype(np.float64).tolist())
POINTS_AND_PADDING = np.c_[POINTS.view("<u4"), np.zeros(COUNT, "<u4")].tobytes()
PACKED = b"".join(POINTS[:, axis].tobytes() for axis in range(3)) + bytes(4 * COUNT)
CAMERA = "element camera 1\nproperty double view\nproperty list int float lens\n"
FORMS: dict[str, bytes] = {
    "lists of one length.ply": ply(f"element vertex 50\n{LIST}", with_list(lambda _: 2)),
    "lists of all lengths.ply": ply(f"element vertex 50\n{LIST}", with_list(lambda k: k % 4)),
    "lists as text.ply": ply(
        f"element vertex 50\n{LIST}",
        "\n".join(
            f"{x!r} {k % 3} {'7 ' * (k % 3)}{y!r} {z!r}" for k, (x, y, z) in enumerate(POINTS.astype(float).tolist())
        ).encode(),
        "ascii",
    ),
    "another element first.ply": ply(
        f"{CAMERA}element vertex 50\n{VERTEX}", bytes(8) + b"\x02\0\0\0" + bytes(8) + POINTS.tobytes()
    ),
    "faces behind.ply": ply(
        f"element vertex 50\n{VERTEX}element face 1\nproperty list uchar int vertex_indices\n",
        POINTS.tobytes() + b"\x03" + bytes(12),
    ),
    "CAPITALS.PLY": ply(f"element vertex 50\n{VERTEX}".replace(" x", " X"), POINTS.tobytes()),
    "nan of Windows.ply": ply(
        f"element vertex 52\n{VERTEX}", f"-nan(ind) 1 2\n{TEXT}\n-1.#IND 1.#QNAN 0\n".encode(), "ascii"
    ),
    "compressed.pcd": pcd(
        np.array([len(compressed(PACKED)), len(PACKED)], "<u4").tobytes() + compressed(PACKED), "binary_compressed"
    ),
    "column.pcd": pcd(POINTS_AND_PADDING, "binary", "WIDTH 1\nHEIGHT 50"),
}


def npz(**arrays: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # type: ignore[arg-type]
    return buffer.getvalue()


FORMS |= {
    "the end of the header in a comment.ply": ply(f"comment end_header\nelement vertex 50\n{VERTEX}", POINTS.tobytes()),
    "without height.pcd": pcd(POINTS_AND_PADDING, "binary", "WIDTH 50"),
    "number of points alone.pcd": pcd(POINTS_AND_PADDING, "binary", "# no grid"),
    "version 5.pcd": pcd(POINTS_AND_PADDING, "binary").replace(b"FIELDS", b"COLUMNS"),
    "CAPITALS.npz": npz(X=POINTS[:, 0], Y=POINTS[:, 1], Z=POINTS[:, 2]),
}
PIXELS = {**dict.fromkeys(("x", "y", "z"), np.ones(3)), **dict.fromkeys(("u", "v", "pair"), np.arange(3))}
REFUSED: dict[str, tuple[bytes, str]] = {
    "no count.ply": (ply(f"element vertex\n{VERTEX}", POINTS.tobytes()), "is not of the form 'element NAME"),
    "no name.ply": (ply("element vertex 50\nproperty float\n", b""), "is not of the form 'property TYPE"),
    "no format.ply": (b"ply\nformat\nend_header\n", "PLY format is ''"),
    "x twice.ply": (ply(f"element vertex 1\n{VERTEX}property float x\n", b"1 2 3 9\n", "ascii"), "field x twice"),
    "two lists of points.ply": (
        ply(f"element vertex 1\n{VERTEX}element vertex 1\n{VERTEX}", b"1 2 3\n4 5 6\n", "ascii"),
        "it has the element vertex twice",
    ),
    "fields twice.pcd": (
        pcd(b"", "binary").replace(b"SIZE", b"FIELDS z y x _\nSIZE"),
        "its header has two lines FIELDS",
    ),
    "a negative sigma.npz": (npz(**PIXELS, sigma=-np.ones(3)), "has a sigma of -1 m: at least 0 m is required"),
    "a pair without a stamp.npz": (
        npz(**PIXELS, pair_stamps_ns=np.array([5, 6])),
        "points of pair 2 (counted from 0), but stamps for only 2 pairs",
    ),
    "no width.pcd": (pcd(b"", "binary", "WIDTH\nHEIGHT 1"), "header has no WIDTH"),
    "no fields.pcd": (pcd(b"", "binary").replace(b"FIELDS x y z _\n", b""), "header has no FIELDS"),
    "sizes missing.pcd": (pcd(b"", "binary").replace(b"SIZE 4 4 4 1", b"SIZE 4 4"), "different numbers of FIELDS"),
    "no points.pcd": (pcd(b"", "binary").replace(b"POINTS 50", b"POINTS"), "header has no POINTS"),
    "x twice.npz": (npz(x=np.ones(3), X=np.zeros(3), y=np.ones(3), z=np.ones(3)), "it has the field x twice"),
    "points.npz": (npz(points=POINTS), "it has the arrays points: x, y and z are required"),
    "grid.npz": (npz(x=np.ones((2, 3)), y=np.ones(6), z=np.ones(6)), "array x has the shape"),
    "another length.npz": (npz(x=np.ones(3), y=np.ones(2), z=np.ones(3)), "its arrays differ in length"),
    "fused 1.npz": (npz(**PIXELS, fused=np.array(1)), "its array fused is 1 x int64: one truth value is required"),
    "fused twice.npz": (npz(**PIXELS, fused=np.ones(2, np.bool_)), "its array fused is 2 x bool: one truth value"),
    "decimal stamps.npz": (npz(**PIXELS, pair_stamps_ns=np.ones(3)), "its array pair_stamps_ns requires integers"),
    "late stamps.npz": (npz(**PIXELS, pair_stamps_ns=np.full(3, 2**62)), "within 146 years of 1970"),
    "many stamps.npz": (npz(**PIXELS, pair_stamps_ns=np.arange(257)), "257 stamps are listed: at most 256"),
    "feet.ply": (ply(f"comment units: feet\nelement vertex 50\n{VERTEX}", POINTS.tobytes()), "states the unit ft"),
    "information.ply": (ply(f"obj_info units mm\nelement vertex 50\n{VERTEX}", POINTS.tobytes()), "states the unit mm"),
    "tab.ply": (ply(f"comment\tunits: mm\nelement vertex 50\n{VERTEX}", POINTS.tobytes()), "states the unit mm"),
    "millimetres.ply": (ply(f"comment unit: mm\nelement vertex 50\n{VERTEX}", POINTS.tobytes()), "states the unit mm"),
    "in millimetres.pcd": (
        b"# all lengths in mm\n" + pcd(b"", "binary", "WIDTH 0\nHEIGHT 1").replace(b"POINTS 50", b"POINTS 0"),
        "states the unit mm",
    ),
    "byte order.ply": (
        ply(f"element vertex 3\n{VERTEX}", np.arange(1.0, 10.0).astype(">f4").tobytes()),
        "check the byte order and the unit",
    ),
    "packed.pcd": (gzip.compress(pcd(POINTS_AND_PADDING, "binary")), "compressed by gzip: decompress it first"),
    "points.xyz": (b"1 2 3\n", "a name that ends in .ply, .pcd or .npz is required"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_cloud_that_cannot_be_understood_is_refused_by_what_was_found(tmp_path: Path, sfr: Sfr, name: str) -> None:
    content, words = REFUSED[name]
    (tmp_path / name).write_bytes(content)
    done = sfr("score", tmp_path / name, tmp_path)
    assert done.code == 2
    assert words in done.err
    assert len(done.err.splitlines()) == 1


@pytest.mark.parametrize("size", ["WIDTH 10\nHEIGHT 5", "WIDTH 50\nHEIGHT 1"])
@pytest.mark.parametrize(("zeros", "count"), [(0, 50), (1, 50), (7, 43)])
def test_pixels_without_a_point_may_be_written_as_zeros(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, zeros: int, count: int, size: str
) -> None:
    points = np.concatenate((POINTS, np.zeros((50, 1), "<f4")), axis=1)
    points[10 : 10 + zeros] = 0.0
    (tmp_path / "theirs.pcd").write_bytes(pcd(points.tobytes(), "binary", size))
    found = load_cloud(tmp_path / "theirs.pcd")
    assert (found.cloud is not None) == ("HEIGHT 5" in size)
    assert len(found.xyz) == count
    assert found.cloud is None or len(found.cloud) == count
    assert ("points at 0, 0, 0 ignored" in caplog.text) == (count < 50)


@pytest.mark.parametrize("viewpoint", ["0.0 0 0 1 0 0 0", "1 2 3 1 0 0 0"])
def test_a_viewpoint_that_is_not_applied_is_reported(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, viewpoint: str
) -> None:
    content = pcd(POINTS_AND_PADDING, "binary").replace(b"0 0 0 1 0 0 0", viewpoint.encode())
    (tmp_path / "theirs.pcd").write_bytes(content)
    np.testing.assert_array_equal(load_cloud(tmp_path / "theirs.pcd").xyz, POINTS.astype(np.float64))
    assert ("VIEWPOINT 1 2 3" in caplog.text) is viewpoint.startswith("1")


AFTER = {
    "text.ply": ply(f"element vertex 49\n{VERTEX}", "".join(f"{x} {y} {z}\n" for x, y, z in POINTS).encode(), "ascii"),
    "binary.ply": ply(f"element vertex 49\n{VERTEX}", POINTS.tobytes()),
    "binary.pcd": pcd(np.c_[POINTS, np.ones(50, "<f4")].astype("<f4").tobytes() + b"more", "binary"),
    "text.pcd": pcd("".join(f"{x} {y} {z} 0 0 0 0\n" for x, y, z in (*POINTS, *POINTS[:1])).encode(), "ascii"),
}


@pytest.mark.parametrize("name", AFTER)
def test_data_after_the_last_point_is_reported(tmp_path: Path, caplog: pytest.LogCaptureFixture, name: str) -> None:
    (tmp_path / name).write_bytes(AFTER[name])
    count = 49 if name.endswith("ply") else 50
    np.testing.assert_allclose(load_cloud(tmp_path / name).xyz, POINTS[:count].astype(np.float64), rtol=1e-6)
    assert f"cloud '{tmp_path / name}': " in caplog.text
    assert "after its last point ignored" in caplog.text


@pytest.mark.parametrize("name", FORMS)
def test_each_form_has_the_points_that_were_written(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(FORMS[name])
    found = load_cloud(tmp_path / name)
    np.testing.assert_array_equal(found.xyz, POINTS.astype(np.float64))
    assert found.cloud is None


@pytest.mark.parametrize("name", [name for name in FORMS if "text" not in name and "Windows" not in name])
def test_a_form_that_is_cut_off_is_refused(tmp_path: Path, sfr: Sfr, name: str) -> None:
    (tmp_path / name).write_bytes(FORMS[name][: -20 if "behind" not in name else -200])
    done = sfr("score", tmp_path / name, tmp_path)
    assert done.code == 2
    assert "cannot be read" in done.err


@pytest.mark.parametrize(("step", "swapped"), [(1, False), (2, False), (4, False), (1, True)])
def test_the_order_of_points_gives_pixels_of_images_of_that_size_alone(
    tmp_path: Path, sfr: Sfr, world: World, caplog: pytest.LogCaptureFixture, step: int, swapped: bool
) -> None:
    with FolderWriter(tmp_path / "data", loc=False, nav=True) as writer:
        writer.write_nav_rig(world.nav_rig)
        for pair in world.navs[:1]:
            writer.write_nav_pair(pair)
    truth = world.navs[0].truth
    assert truth is not None
    points = np.asarray(truth, "<f4")[::step, ::step]
    points = points.transpose(1, 0, 2) if swapped else points
    height, width = points.shape[:2]
    size = f"WIDTH {width}\nHEIGHT {height}\nPOINTS {width * height}\n"
    head = f"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n{size}DATA binary\n"
    (tmp_path / "theirs.pcd").write_bytes(head.encode() + points.tobytes())
    done = sfr("score", tmp_path / "theirs.pcd", tmp_path / "data", "--points", tmp_path / "p.csv")
    of_images = (width, height) == (world.nav_rig.width, world.nav_rig.height)
    assert ("is organised as" in caplog.text) is not of_images
    assert done.code == (0 if of_images else 2), done.err
    if of_images:
        errors = np.loadtxt(tmp_path / "p.csv", delimiter=",", skiprows=1, ndmin=2)[:, 4]
        assert np.abs(errors).max() < 1e-6


@pytest.mark.parametrize("wrong", ["", "pixels of half the size", "points in the optical frame", "rows from below"])
def test_points_that_are_not_seen_at_their_pixels_are_named(tmp_path: Path, sfr: Sfr, wrong: str) -> None:
    item, rig = nav_pair(0), NAV_RIG
    with FolderWriter(tmp_path / "data", loc=False, nav=True) as writer:
        writer.write_nav_rig(rig)
        writer.write_nav_pair(item)
    assert item.truth is not None
    v, u = np.nonzero(np.isfinite(item.truth).all(axis=2))
    xyz = item.truth[v, u].astype(np.float64)
    if "half" in wrong:
        u, v = u // 2, v // 2
    elif "optical" in wrong:
        xyz = (item.T_lm_navsb @ rig.T_sb_left).inverse().apply(xyz)
    elif "below" in wrong:
        v = rig.height - 1 - v
    points = np.zeros(len(u), PointCloud.dtype())
    for name, values in {"x": xyz[:, 0], "y": xyz[:, 1], "z": xyz[:, 2], "u": u, "v": v}.items():
        points[name] = values
    save_cloud(tmp_path / "theirs.ply", PointCloud.from_structured(points, fused=False))
    done = sfr("score", tmp_path / "theirs.ply", tmp_path / "data", "--lenient")
    assert done.code == 0, done.err
    assert ("px from the pixels that they name" in done.err) is bool(wrong)


@pytest.mark.parametrize("prefix", ["", "scalar_", "other_"])
def test_pixels_are_read_by_the_names_of_cloudcompare_and_missing_ones_are_reported(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, prefix: str
) -> None:
    fields = "".join(f"property float {prefix}{name}\n" for name in ("u", "v", "pair"))
    axes = "".join(f"property float {name}\n" for name in "xyz")
    (tmp_path / "c.ply").write_text(f"ply\nformat ascii 1.0\nelement vertex 1\n{axes}{fields}end_header\n1 2 3 4 5 0\n")
    has_pixels = prefix != "other_"
    assert (load_cloud(tmp_path / "c.ply").cloud is not None) == has_pixels
    assert ("has no field u, v, pair" in caplog.text) != has_pixels
