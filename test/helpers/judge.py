"""A drive of 60 m over hills, an estimate with step errors of 0.3 mm, and `sfr score` on their files."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from helpers.cli_result import Result, Sfr
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory

POSES = 401
PERIOD_NS = 100_000_000
STEP_M = 0.15
LONG = 101  #: Images of the source `images`, 15 m.
SKY_ROWS = 30  #: Uppermost rows of the mapping pairs of the source `source` that see no surface.
FEW_INDEPENDENT = "minimum_independent: 2\n"
#: Limits file with a limit over 5 m; the test appends the number.
OVER_5_M = "trajectory:\n- condition: distance=5\n  position_mean_plus_3sigma_m: "


class Judge:
    """Writes the drive and an estimate to a folder, and scores them with `sfr score`."""

    def __init__(self, sfr: Sfr, folder: Path) -> None:
        self.sfr, self.folder = sfr, folder
        place = np.arange(POSES)  # a bend over hills, because height, roll and pitch of a plane are not judged
        heading = Rotation.from_euler("ZY", np.column_stack((0.4 * np.sin(0.02 * place), 0.05 * np.sin(0.05 * place))))
        self.steps = heading.apply(np.tile([STEP_M, 0.0, 0.0], (POSES, 1)))
        self.heading = heading
        stamps = 100 * 10**9 + PERIOD_NS * np.arange(POSES, dtype=np.int64)
        self.truth = Trajectory(stamps, np.cumsum(self.steps, axis=0), heading.as_quat())
        noise = np.cumsum(np.random.default_rng(1).normal(0.0, 0.0003, (POSES, 3)), axis=0)
        self.estimate = replace(self.truth, positions=self.truth.positions + noise)

    def limits(self, text: str) -> Path:
        path = self.folder / "limits.yaml"
        path.write_text(text)
        return path

    def poses(self, name: str, trajectory: Trajectory) -> Path:
        save_trajectory(self.folder / name, trajectory)
        return self.folder / name

    def calls(self, stamps: Any, name: str = "calls.csv", peak: Any = "", state: str = "tracking") -> Path:
        rows = [f"{stamp},0.1,{state},{peak}" for stamp in stamps]
        (self.folder / name).write_text("\n".join(["stamp_ns,processing_time_s,state,peak_rss_bytes", *rows, ""]))
        return self.folder / name

    def __call__(
        self, *options: Any, limits: str | None = None, estimate: Trajectory | None = None, truth: Any = None
    ) -> tuple[Result, dict[str, Any]]:
        """Score an estimate; return the result of the command and its JSON."""
        made = self.poses("estimate.csv", self.estimate if estimate is None else estimate)
        true = truth if isinstance(truth, Path) else self.poses("truth.csv", self.truth if truth is None else truth)
        judged = [] if limits is None else ["--limits", self.limits(limits)]
        (report := self.folder / "score.json").unlink(missing_ok=True)
        result = self.sfr("score", made, true, *judged, "--json", report, *options)
        return result, json.loads(report.read_text()) if report.is_file() else {}
