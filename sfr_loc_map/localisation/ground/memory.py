"""Memory of the ground between two pairs: its identification, faults of earlier images, and images to compare with.

The memory is one immutable value (`GroundMemory`), whose methods are its only changes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatImage, Mask, read_only
from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.findings import Verdict
from sfr_loc_map.localisation.frontend.stereo_frame import StereoFrame
from sfr_loc_map.localisation.ground.cell_change import LEVEL
from sfr_loc_map.localisation.ground.excluded_cells import ExcludedCells
from sfr_loc_map.localisation.ground.identification import Consistency, Identification, ImageFaults, Phase
from sfr_loc_map.localisation.ground.thresholds import (
    AFTER_TRANSFER,
    FALLING_GAIN,
    MAX_DYNAMIC,
    MIN_EXCESS,
    NEARLY_HALF,
    RISING_GAIN,
    TYPICAL_FACTOR,
)


class Support(NamedTuple):
    """How much of a pair supports the main motion, from which the memory may learn."""

    moves_image: bool  #: Whether this motion moves the image.
    unexplained_fraction: float  #: Fraction of the landmarks that do not follow this motion.
    unexplained_cells: Mask  #: `(R, C)` cells of these landmarks.
    inlier_cells: Mask  #: `(R, C)` cells of the landmarks that follow this motion.


class EarlierImage(NamedTuple):
    """Earlier image that the next image is compared with, cell by cell."""

    image: FloatImage  #: Pyramid level `LEVEL` of a left image.
    pose: Pose  #: Pose of the left camera at that image.
    #: Number of pairs from the image to the next pair. A refused pair counts only if the memory learns from it. The
    #: greater the age, the farther an outlier may move before it is ignored (`thresholds.FAR_RATIO`).
    age: int = 1

    def older(self) -> EarlierImage:
        """Return the same image with its age increased by one pair."""
        return self._replace(age=self.age + 1)


NO_IMAGE = EarlierImage(read_only(np.zeros((0, 0), np.float32)), Pose.of(Transform.identity()))
"""Earlier image before the first window. No pair is compared with it."""


@dataclass(frozen=True, slots=True, eq=False)
class GroundMemory:
    """Memory of accepted pairs, of pairs that contradict their pose, and of stale rows.

    The table shows how each event changes each component. Other components stay as they are.

    | component | `selected` | `unselected` | `window_begun` | `adjusted` | `lost` | `rows_stale` | `window_failed` |
    |---|---|---|---|---|---|---|---|
    | `excluded` | = cells after the pair | | | | | | one pair older |
    | `earlier` | one pair older | one pair older | = first image | pose | | | |
    | `last_image` | = image of the pair | = None | = None | | | | |
    | `identification` | by the case | | learnt again | | learnt again | | |
    | `faults` | by the case | | = none | | | by the rows | |
    | `typical` | by the case | | = None | | | | |

    | event | is |
    |---|---|
    | `selected` | a pair in which the ground's motion was selected, by its case (`cases.CASE_RULES`) |
    | `unselected` | a pair with a frozen left image or with stale rows, in which no motion was selected |
    | `window_begun` | a pair begins a window |
    | `adjusted` | the adjustment of a keyframe in the background has ended |
    | `lost` | a pair is lost |
    | `rows_stale` | stale rows are detected in a pair, before its other changes |
    | `window_failed` | a textured pair has too few landmarks for a window |

    The changes by `selected` and `unselected` depend on the verdict on the pair, too (`NextMemory`). They are discarded
    after a refused pair, unless they outlast a refusal (`cases.Rule`). The earlier image may be replaced only by a pair
    that can be a reference.
    """

    excluded: ExcludedCells  #: Cells that do not move with the ground.
    earlier: EarlierImage = NO_IMAGE  #: Image at an accepted pose, for the detection of changed cells.
    #: Left image at the last accepted pose, pyramid level `MIXTURE_LEVEL`, for the detection of double exposures; None
    #: if the ground's motion was not selected in that pair.
    last_image: FloatImage | None = None
    identification: Identification = Identification()  #: Which motion is the ground's.
    faults: ImageFaults = ImageFaults()  #: Faults of earlier images.
    #: Typical fraction of unexplained landmarks; None until one motion has explained a pair of the window.
    typical: float | None = None

    @classmethod
    def none(cls, shape: tuple[int, int]) -> GroundMemory:
        """Return the memory before the first pair of images of a shape (height, width)."""
        return cls(ExcludedCells.none(shape))

    # ---- what the memory shows

    @property
    def is_identified(self) -> bool:
        """Whether earlier pairs have identified the ground's motion."""
        return self.identification.phase is Phase.IDENTIFIED

    @property
    def is_clear(self) -> bool:
        """Whether earlier pairs no longer have an effect: the images have no fault, and the ground is not uncertain."""
        return self.faults == ImageFaults() and self.identification.phase is not Phase.UNCERTAIN

    def is_usual(self, unexplained: float) -> bool:
        """Return whether a fraction of unexplained landmarks is usual for the ground.

            unexplained < min(MIN_EXCESS + TYPICAL_FACTOR typical, NEARLY_HALF)

        After a partial transfer, `MIN_EXCESS` is multiplied by `AFTER_TRANSFER`.
        """
        margin = AFTER_TRANSFER * MIN_EXCESS if self.faults.transfers else MIN_EXCESS
        return unexplained < min(margin + TYPICAL_FACTOR * (self.typical or 0.0), NEARLY_HALF)

    def consistency_of(self, support: Support) -> Consistency:
        """Return whether a pair is consistent with the earlier pairs, if the main motion is the only motion.

        A pair with motion is consistent if few cells are excluded as dynamic, and if inliers cover the cells that were
        unexplained earlier. An unusual pair that is not consistent prolongs an uncertainty.
        """
        if not support.moves_image:
            return Consistency.UNKNOWN
        is_covered = self.identification.is_covered_by(support.inlier_cells)
        if self.excluded.dynamic_fraction < MAX_DYNAMIC and is_covered:
            return Consistency.CONSISTENT
        is_uncertain = self.identification.phase is Phase.UNCERTAIN
        if is_uncertain and not self.is_usual(support.unexplained_fraction):
            return Consistency.INCONSISTENT
        return Consistency.PARTIAL

    # ---- events

    def selected(
        self,
        *,
        identification: Identification,
        faults: ImageFaults,
        typical: float | None,
        excluded: ExcludedCells,
        image: FloatImage,
    ) -> GroundMemory:
        """Return the memory after a pair whose pose was estimated from a selected motion.

        Args:
            identification: Which motion is the ground's, after the pair.
            faults: Faults of the images, after the pair.
            typical: Typical fraction of unexplained landmarks, after the pair.
            excluded: Cells excluded from this pair on, also in a keyframe that the pair becomes.
            image: Pyramid level `MIXTURE_LEVEL` of the pair's left image.
        """
        return GroundMemory(excluded, self.earlier.older(), image, identification, faults, typical)

    def typical_after(self, unexplained: float) -> float | None:
        """Return the typical fraction of unexplained landmarks after a pair with one motion.

        The fraction changes only while the ground is not uncertain. Once there is a typical fraction, an unusual pair
        is not learnt (`Case.UNUSUAL`).
        """
        if self.identification.phase is Phase.UNCERTAIN:
            return self.typical
        typical = unexplained if self.typical is None else self.typical
        gain = RISING_GAIN if unexplained > typical else FALLING_GAIN
        return typical + gain * (unexplained - typical)

    def unselected(self) -> GroundMemory:
        """Return the memory after a pair in which no motion was selected.

        An uncertainty persists, and the recovery from earlier faults makes no progress. Excluded cells do not age,
        because stationary cells, which renew the lifetime of cells fixed to the camera, are not detected in such a
        pair.
        """
        return replace(self, earlier=self.earlier.older(), last_image=None)

    def window_begun(self, frame: StereoFrame, pose: Pose) -> GroundMemory:
        """Return the memory in a new window. The ground must be learnt again, and an uncertainty persists."""
        return replace(
            self,
            earlier=EarlierImage(frame.left[LEVEL].image, pose),
            last_image=None,
            identification=self.identification.relearning(),
            faults=ImageFaults(),
            typical=None,
        )

    def adjusted(self, T_after_before: Transform) -> GroundMemory:
        """Return the memory after an adjustment moved the last pose in the world.

        The earlier image moves with it, so that the image motion between the two remains.
        """
        pose = Pose.of(T_after_before @ Transform(*self.earlier.pose))
        return replace(self, earlier=self.earlier._replace(pose=pose))

    def lost(self) -> GroundMemory:
        """Return the memory after a lost pair. The tracks of the next pairs may follow another motion."""
        return replace(self, identification=self.identification.relearning())

    def window_failed(self, shape: tuple[int, int]) -> GroundMemory:
        """Return the memory after a textured pair with too few landmarks for a new window.

        The excluded cells may be the cause, so that they age. The shape of the images is (height, width).
        """
        return replace(self, excluded=self.excluded.older(shape))

    def rows_stale(self, stale: Mask) -> GroundMemory:
        """Return the memory after a pair was compared with the previous pair. Its stale rows are `(H,)`."""
        if not stale.any():
            return self
        return replace(self, faults=self.faults.after_stale_rows(stale))


class NextMemory(NamedTuple):
    """The memory after a pair, which depends on the verdict on the pair."""

    if_reference: GroundMemory  #: The pair is accepted, and later pairs may be compared with it.
    if_accepted: GroundMemory  #: The pair is accepted, but later pairs may not be compared with it.
    if_refused: GroundMemory

    @classmethod
    def of_selected(
        cls, before: GroundMemory, learnt: GroundMemory, next_earlier: EarlierImage, *, outlasts_refusal: bool
    ) -> NextMemory:
        """Return the memory after a pair in which a motion was selected.

        Args:
            before: Memory before the pair.
            learnt: Memory with what the pair shows.
            next_earlier: Earlier image of the next pairs if they may be compared with this pair.
            outlasts_refusal: Whether the memory learns from the pair although its pose is refused. The last image is
                then still that at the last accepted pose.
        """
        refused = replace(learnt, last_image=before.last_image) if outlasts_refusal else before
        return cls(replace(learnt, earlier=next_earlier), learnt, refused)

    @classmethod
    def of_unselected(cls, before: GroundMemory) -> NextMemory:
        """Return the memory after a pair in which no motion was selected."""
        learnt = before.unselected()
        return cls(learnt, learnt, before)

    def for_verdict(self, verdict: Verdict) -> GroundMemory:
        """Return the memory after the verdict."""
        if verdict.refuses:
            return self.if_refused
        return self.if_reference if verdict.can_be_reference else self.if_accepted
