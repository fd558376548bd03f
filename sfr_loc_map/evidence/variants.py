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


class Variant(StrEnum):
    """Variants of a run of the localiser."""

    FORWARD = "forward"  #: All pairs in recorded order.
    BACKWARD = "backward"  #: The pairs in reverse order.
    EVERY_SECOND = "every second pair"
    LEFT_HALF = "left half"  #: Only landmarks in the left half of the left image.
    RIGHT_HALF = "right half"


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
    """Estimates of a run of the localiser. The stamps of a backward run are mirrored so that they increase."""

    name: str
    estimates: Estimates
    statistics: tuple[TrackingStatistics, ...] = ()  #: Figures of the calls.
    is_backward: bool = False  #: Whether the pairs were processed in reverse order.
    mirror_ns: int = 0  #: Stamp of a pair plus stamp of its estimate in a backward run; equal for all pairs.

    def own_stamps(self, stamps_ns: IntArray) -> IntArray:
        """Return the stamps of the estimates at the stamps of pairs."""
        return self.mirror_ns - stamps_ns if self.is_backward else stamps_ns


def calls_of(pairs: int) -> int:
    """Return the number of calls of all variants over a number of pairs."""
    return pairs * len(Variant) - pairs // 2  # one variant skips every second pair


def run_variant(drive: PairsInMemory, config: LocalisationConfig, variant: Variant, progress: Progress) -> ComparedRun:
    """Return the estimates of one variant; raise ConfigError if the configured mask cannot be read."""
    kept = list(drive.kept)
    is_backward = variant is Variant.BACKWARD
    mirror_ns = kept[0].stamp_ns + kept[-1].stamp_ns
    if is_backward:
        kept = [replace(pair, stamp_ns=mirror_ns - pair.stamp_ns) for pair in reversed(kept)]
    elif variant is Variant.EVERY_SECOND:
        kept = kept[::2]
    with tempfile.TemporaryDirectory() as folder:
        if variant in (Variant.LEFT_HALF, Variant.RIGHT_HALF):
            mask = Path(folder) / "half.png"
            cv2.imwrite(str(mask), half_mask(drive.rig, variant, config.left_mask))
            config = replace(config, left_mask=str(mask))
        run = run_pairs(drive, config, variant.value, kept, progress)
    return replace(run, is_backward=is_backward, mirror_ns=mirror_ns)


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


def half_mask(rig: StereoRig, variant: Variant, given: str) -> GreyImage:
    """Return the mask of one half of the left image, combined with the configured mask, which has the image size."""
    is_left = np.arange(rig.width) < rig.width // 2
    kept = is_left if variant is Variant.LEFT_HALF else ~is_left
    mask = np.tile(np.where(kept, 255, 0).astype(np.uint8), (rig.height, 1))
    return np.minimum(mask, read_mask(given)) if given else mask
