"""Memory of the ground between two pairs (`GroundMemory`): what earlier pairs have shown.

The memory is one immutable value, and its methods are its only changes. The following table shows how each event
changes its state. A number after a phase is `pairs_left`, the number of consistent pairs that end the phase. An empty
cell means no change.

| event | phase | `transfers` | `recovery_pairs` |
|---|---|---|---|
| `after_pair`, the pair shows | | | |
| ... `NOTHING` | | 0 | - 1 |
| ... `AT_REST` | `LEARNING`, `IDENTIFIED` | 0 | |
| | `UNCERTAIN` | 0 | at least 3 |
| ... `CONSISTENT` | `LEARNING` n to n - 1, 1 to `IDENTIFIED` | 0 | - 1 |
| | `UNCERTAIN` n to n - 1 | 0 | at least 3 |
| | `UNCERTAIN` 1 to `LEARNING` 3 | 0 | - 1 |
| ... `PARTLY_CONSISTENT` | `LEARNING` n to `LEARNING` 3 | 0 | - 1 |
| | `UNCERTAIN` | 0 | at least 3 |
| ... `UNCERTAIN_GROUND` | `IDENTIFIED` to `UNCERTAIN` 3 | 0 | at least 3 |
| | `LEARNING` to `UNCERTAIN` 10 | 0 | at least 3 |
| | `UNCERTAIN` n to `UNCERTAIN` 3 (n at most 3) or 10 | 0 | at least 3 |
| ... `DOUBLE_EXPOSURE` | | 0 | at least 3 |
| ... `PARTIAL_TRANSFER` | | + 1 | at least `transfers`, or 3 if that is smaller |
| `rows_stale` | | at least 1 | at least 1, or 10 if most rows are stale |
| `lost` | `LEARNING` 3, but `UNCERTAIN` persists | | |
| `window_begun` | `LEARNING` 3, but `UNCERTAIN` persists | 0 | 0 |

`recovery_pairs` decreases only in pairs with motion (`Motion.is_moving`).
"""

from __future__ import annotations

from enum import Enum, auto
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatImage, Mask, read_only
from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.findings import Verdict
from sfr_loc_map.localisation.frontend.stereo_frame import StereoFrame
from sfr_loc_map.localisation.ground.cell_change import CELL, LEVEL, cell_counts
from sfr_loc_map.localisation.ground.double_exposure import MIXTURE_LEVEL
from sfr_loc_map.localisation.ground.rigid_motion import Agreement, ComparedPair, Exclusion, Selection

CONSISTENT_PAIRS: Final = 3
"""Number of consistent pairs with motion until the motion counts as the ground's, or until a faulty pair no longer has
an effect. If larger, clean pairs stay degraded for longer after a fault. If smaller, a second faulty pair after a good
pair is published as good."""
LONG_RECOVERY_PAIRS: Final = 10
"""The larger number that replaces `CONSISTENT_PAIRS` after two motions or a contradiction while the ground was not
identified, or after a mostly stale image, because these faults may last longer."""
MAX_TRANSFERS: Final = 10
"""Maximum number of consecutive pairs that count as partially transferred. Such faults are short, and a longer sequence
has another cause. If larger, an object that covers much of the image prevents keyframes for longer. If smaller, a
longer fault counts as two motions."""
MOSTLY_STALE: Final = 0.5  #: Fraction of stale rows above which all rows of the next images may be stale.

# ---- unexplained landmarks

MIN_EXCESS: Final = 0.12
"""Minimum excess of the fraction of unexplained landmarks over the typical fraction for an unusual motion. If larger,
small objects and stale parts bias the pose without a report. If smaller, clean pairs with many outliers are
degraded."""
AFTER_TRANSFER: Final = 0.5  #: Factor on `MIN_EXCESS` after a partial transfer: the next pair may be affected, too.
TYPICAL_FACTOR: Final = 1.25
"""Factor on the typical fraction of unexplained landmarks, because the scatter of the fraction grows with its value. If
larger, fewer faults are reported on drives with many outliers. If smaller, clean pairs of such drives are degraded."""
NEARLY_HALF: Final = 0.47
"""Fraction of unexplained landmarks from which a motion is always unusual. The value is slightly below the half from
which the majority does not follow the motion. If smaller, pairs with large objects are ambiguous more often."""
RISING_GAIN: Final = 0.1
"""Update gain of the typical fraction if the fraction of a pair is larger, but usual. An unusual fraction is learnt
only if there is no typical fraction yet. If the gain is larger, a fault that grows slowly becomes typical before it is
reported. If the gain is smaller, ground that becomes rougher is reported more often."""
FALLING_GAIN: Final = 0.5
"""Update gain of the typical fraction if the fraction of a pair is smaller. A fault at the start has no effect after a
few pairs. If the gain is larger, one clean pair makes the next pairs unusual. If the gain is smaller, later faults are
hidden for longer."""
MAX_DYNAMIC: Final = MIN_EXCESS
"""A pair with at least this fraction of cells excluded as dynamic is only partly consistent. The fraction is
`MIN_EXCESS`, because landmarks of these cells would be unexplained. If larger, an uncertainty ends while a large object
is in view. If smaller, an uncertainty lasts while a small object is in view."""
MIN_COVERED: Final = 0.5
"""Minimum fraction of the cells with unexplained landmarks that inliers must cover later: the majority."""

# ---- compared image and excluded cells

COMPARED_PX: Final = 3.0
"""Image motion, px, above which cells fixed to the camera are detected, and the compared image is replaced. The value
is above `rigid_motion.MOVED_PX`, the motion at which a cell counts as moved, so that most cells have moved."""
COMPARED_PAIRS: Final = 10
"""Number of pairs after which the compared image is replaced at any speed, because light and exposure change. If
larger, such changes count as changes of the scene. If smaller, fixed cells are not detected in slow motion."""
FIXED_LIFE: Final = 10
"""Lifetime, in compared pairs, of a cell that was detected as fixed to the camera. Each compared pair, including the
pair of the detection, reduces the lifetime by one. If the cell is stationary, its lifetime starts again instead. If
larger, ground that an arm has uncovered has no landmarks for longer. If smaller, landmarks are created on a body whose
illumination changes."""
DYNAMIC_LIFE: Final = 8
"""Lifetime, in compared pairs, of a cell that was detected as dynamic. Each compared pair, including the pair of the
detection, reduces the lifetime by one, so that the cell is excluded in seven pairs. An object leaves its cells within a
few pairs. If larger, the ground behind the object has no new landmarks for longer. If smaller, landmarks are created on
the object."""


class ExcludedCells(NamedTuple):
    """Cells `(R, C)` of the left image that are excluded for several pairs because they do not move with the ground.

    A cell is excluded because it is fixed to the camera, or because it is dynamic (it moves differently from the
    ground). Lifetimes are counted in pairs that are compared with an earlier image and from which the memory learns. In
    other pairs, a body that still covers its cells cannot renew their lifetime. A textured pair with too few landmarks
    for a new window also counts, because the excluded cells may be the cause.
    """

    life: NDArray[np.int64]  #: `(R, C)` number of pairs for which a cell remains excluded.
    is_fixed: Mask  #: `(R, C)` whether a cell was excluded because it is fixed to the camera.
    #: `(H, W)`, 0 where landmarks are not created. None before a pair that excludes landmarks (`after_pair`), and if no
    #: cell has lifetime left.
    mask: NDArray[np.uint8] | None = None
    fraction: float = 0.0  #: Fraction of the image that is excluded.
    dynamic_fraction: float = 0.0  #: Fraction of the cells that are excluded because they are dynamic.

    @classmethod
    def none(cls, shape: tuple[int, int]) -> ExcludedCells:
        """Return an instance without excluded cells, for images of a shape (height, width)."""
        count = cell_counts(shape)
        return cls(np.zeros(count, np.int64), np.zeros(count, np.bool_))

    def after_pair(self, exclusion: Exclusion, stationary: Mask, shape: tuple[int, int]) -> ExcludedCells:
        """Return the excluded cells after a compared pair, including the cells that the pair excludes.

        The returned mask also applies to a keyframe that this pair becomes. Masking starts with a pair that excludes
        landmarks, and continues while any cell has lifetime left. A cell without landmarks may look fixed by chance
        (sky, horizon), and masks of such cells alone would change two of three drives without a fault.

        Args:
            exclusion: What the pair excludes.
            stationary: `(R, C)` stationary cells.
            shape: Height and width of the image.
        """
        if not (self.life.any() or exclusion.fixed.any() or exclusion.dynamic.any()):
            return self  # no cell was excluded, and the pair excludes none
        is_fixed = (self.is_fixed | exclusion.fixed) & ~exclusion.dynamic
        life = np.where(exclusion.fixed, FIXED_LIFE, self.life)
        life = np.where(exclusion.dynamic, DYNAMIC_LIFE, life)
        life = np.maximum(life - 1, 0)
        life = np.where(is_fixed & stationary & (life > 0), FIXED_LIFE, life)
        dynamic_count = np.count_nonzero((life > 0) & ~is_fixed)
        excluded = ExcludedCells(life, is_fixed, dynamic_fraction=dynamic_count / max(life.size, 1))
        is_masked = self.mask is not None or len(exclusion.rows) > 0
        return excluded._with_mask(shape) if is_masked else excluded

    def older(self, shape: tuple[int, int]) -> ExcludedCells:
        """Return the excluded cells after a pair that renews no lifetime. The shape is (height, width)."""
        nothing = Exclusion.nothing(self.life.shape)
        return self.after_pair(nothing, nothing.fixed, shape)

    def _with_mask(self, shape: tuple[int, int]) -> ExcludedCells:
        """Return the cells with a mask that covers them and their neighbours; the shape is (height, width)."""
        if not self.life.any():
            return self
        free = cv2.erode((self.life == 0).astype(np.uint8), np.ones((3, 3), np.uint8))
        mask = np.repeat(np.repeat(free * np.uint8(255), CELL, axis=0), CELL, axis=1)
        borders = [(0, size - drawn) for size, drawn in zip(shape, mask.shape, strict=True)]
        mask = np.pad(mask, borders, mode="edge")
        return self._replace(mask=mask, fraction=float(np.mean(free == 0)))


class EarlierImage(NamedTuple):
    """Earlier image that the next image is compared with, cell by cell."""

    image: FloatImage  #: Pyramid level `LEVEL` of a left image.
    pose: Pose  #: Pose of the left camera at that image.
    #: Number of pairs from the image to the next pair. A refused pair counts only if the memory learns from it. The
    #: motion above which outliers are ignored increases with the age (`rigid_motion.FAR_RATIO`).
    age: int = 1

    def older(self) -> EarlierImage:
        """Return the same image with its age increased by one pair."""
        return self._replace(age=self.age + 1)


NO_IMAGE = EarlierImage(read_only(np.zeros((0, 0), np.float32)), Pose.of(Transform.identity()))
"""Earlier image before the first window. No pair is compared with it."""


class Phase(Enum):
    """Phase of the identification of the ground by its motion."""

    LEARNING = auto()  #: No single motion has explained several pairs with motion yet.
    IDENTIFIED = auto()  #: One motion has explained several pairs with motion.
    #: Two motions competed, the image contradicted the motion, or half of the landmarks were unexplained.
    UNCERTAIN = auto()


class Shown(Enum):
    """What a pair shows about the ground's motion and about faults of the images."""

    NOTHING = auto()  #: Nothing about the ground's motion, and no fault.
    AT_REST = auto()  #: One motion, but the image did not move.
    CONSISTENT = auto()  #: One motion explains a pair with motion, even where landmarks were unexplained earlier.
    PARTLY_CONSISTENT = auto()  #: One motion, but a dynamic object is in view, or earlier cells stay unexplained.
    #: Two motions compete, the image contradicts the motion, or about half of the landmarks are unexplained. While the
    #: ground is uncertain: as `PARTLY_CONSISTENT`, and more landmarks than usual are unexplained.
    UNCERTAIN_GROUND = auto()
    DOUBLE_EXPOSURE = auto()  #: Two exposures are blended. The next pairs may be faulty, too.
    PARTIAL_TRANSFER = auto()  #: Parts of the images were exposed at different times.


class GroundMemory(NamedTuple):
    """What earlier pairs have shown: accepted pairs, pairs that contradict their pose, and stale rows.

    The table of the module shows how the events change `phase`, `transfers` and `recovery_pairs`. This table shows how
    they change the other components, which otherwise stay as they are.

    | event | `excluded` | `earlier` | `last_image` | `typical` |
    |---|---|---|---|---|
    | `after_pair`: the ground's motion was selected | as shown | pair, or older | pair | if it shows one motion |
    | `unselected`: the left image is frozen, or rows are stale | | older | None | |
    | `window_begun`: the pair begins a window | | first image | None | None |
    | `adjusted`: the adjustment of a keyframe has ended | | pose | | |
    | `window_failed`: a textured pair has too few landmarks for a window | older | | | |

    `after_pair` and `unselected` happen before the verdict on the pair. `after_verdict` then keeps what the verdict
    permits.
    """

    excluded: ExcludedCells  #: Cells that do not move with the ground.
    earlier: EarlierImage = NO_IMAGE  #: Image at an accepted pose, for the detection of changed cells.
    #: Left image at the last accepted pose, pyramid level `MIXTURE_LEVEL`, for the detection of double exposures; None
    #: if the ground's motion was not selected in that pair.
    last_image: FloatImage | None = None
    phase: Phase = Phase.LEARNING  #: Whether the ground's motion is identified.
    pairs_left: int = CONSISTENT_PAIRS  #: Number of consistent pairs until the phase ends; not used if identified.
    uncertain_cells: Mask | None = None  #: `(R, C)` cells of unexplained landmarks; None if not uncertain.
    transfers: int = 0  #: Number of consecutive partially transferred pairs up to the last pair.
    #: Number of pairs with motion that must follow until earlier faults have no effect. All of these pairs but the
    #: last are degraded (`Finding.RECOVERING`).
    recovery_pairs: int = 0
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
        return self.phase is Phase.IDENTIFIED

    @property
    def is_uncertain(self) -> bool:
        """Whether earlier pairs have made the ground's motion uncertain."""
        return self.phase is Phase.UNCERTAIN

    @property
    def is_clear(self) -> bool:
        """Whether earlier pairs no longer have an effect: the images have no fault, and the ground is not uncertain."""
        return self.transfers == 0 and self.recovery_pairs == 0 and not self.is_uncertain

    @property
    def has_typical(self) -> bool:
        """Whether the ground is not uncertain, and earlier pairs show how many landmarks are usually unexplained."""
        return self.is_identified or (self.phase is Phase.LEARNING and self.typical is not None)

    @property
    def may_be_transfer(self) -> bool:
        """Whether the next pair may be partially transferred. Many such pairs in a row have another cause."""
        return self.transfers < MAX_TRANSFERS

    def is_usual(self, unexplained: float) -> bool:
        """Return whether a fraction of unexplained landmarks is usual for the ground.

            unexplained < min(MIN_EXCESS + TYPICAL_FACTOR typical, NEARLY_HALF)

        After a partial transfer, `MIN_EXCESS` is multiplied by `AFTER_TRANSFER`.
        """
        margin = AFTER_TRANSFER * MIN_EXCESS if self.transfers else MIN_EXCESS
        return unexplained < min(margin + TYPICAL_FACTOR * (self.typical or 0.0), NEARLY_HALF)

    def shown_by_one_motion(self, main: Agreement, inliers: Mask) -> Shown:
        """Return what a pair shows if the main motion is the only motion.

        A pair with motion is consistent with the earlier pairs if few cells are excluded as dynamic, and if inliers
        cover the cells that were unexplained earlier. An unusual pair that is not consistent prolongs an uncertainty.
        """
        if not main.moves_image:
            return Shown.AT_REST
        if self.excluded.dynamic_fraction < MAX_DYNAMIC and self._are_covered(main, inliers):
            return Shown.CONSISTENT
        if self.is_uncertain and not self.is_usual(main.unexplained_fraction):
            return Shown.UNCERTAIN_GROUND
        return Shown.PARTLY_CONSISTENT

    def _are_covered(self, main: Agreement, inliers: Mask) -> bool:
        """Return whether at least half of the uncertain cells contain inliers or adjoin a cell that does."""
        if self.uncertain_cells is None:
            return True
        beside = cv2.dilate(main.cells(inliers).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        return bool((beside & self.uncertain_cells).sum() >= MIN_COVERED * self.uncertain_cells.sum())

    def stays_uncertain(self, shown: Shown) -> bool:
        """Return whether the ground is uncertain before and after a pair with one motion (`shown_by_one_motion`)."""
        is_last = shown is Shown.CONSISTENT and self.pairs_left == 1
        return self.is_uncertain and not is_last

    # ---- a pair in the map

    def after_pair(self, pair: ComparedPair, main: Agreement, shown: Shown, selection: Selection) -> GroundMemory:
        """Return the memory after a pair in which the ground's motion was selected.

        Args:
            pair: The pair.
            main: Agreement of the main motion.
            shown: What the pair shows.
            selection: The motion that is used as the ground's, and what does not follow this motion.
        """
        learnt = self._in_next_phase(main, shown)
        learnt = learnt._replace(transfers=self.transfers + 1 if shown is Shown.PARTIAL_TRANSFER else 0)
        least = learnt._least_recovery_after(shown)
        recovery_pairs = max(self.recovery_pairs, least)
        if least == 0 and selection.motion.is_moving:
            recovery_pairs = max(self.recovery_pairs - 1, 0)
        return learnt._replace(
            excluded=self.excluded.after_pair(selection.exclusion, pair.change.stationary, pair.tools.shape),
            earlier=self._earlier_after(pair, shown, selection),
            last_image=pair.frame.left[MIXTURE_LEVEL].image,
            recovery_pairs=recovery_pairs,
        )

    def _in_next_phase(self, main: Agreement, shown: Shown) -> GroundMemory:
        """Return the memory with the phase and the typical fraction after a pair."""
        if shown is Shown.UNCERTAIN_GROUND:
            return self._uncertain(main)
        if shown not in (Shown.AT_REST, Shown.CONSISTENT, Shown.PARTLY_CONSISTENT):
            return self
        learnt = self._replace(typical=self._typical_after(main.unexplained_fraction))
        match shown, self.phase:
            case (Shown.CONSISTENT, Phase.LEARNING | Phase.UNCERTAIN) if self.pairs_left > 1:
                return learnt._replace(pairs_left=self.pairs_left - 1)
            case (Shown.CONSISTENT, Phase.LEARNING):
                return learnt._in_phase(Phase.IDENTIFIED)
            case (Shown.CONSISTENT, Phase.UNCERTAIN) | (Shown.PARTLY_CONSISTENT, Phase.LEARNING):
                return learnt._in_phase(Phase.LEARNING)
        return learnt

    def _least_recovery_after(self, shown: Shown) -> int:
        """Return the minimum of `recovery_pairs` after a pair. This memory has the phase and transfers after it."""
        if shown is Shown.NOTHING:
            return 0
        if shown is Shown.PARTIAL_TRANSFER:
            return min(self.transfers, CONSISTENT_PAIRS)
        return CONSISTENT_PAIRS if shown is Shown.DOUBLE_EXPOSURE or self.is_uncertain else 0

    def _earlier_after(self, pair: ComparedPair, shown: Shown, selection: Selection) -> EarlierImage:
        """Return the image with which the next pair is compared.

        The earlier image stays until most of its cells have moved, and while the present image may have stale parts.
        """
        has_moved = selection.motion.agreement.motion_px > COMPARED_PX
        is_replaced = has_moved or not selection.is_main or self.earlier.age > COMPARED_PAIRS
        if is_replaced and shown is not Shown.PARTIAL_TRANSFER:
            return EarlierImage(pair.frame.left[LEVEL].image, selection.motion.tracks.pose)
        return self.earlier.older()

    def _typical_after(self, unexplained: float) -> float | None:
        """Return the typical fraction of unexplained landmarks, updated by a pair that one motion explains.

        The fraction changes only while the ground is not uncertain. Once there is a typical fraction, an unusual pair
        is not learnt (`selection.UNEXPLAINED`).
        """
        if self.is_uncertain:
            return self.typical
        typical = unexplained if self.typical is None else self.typical
        gain = RISING_GAIN if unexplained > typical else FALLING_GAIN
        return typical + gain * (unexplained - typical)

    def _uncertain(self, main: Agreement) -> GroundMemory:
        """Return the memory of a ground that a pair has made uncertain.

        The cells of the unexplained landmarks are added to those of a present uncertainty. The uncertainty is short if
        the ground was identified, or if a present uncertainty had at most `CONSISTENT_PAIRS` pairs left.
        """
        cells = main.cells(main.unexplained)
        if self.uncertain_cells is not None:
            cells = self.uncertain_cells | cells
        is_short = self.is_identified or (self.is_uncertain and self.pairs_left <= CONSISTENT_PAIRS)
        pairs_left = CONSISTENT_PAIRS if is_short else LONG_RECOVERY_PAIRS
        return self._replace(phase=Phase.UNCERTAIN, pairs_left=pairs_left, uncertain_cells=cells)

    def _in_phase(self, phase: Phase) -> GroundMemory:
        """Return the memory at the start of a phase without uncertainty."""
        return self._replace(phase=phase, pairs_left=CONSISTENT_PAIRS, uncertain_cells=None)

    def unselected(self) -> GroundMemory:
        """Return the memory after a pair in which no motion was selected.

        An uncertainty persists, and the recovery from earlier faults makes no progress. Excluded cells do not age,
        because stationary cells, which renew the lifetime of cells fixed to the camera, are not detected in such a
        pair.
        """
        return self._replace(earlier=self.earlier.older(), last_image=None)

    def after_verdict(self, learnt: GroundMemory, verdict: Verdict) -> GroundMemory:
        """Return the memory after the verdict on a pair. `learnt` is this memory after the pair.

        Most refused pairs are not learnt (`findings.RULES`), and leave the memory unchanged. The present image becomes
        the image that later pairs are compared with only if the pair can be a reference. The present image becomes the
        image at the last pose only if the pose is accepted.
        """
        if not verdict.is_learnt:
            return self
        if verdict.refuses:
            learnt = learnt._replace(last_image=self.last_image)
        if verdict.refuses or not verdict.can_be_reference:
            learnt = learnt._replace(earlier=self.earlier.older())
        return learnt

    # ---- other events

    def rows_stale(self, stale: Mask) -> GroundMemory:
        """Return the memory after a pair was compared with the previous pair. Its stale rows are `(H,)`.

        The next pairs may have stale parts, too.
        """
        if not stale.any():
            return self
        pairs = LONG_RECOVERY_PAIRS if stale.mean() > MOSTLY_STALE else 1
        return self._replace(transfers=max(self.transfers, 1), recovery_pairs=max(self.recovery_pairs, pairs))

    def lost(self) -> GroundMemory:
        """Return the memory after a lost pair. The tracks of the next pairs may follow another motion."""
        return self if self.is_uncertain else self._in_phase(Phase.LEARNING)

    def window_begun(self, frame: StereoFrame, pose: Pose) -> GroundMemory:
        """Return the memory in a new window. The ground must be learnt again, and an uncertainty persists."""
        return self.lost()._replace(
            earlier=EarlierImage(frame.left[LEVEL].image, pose),
            last_image=None,
            transfers=0,
            recovery_pairs=0,
            typical=None,
        )

    def window_failed(self, shape: tuple[int, int]) -> GroundMemory:
        """Return the memory after a textured pair with too few landmarks for a new window.

        The excluded cells may be the cause, so that they age. The shape of the images is (height, width).
        """
        return self._replace(excluded=self.excluded.older(shape))

    def adjusted(self, T_after_before: Transform) -> GroundMemory:
        """Return the memory after an adjustment moved the last pose in the world.

        The pose of the earlier image moves with the last pose, so that the image motion between the two remains.
        """
        pose = Pose.of(T_after_before @ Transform(*self.earlier.pose))
        return self._replace(earlier=self.earlier._replace(pose=pose))
