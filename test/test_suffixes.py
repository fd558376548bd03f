"""The case of a suffix has no meaning: each command reads and writes `x.CSV` like `x.csv`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from helpers.cli_result import Sfr
from helpers.made_worlds import make_world, write_folder
from sfr_loc_map.cli.table_file import save_table
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.hashes import hash_path
from sfr_loc_map.io.clouds.cloud_file import save_cloud
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory


@pytest.fixture
def inputs(tmp_path: Path) -> dict[str, Path]:
    """Return a source, a trajectory and a cloud by their kind."""
    source = write_folder(tmp_path / "source", make_world())
    trajectory, cloud = tmp_path / "t.csv", tmp_path / "c.ply"
    stamps_ns = np.arange(5, dtype=np.int64) * 10**8
    quats = np.tile([0.0, 0.0, 0.0, 1.0], (5, 1))
    save_trajectory(trajectory, Trajectory(stamps_ns, np.arange(15.0).reshape(5, 3), quats))
    points = np.zeros(4, PointCloud.dtype())
    points["u"] = range(4)
    save_cloud(cloud, PointCloud.from_structured(points, fused=True))
    return {"source": source, "trajectory": trajectory, "cloud": cloud}


BACK = {"trajectory": "back.CSV", "cloud": "back.PLY", "source": "back.MCAP"}
"""The output of a second conversion, from the output of the first."""


def content_of(path: Path) -> str:
    """Return the hash of a file, or the names in a folder, whose bag has the times of its writing."""
    names = sorted(item.name.lower() for item in path.iterdir()) if path.is_dir() else [hash_path(path)]
    return " ".join(names)


@pytest.mark.parametrize(
    ("kind", "suffix"),
    [
        *(("trajectory", suffix) for suffix in (".csv", ".tum", ".txt", ".kitti", ".euroc.csv")),
        *(("cloud", suffix) for suffix in (".ply", ".pcd", ".npz")),
        *(("source", suffix) for suffix in (".csv", ".mcap", ".db3", ".bag")),
    ],
)
def test_conversions_write_and_read_a_suffix_in_any_case(
    sfr: Sfr, tmp_path: Path, inputs: dict[str, Path], kind: str, suffix: str
) -> None:
    found = set()
    for name in (suffix, suffix.upper(), suffix.title()):
        folder = tmp_path / name
        folder.mkdir()
        first = sfr("convert", inputs[kind], folder / f"out{name}")
        second = sfr("convert", folder / f"out{name}", folder / BACK[kind])
        assert (first.code, second.code) == (0, 0), first.err + second.err
        found.add((content_of(folder / f"out{name}"), content_of(folder / BACK[kind])))
    assert len(found) == 1, "the case of the suffix changed the files"


@pytest.mark.parametrize("suffix", [".html", ".htm", ".md", ".csv"])
def test_reports_write_and_read_a_suffix_in_any_case(
    sfr: Sfr, tmp_path: Path, inputs: dict[str, Path], suffix: str
) -> None:
    drive = inputs["trajectory"]
    begins = set()
    for letters in (str.lower, str.upper):
        score, page = tmp_path / letters("s.json"), tmp_path / letters(f"page{suffix}")
        scored = sfr("score", drive, drive, "--condition", "distance=5", "--json", score)
        written = sfr("report", score, "-o", page)
        assert (scored.code, written.code) == (0, 0), scored.err + written.err
        begins.add(page.read_text()[:20])
    assert len(begins) == 1, "the case of the suffix changed the format"


def test_a_table_is_written_as_csv_for_a_suffix_in_any_case(tmp_path: Path) -> None:
    for name in ("x.csv", "X.CSV"):
        save_table(tmp_path / name, {"u": np.arange(2)})
        assert (tmp_path / name).read_text() == "u\n0\n1\n"


def test_a_table_of_poses_is_converted_whatever_its_suffix_is(
    sfr: Sfr, tmp_path: Path, inputs: dict[str, Path]
) -> None:
    table = inputs["trajectory"].rename(tmp_path / "t.poses")
    result = sfr("convert", table, tmp_path / "o.csv")
    assert result.code == 0, result.err
    assert (tmp_path / "o.csv").read_bytes() == table.read_bytes()
