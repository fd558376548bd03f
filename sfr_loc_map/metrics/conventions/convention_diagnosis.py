"""Diagnosis of the single convention mismatch that explains the disagreement of estimate and truth.

A hypothesis is a mismatch of `mismatches`, or an offset of the stamps (`offset_search`). Its evidence is the
disagreement of each sub-trajectory that remains after its correction (`Tried.remaining`). One rule decides whether a
hypothesis is found (`_explains`). Of the hypotheses found, that with the smallest mean disagreement is reported.

A hypothesis competes with the explanations that presume less: that the estimate is correct as delivered, that it has
the scale error of a method, and, if numbers were fitted, each hypothesis without fitted numbers. In at least nine
tenths of the sub-trajectories, the disagreement that the hypothesis leaves must meet two conditions. The disagreement
must be at most `EXPLAINED`. It must also be at most 1 / `GAIN` (1 / `GAIN_FITTED` if numbers were fitted) of the median
disagreement that each of these explanations leaves. If this median is below `NEGLIGIBLE` for one of these explanations,
no hypothesis is needed. After the correction of an offset of the stamps, at least nine tenths of the estimates must be
within the time span of the truth.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.metrics.config import AssociationConfig
from sfr_loc_map.metrics.conventions.disagreement import ComparedPoses, compared_poses, eighths
from sfr_loc_map.metrics.conventions.mismatches import Mismatch, mismatches_of
from sfr_loc_map.metrics.conventions.offset_search import best_offset, period_ns
from sfr_loc_map.metrics.figures.records import Record
from sfr_loc_map.metrics.frames.association import check_attitudes

NEGLIGIBLE = 1e-3
"""Disagreement that requires no explanation: 0.1 % of the path, or 0.06 deg. The drift of visual odometry is larger
(about 0.5 % for the best methods of the KITTI benchmark)."""
EXPLAINED = 0.25
"""Maximum disagreement after the correction: 25 % of the path, or 14 deg. Chosen by hand, above the
errors of methods. Wrong axes or units cause a disagreement of about 1."""
NEARLY_ALL = 0.9  #: Minimum fraction of explained sub-trajectories. Chosen by hand.
GAIN, GAIN_FITTED = 2.0, 3.0
"""Minimum factors by which a hypothesis, without and with fitted numbers, must reduce the median disagreement that
simpler explanations leave. Chosen by hand; no random drive without a mismatch has a diagnosis (`python -m campaigns
honest-drives`)."""
HONEST_SCALES = (0.8, 1.25)
"""Range of scales that are attributed to the method. Chosen by hand; units differ by a factor of ten or more."""
TIME_OFFSET = "time offset"  #: Name of the mismatch that the stamps are offset.


class Hypothesis(Record, frozen=True, kw_only=True):
    """One mismatch and the result of its correction."""

    mismatch: str  #: Short name.
    sentence: str  #: Fault of the estimate, and its correction.
    disagreement: float  #: Mean disagreement that remains after the correction.
    fitted: bool = False  #: Whether numbers were fitted for the correction.
    setting: str = ""  #: Setting `NAME=VALUE` of `PoseConvention` for the correction; empty if there is none.

    @property
    def prevents_verdict(self) -> bool:
        """Whether the figures are meaningless, because estimate and truth use different conventions.

        An offset of the stamps does not prevent a verdict: the method under test may be late, and its errors are then
        real.
        """
        return self.mismatch != TIME_OFFSET


class Diagnosis(Record, frozen=True, kw_only=True):
    """The result of a diagnosis."""

    disagreement: float | None  #: Mean disagreement of the estimate as given; None if too few stamps are common.
    hypotheses: tuple[Hypothesis, ...]  #: Mismatches, in ascending order of the remaining disagreement.
    found: Hypothesis | None  #: Mismatch that explains the disagreement; None without a disagreement or an explanation.


class Tried(NamedTuple):
    """A hypothesis and its evidence: the remaining disagreement of each sub-trajectory."""

    hypothesis: Hypothesis
    remaining: FloatArray
    is_of_truth: bool = False  #: Whether the truth has the mismatch and not the estimate.


def diagnose(
    estimate: Trajectory,
    truth: Trajectory,
    config: AssociationConfig,
    rig: StereoRig | None = None,
    *,
    every: bool = True,
) -> Diagnosis:
    """Find the single convention mismatch that explains the disagreement of estimate and truth (poses of RB in DS).

    With `every`, all hypotheses are tried even if estimate and truth agree. A score does not need these hypotheses.
    MetricsError if the estimate has only positions.
    """
    check_attitudes(estimate)
    compared = compared_poses(estimate, truth, config, rig)
    as_delivered = compared.disagreements(compared.true, compared.found) if compared.has_enough_frames else None
    before = None if as_delivered is None else float(np.mean(as_delivered))
    if as_delivered is not None and np.median(as_delivered) < NEGLIGIBLE and not every:
        return Diagnosis(disagreement=before, hypotheses=(), found=None)
    without_mismatch = [] if as_delivered is None else [as_delivered, *_with_scale_of_truth(compared)]
    tried = sorted((*_by_mismatch(compared), *_by_offset(compared)), key=lambda item: item.hypothesis.disagreement)
    return Diagnosis(
        disagreement=before, hypotheses=tuple(item.hypothesis for item in tried), found=_chosen(tried, without_mismatch)
    )


# ---- the rule of choice


def _chosen(tried: Sequence[Tried], without_mismatch: Sequence[FloatArray]) -> Hypothesis | None:
    """Return the first hypothesis that explains the disagreement; None if no hypothesis does.

    If estimate and truth have the same world frame, some mismatches of either leave the same disagreement, and that of
    the estimate is returned.
    """
    without_fit = [item.remaining for item in tried if not item.hypothesis.fitted]
    explaining = [
        item
        for item in tried
        if _explains(item, [*without_mismatch, *without_fit] if item.hypothesis.fitted else without_mismatch)
    ]
    if not explaining:
        return None
    most = explaining[0].hypothesis.disagreement + NEGLIGIBLE
    of_estimate = (item for item in explaining if not item.is_of_truth and item.hypothesis.disagreement <= most)
    return next(of_estimate, explaining[0]).hypothesis


def _explains(tried: Tried, simpler: Sequence[FloatArray]) -> bool:
    """Return whether a hypothesis explains the disagreement better than all explanations that presume less.

    `simpler` are the disagreements of the sub-trajectories that these explanations leave. Their median is compared, so
    that outliers of the estimate require no explanation.
    """
    gain = GAIN_FITTED if tried.hypothesis.fitted else GAIN
    remaining = float(np.quantile(tried.remaining, NEARLY_ALL))
    others = [float(np.median(each)) for each in simpler]
    return remaining <= EXPLAINED and all(other >= NEGLIGIBLE and gain * remaining <= other for other in others)


# ---- the evidence of each explanation


def _with_scale_of_truth(compared: ComparedPoses) -> Iterator[FloatArray]:
    """Yield the disagreement after the correction of a scale error, if a method can have this error."""
    true_positions, _ = compared.true
    positions, quats = compared.found
    starts, ends = eighths(len(positions))
    true_m, found_m = (np.linalg.norm(p[ends] - p[starts], axis=1) for p in (true_positions, positions))
    scale = float(true_m @ found_m) / max(float(found_m @ found_m), 1e-12)
    if HONEST_SCALES[0] <= scale <= HONEST_SCALES[1]:
        yield compared.disagreements(compared.true, (scale * positions, quats))


def _by_mismatch(compared: ComparedPoses) -> Iterator[Tried]:
    """Yield each mismatch that is corrected pose by pose; none with too few frames."""
    if not compared.has_enough_frames:
        return
    for mismatch in mismatches_of(compared):
        remaining = _remaining_after(mismatch, compared)
        whose = "truth" if mismatch.is_of_truth else "estimate"
        hypothesis = Hypothesis(
            mismatch=mismatch.name,
            sentence=f"the {whose} looks wrong: {mismatch.sentence}",
            disagreement=float(np.mean(remaining)),
            fitted=mismatch.is_fitted,
            setting=mismatch.setting,
        )
        yield Tried(hypothesis, remaining, mismatch.is_of_truth)


def _remaining_after(mismatch: Mismatch, compared: ComparedPoses) -> FloatArray:
    """Return the disagreement of each sub-trajectory after the correction of a mismatch.

    All poses of the estimate are corrected, including those without a true pose, because inverted motions refer to the
    first pose, which may be one of these.
    """
    if mismatch.is_of_truth:
        return compared.disagreements(mismatch.correct(*compared.true), compared.found)
    corrected = mismatch.correct(compared.estimate.positions, compared.estimate.quats_xyzw)
    return compared.disagreements(compared.true, compared.at_frames(corrected))


def _by_offset(compared: ComparedPoses) -> Iterator[Tried]:
    """Yield the hypothesis that the stamps are offset, if the truth covers most of the estimate after an offset."""
    begin_ns = 0
    has_poses = len(compared.estimate) > 0 and len(compared.truth) > 0
    if not compared.has_enough_frames and has_poses:  # the stamps are probably of different clocks
        begin_ns = int(compared.truth.stamps_ns[0]) - int(compared.estimate.stamps_ns[0])
    best = best_offset(compared.estimate, compared.truth, begin_ns)
    if best is None:
        return
    seconds = best.offset_ns / NS_PER_S
    periods = best.offset_ns / period_ns(compared.estimate)
    hypothesis = Hypothesis(
        mismatch=TIME_OFFSET,
        sentence="the stamps of estimate and truth are offset: add "
        f"{seconds:+.3f} s ({periods:+.3g} periods) to those of the estimate",
        disagreement=best.disagreement,
        fitted=True,
        setting=f"time_offset_ns={best.offset_ns}",
    )
    yield Tried(hypothesis, best.remaining)
