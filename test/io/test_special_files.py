"""A named pipe in the place of an input is refused: opening it would wait for ever."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from sfr_loc_map.config import load_yaml
from sfr_loc_map.errors import SfrError
from sfr_loc_map.io.cloud_file import load_cloud
from sfr_loc_map.io.folder import load_rig
from sfr_loc_map.io.image_codec import read_grey
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.text_table import read_lines
from sfr_loc_map.io.trajectory_file import load_trajectory
from sfr_loc_map.localisation.frontend.feature_detection import read_mask
from sfr_loc_map.pipeline.call_stats import load_call_stats
from sfr_loc_map.report.page import load_score


@pytest.fixture
def no_waiting() -> Iterator[None]:
    """Fail where a reader waits for a writer."""

    def fail(*_: object) -> None:
        raise TimeoutError("it waits")

    before = signal.signal(signal.SIGALRM, fail)
    signal.alarm(5)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


READERS: dict[str, Callable[[Path], object]] = {
    "t.csv": load_trajectory,
    "t.tum": load_trajectory,
    "c.ply": load_cloud,
    "c.pcd": load_cloud,
    "c.npz": load_cloud,
    "i.png": read_grey,
    "mask.png": lambda path: read_mask(str(path)),
    "x.mcap": open_source,
    "x.db3": open_source,
    "folder/metadata.yaml": lambda path: open_source(path.parent),
    "folder/x.mcap": lambda path: open_source(path.parent),
    "folder/rig.json": load_rig,
    "folder/pairs.csv": lambda path: open_source(path.parent),
    "limits.yaml": load_yaml,
    "calib.txt": read_lines,
    "s.csv": load_call_stats,
    "score.json": load_score,
}


@pytest.mark.parametrize("name", READERS)
def test_a_pipe_is_refused(no_waiting: None, tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    os.mkfifo(path)
    with pytest.raises(SfrError, match="a named pipe"):
        READERS[name](path)
