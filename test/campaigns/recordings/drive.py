"""A short drive of the sample at half resolution, from which all recordings are made: images, rig, true poses."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import cv2

from sfr_loc_map.geometry.arrays import FloatArray, GreyImage
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform, interpolated
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.sequence import panorama_of

SAMPLE = Path(__file__).parents[3] / "sample" / "sample.mcap"
BEGIN_NS, PERIOD_NS = 1_700_000_000_000_000_000, 100_000_000
"""Pairs have a rate of 10 Hz, as from a camera; the rover is faster than in the sample accordingly."""
PAIRS = 36  # 4.3 m: three starts of 1 m at the default spacing
ANTENNA_M = (-0.21, 0.13, 0.84)
"""Position of the prism, antenna or markers in RB."""
MARKERS_XYZW = (0.0, 0.0, 0.6, 0.8)
"""Orientation of the markers' frame in RB."""


@dataclass(frozen=True)
class Drive:
    """Images, rigs and true poses of a drive."""

    rig: StereoRig
    images: list[tuple[GreyImage, GreyImage]]
    positions: FloatArray
    quats_xyzw: FloatArray
    nav_rig: StereoRig
    nav: list[PosedStereoPair]

    @property
    def stamps_ns(self) -> list[int]:
        return [BEGIN_NS + n * PERIOD_NS for n in range(len(self.images))]

    def truth(self, rate: int = 1) -> Iterator[tuple[int, Transform]]:
        """Yield stamp and T_ds_rb, `rate` per pair, interpolated between the pairs."""
        poses = [*map(Transform.from_quat, self.positions, self.quats_xyzw)]
        for n in range((len(poses) - 1) * rate + 1):
            k, part = divmod(n, rate)
            pose = interpolated(poses[k], poses[k + 1], part / rate) if part else poses[k]
            yield BEGIN_NS + n * PERIOD_NS // rate, pose


def load_drive(pairs: int = PAIRS) -> Drive:
    """Read the first pairs of the sample at half resolution; a pixel is the mean of four, so f and c scale exactly."""
    source = open_source(SAMPLE)
    assert source.loc is not None
    assert source.loc.ground_truth is not None
    images = [(half(pair.left), half(pair.right)) for pair in islice(source.loc.pairs(), pairs)]
    truth = source.loc.ground_truth
    nav = panorama_of(source)
    return Drive(
        halved(source.loc.rig), images, truth.positions[:pairs], truth.quats_xyzw[:pairs], nav.rig, list(nav.pairs())
    )


def half(image: GreyImage) -> GreyImage:
    return cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)


def halved(rig: StereoRig) -> StereoRig:
    centre = (0.5 * rig.cx - 0.25, 0.5 * rig.cy - 0.25)
    return StereoRig(rig.width // 2, rig.height // 2, 0.5 * rig.fx, 0.5 * rig.fy, *centre, rig.baseline_m, rig.T_rb_sb)
