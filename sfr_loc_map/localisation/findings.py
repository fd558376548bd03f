"""Findings of the guards, and the table that decides what follows from them.

`RULES` lists all findings in the order of precedence: the first one present gives the action and the published reason
of a pair (`decide`). Findings that refuse a pair come first, in the order in which they are checked. A pose whose
findings only degrade it is accepted. Their order decides the published reason alone, because inflations and keyframes
are combined from all findings. What is measured (stale images, a gap, the calibration, sheared rows) comes before what
is inferred from the motions of landmarks, because the former may cause the latter. The published reason is therefore
not always that of the largest inflation.

| findings | found by |
|---|---|
| `REPEATED_PAIR`, `FROZEN_IMAGE`, `STALE_ROWS` | `guards.check_images`, after the comparison in `stale_images` |
| `IDENTICAL_IMAGES` | `guards.check_wiring` |
| `UNTEXTURED`, `FEW_LANDMARKS` | `guards.check_landmarks`, `guards.check_tracks` |
| `CONTRADICTED`, `PARTIAL_TRANSFER`, `DOUBLE_EXPOSURE`, `UNEXPLAINED`, `RECOVERING` | `ground_cases.findings_of` |
| `GROUND_IN_DOUBT`, `AMBIGUOUS` | `ground_cases.findings_of` |
| `SINGULAR`, `TOO_FAST` | `guards.check_pose` |
| `SWAPPED`, `ONE_SIDED` | `guards.check_sides` |
| `AFTER_GAP` | `guards.check_gap` |
| `DIVERGED` | `guards.check_adjustment` |
| `CALIBRATION`, `SHEARED_ROWS` | `guards.check_calibration`, `guards.check_shear` |

A new guard adds a `Finding`, a row in `RULES`, a function in `guards.py`, and its call in the localiser:

- in `_locate` if it needs the images alone, in `_check_pose` if it depends on the pose (a keyframe then repeats it for
  the pose by all landmarks), and in `_judge` otherwise. A new window (`_begin`) checks only landmarks and gap;
- if it needs a memory, the memory is a field of `State`. A memory that learns from poses is handed to `_accept` by the
  `Candidate`, and changes only there. The memory of the ground is handed over by `Ground`.

A guard of the ground's motion is a case of `ground_cases`.
"""

from __future__ import annotations

from enum import Enum, Flag, auto
from typing import Final, NamedTuple

from sfr_loc_map.localisation.estimate import StateReason


class Action(Enum):
    """What happens to a pair."""

    KEEP = auto()  #: The last pose is published again, with a larger covariance. A lost localiser stays lost.
    REJECT = auto()  #: The localiser is lost. No window may begin with the pair.
    RESTART = auto()  #: The localiser is lost. After some good images a new window begins at the last pose.
    DEGRADE = auto()  #: The pose is accepted, or a window begins with the pair, and the state is degraded.
    ACCEPT = auto()  #: The pose is accepted.

    @property
    def refuses(self) -> bool:
        """Whether the pose of the pair is not accepted."""
        return self in (Action.KEEP, Action.REJECT, Action.RESTART)


class Finding(Enum):
    """What a guard may find in a pair."""

    REPEATED_PAIR = auto()  #: Both images are those of the pair before, also swapped or with new noise.
    IDENTICAL_IMAGES = auto()  #: Left and right image are the same image.
    UNTEXTURED = auto()  #: The same as `FEW_LANDMARKS`, and an image has no texture.
    FEW_LANDMARKS = auto()  #: The window has too few landmarks, too few were tracked, or they do not agree on a pose.
    CONTRADICTED = auto()  #: The pose predicts no motion where the image changed.
    SINGULAR = auto()  #: The pose is not finite or not determined.
    TOO_FAST = auto()  #: No rover moves that fast.
    SWAPPED = auto()  #: Left and right image are swapped.
    FROZEN_IMAGE = auto()  #: One image is that of the pair before. It is blanked.
    STALE_ROWS = auto()  #: Some rows are those of the pair before. They are blanked.
    DIVERGED = auto()  #: The adjustment of the keyframe before diverged: its map was given up.
    AFTER_GAP = auto()  #: The window began after a motion that no image showed.
    CALIBRATION = auto()  #: The right camera drifts, or a yaw is still to be corrected.
    SHEARED_ROWS = auto()  #: The rows of the images are of different moments (rolling shutter).
    PARTIAL_TRANSFER = auto()  #: Parts of the images are of different moments, and it is unknown which.
    DOUBLE_EXPOSURE = auto()  #: The exposures of two pairs are blended, and the pose may be that of the earlier one.
    UNEXPLAINED = auto()  #: An unusual fraction of the landmarks does not follow the pose.
    #: An earlier pair had stale rows or a finding of the ground's motion, and few moving pairs have followed since.
    RECOVERING = auto()
    ONE_SIDED = auto()  #: Few inliers are observed in both images although both have texture: one of them may be stale.
    GROUND_IN_DOUBT = auto()  #: One motion was found while the ground is in doubt (`ground_memory.Phase.IN_DOUBT`).
    AMBIGUOUS = auto()  #: Two motions were found, and it is unknown which is the ground's.


Findings = frozenset[Finding]
"""Findings of a pair; the empty set if no guard reports a problem."""


class Inflation(Flag):
    """What a finding adds to the covariance of a pose (`covariance.inflation_of`)."""

    NONE = 0
    #: The motion since the last pose as if no image had shown it, because the images may partly be older. The next
    #: accepted pose no longer contains it.
    SUSPECTED = auto()
    #: The largest of three sizes: the distance to the pose of the other motion, the motion since the last pose as it
    #: was estimated, and that motion as if no image had shown it. All later poses contain it.
    AMBIGUITY = auto()


class Rule(NamedTuple):
    """What follows from a finding."""

    action: Action
    reason: StateReason
    inflation: Inflation = Inflation.NONE
    #: Whether later pairs may be compared with this one: as a keyframe, for recovery, to detect changes. Without a map,
    #: a window only begins with a comparable pair; the localiser is lost after another one.
    is_comparable: bool = True


RULES: Final = {
    # Refused: these pairs have no pose that a keyframe could have.
    Finding.REPEATED_PAIR: Rule(Action.KEEP, StateReason.REPEATED_IMAGES),
    Finding.IDENTICAL_IMAGES: Rule(Action.REJECT, StateReason.NO_STEREO),
    Finding.UNTEXTURED: Rule(Action.RESTART, StateReason.UNTEXTURED_IMAGES),
    Finding.FEW_LANDMARKS: Rule(Action.RESTART, StateReason.FEW_LANDMARKS),
    Finding.CONTRADICTED: Rule(Action.KEEP, StateReason.MOVING_REGIONS),
    Finding.SINGULAR: Rule(Action.RESTART, StateReason.IMPLAUSIBLE_MOTION),
    Finding.TOO_FAST: Rule(Action.RESTART, StateReason.IMPLAUSIBLE_MOTION),
    Finding.SWAPPED: Rule(Action.REJECT, StateReason.NO_STEREO),
    # No keyframe: without the blanked image no landmark can be triangulated.
    Finding.FROZEN_IMAGE: Rule(Action.DEGRADE, StateReason.REPEATED_IMAGES, is_comparable=False),
    # No keyframe: the edges of the blanked rows would be taken for texture.
    Finding.STALE_ROWS: Rule(Action.DEGRADE, StateReason.TORN_IMAGES, is_comparable=False),
    # Keyframe: a window begins with the pair. Later pairs of the window publish the gap.
    Finding.DIVERGED: Rule(Action.DEGRADE, StateReason.IMPLAUSIBLE_MOTION),
    # Keyframe: the images are good, and further keyframes end the finding.
    Finding.AFTER_GAP: Rule(Action.DEGRADE, StateReason.UNSEEN_MOTION),
    # Keyframe: the yaw is estimated by keyframes and would otherwise never be corrected.
    Finding.CALIBRATION: Rule(Action.DEGRADE, StateReason.CALIBRATION_DRIFT),
    # Keyframe: a rolling shutter shears all pairs, and without keyframes tracking would end.
    Finding.SHEARED_ROWS: Rule(Action.DEGRADE, StateReason.TORN_IMAGES, Inflation.SUSPECTED),
    # No keyframe: the parts of the other moment would become landmarks at wrong places.
    Finding.PARTIAL_TRANSFER: Rule(Action.DEGRADE, StateReason.TORN_IMAGES, Inflation.SUSPECTED, is_comparable=False),
    # Keyframe: one exposure dominates, and without keyframes tracking would end.
    Finding.DOUBLE_EXPOSURE: Rule(Action.DEGRADE, StateReason.TORN_IMAGES, Inflation.SUSPECTED),
    # Keyframe: a scene that changes quickly needs new landmarks, and the unexplained ones are removed as outliers.
    Finding.UNEXPLAINED: Rule(Action.DEGRADE, StateReason.TORN_IMAGES, Inflation.SUSPECTED),
    # Keyframe: one motion explains this pair; only the earlier one was not explained.
    Finding.RECOVERING: Rule(Action.DEGRADE, StateReason.TORN_IMAGES, Inflation.SUSPECTED),
    # Keyframe: new landmarks are matched between the two images, which fails where one of them is old.
    Finding.ONE_SIDED: Rule(Action.DEGRADE, StateReason.TORN_IMAGES, Inflation.SUSPECTED),
    # Keyframe: the window continues with the only motion, or the likelier one; the doubt stays in the covariance.
    Finding.GROUND_IN_DOUBT: Rule(Action.DEGRADE, StateReason.MOVING_REGIONS, Inflation.AMBIGUITY),
    Finding.AMBIGUOUS: Rule(Action.DEGRADE, StateReason.MOVING_REGIONS, Inflation.AMBIGUITY),
}
"""What follows from each finding, in the order of precedence.

The published reason is that of the first finding, with one exception: a pair that is kept while the localiser is lost
publishes the reason for which the localiser was lost.

Seven findings publish `torn_images`, because an operator acts on them in the same way: the images may not be entirely
of their stamp. For five of them the pair itself shows signs of it. For `RECOVERING` an earlier pair did, and for
`UNEXPLAINED` a scene that changes quickly is another possible cause. They differ in what is known about it, hence in
the inflation and in the keyframes.

Three findings add nothing to the covariance because the covariance always contains what they report: the yaw with its
standard deviation (`CALIBRATION`), and the start of the window with the motion that no image showed (`AFTER_GAP`,
`DIVERGED`). Two add nothing because the stale parts are known and blanked (`FROZEN_IMAGE`, `STALE_ROWS`). A kept pose
(`Action.KEEP`) is always inflated by the motion since it was estimated (`trajectory.kept`).
"""


class Verdict(NamedTuple):
    """What happens to a pair, and why."""

    finding: Finding | None  #: The finding that decides; None without findings.
    action: Action
    reason: StateReason | None  #: Reason of the finding that decides.
    inflation: Inflation  #: What all findings together add to the covariance.
    is_comparable: bool  #: Whether later pairs may be compared with this one.

    @property
    def refuses(self) -> bool:
        """Whether the pose of the pair is not accepted."""
        return self.action.refuses


NO_FINDING: Final = Verdict(None, Action.ACCEPT, None, Inflation.NONE, is_comparable=True)
"""What happens to a pair without findings."""


def decide(findings: Findings) -> Verdict:
    """Return what follows from the findings of a pair."""
    if not findings:
        return NO_FINDING
    present = [finding for finding in RULES if finding in findings]
    rules = [RULES[finding] for finding in present]
    inflation = Inflation.NONE
    for rule in rules:
        inflation |= rule.inflation
    return Verdict(
        finding=present[0],
        action=rules[0].action,
        reason=rules[0].reason,
        inflation=inflation,
        is_comparable=all(rule.is_comparable for rule in rules),
    )
