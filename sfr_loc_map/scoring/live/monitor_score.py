"""The score of a run from received messages, without ROS."""

from __future__ import annotations

import logging
from array import array
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sfr_loc_map.calls.call_record import CallRecord
from sfr_loc_map.calls.call_stats import CallStats
from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.io.truth.config import RB_ITSELF, TrackedBodyConfig
from sfr_loc_map.metrics.completeness.expected_items import with_unmapped_pairs
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.figures.results import MapResult
from sfr_loc_map.metrics.map.map_score import score_map
from sfr_loc_map.metrics.score.limits import Limits
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.scoring.conversion import ConventionFinding, convention_mismatch
from sfr_loc_map.scoring.inputs import DriveToScore, ExpectedPairs, Run
from sfr_loc_map.scoring.judgement import with_conditions
from sfr_loc_map.scoring.live.live_maps import LiveMaps, MapInputs, MapToScore
from sfr_loc_map.scoring.live.live_score import ENDED, LiveData, LiveRun, score_so_far
from sfr_loc_map.scoring.live.received_rows import ReceivedRows
from sfr_loc_map.suite_names import Task

_log = logging.getLogger(__name__)

DIAGNOSED_GROWTH = 1.2  #: A diagnosis is repeated once the number of poses has grown by this factor.


class LastDiagnosis(NamedTuple):
    """The last diagnosis of the conventions."""

    poses: int = 0  #: Number of poses at the diagnosis.
    finding: ConventionFinding | None = None


class MonitorScore:
    """Collects poses, truth, clouds and calls, and scores them; `maps` judges each complete map and keeps the worst."""

    def __init__(self, config: ScoreConfig, limits: Limits | None, body: TrackedBodyConfig = RB_ITSELF) -> None:
        """Start a run, judged by limits if there are any. `body` is the tracked body of the true poses."""
        self.map_inputs = MapInputs()
        self._config = with_conditions(config, limits)
        self._limits = limits
        self._body = body
        self.restart()

    def restart(self) -> None:
        """Discard all data except the clouds and the truth of maps in progress."""
        self.map_inputs.begin_run()
        self.rows = ReceivedRows(self._body)
        self.maps = LiveMaps(self._limits, partial=self._config.trajectory.partial)
        self._refused_maps = 0
        self._refusal = ""  # reason why the latest of these maps was refused
        self._diagnosis = LastDiagnosis()
        self._images_ns = array("q")  # stamps of the images before the first estimate, 8 bytes each

    def add_image(self, stamp_ns: int) -> None:
        """Add the stamp of an image of the localisation cameras, for which a pose is expected.

        Images are counted only if the run ends without any estimate. Otherwise they are not used, because a best-effort
        subscription may lose images.
        """
        if not self.rows.has_estimates:
            self._images_ns.append(stamp_ns)

    def add_estimate(
        self, stamp_ns: int, position: Sequence[float], quat_xyzw: Sequence[float], covariance: FloatArray | None
    ) -> None:
        """Add an estimated pose of RB in DS, orientation and covariance `(6, 6)` in ROS order."""
        self.rows.add_estimate(stamp_ns, position, quat_xyzw, covariance)

    def add_truth(
        self, stamp_ns: int, position: Sequence[float], quat_xyzw: Sequence[float], variances: FloatArray | None = None
    ) -> None:
        """Add a true pose of the tracked body in DS, with variances `(6,)`. A zero quaternion means a position only."""
        self.rows.add_truth(stamp_ns, position, quat_xyzw, variances)

    def add_call(self, record: CallRecord) -> None:
        """Add a call, before or after its pose. The call of a fusion names the pairs of its cloud."""
        self.rows.add_call(record)
        self.map_inputs.add_call(record)

    def score_maps(self) -> bool:
        """Score the clouds whose inputs are complete, after an input was added. Return whether any were complete.

        The pairs of a cloud that cannot be scored have no map, which a warning and a caveat report.
        """
        was_taken = False
        for made in self.map_inputs.take_complete():
            was_taken = True
            try:
                self.maps.add(self._map_result(made))
            except MetricsError as error:
                self.map_inputs.refuse(made)
                self._refused_maps += 1
                self._refusal = f"the map of stamp {made.stamp_ns} ns cannot be scored: {error}"
                _log.warning(self._refusal)
        return was_taken

    def _map_result(self, made: MapToScore) -> MapResult:
        """Return the score of the finite points of a map; MetricsError if the cloud is not of these pairs."""
        finite = np.asarray(np.isfinite(made.cloud.xyz).all(axis=1))
        return score_map(
            made.cloud.select(finite),
            made.truths,
            self._config.map,
            expected_pairs=made.expected_pairs,
            not_finite=int(np.count_nonzero(~finite)),
        )

    def result(self, live: LiveRun = ENDED) -> Score:
        """Return the current score with the errors of its sub-trajectories; by default, also the data of all plots.

        The score contains the maps that `score_maps` has scored.
        During a run, results of the last seconds (`LiveRun.in_flight_s`) do not count as missing, and the first pose
        and the next map are awaited. After the run, images without poses and the pairs after the last map are missing.
        """
        is_under_way = live.is_under_way
        stats = self.rows.calls.stats(stated_tasks=tuple(Task))
        drive = self._drive(stats, is_under_way=is_under_way)
        unmapped = self.map_inputs.refused_pairs if is_under_way else self.map_inputs.unmapped_pairs
        surface = self.maps.result
        if surface is not None and unmapped:
            surface = replace(surface, figures=with_unmapped_pairs(surface.figures, unmapped))
        run = Run(
            stats=[] if stats is None else [stats],
            drive=drive,
            expected=ExpectedPairs(
                unposed_images=0 if is_under_way or self.rows.has_estimates else len(set(self._images_ns)),
                nav_stamps_ns=np.array(sorted(self.map_inputs.pair_stamps_ns), np.int64),
                unmapped=unmapped if surface is None else 0,
            ),
        )
        finding = self._convention_finding(drive)
        received = LiveData(run=run, messages=self.rows.messages, map=surface, convention_finding=finding)
        score = score_so_far(received, live, self._config, self._limits)
        if not self._refused_maps:
            return score
        return score.with_caveat(
            f"pairs of maps that cannot be scored count as pairs without a map; number of these maps: "
            f"{self._refused_maps}, the latest reason: {self._refusal}"
        )

    def _convention_finding(self, drive: DriveToScore | None) -> ConventionFinding | None:
        """Return the convention mismatch of estimate and truth that the last diagnosis has found.

        A diagnosis takes 0.1 s or more. It is repeated when the number of poses has grown by `DIAGNOSED_GROWTH`.
        """
        poses, last = self.rows.poses, self._diagnosis
        if not last.poses <= poses < DIAGNOSED_GROWTH * last.poses:
            self._diagnosis = LastDiagnosis(poses)  # not repeated for these poses if the diagnosis fails
            finding = None if drive is None else convention_mismatch(drive, self._config)
            self._diagnosis = LastDiagnosis(poses, finding)
        return self._diagnosis.finding

    def _drive(self, stats: CallStats | None, *, is_under_way: bool = False) -> DriveToScore | None:
        """Return the received drive with the states and covariances of its calls; None without estimate or truth."""
        truth = self.rows.truth()
        estimates = self.rows.estimates(stats, is_under_way=is_under_way)
        if truth is None or estimates is None:
            return None
        return DriveToScore(estimates, truth)
