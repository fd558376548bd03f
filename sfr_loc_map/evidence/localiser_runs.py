"""Runs of the localiser over one recording that should agree: other direction, other pairs, other landmarks."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path

import cv2
import numpy as np

from sfr_loc_map.calls.call_poses import estimates_of
from sfr_loc_map.calls.growing_calls import stats_of
from sfr_loc_map.geometry.arrays import GreyImage, IntArray
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.trajectory import Truth
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import StartPose, TrackingStatistics
from sfr_loc_map.localisation.frontend.masks import read_mask
from sfr_loc_map.metrics.frames.association import Estimates
from sfr_loc_map.runs.localiser_run import localise, trajectory_of

Progress = Callable[[], None]


class RunVariant(StrEnum):
    """Variants of a run of the localiser over all pairs of a check."""

    FORWARD = "forward"  #: All pairs in recorded order.
    BACKWARD = "backward"  #: The pairs in reverse order.
    EVERY_SECOND = "every second pair"
    LEFT_HALF = "left half"  #: Only landmarks in the left half of the left image.
    RIGHT_HALF = "right half"


DIRECT = "direct"  #: Name of a run between two visits of a place, without the path between them.
CORRECTED = "corrected"  #: Name of the run with the corrected calibration.
COMPARED = (
    (RunVariant.FORWARD, RunVariant.BACKWARD),
    (RunVariant.FORWARD, RunVariant.EVERY_SECOND),
    (RunVariant.LEFT_HALF, RunVariant.RIGHT_HALF),
)
"""Runs that are compared over sub-trajectories."""
CALIBRATED = (RunVariant.FORWARD, RunVariant.BACKWARD, RunVariant.LEFT_HALF, RunVariant.RIGHT_HALF)
"""Runs that estimate the rotation of the right camera, each from all pairs."""


def name_of_comparison(first: str, other: str) -> str:
    """Return the name of the comparison of two runs in the table of figures."""
    return f"{first} - {other}"


AT_REVISITED_PLACES = name_of_comparison(RunVariant.FORWARD, DIRECT)
"""Name of the comparison of the accumulated motions with those of the direct runs."""
OWN_COMPARISONS = frozenset((*(name_of_comparison(*runs) for runs in COMPARED), AT_REVISITED_PLACES))
"""Names of the comparisons of the localiser's own runs. Other comparisons are those with estimates of other methods."""
NAMES_OF_OWN_RUNS = frozenset((*RunVariant, DIRECT, CORRECTED))
"""Names that an estimate of another method must not have."""


@dataclass(frozen=True, slots=True)
class PairsInMemory:
    """Selected pairs of a drive, with the interface of a drive and without a truth."""

    rig: StereoRig
    kept: Sequence[StereoPair]
    ground_truth: Truth | None = None
    missing_ns: Sequence[int] = ()

    @property
    def stamps_ns(self) -> Sequence[int]:
        """Stamps of the pairs."""
        return [pair.stamp_ns for pair in self.kept]

    def __len__(self) -> int:
        return len(self.kept)

    def pairs(self) -> Iterator[StereoPair]:
        """Yield the pairs."""
        return iter(self.kept)


@dataclass(frozen=True, slots=True, eq=False)
class ComparedRun:
    """Estimates of a run of the localiser, or of another method.

    The localiser requires increasing stamps, so that the estimates of a backward run have mirrored stamps.
    """

    name: str
    estimates: Estimates
    statistics: tuple[TrackingStatistics, ...] = ()  #: Figures of the calls.
    #: Stamps of the pairs of a backward run, which decrease; None for other runs, whose estimates have these stamps.
    backward_stamps_ns: IntArray | None = None

    @property
    def is_backward(self) -> bool:
        """Whether the pairs were processed in reverse order."""
        return self.backward_stamps_ns is not None

    @property
    def pair_stamps_ns(self) -> IntArray:
        """Stamp of the pair of each estimate."""
        return self.estimates.trajectory.stamps_ns if self.backward_stamps_ns is None else self.backward_stamps_ns


def calls_of(pairs: int) -> int:
    """Return the number of calls of all variants over a number of pairs."""
    return pairs * len(RunVariant) - pairs // 2  # one variant skips every second pair


def run_variant(
    drive: PairsInMemory, config: LocalisationConfig, variant: RunVariant, progress: Progress
) -> ComparedRun:
    """Return the estimates of one variant; raise ConfigError if the configured mask cannot be read."""
    kept = list(drive.kept)
    mirror_ns = kept[0].stamp_ns + kept[-1].stamp_ns
    if variant is RunVariant.BACKWARD:
        kept = [replace(pair, stamp_ns=mirror_ns - pair.stamp_ns) for pair in reversed(kept)]
    elif variant is RunVariant.EVERY_SECOND:
        kept = kept[::2]
    with tempfile.TemporaryDirectory() as folder:
        if variant in (RunVariant.LEFT_HALF, RunVariant.RIGHT_HALF):
            mask = Path(folder) / "half.png"
            cv2.imwrite(str(mask), half_mask(drive.rig, variant, config.left_mask))
            config = replace(config, left_mask=str(mask))
        run = run_pairs(drive, config, variant.value, kept, progress)
    if variant is RunVariant.BACKWARD:
        return replace(run, backward_stamps_ns=mirror_ns - run.estimates.trajectory.stamps_ns)
    return run


def run_pairs(
    drive: PairsInMemory,
    config: LocalisationConfig,
    name: str,
    kept: Sequence[StereoPair],
    progress: Progress = lambda: None,
) -> ComparedRun:
    """Return the estimates of selected pairs of a drive."""
    done = []
    for result in localise(replace(drive, kept=kept), config, StartPose(Transform.identity())):
        done.append(result)
        progress()
    trajectory = trajectory_of(estimate for estimate, _ in done)
    estimates = estimates_of(trajectory, stats_of([record for _, record in done]))
    return ComparedRun(name, estimates, tuple(estimate.statistics for estimate, _ in done))


def half_mask(rig: StereoRig, variant: RunVariant, given: str) -> GreyImage:
    """Return the mask of one half of the left image, combined with the configured mask, which has the image size."""
    is_left = np.arange(rig.width) < rig.width // 2
    kept = is_left if variant is RunVariant.LEFT_HALF else ~is_left
    mask = np.tile(np.where(kept, 255, 0).astype(np.uint8), (rig.height, 1))
    return np.minimum(mask, read_mask(given)) if given else mask
