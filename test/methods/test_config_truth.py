"""A configuration that contains the ground truth is refused."""

from __future__ import annotations

from pathlib import Path

from helpers import HELPERS
from helpers.cli_result import Sfr


def test_the_ground_truth_is_no_configuration(drive: Path, tmp_path: Path, sfr: Sfr) -> None:
    """Also in the formats of other tools; a few numbers that agree with it are an honest setting."""
    (tmp_path / "candidate.py").write_text((HELPERS / "misbehaving_class.py").read_text())
    method = ("--method", f"{tmp_path / 'candidate.py'}:Misbehaving")
    for name in ("t.csv", "t.tum", "t.kitti"):
        assert sfr("convert", drive, tmp_path / name).code == 0
        words = ("localise", drive, "-o", tmp_path / "e.csv", *method, "--config", tmp_path / name)
        refused = sfr(*words)
        assert (refused.code, "12 of 12 positions of the ground truth" in refused.err) == (2, True), refused.err
    waypoints = (tmp_path / "t.csv").read_text().splitlines()[3:7]
    (tmp_path / "config.txt").write_text("\n".join(["stand", *waypoints]))
    ran = sfr("localise", drive, "-o", tmp_path / "e.csv", *method, "--config", tmp_path / "config.txt")
    assert ran.code == 0, ran.err
