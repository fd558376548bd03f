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
from sfr_loc_map.localisation.findings import Finding, Verdict
from sfr_loc_map.localisation.frontend.stereo_frame import StereoFrame
from sfr_loc_map.localisation.ground.cell_change import LEVEL
from sfr_loc_map.localisation.ground.excluded_cells import ExcludedCells
from sfr_loc_map.localisation.ground.identification import Fault, Identification, ImageFaults, Phase, Sign

# The values of this package that were chosen by hand were chosen on rendered drives with injected faults, so that clean
# drives have no findings, and no error of a faulty drive exceeds five times the stated 3 sigma without a finding.

MIN_EXCESS = 0.12
"""Minimum excess of the fraction of unexplained landmarks over the typical fraction for an unusual motion. Chosen by
hand. If larger, small objects and stale parts bias the pose without a report. If smaller, clean pairs with many
outliers are degraded."""
AFTER_TRANSFER = 0.5  #: Factor on `MIN_EXCESS` after a partial transfer: the next pair may be affected, too.
MAX_DYNAMIC = MIN_EXCESS
"""A pair with at least this fraction of cells excluded as dynamic does not confirm the ground's motion. The fraction is
`MIN_EXCESS`, because landmarks of these cells would be unexplained. If larger, doubt ends while a large object is
in view. If smaller, doubt lasts while a small object is in view."""
NEARLY_HALF = 0.47
"""Fraction of unexplained landmarks from which a motion is always unusual. Chosen by hand, slightly below the half from
which the majority does not follow the motion. If smaller, pairs with large objects are ambiguous more often."""
TYPICAL_FACTOR = 1.25
"""Factor on the typical fraction of unexplained landmarks, because the scatter of the fraction grows with its value.
Chosen by hand. If larger, fewer faults are reported on drives with many outliers. If smaller, clean pairs of such
drives are degraded."""
RISING_GAIN = 0.1
"""Update gain of the typical fraction if the fraction of a pair is larger, but usual. An unusual fraction is learnt
only if there is no typical fraction yet. Chosen by hand. If the gain is larger, a fault that grows slowly becomes
typical before it is reported. If it is smaller, ground that becomes rougher is reported more often."""
FALLING_GAIN = 0.5
"""Update gain of the typical fraction if the fraction of a pair is smaller. Chosen by hand, so that a fault at the
start has no effect after a few pairs. If the gain is larger, one clean pair makes the next pairs unusual. If the gain
is smaller, later faults are hidden for longer."""


class Support(NamedTuple):
    """How much of a pair supports the main motion, from which the memory may learn."""

    moves_image: bool  #: Whether this motion moves the image.
    unexplained_fraction: float  #: Fraction of the landmarks that do not follow this motion.
    unexplained_cells: Mask  #: `(R, C)` cells of these landmarks.
    inlier_cells: Mask  #: `(R, C)` cells of the landmarks that follow this motion.


class Effect(NamedTuple):
    """The finding of a case, and its effect on the memory of the ground."""

    identification: Identification  #: Which motion is the ground's, after the pair.
    finding: Finding | None = None
    fault: Fault = Fault.NONE  #: What the case shows about faults of the images.
    is_typical: bool = False  #: Whether the typical fraction of unexplained landmarks is learnt from the pair.
    outlasts_refusal: bool = False  #: Whether the memory learns from the pair although its pose is refused.


class EarlierImage(NamedTuple):
    """Earlier image that the next image is compared with, cell by cell."""

    image: FloatImage  #: Pyramid level `LEVEL` of a left image.
    pose: Pose  #: Pose of the left camera at that image.
    #: Number of pairs from the image to the next pair. A refused pair from which the memory does not learn is not
    #: counted. The image motion from which outliers are ignored is proportional to the age (`selection.FAR_RATIO`).
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

    | component | `after` | `after_unselected` | `in_new_window` | `moved` | `after_lost_pair` | `after_stale_rows` |
    |---|---|---|---|---|---|---|
    | `excluded` | = cells after the pair | | | | | |
    | `earlier` | one pair older, or a newer image | one pair older | = first image | pose | | |
    | `last_image` | = image of the pair | = None | = None | | | |
    | `identification` | by the case | | restarted | | restarted | |
    | `faults` | by the fault | | = none | | | by the rows |
    | `typical` | updated if there is one motion | | = None | | | |

    | event | is |
    |---|---|
    | `after` | a pair in which the ground's motion was selected |
    | `after_unselected` | a pair with a frozen left image or with stale rows, in which no motion was selected |
    | `in_new_window` | a pair that begins a window |
    | `moved` | the end of the adjustment of a keyframe in the background |
    | `after_lost_pair` | a lost pair |
    | `after_stale_rows` | the detection of stale rows in a pair, before its other changes |

    In addition, `excluded` is one pair older after a textured pair with too few landmarks for a new window
    (`after_failed_window`). After a refused pair, the changes of `after` and `after_unselected` are discarded
    (`NextMemory`).
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
        """Whether earlier pairs no longer have an effect: the images have no fault, and the ground is not in doubt."""
        return self.faults == ImageFaults() and self.identification.phase is not Phase.IN_DOUBT

    def is_usual(self, unexplained: float) -> bool:
        """Return whether a fraction of unexplained landmarks is usual for the ground."""
        margin = AFTER_TRANSFER * MIN_EXCESS if self.faults.transfers else MIN_EXCESS
        return unexplained < min(margin + TYPICAL_FACTOR * (self.typical or 0.0), NEARLY_HALF)

    def sign_of_one_motion(self, support: Support) -> Sign:
        """Return what a pair shows about the ground if the main motion is the only one.

        A stationary image shows nothing. A moving pair agrees if few cells are excluded as dynamic, and if inliers
        cover the cells that were unexplained earlier. An unusual pair that does not agree prolongs a doubt.
        """
        if not support.moves_image:
            return Sign.NOTHING
        is_covered = self.identification.is_covered_by(support.inlier_cells)
        if self.excluded.dynamic_fraction < MAX_DYNAMIC and is_covered:
            return Sign.AGREES
        is_in_doubt = self.identification.phase is Phase.IN_DOUBT
        if is_in_doubt and not self.is_usual(support.unexplained_fraction):
            return Sign.DOUBTS
        return Sign.AGREES_PARTLY

    # ---- changes

    def after(
        self, effect: Effect, support: Support, *, is_moving: bool, excluded: ExcludedCells, image: FloatImage
    ) -> GroundMemory:
        """Return the memory after a pair whose pose was estimated from a selected motion.

        Args:
            effect: Effect of the pair's case.
            support: What the pair shows about the main motion.
            is_moving: Whether the pose of the selected motion is trusted and the image moved.
            excluded: Cells excluded from this pair on, also in a keyframe that the pair becomes.
            image: Pyramid level `MIXTURE_LEVEL` of the pair's left image.
        """
        return GroundMemory(
            excluded=excluded,
            earlier=self.earlier.older(),
            last_image=image,
            identification=effect.identification,
            faults=self.faults.after(effect.fault, is_moving=is_moving),
            typical=self._with_typical(support.unexplained_fraction) if effect.is_typical else self.typical,
        )

    def _with_typical(self, unexplained: float) -> float | None:
        """Return the typical fraction of unexplained landmarks after a pair with one motion.

        The fraction changes only while the ground is not in doubt. Once there is a typical fraction, an unusual pair
        is not learnt (`MainCase.UNEXPLAINED`).
        """
        if self.identification.phase is Phase.IN_DOUBT:
            return self.typical
        typical = unexplained if self.typical is None else self.typical
        gain = RISING_GAIN if unexplained > typical else FALLING_GAIN
        return typical + gain * (unexplained - typical)

    def after_unselected(self) -> GroundMemory:
        """Return the memory after a pair in which no motion was selected.

        A doubt persists, and the recovery from earlier faults makes no progress. Excluded cells do not age, because
        stationary cells, which renew the lifetime of cells fixed to the camera, are not detected in such a pair.
        """
        return replace(self, earlier=self.earlier.older(), last_image=None)

    def in_new_window(self, frame: StereoFrame, pose: Pose) -> GroundMemory:
        """Return the memory in a new window. The ground must be learnt again, and doubt persists."""
        return replace(
            self,
            earlier=EarlierImage(frame.left[LEVEL].image, pose),
            last_image=None,
            identification=self.identification.restarted(),
            faults=ImageFaults(),
            typical=None,
        )

    def moved(self, T_after_before: Transform) -> GroundMemory:
        """Return the memory after an adjustment moved the last pose in the world.

        The earlier image moves with it, so that the image motion between the two remains.
        """
        pose = Pose.of(T_after_before @ Transform(*self.earlier.pose))
        return replace(self, earlier=self.earlier._replace(pose=pose))

    def after_lost_pair(self) -> GroundMemory:
        """Return the memory after a lost pair. The tracks of the next pairs may follow another motion."""
        return replace(self, identification=self.identification.restarted())

    def after_failed_window(self, shape: tuple[int, int]) -> GroundMemory:
        """Return the memory after a textured pair with too few landmarks for a new window.

        The excluded cells may be the cause, so that they age. The shape of the images is (height, width).
        """
        return replace(self, excluded=self.excluded.older(shape))

    def after_stale_rows(self, stale: Mask) -> GroundMemory:
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
        learnt = before.after_unselected()
        return cls(learnt, learnt, before)

    def for_verdict(self, verdict: Verdict) -> GroundMemory:
        """Return the memory after the verdict."""
        if verdict.refuses:
            return self.if_refused
        return self.if_reference if verdict.can_be_reference else self.if_accepted
