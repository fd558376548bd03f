"""Random stereo pairs in each format that is written, and blobs at known pixels."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sfr_loc_map.geometry.rotation import quat_normalised
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair, StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.bag.writer import BagWriter
from sfr_loc_map.io.layouts.folder import FolderWriter
from sfr_loc_map.io.sequence import Source

START_NS = 1_700_000_000_000_000_001


@dataclass(frozen=True)
class World:
    loc_rig: StereoRig
    nav_rig: StereoRig
    pairs: tuple[StereoPair, ...]
    navs: tuple[PosedStereoPair, ...]
    truth: Trajectory


def random_pose(rng: np.random.Generator) -> Transform:
    return Transform.from_quat(rng.normal(size=3), quat_normalised(rng.normal(size=4)))


def random_pair(rng: np.random.Generator, stamp_ns: int, shape: tuple[int, int]) -> StereoPair:
    return StereoPair(stamp_ns, *(rng.integers(0, 256, shape, dtype=np.uint8) for _ in range(2)))


def make_world(count: int = 4, seed: int = 0, width: int = 24, height: int = 16) -> World:
    """Return images of noise and random poses; only the first of two mapping pairs has a ground truth."""
    rng = np.random.default_rng(seed)
    loc_rig = StereoRig(width, height, 20.1, 20.3, 11.7, 7.9, 0.12, random_pose(rng))
    nav_rig = StereoRig(width + 2, height, 33.3, 33.3, 12.5, 8.25, 0.15)
    stamps = [START_NS + i * 333_333_333 for i in range(count)]
    pairs = tuple(random_pair(rng, stamp, (height, width)) for stamp in stamps)
    navs = []
    for i in range(2):
        truth = rng.normal(size=(height, width + 2, 3)).astype(np.float32)
        truth[0] = np.nan
        pair = random_pair(rng, START_NS + i * 500_000_000, (height, width + 2))
        navs.append(PosedStereoPair(pair, random_pose(rng), truth if i == 0 else None))
    trajectory = Trajectory(
        np.array(stamps, np.int64), rng.normal(size=(count, 3)), quat_normalised(rng.normal(size=(count, 4)))
    )
    return World(loc_rig, nav_rig, pairs, tuple(navs), trajectory)


def fill(writer: FolderWriter | BagWriter, world: World, *, loc: bool = True, nav: bool = True) -> None:
    if loc:
        writer.write_loc_rig(world.loc_rig)
        for pair in world.pairs:
            writer.write_loc_pair(pair)
        truth = world.truth
        for i, stamp in enumerate(truth.stamps_ns.tolist()):
            writer.write_truth(stamp, truth.positions[i], truth.quats_xyzw[i])
    if nav:
        writer.write_nav_rig(world.nav_rig)
        for item in world.navs:
            writer.write_nav_pair(item)


def write_folder(path: Path, world: World, *, loc: bool = True, nav: bool = True) -> Path:
    with FolderWriter(path, loc=loc, nav=nav) as writer:
        fill(writer, world, loc=loc, nav=nav)
    return path


def write_bag(path: Path, world: World, *, loc: bool = True, nav: bool = True, **options: Any) -> Path:
    with BagWriter(path, "sqlite3" if path.suffix == ".db3" else "mcap", **options) as writer:
        fill(writer, world, loc=loc, nav=nav)
    return path


def assert_same_pose(a: Transform, b: Transform) -> None:
    assert a.matrix.tobytes() == b.matrix.tobytes()
    assert a.file_quat_xyzw.tolist() == b.file_quat_xyzw.tolist()


def assert_same_pairs(found: Iterable[StereoPair], wanted: Iterable[StereoPair]) -> None:
    for a, b in zip(found, wanted, strict=True):
        assert a.stamp_ns == b.stamp_ns
        np.testing.assert_array_equal((a.left, a.right), (b.left, b.right))


def assert_same_trajectory(a: Trajectory, b: Trajectory) -> None:
    assert a.stamps_ns.tolist() == b.stamps_ns.tolist()
    assert a.positions.tobytes() == b.positions.tobytes()
    assert a.quats_xyzw.tobytes() == b.quats_xyzw.tobytes()


def assert_is_world(source: Source, world: World) -> None:
    """Check that a source holds a world, bit-identical."""
    assert (len(source.loc), len(source.nav)) == (len(world.pairs), len(world.navs))
    assert source.loc.rig.same_cameras(world.loc_rig)
    assert source.nav.rig.same_cameras(world.nav_rig)
    assert_same_pose(source.loc.rig.T_rb_sb, world.loc_rig.T_rb_sb)
    assert source.nav.rig.T_rb_sb is None
    assert_same_trajectory(source.loc.ground_truth, world.truth)
    assert_same_pairs(source.loc.pairs(), world.pairs)
    navs = list(source.nav.pairs())
    assert_same_pairs((n.pair for n in navs), (n.pair for n in world.navs))
    for a, b in zip(navs, world.navs, strict=True):
        assert_same_pose(a.T_lm_navsb, b.T_lm_navsb)
        assert (a.truth is None) == (b.truth is None)
        assert a.truth is None or (a.truth.dtype == np.float32 and np.array_equal(a.truth, b.truth, equal_nan=True))


def blob(at: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return an image with a bright spot at a pixel (u, v)."""
    v, u = np.mgrid[: shape[0], : shape[1]]
    return np.rint(250.0 * np.exp(-((u - at[0]) ** 2 + (v - at[1]) ** 2) / 8.0)).astype(np.uint8)


def centre_of(image: np.ndarray) -> np.ndarray:
    """Return the position (u, v) of the spot of an image, px."""
    weights = np.where(image > 20, image, 0).astype(float)
    v, u = np.mgrid[: image.shape[0], : image.shape[1]]
    return np.array([(weights * u).sum(), (weights * v).sum()]) / weights.sum()


def seen_at(ray: Sequence[float], model: str, d: Sequence[float], k: Sequence[float]) -> np.ndarray:
    """Return the pixel of a ray by the formula of a model (OpenCV's documentation of its camera models)."""
    x, y = ray[0] / ray[2], ray[1] / ray[2]
    r = np.hypot(x, y)
    if model == "equidistant":
        theta = np.arctan(r)
        scale = theta * (1 + d[0] * theta**2 + d[1] * theta**4 + d[2] * theta**6 + d[3] * theta**8) / r
        x, y = x * scale, y * scale
    else:
        d = (*d, *(0.0,) * (8 - len(d)))
        radial = (1 + d[0] * r**2 + d[1] * r**4 + d[4] * r**6) / (1 + d[5] * r**2 + d[6] * r**4 + d[7] * r**6)
        x, y = (
            x * radial + 2 * d[2] * x * y + d[3] * (r**2 + 2 * x**2),
            y * radial + d[2] * (r**2 + 2 * y**2) + 2 * d[3] * x * y,
        )
    return np.array([k[0] * x + k[2], k[4] * y + k[5]])
