"""Memory of the ground between two pairs: its identification, faults of earlier images, and images to compare with."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

from sfr_loc_map.geometry.arrays import FloatImage, Mask
from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.localisation.findings import Finding, Findings
from sfr_loc_map.localisation.frontend.stereo_frame import StereoFrame
from sfr_loc_map.localisation.ground.cell_change import LEVEL
from sfr_loc_map.localisation.ground.excluded_cells import ExcludedCells
from sfr_loc_map.localisation.ground.identification import Fault, Identification, ImageFaults, Phase, Sign

# The values here, in `identification`, in `evidence`, in `motion_tools` and in `selection` were chosen by hand on
# rendered drives with injected faults, so that clean drives have no findings, and no error of a faulty drive exceeds
# five times the stated 3 sigma without a finding.

MIN_EXCESS = 0.12
"""Minimum excess of the fraction of unexplained landmarks over the typical fraction for an unusual motion. Chosen by
hand. If larger, small objects and stale parts bias the pose without a report. If smaller, clean pairs with many
outliers are degraded."""
AFTER_TRANSFER = 0.5  #: Factor on `MIN_EXCESS` after a partial transfer: the next pair may be affected, too.
MAX_DYNAMIC = MIN_EXCESS
"""A pair with at least this fraction of cells excluded as dynamic does not confirm the ground's motion. It is equal to
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
"""Update gain of the typical fraction if the fraction of a pair is larger. Chosen by hand. If the gain is larger, a
fault becomes typical before it is reported. If it is smaller, rougher ground is reported for longer."""
FALLING_GAIN = 0.5
"""Update gain of the typical fraction if the fraction of a pair is smaller. Chosen by hand, so that a fault at the
start has no effect after a few pairs. If the gain is larger, one clean pair makes the next pairs unusual. If the gain
is smaller, later faults are hidden for longer."""


class MainMotion(NamedTuple):
    """What the memory learns from the main motion of a pair."""

    moves_image: bool  #: Whether this motion moves the image.
    unexplained_fraction: float  #: Fraction of the landmarks that do not follow this motion.
    unexplained_cells: Mask  #: `(R, C)` cells of these landmarks.
    inlier_cells: Mask  #: `(R, C)` cells of the landmarks that follow this motion.


class Effect(NamedTuple):
    """The finding of a case, and its effect on the memory of the ground."""

    finding: Finding | None = None
    #: What the case shows about the ground's motion. With `AGREES`, the pair also updates the typical fraction, and the
    #: memory determines whether the pair agrees completely (`GroundMemory.sign_of_one_motion`).
    sign: Sign = Sign.NOTHING
    fault: Fault = Fault.NONE  #: What the case shows about faults of the images.
    outlasts_refusal: bool = False  #: Whether the memory learns from the pair although its pose is refused.

    @property
    def findings(self) -> Findings:
        """The finding as a set; empty without one."""
        return frozenset() if self.finding is None else frozenset({self.finding})


class EarlierImage(NamedTuple):
    """Earlier image that the present image is compared with, cell by cell."""

    image: FloatImage  #: Pyramid level `LEVEL` of a left image.
    pose: Pose  #: Pose of the left camera at that image.
    #: Number of pairs since the image. A refused pair from which the memory does not learn is not
    #: counted. The image motion from which outliers are ignored is proportional to the age (`selection.FAR_RATIO`).
    age: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class GroundMemory:
    """Memory of accepted pairs, of pairs that contradict their pose, and of stale rows."""

    excluded: ExcludedCells  #: Cells that do not move with the ground.
    earlier: EarlierImage | None = None  #: Image at an accepted pose; None before the first window.
    #: Pyramid level `MIXTURE_LEVEL` of the left image at the last accepted pose; None if that image was not compared
    #: with earlier images.
    previous: FloatImage | None = None
    identification: Identification = Identification()  #: Which motion is the ground's.
    faults: ImageFaults = ImageFaults()  #: Faults of earlier images.
    #: Typical fraction of unexplained landmarks; None until one motion has explained a pair of the window.
    typical: float | None = None

    @classmethod
    def none(cls, shape: tuple[int, int]) -> GroundMemory:
        """Return the memory before the first pair of images of a shape (height, width)."""
        return cls(ExcludedCells.none(shape))

    @property
    def is_clear(self) -> bool:
        """Whether earlier pairs have no more effect: the images have no fault, and the ground is not in doubt."""
        return self.faults == ImageFaults() and self.identification.phase is not Phase.IN_DOUBT

    def after(
        self,
        effect: Effect,
        main: MainMotion,
        *,
        excluded: ExcludedCells,
        earlier: EarlierImage,
        image: FloatImage,
        is_moving: bool,
    ) -> GroundMemory:
        """Return the memory after a pair.

        Args:
            effect: Effect of the pair's case.
            main: What the main motion explains.
            excluded: Cells excluded from this pair on, also in a keyframe that the pair becomes.
            earlier: Image that the pair was compared with.
            image: Pyramid level `MIXTURE_LEVEL` of the pair's left image.
            is_moving: Whether the pose of the selected tracks is trusted and the image moved.
        """
        is_one_motion = effect.sign is Sign.AGREES
        sign = self.sign_of_one_motion(main) if is_one_motion else effect.sign
        return GroundMemory(
            excluded=excluded,
            earlier=earlier,
            previous=image,
            identification=self.identification.after(sign, main.unexplained_cells),
            faults=self.faults.after(effect.fault, is_moving=is_moving),
            typical=self.typical_after(main.unexplained_fraction) if is_one_motion else self.typical,
        )

    def sign_of_one_motion(self, main: MainMotion) -> Sign:
        """Return what a pair shows about the ground if the main motion is the only one.

        A stationary image shows nothing. A moving pair agrees if few cells are excluded as dynamic, and if inliers
        cover the cells that were unexplained earlier. An unusual pair that does not agree prolongs a doubt.
        """
        if not main.moves_image:
            return Sign.NOTHING
        is_covered = self.identification.is_covered_by(main.inlier_cells)
        if self.excluded.dynamic_fraction < MAX_DYNAMIC and is_covered:
            return Sign.AGREES
        is_in_doubt = self.identification.phase is Phase.IN_DOUBT
        if is_in_doubt and not self.is_usual(main.unexplained_fraction):
            return Sign.DOUBTS
        return Sign.AGREES_PARTLY

    def is_usual(self, unexplained: float) -> bool:
        """Return whether a fraction of unexplained landmarks is usual for the ground."""
        margin = AFTER_TRANSFER * MIN_EXCESS if self.faults.transfers else MIN_EXCESS
        return unexplained < min(margin + TYPICAL_FACTOR * (self.typical or 0.0), NEARLY_HALF)

    def typical_after(self, unexplained: float) -> float | None:
        """Return the typical fraction of unexplained landmarks after a pair with one motion.

        The fraction does not change after an unusual pair if the ground is identified, or while the ground is in doubt.
        """
        phase = self.identification.phase
        if phase is Phase.IN_DOUBT or (phase is Phase.IDENTIFIED and not self.is_usual(unexplained)):
            return self.typical
        typical = unexplained if self.typical is None else self.typical
        gain = RISING_GAIN if unexplained > typical else FALLING_GAIN
        return typical + gain * (unexplained - typical)

    def in_new_window(self, frame: StereoFrame, pose: Pose) -> GroundMemory:
        """Return the memory in a new window. The ground must be learnt again, and doubt persists."""
        return replace(
            self,
            earlier=EarlierImage(frame.left[LEVEL].image, pose),
            previous=None,
            identification=self.identification.restarted(),
            faults=ImageFaults(),
            typical=None,
        )

    def after_lost_pair(self) -> GroundMemory:
        """Return the memory after a lost pair. The tracks of the next pairs may follow another motion."""
        return replace(self, identification=self.identification.restarted())

    def after_stale_rows(self, stale: Mask) -> GroundMemory:
        """Return the memory after a pair whose rows `(H,)` are partly stale."""
        return replace(self, faults=self.faults.after_stale_rows(stale))
