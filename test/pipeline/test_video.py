"""The film of the tracks."""

from __future__ import annotations

import resource
from pathlib import Path

import cv2
import numpy as np
import pytest
from made_scene import HEIGHT, LOC_RIG, WIDTH, loc_pair, write_folder

from sfr_loc_map.errors import OutputError
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.visualisation import STRIP
from sfr_loc_map.pipeline.offline import localise, track_video


@pytest.mark.parametrize("ending", [".avi", ".mp4"])
def test_a_film_has_one_image_for_each_pair_and_estimates_stay_the_same(tmp_path: Path, ending: str) -> None:
    sequence = open_source(write_folder(tmp_path / "drive", 4, 0)).loc
    assert sequence is not None
    path, config, start = tmp_path / f"tracks{ending}", LocalisationConfig(), Transform.identity()
    with track_video(path, sequence.rig) as watch:
        watched = [estimate for estimate, _ in localise(sequence, config, start, watch)]
    for a, (b, _) in zip(watched, localise(sequence, config, start), strict=True):
        np.testing.assert_array_equal(a.T_ds_rb.matrix, b.T_ds_rb.matrix)
    film = cv2.VideoCapture(str(path))
    images = []
    while (read := film.read())[0]:
        images.append(read[1])
    assert len(images) == 4
    assert images[0].shape == (HEIGHT + STRIP, WIDTH, 3)
    grey = images[0][4 : HEIGHT - 4, 4 : WIDTH - 4].mean(axis=2)
    assert np.median(np.abs(grey - 0.75 * loc_pair(0).left[4:-4, 4:-4])) < 12


def test_an_unknown_ending_is_refused_and_a_failure_leaves_nothing(tmp_path: Path) -> None:
    with (
        pytest.raises(OutputError, match=r"tracks\.gif.*\.avi or \.mp4"),
        track_video(tmp_path / "tracks.gif", LOC_RIG),
    ):
        pass
    with pytest.raises(RuntimeError, match="broken"), track_video(tmp_path / "tracks.avi", LOC_RIG):
        raise RuntimeError("broken")
    assert not list(tmp_path.iterdir())


def test_a_film_that_is_cut_short_by_a_full_disk_is_refused(tmp_path: Path) -> None:
    sequence = open_source(write_folder(tmp_path / "drive", 4, 0)).loc
    assert sequence is not None
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, hard))
    try:
        with (
            pytest.raises(OutputError, match=r"tracks\.mp4.* of 4 images; check the space"),
            track_video(tmp_path / "tracks.mp4", sequence.rig) as watch,
        ):
            list(localise(sequence, LocalisationConfig(), Transform.identity(), watch))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert not list(tmp_path.glob("*.mp4"))
