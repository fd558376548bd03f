"""The ground truth of a set of mapping pairs: what each left pixel sees [4.3.4]."""

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
    """The truth of one pair.

    Attributes:
        points: `(H, W, 3)` float32, metres, LM; NaN where none.
        T_lm_left: Takes points in the left optical frame to LM.
        rig: Rig of the images.
    """

    points: NDArray[np.float32]
    T_lm_left: Transform
    rig: StereoRig

    def __post_init__(self) -> None:
        """Check the size.

        Raises:
            MetricsError: If the truth is not of the rig's size.
        """
        if self.points.shape != (self.rig.height, self.rig.width, 3):
            raise MetricsError(
                f"truth of a mapping pair is {self.points.shape}: ({self.rig.height}, {self.rig.width}, 3) is needed"
            )

    @classmethod
    def of(cls, pair: PosedStereoPair, rig: StereoRig) -> PairTruth | None:
        """Return the truth of a pair, None if the source has none."""
        if pair.truth is None:
            return None
        return cls(pair.truth, pair.T_lm_navsb @ rig.T_sb_left, rig)

    def ranges_m(self) -> FloatArray:
        """Return the distance `(H, W)` of each true point from the left optical centre; NaN where none."""
        offset = self.points - self.T_lm_left.translation
        return np.asarray(np.sqrt(np.einsum("ijk,ijk->ij", offset, offset)))

    def depths_m(self, points: NDArray[np.floating]) -> FloatArray:
        """Return the depth `(...)` along the left optical axis of points `(..., 3)` in LM."""
        return np.asarray((points - self.T_lm_left.translation) @ self.T_lm_left.rotation[:, 2])


def truths_of(pairs: Sequence[PosedStereoPair], rig: StereoRig) -> list[PairTruth]:
    """Return the truth of every pair of a set.

    Raises:
        MetricsError: If a pair has none.
    """
    truths = [PairTruth.of(pair, rig) for pair in pairs]
    without = [str(pair.pair.stamp_ns) for pair, truth in zip(pairs, truths, strict=True) if truth is None]
    if without or not truths:
        raise MetricsError(
            f"a map score needs the truth of every pair: none for {', '.join(without) or 'any (no pair at all)'}; "
            "give a source with truth"
        )
    return [truth for truth in truths if truth is not None]
