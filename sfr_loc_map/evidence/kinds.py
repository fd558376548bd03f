"""The kinds of evidence of a check without ground truth: the statistic of each, what it shows, and what it hides.

Each kind is a table of a check (`check_tables`), whose note is `EvidenceKind.note`. These functions make the rows of
its figures:

| kind | functions |
|---|---|
| `AGREEMENT` | `agreement.agreement_rows`, also of the misclosures at all revisited places together |
| `REVISITED` | `revisited.closure_rows` |
| `PREDICTED` | `predicted.predicted_rows` |
| `SCALE` | `agreement.agreement_rows`, `other_estimates.scale_row` |
| `HAT` | `other_estimates.hat_rows` |
| `CALIBRATION` | `calibration.offset_rows`, `calibration.cost_row` |
| `OVERLAP` | `overlap.overlap_rows` |
"""

from __future__ import annotations

from typing import NamedTuple

from sfr_loc_map.mapping.multiview.pose_agreement import MAX_GREY_RATIO, MAX_RANGE_RATIO
from sfr_loc_map.mapping.multiview.projection import SHIFT_PX


class EvidenceKind(NamedTuple):
    """One kind of evidence."""

    name: str  #: Name of the table of this kind.
    title: str
    statistic: str  #: Definition of its numbers.
    shows: str  #: What follows from the numbers.
    hides: str  #: Errors that the numbers cannot show.
    decides: bool  #: Whether the result of the check depends on this kind, as stated in `check_result`.

    @property
    def note(self) -> str:
        """The note below the table."""
        effect = "Decides the result." if self.decides else "Does not decide the result."
        return f"{self.statistic} Shown: {self.shows} Hidden: {self.hides} {effect}"


AGREEMENT = EvidenceKind(
    "check",
    "Runs that should agree",
    statistic="Difference of two runs over sub-trajectories. NEES: squared difference normalised by the covariances of "
    "both runs, over the independent sub-trajectories without a lost or degraded pose; 6 on average if the "
    "covariances are correct. p: probability of a difference this large if the covariances are correct.",
    shows="at least one of the two runs has the error in the column 'minimum error of a run' or a larger error.",
    hides="errors that both runs share. A wrong calibration is unobservable, and the noise of common images reduces "
    "the difference.",
    decides=True,
)
REVISITED = EvidenceKind(
    "revisited",
    "Revisited places",
    statistic="Misclosure: difference between the motion accumulated along the path from visit to visit and the motion "
    "that a direct run measures from the landmarks of the first visit. NEES: 6 on average if the covariances are "
    "consistent.",
    shows="errors that accumulate along the path.",
    hides="a scale error, because it cancels in a closed loop.",
    decides=True,
)
PREDICTED = EvidenceKind(
    "predicted",
    "Predicted error by its sources",
    statistic="Root mean square over n sub-trajectories, from the covariance of the forward run. Disparity: a constant "
    "error, such as from a yaw of the right camera. Lens: an error that varies over the image. Sub-trajectories with a "
    "degraded or lost pose are skipped.",
    shows="the expected error and its largest source, if the covariance is correct.",
    hides="sources that the localiser does not model: baseline, focal length, mounting, stamps.",
    decides=False,
)
SCALE = EvidenceKind(
    "scale",
    "Other estimates",
    statistic="Difference of the forward run and another estimate over sub-trajectories. Excess of length: relative "
    "excess of the straight-line distances of the forward run over those of the other estimate, with an interval over "
    "the independent sub-trajectories.",
    shows="at least one of both has the error in the column 'minimum error of a run' or a larger error. The excess is "
    "the error of the ratio of baseline and focal length, if the other estimate is the odometry of wheels that "
    "do not slip.",
    hides="errors that both estimates share.",
    decides=False,
)
HAT = EvidenceKind(
    "hat",
    "Three estimates",
    statistic="Three-cornered hat: the sigma of each of three estimates from their differences over at least three "
    "independent sub-trajectories, without an interval.",
    shows="which estimate is the least precise, if the errors are independent.",
    hides="errors that the estimates share, such as those of the calibration.",
    decides=False,
)
CALIBRATION = EvidenceKind(
    "calibration",
    "Calibration of the right camera",
    statistic="Offsets from the calibration file: mean over the n runs that observe the angle. The runs share their "
    "images, so that there is no interval. Yaw is reported as 0 until it is significant. The error of depth is "
    "therefore unknown unless the result for the yaw is redo. Shift of positions: root mean square over n "
    "sub-trajectories of the effect that the online calibration does not correct.",
    shows="redo if the offsets of all runs have one sign and their mean is large; keep if the offsets of all runs are "
    "small.",
    hides="a wrong baseline or focal length, which is unobservable without a truth or wheel odometry.",
    decides=True,
)
OVERLAP = EvidenceKind(
    "overlap",
    "Maps that should agree",
    statistic="Robust root mean square of the range differences of points that both pairs observe. The expected "
    "difference follows from the reported sigmas if the poses are correct.",
    shows=f"the maps disagree above a ratio of {MAX_RANGE_RATIO:g}, or if the grey level difference exceeds "
    f"{MAX_GREY_RATIO:g} times the difference at pixels {SHIFT_PX} px away.",
    hides="errors of the camera calibration, because all pairs share them.",
    decides=True,
)

KINDS = (AGREEMENT, REVISITED, PREDICTED, SCALE, HAT, CALIBRATION, OVERLAP)
"""All kinds, in the order of the tables of a check."""
