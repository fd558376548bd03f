"""Findings of the guards, and the table of their consequences.

`RULES` lists all findings in the order of precedence. The first finding present determines the action and the published
reason of a pair (`decide`). Findings that refuse a pair come first, causes before their effects.

A pose with other findings is accepted and degraded. The order of these findings affects only the published reason,
because inflation and suitability as a keyframe are combined from all findings. Measured problems (stale images, a gap,
the calibration, sheared rows) precede problems inferred from the motions of landmarks, because a measured problem may
cause an inferred one. The published reason is therefore not always that of the largest inflation.

| findings | found by |
|---|---|
| `REPEATED_PAIR`, `IDENTICAL_IMAGES`, `FROZEN_IMAGE`, `STALE_ROWS` | `guards.check_images`, by `stale_images` |
| `UNTEXTURED`, `FROZEN_AND_FEW`, `FEW_LANDMARKS` | `guards.check_landmarks`, `guards.check_tracks` |
| `CONTRADICTED`, `PARTIAL_TRANSFER`, `TRANSFER_OR_MOTION`, `DOUBLE_EXPOSURE` | `ground.selection.findings_of` |
| `UNEXPLAINED`, `BODY_OR_GROUND`, `AT_REST_UNCERTAIN`, `AMBIGUOUS` | `ground.selection.findings_of` |
| `RECOVERING`, `GROUND_UNCERTAIN` | `ground.selection.findings_of`, `Ground.unselected` |
| `SINGULAR`, `TOO_FAST` | `guards.check_pose` |
| `SWAPPED` | `guards.check_order` in a new window, `guards.check_sides` in a pair with a pose |
| `UNTEXTURED_SIDE`, `ONE_SIDED` | `guards.check_sides` |
| `AFTER_GAP`, `DIVERGED` | `guards.check_gap`, `guards.check_adjustment` |
| `CALIBRATION`, `SHEARED_ROWS` | `guards.check_calibration`, `guards.check_shear` |

A new guard requires a `Finding`, a row in `RULES`, a function in `guards.py`, and a call in the localiser:

- A guard that needs only the images is called in `Localiser._locate`. Its findings also apply to a window that begins
  with the pair.
- A guard that refuses poses, and takes little time, is called in `Localiser._refusals_of_pose`. For a keyframe, this
  function is called again with the pose from all landmarks, to decide whether this pose is used.
- Any other guard is called in `Localiser._judge`.
- A guard for a new window is called in `Localiser._begin_window`.
- The memory of a guard is a field of `State`. A memory that learns from poses is passed to `State.accepted` by the
  `Candidate` and changes only there. The memory of the ground is passed by `Ground`, and may learn from a refused pair
  as well.

A guard for the ground's motion is a case in `ground.selection.CASES`.
"""

from __future__ import annotations

from enum import Enum, Flag, auto
from typing import Final, NamedTuple

from sfr_loc_map.localisation.estimate import StateReason


class Action(Enum):
    """What happens to a pair."""

    #: The last pose is published again, with a larger covariance, until this covariance is that of a lost pose. If the
    #: localiser is lost, the pair is lost, and new images count as for `LOSE_OR_BEGIN`.
    KEEP = auto()
    LOSE = auto()  #: The localiser is lost. No window may begin with the pair.
    #: The localiser is lost. After several good images, a window begins at the last pose instead.
    LOSE_OR_BEGIN = auto()
    DEGRADE = auto()  #: The pose is accepted, or a window begins with the pair, and the state is degraded.
    ACCEPT = auto()  #: The pose is accepted.


class Finding(Enum):
    """What a guard may find in a pair."""

    REPEATED_PAIR = auto()  #: Both images repeat those of the previous pair, possibly swapped or with new noise.
    IDENTICAL_IMAGES = auto()  #: Left and right image are identical, possibly with different noise.
    SWAPPED = auto()  #: Left and right image are swapped.
    UNTEXTURED = auto()  #: Like `FEW_LANDMARKS`, and an image has no texture.
    FROZEN_AND_FEW = auto()  #: Like `FEW_LANDMARKS`, and one image repeats that of the previous pair and is blanked.
    FEW_LANDMARKS = auto()  #: The window has too few landmarks, too few were tracked, or they do not agree on a pose.
    CONTRADICTED = auto()  #: The pose predicts no motion where the image changed.
    SINGULAR = auto()  #: The pose is not finite or not determined.
    TOO_FAST = auto()  #: The motion exceeds the configured bounds.
    FROZEN_IMAGE = auto()  #: One image repeats that of the previous pair and is blanked.
    STALE_ROWS = auto()  #: Some rows repeat those of the previous pair and are blanked.
    UNTEXTURED_SIDE = auto()  #: One image has no texture (covered, black or overexposed), and the other was tracked.
    DIVERGED = auto()  #: The window begins with this pair because the adjustment of the previous window diverged.
    AFTER_GAP = auto()  #: The window began after an unobserved motion.
    CALIBRATION = auto()  #: The right camera drifts, or its yaw is not yet corrected.
    SHEARED_ROWS = auto()  #: The rows of the images were exposed at different times (rolling shutter).
    PARTIAL_TRANSFER = auto()  #: Unknown parts of the images are stale.
    #: Like `PARTIAL_TRANSFER`, or the other part of the image shows the ground, which is not identified yet.
    TRANSFER_OR_MOTION = auto()
    DOUBLE_EXPOSURE = auto()  #: The exposures of two pairs are blended, and the pose may be that of the earlier pair.
    UNEXPLAINED = auto()  #: An unusually large fraction of the landmarks does not follow the pose.
    #: An earlier pair had stale rows or a finding about the ground's motion; too few pairs with motion have followed.
    RECOVERING = auto()
    ONE_SIDED = auto()  #: Few inliers are observed in both images; both have texture, and one may be stale.
    #: One motion of landmarks outside stationary cells was selected, and the ground is not identified yet.
    BODY_OR_GROUND = auto()
    #: No second motion was found, and the ground's motion is uncertain. Either the ground was uncertain before
    #: (`Phase.UNCERTAIN`), or about half of the landmarks are unexplained, or more landmarks than usual are unexplained
    #: and the ground is not identified.
    GROUND_UNCERTAIN = auto()
    AT_REST_UNCERTAIN = auto()  #: The ground is still uncertain, and neither the pose nor the image shows a motion.
    AMBIGUOUS = auto()  #: Two motions were found, and either may be the ground's.


class Inflation(Flag):
    """What a finding adds to the covariance of a pose (`error_sources.inflation_of`)."""

    NONE = 0
    UNOBSERVED = auto()  #: The motion since the last pose counts as unobserved, because images may be stale.
    AMBIGUITY = auto()  #: The true motion may be another motion, a standstill, or a motion that was not found.


class Refusal(NamedTuple):
    """The consequences of a finding that refuses the pose of a pair."""

    action: Action  #: `KEEP`, `LOSE` or `LOSE_OR_BEGIN`.
    reason: StateReason
    #: Whether the memory of the ground learns from the refused pair (`GroundMemory.after_verdict`).
    is_learnt: bool = False


class Degradation(NamedTuple):
    """The consequences of a finding with which a pose is accepted and degraded."""

    reason: StateReason
    inflation: Inflation = Inflation.NONE
    #: Whether the pair may be a reference for later pairs: as a keyframe, as a recovery image, and as the earlier image
    #: of the change detection. A window begins only with such a pair.
    can_be_reference: bool = True


RULES: Final[dict[Finding, Refusal | Degradation]] = {
    Finding.REPEATED_PAIR: Refusal(Action.KEEP, StateReason.REPEATED_IMAGES),
    Finding.IDENTICAL_IMAGES: Refusal(Action.LOSE, StateReason.NO_STEREO),
    # Before the findings of too few landmarks, because a window of swapped images has few landmarks.
    Finding.SWAPPED: Refusal(Action.LOSE, StateReason.NO_STEREO),
    Finding.UNTEXTURED: Refusal(Action.LOSE_OR_BEGIN, StateReason.UNTEXTURED_IMAGES),
    Finding.FROZEN_AND_FEW: Refusal(Action.LOSE_OR_BEGIN, StateReason.REPEATED_IMAGES),
    Finding.FEW_LANDMARKS: Refusal(Action.LOSE_OR_BEGIN, StateReason.FEW_LANDMARKS),
    # Learnt: the ground is uncertain, and a search in the next pairs may find its motion.
    Finding.CONTRADICTED: Refusal(Action.KEEP, StateReason.MOVING_REGIONS, is_learnt=True),
    Finding.SINGULAR: Refusal(Action.LOSE_OR_BEGIN, StateReason.IMPLAUSIBLE_MOTION),
    Finding.TOO_FAST: Refusal(Action.LOSE_OR_BEGIN, StateReason.IMPLAUSIBLE_MOTION),
    # No keyframe: without the blanked image no landmark can be triangulated.
    Finding.FROZEN_IMAGE: Degradation(StateReason.REPEATED_IMAGES, can_be_reference=False),
    # No keyframe: the edges of the blanked rows would be detected as texture.
    Finding.STALE_ROWS: Degradation(StateReason.TORN_IMAGES, can_be_reference=False),
    # No keyframe: without the other image no landmark can be triangulated.
    Finding.UNTEXTURED_SIDE: Degradation(StateReason.UNTEXTURED_IMAGES, can_be_reference=False),
    # Keyframe: a window begins with the pair. Later pairs of the window report the gap.
    Finding.DIVERGED: Degradation(StateReason.IMPLAUSIBLE_MOTION),
    # Keyframe: the images are good, and the finding ends after further keyframes.
    Finding.AFTER_GAP: Degradation(StateReason.UNSEEN_MOTION),
    # Keyframe: the yaw is estimated from keyframes and would otherwise never be corrected.
    Finding.CALIBRATION: Degradation(StateReason.CALIBRATION_DRIFT),
    # Keyframe: a rolling shutter shears all pairs, and without keyframes tracking would be lost.
    Finding.SHEARED_ROWS: Degradation(StateReason.TORN_IMAGES, Inflation.UNOBSERVED),
    # No keyframe: landmarks in stale parts would have wrong positions.
    Finding.PARTIAL_TRANSFER: Degradation(StateReason.TORN_IMAGES, Inflation.UNOBSERVED, can_be_reference=False),
    # No keyframe: landmarks in stale parts would have wrong positions. The covariance includes the ambiguity.
    Finding.TRANSFER_OR_MOTION: Degradation(StateReason.TORN_IMAGES, Inflation.AMBIGUITY, can_be_reference=False),
    # Keyframe: one exposure dominates, and without keyframes tracking would be lost.
    Finding.DOUBLE_EXPOSURE: Degradation(StateReason.TORN_IMAGES, Inflation.UNOBSERVED),
    # Keyframe: a scene that changes quickly requires new landmarks, and outliers are removed.
    Finding.UNEXPLAINED: Degradation(StateReason.TORN_IMAGES, Inflation.UNOBSERVED),
    # Keyframe: one motion explains this pair, and only an earlier pair was faulty.
    Finding.RECOVERING: Degradation(StateReason.TORN_IMAGES, Inflation.UNOBSERVED),
    # No keyframe: landmarks are triangulated from both images, which do not match.
    Finding.ONE_SIDED: Degradation(StateReason.TORN_IMAGES, Inflation.UNOBSERVED, can_be_reference=False),
    # Keyframe: the cells of the body are excluded, and the next pairs identify the ground.
    Finding.BODY_OR_GROUND: Degradation(StateReason.MOVING_REGIONS, Inflation.UNOBSERVED),
    # Keyframe: the window continues with the more likely motion. The covariance includes the ambiguity.
    Finding.GROUND_UNCERTAIN: Degradation(StateReason.MOVING_REGIONS, Inflation.AMBIGUITY),
    # Keyframe: the pair shows no motion, and the finding ends only when the rover moves.
    Finding.AT_REST_UNCERTAIN: Degradation(StateReason.MOVING_REGIONS),
    Finding.AMBIGUOUS: Degradation(StateReason.MOVING_REGIONS, Inflation.AMBIGUITY),
}
"""Consequences of each finding, in the order of precedence.

The first finding present determines the action and the published reason. `localiser` lists the verdicts of a pair, each
of which applies this table to all findings so far. The selection of the ground contributes at most one finding, that of
its case (`ground.selection.CASES`), so that the covariance grows by the inflation of one case only.

Eight findings publish `torn_images`, because they require the same check by an operator: parts of the images may have
been exposed at different times, by stale parts, blended exposures or a rolling shutter. For six of these findings the
pair itself shows evidence of this. For `RECOVERING`, an earlier pair showed the evidence. For `UNEXPLAINED`, a scene
that changes quickly is another possible cause. The eight findings differ in their inflation and in whether the pair may
become a keyframe.

Three findings add nothing to the covariance because it already includes what they report: the uncertainty of the yaw
(`CALIBRATION`), and the unobserved motion before the window (`AFTER_GAP`, `DIVERGED`). Two findings add nothing
because the stale parts are known and blanked (`FROZEN_IMAGE`, `STALE_ROWS`). `UNTEXTURED_SIDE` adds nothing because
nothing is tracked in an image without texture. `AT_REST_UNCERTAIN` adds nothing because an image without motion shows a
rover at rest, whichever of its parts is the ground. The covariance of a kept pose (`Action.KEEP`) always grows by the
unobserved motion since the pose was estimated (`PathState.kept`).

The localiser contains two further consequences: a pair that is refused as `REPEATED_PAIR` has the statistic `repeated`,
and if a new window is refused because of `FEW_LANDMARKS`, the excluded cells age (`State.window_failed`).
"""

assert RULES.keys() == set(Finding), "each finding requires a rule"


class Verdict(NamedTuple):
    """The decision about a pair, and its reason."""

    finding: Finding | None  #: The decisive finding; None without findings.
    action: Action
    reason: StateReason | None  #: Reason of the decisive finding; None without findings.
    inflation: Inflation  #: What all findings together add to the covariance.
    can_be_reference: bool  #: Whether the pair may be a reference for later pairs.
    is_learnt: bool  #: Whether the memory of the ground learns from the pair.

    @property
    def refuses(self) -> bool:
        """Whether the pose of the pair is refused."""
        return self.action in (Action.KEEP, Action.LOSE, Action.LOSE_OR_BEGIN)


def decide(findings: frozenset[Finding]) -> Verdict:
    """Return the verdict on a pair with some findings."""
    if not findings:
        return Verdict(None, Action.ACCEPT, None, Inflation.NONE, can_be_reference=True, is_learnt=True)
    present = [finding for finding in RULES if finding in findings]
    rules = [RULES[finding] for finding in present]
    first = rules[0]
    refusals = [rule for rule in rules if isinstance(rule, Refusal)]
    degradations = [rule for rule in rules if isinstance(rule, Degradation)]
    inflation = Inflation.NONE
    for rule in degradations:
        inflation |= rule.inflation
    return Verdict(
        finding=present[0],
        action=first.action if isinstance(first, Refusal) else Action.DEGRADE,
        reason=first.reason,
        inflation=inflation,
        can_be_reference=all(rule.can_be_reference for rule in degradations),
        is_learnt=not refusals or any(rule.is_learnt for rule in refusals),
    )
