"""`sfr simulate`: scenarios, faults in copies of a source, and one-line errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from helpers.broken_sources import good_folder
from helpers.cli_result import Sfr
from sfr_loc_map.io.registry import open_source

TINY = """
seed: 3
terrain: {coarseness: 8}
rocks: {cover: 0.01, smallest_m: 0.2}
drive: {segments: ["straight 1"], pairs: 3}
panorama: {enabled: true, pan_deg: [5], tilt_deg: [25]}
loc: {width: 48, height: 40, focal_px: 40}
nav: {width: 48, height: 40, focal_px: 40}
sensor: {samples: 1}
"""


@pytest.fixture
def tiny(tmp_path: Path) -> Path:
    path = tmp_path / "tiny.yaml"
    path.write_text(TINY)
    return path


@pytest.mark.slow
def test_scenario_to_data_set_to_score(sfr: Sfr, tmp_path: Path, tiny: Path) -> None:
    pytest.importorskip("embreex")
    out = tmp_path / "data"
    made = sfr("simulate", tiny, out, "--workers", "1", "--seed", "8", "--set", "drive.pairs=2")
    assert (made.code, made.out) == (0, "")
    assert made.err == f"3 pairs: {out}\n"
    settings = yaml.safe_load((out / "simulation.yaml").read_text())
    assert (settings["seed"], settings["drive.pairs"], settings["loc.width"]) == (8, 2, 48)
    source = open_source(out)
    assert source.loc is not None
    assert source.nav is not None
    assert (len(source.loc), len(source.nav)) == (2, 1)
    truth = tmp_path / "truth.csv"
    assert sfr("convert", out, truth).code == 0
    assert sfr("score", truth, out, "--condition", "frames=1", "--spacing", "1").code == 0


def test_faults_are_written_what_it_says(sfr: Sfr, tmp_path: Path) -> None:
    source = good_folder(tmp_path / "source")
    bad, again = tmp_path / "bad", tmp_path / "again.mcap"
    fault = ("--fault", "noisy:amount=30,share=1,start=0", "--seed", "4")
    done = sfr("simulate", bad, "--from", source, *fault)
    assert (done.code, done.out, done.err.strip()) == (0, "", f"5 of 5 pairs: {bad}")
    assert sfr("simulate", again, "--from", source, *fault).code == 0
    sources = [open_source(path).loc for path in (source, bad, again)]
    assert all(part is not None for part in sources)
    for clean, noisy, same in zip(*(part.pairs() for part in sources if part is not None), strict=True):
        assert clean.stamp_ns == noisy.stamp_ns == same.stamp_ns
        assert 15 < (noisy.left.astype(float) - clean.left).std() < 35
        assert np.array_equal(noisy.right, same.right)
