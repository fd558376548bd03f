"""Thresholds of all decisions about the ground's motion, in the order in which a pair uses them.

The values that were chosen by hand were chosen on rendered drives with injected faults, so that clean drives have no
findings, and no error of a faulty drive exceeds five times the stated 3 sigma without a finding. The constants of the
measurements in the images are beside their kernels (`cell_change`, `cell_motion`, `double_exposure`).
"""

from __future__ import annotations

from typing import Final

# ---- unexplained landmarks

MIN_EXCESS: Final = 0.12
"""Minimum excess of the fraction of unexplained landmarks over the typical fraction for an unusual motion. Chosen by
hand. If larger, small objects and stale parts bias the pose without a report. If smaller, clean pairs with many
outliers are degraded."""
AFTER_TRANSFER: Final = 0.5  #: Factor on `MIN_EXCESS` after a partial transfer: the next pair may be affected, too.
TYPICAL_FACTOR: Final = 1.25
"""Factor on the typical fraction of unexplained landmarks, because the scatter of the fraction grows with its value.
Chosen by hand. If larger, fewer faults are reported on drives with many outliers. If smaller, clean pairs of such
drives are degraded."""
NEARLY_HALF: Final = 0.47
"""Fraction of unexplained landmarks from which a motion is always unusual. Chosen by hand, slightly below the half from
which the majority does not follow the motion. If smaller, pairs with large objects are ambiguous more often."""
RISING_GAIN: Final = 0.1
"""Update gain of the typical fraction if the fraction of a pair is larger, but usual. An unusual fraction is learnt
only if there is no typical fraction yet. Chosen by hand. If the gain is larger, a fault that grows slowly becomes
typical before it is reported. If it is smaller, ground that becomes rougher is reported more often."""
FALLING_GAIN: Final = 0.5
"""Update gain of the typical fraction if the fraction of a pair is smaller. Chosen by hand, so that a fault at the
start has no effect after a few pairs. If the gain is larger, one clean pair makes the next pairs unusual. If the gain
is smaller, later faults are hidden for longer."""
FAR_RATIO: Final = 0.06
"""Image motion per pair, as a fraction of the width, above which a landmark is often not found again. Such an outlier
does not count as unexplained. Slightly above the optical flow that triggers a keyframe
(`keyframes.KEYFRAME_FLOW_RATIO`)."""

# ---- contradicted motions

MAX_CONTRADICTING_FIRST: Final = 0.05
"""Maximum fraction of cells that contradict a motion while the ground is not identified, and that contradict a motion
that was found by a search. Chosen by hand, above the 1 % of cells that change by noise alone
(`cell_change.NOISE_CORRELATION`). If larger, a fixed reflection is tracked for longer. If smaller, good poses are
refused because of moving shadows."""
MAX_CONTRADICTING: Final = 0.4
"""Maximum fraction of cells that contradict the motion of an identified ground. Chosen by hand below one half, because
an object may fill much of the view of a rover at rest. If larger, a pose that most of the image contradicts is
accepted. If smaller, good poses are refused while a large object is in view."""

# ---- searches for motions

MIN_AGREEMENT: Final = 0.3
"""Minimum fraction of the landmarks searched for that a motion must explain to be found. Chosen by hand. If larger,
another motion among many outliers is missed. If smaller, chance agreement of outliers counts as a motion and degrades
good pairs."""
CONVINCING: Final = 0.6
"""Minimum fraction of the landmarks searched for that a motion must explain to be accepted without further tests.
Chosen by hand above one half: the majority agrees. If smaller, slow motions near the main motion are accepted. If
larger, fewer motions are accepted by this test alone; the others must also differ from the main motion in the image
(`MIN_DIFFERENCE_PX`)."""
MIN_STATIONARY_LANDMARKS: Final = 12
"""Minimum number of landmarks in stationary cells for these cells to show the rover. Chosen by hand: twice the
minimum of a pose (`pose_solver.MIN_LANDMARKS`). If smaller, more pairs cost the time of a search. If larger, a small
body is detected only by its cells."""
MIN_DIFFERENCE_PX: Final = 1.0
"""Minimum image motion, px, between the poses of two different motions. Chosen by hand: ten times the usual residual of
an inlier (0.1 px), because two estimates of one motion differ slightly. If larger, slow objects are missed."""
MIN_DIFFERENCE_RATIO: Final = 0.05
"""Minimum ratio of the image motion between the poses of two different motions to the image motion of the main pose.
Chosen by hand, because errors of the prediction grow with the motion. If larger, objects that move nearly like the
ground are missed."""

# ---- search for a second exposure

SEARCHED_UNEXPLAINED: Final = 0.03
"""Minimum fraction of unexplained landmarks for the search for a second exposure, which takes 0.3 ms. The
fraction is at least 0.04 with ghosts of 30 to 69 %, and smaller in most pairs of clean drives."""
MIXTURE_LANDMARKS: Final = 64
"""Number of landmarks in which a second exposure is searched for. Chosen by hand: the standard error of the weight
decreases with the square root of this number, and the time increases with it."""
MIXTURE_PATCHES: Final = 32
"""Minimum number of patches for the detection of a second exposure, or `min_tracked` if that is smaller. Chosen by
hand: half of the patches that are compared (`MIXTURE_LANDMARKS`). If larger, ghosts in images with little contrast are
missed. If smaller, the standard error of the weight is estimated from too few patches."""
MIN_MIXTURE_WEIGHT: Final = 0.1
"""An image shows a second exposure if the lower bound of the estimated weight of this exposure exceeds this value. In
images of one exposure the estimate differs from 0 by a few hundredths at most."""
MIXTURE_SIGMAS: Final = 3.0
"""Number of standard errors between the weight and its lower bound, so that the bound is too high in one image in
740 (normal errors). If larger, weak ghosts are missed."""

# ---- two motions

CLEAR_RATIO: Final = 1.4
"""Minimum ratio of the weights, or of the numbers of inliers, for one of two solutions to be clearly better. Chosen by
hand. If larger, more pairs are ambiguous and degraded with a larger covariance. If smaller, a wrong motion is accepted
as clear."""
OLD_WEIGHT: Final = 3.0
"""Weight of a landmark whose host is older than the newest host; other landmarks have weight 1. Chosen by hand: an
older landmark has followed the ground over a whole keyframe interval. If larger, a body that was tracked for long
outweighs the ground. If smaller, a large object with new landmarks does."""
REPEATED_WEIGHT: Final = 1.5
"""Factor on the weight of a motion that repeats the last motion. Chosen by hand. If larger, a turn of the rover
beside an object is attributed to the object. If smaller, an object with 1.5 times the landmarks of the ground outweighs
it."""
REPEATED_RATIO: Final = 0.5
"""A motion repeats the last motion if its distance from the repeated motion (`Prediction.repeated_motion`) is at most
this fraction of the other motion's distance. Distances are image motions. If the two motions are equally far from the
repeated motion, neither repeats the last motion."""
STANDSTILL_RATIO: Final = 0.15
"""Ratio of the image motion to that of the last motion, below which a motion is a standstill. Chosen by hand. If
larger, a slow object counts as a stale part of the image. If smaller, a stale part tracked with an error counts as an
object."""

# ---- memory: identification and faults

CONSISTENT_PAIRS: Final = 3
"""Number of consistent pairs with motion until the motion counts as the ground's, or until a faulty pair no longer has
an effect. Chosen by hand. If larger, clean pairs stay degraded for longer after a fault. If smaller, a second faulty
pair after a good pair is published as good."""
LONG_RECOVERY_PAIRS: Final = 10
"""The larger number that replaces `CONSISTENT_PAIRS` after two motions or a contradiction while the ground was not
identified, or after a mostly stale image, because these faults may last longer. Chosen by hand, like
`CONSISTENT_PAIRS`."""
MAX_DYNAMIC: Final = MIN_EXCESS
"""A pair with at least this fraction of cells excluded as dynamic is only partly consistent. The fraction is
`MIN_EXCESS`, because landmarks of these cells would be unexplained. If larger, an uncertainty ends while a large object
is in view. If smaller, an uncertainty lasts while a small object is in view."""
MIN_COVERED: Final = 0.5
"""Minimum fraction of the cells with unexplained landmarks that inliers must cover later: the majority."""
MAX_TRANSFERS: Final = 10
"""Maximum number of consecutive pairs that count as partially transferred. Chosen by hand: such faults are short, and
a longer sequence has another cause. If larger, an object that covers much of the image prevents keyframes for longer.
If smaller, a longer fault counts as two motions."""
MOSTLY_STALE: Final = 0.5  #: Fraction of stale rows from which all rows of the next images may be stale.

# ---- memory: compared image and excluded cells

COMPARED_PX: Final = 3.0
"""Image motion, px, above which cells fixed to the camera are detected, and the compared image is replaced. Chosen by
hand: it exceeds `cell_motion.MOVED_PX`, the motion at which a cell counts as moved, so that most cells have moved."""
COMPARED_PAIRS: Final = 10
"""Number of pairs after which the compared image is replaced at any speed, because light and exposure change. Chosen by
hand. If larger, such changes count as changes of the scene. If smaller, fixed cells are not detected in slow motion."""
FIXED_LIFE: Final = 10
"""Lifetime, in compared pairs, of a cell that was detected as fixed to the camera. Each compared pair, including the
pair of the detection, reduces the lifetime by one. If the cell is stationary, its lifetime starts again instead. Chosen
by hand. If larger, ground that an arm has uncovered has no landmarks for longer. If smaller, landmarks are created on a
body whose illumination changes."""
DYNAMIC_LIFE: Final = 8
"""Lifetime, in compared pairs, of a cell that was detected as dynamic. Each compared pair, including the pair of the
detection, reduces the lifetime by one, so that the cell is excluded in seven pairs. Chosen by hand: an object leaves
its cells within a few pairs. If larger, the ground behind the object has no new landmarks for longer. If smaller,
landmarks are created on the object."""
