"""The ground truth of mapping pairs, by which a cloud is scored."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform


@dataclass(frozen=True, slots=True, eq=False)
class PairTruth:
    """The truth of one pair: points `(H, W, 3)` float32 in LM, metres, NaN if absent, and the left optical frame."""

    points: NDArray[np.float32]
    T_lm_left: Transform
    rig: StereoRig

    def __post_init__(self) -> None:
        """Check that the truth has the image size of the rig; MetricsError if not."""
        if self.points.shape != (self.rig.height, self.rig.width, 3):
            needed = (self.rig.height, self.rig.width, 3)
            raise MetricsError(f"truth of a mapping pair has the shape {self.points.shape}: {needed} is required")

    @classmethod
    def of(cls, pair: PosedStereoPair, rig: StereoRig) -> PairTruth | None:
        """Return the truth of a pair, None if the source has none."""
        return None if pair.truth is None else cls(pair.truth, pair.T_lm_navsb @ rig.T_sb_left, rig)

    def ranges_m(self) -> FloatArray:
        """Return the distance `(H, W)` of each true point from the left optical centre; NaN without a true point."""
        offset = self.points - self.T_lm_left.translation
        return np.asarray(np.sqrt(np.einsum("ijk,ijk->ij", offset, offset)))

    def depths_m(self, points: NDArray[np.floating]) -> FloatArray:
        """Return the depth `(...)` along the left optical axis of points `(..., 3)` in LM."""
        return np.asarray((points - self.T_lm_left.translation) @ self.T_lm_left.rotation[:, 2])


def truths_of(pairs: Sequence[PosedStereoPair], rig: StereoRig) -> list[PairTruth]:
    """Return the truth of every pair; MetricsError if a pair has none."""
    truths = [PairTruth.of(pair, rig) for pair in pairs]
    without = [str(pair.pair.stamp_ns) for pair, truth in zip(pairs, truths, strict=True) if truth is None]
    if without:
        stamps = ", ".join(without)
        raise MetricsError(
            f"a map score requires the truth of every pair, but the pairs of stamps {stamps} ns have none: give a "
            "source with truth"
        )
    return [truth for truth in truths if truth is not None]


def check_points(xyz: NDArray[np.floating], truths: Sequence[PairTruth]) -> None:
    """Check that the points `(P, 3)` of a cloud are finite and that there is a truth; MetricsError if not."""
    if not truths:
        raise MetricsError("a map score requires the truth of at least one pair: give a source with truth")
    if not np.isfinite(xyz).all():
        raise MetricsError("the cloud has points that are not finite: remove them")
