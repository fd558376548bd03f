"""The table of shortfalls: what is expected, what is counted as missing or wrong, and when a result is incomplete.

`SHORTFALLS` has the figures of completeness that count missing, unjudged or wrong data. `EVIDENCE` has the records of a
score that show missing results without limits as well. `judging.incomplete` finds the shortfalls of a score by both
tables. Limits on completeness and the check of stored scores (`raw_values`) follow from `SHORTFALLS`.

To add a shortfall, add its line to `SHORTFALLS` and to `catalogue`, and compute its row (`drive_completeness`,
`completeness`, `copies`). A shortfall with the rule `MISSED` also requires a function in `judging.incomplete`. Scores
that were stored without the row are then refused.

To add a scope, add it to `row_part.Scope`, compute its row `judged`, and state in `judging.limit_scope` which limits
require the scope.
"""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple

from sfr_loc_map.metrics.catalogue import ERRORS_BEYOND, KINDS, STANDING
from sfr_loc_map.metrics.row_part import Scope


class Rule(StrEnum):
    """When a shortfall makes its scope incomplete, so that no limit on the scope passes.

    A limit on the figure itself, or one of `ShortfallKind.accepted_by`, replaces the rule.
    """

    EVIDENT = "evident"  #: With and without limits.
    JUDGED = "judged"  #: If limits judge the scope, and the figure exceeds `most`.
    MISSED = "missed"  #: If the figure exceeds `most`, and a limit is missed by the data that the figure counts.
    STATED = "stated"  #: Only if the figure is limited, but is unknown because the state of a pose is unknown.
    NEVER = "never"  #: The figure can be limited, but is no shortfall otherwise.


class ShortfallKind(NamedTuple):
    """A kind of missing, unjudged or unexpected data of one scope."""

    figure: str  #: Figure of completeness in the catalogue, which counts the data as a fraction of the expected ones.
    scope: Scope | None  #: None for every scope.
    expected: str  #: What the figure is a fraction of.
    rule: Rule
    most: float = 0.0  #: Largest value of the figure for which the scope is complete.
    #: Why the scope is incomplete; `percent`, `value` and `part` (the calls) are inserted. If empty, the text has other
    #: figures as well and is composed by `judging.incomplete`.
    text: str = ""
    unknown: str = ""  #: Why the scope is incomplete if the figure is unknown; if empty, an unknown figure is accepted.
    accepted_by: tuple[str, ...] = ()  #: Limits that accept the shortfall as well as the limit on the figure.
    is_of_expected: bool = False  #: Whether the figure is a fraction of the expected items, as the row `judged`.
    is_wrong: bool = False  #: Whether the counted data are wrong and not only missing.

    @property
    def limit_name(self) -> str:
        """The name of the limit on the figure, and of the verdict that states the shortfall."""
        if self.figure == JUDGED:
            return "judged_share_min"
        is_count = self.figure in KINDS and KINDS[self.figure].is_count
        return f"{self.figure}_max" if is_count else f"{self.figure}_max_share"

    @property
    def has_most(self) -> bool:
        """Whether a value of the figure above `most` is a shortfall."""
        return self.rule in (Rule.JUDGED, Rule.MISSED)

    @property
    def is_lifted_by_partial(self) -> bool:
        """Whether partial judging (`--partial`) accepts the shortfall, which is missing data and no wrong data."""
        return self.rule in (Rule.EVIDENT, Rule.JUDGED) and not self.is_wrong

    def is_accepted_by(self, limit_name: str) -> bool:
        """Return whether a limit of this name replaces the rule."""
        return self.rule is not Rule.STATED and limit_name in (self.limit_name, *self.accepted_by)


JUDGED = "judged"  #: Figure of the fraction of the expected items of a scope that is judged.
ANSWERS = "answers"  #: Name of the evidence of unanswered pairs, which have no figure of their own.
MISSING_SHARE = 0.01  #: Missing fraction of a drive that is evident without limits.
BEYOND_MOST = 0.02  #: Largest fraction of frames whose errors far exceed the judged errors, as in a short loss.
STANDING_MOST = 0.5  #: Largest fraction of the sub-trajectories in which the rover is stationary.
IMAGES = "images, or true poses if the images are unknown"
UNKNOWN_STATE = "it is unknown which poses are {figure}: give the calls of the run (option stats)"
UNKNOWN_ITEMS = ShortfallKind(JUDGED, None, "expected items of the scope, which are unknown", Rule.JUDGED, 1.0)
UNKNOWN_MEMORY = ShortfallKind(
    JUDGED,
    Scope.MEMORY,
    "pairs",
    Rule.JUDGED,
    1.0,
    "the memory of {percent} % of the {part} calls was not measured",
    accepted_by=("calls_missing_max_share",),
)
SHORTFALLS = (
    ShortfallKind("missing", Scope.DRIVE, IMAGES, Rule.JUDGED, 0.0, is_of_expected=True),
    ShortfallKind(
        "images_without_truth",
        Scope.DRIVE,
        IMAGES,
        Rule.JUDGED,
        0.0,
        "{percent} % of the images or true poses have no ground truth, or no true pose at the stamp of their estimate "
        "(option frames=images interpolates the truth)",
        is_of_expected=True,
    ),
    ShortfallKind("lost", Scope.DRIVE, "frames", Rule.STATED, unknown=UNKNOWN_STATE),
    ShortfallKind("degraded", Scope.DRIVE, "frames", Rule.STATED, unknown=UNKNOWN_STATE),
    ShortfallKind("unmatched", Scope.DRIVE, "estimates", Rule.NEVER),
    ShortfallKind("path_without_images", Scope.DRIVE, "path of the ground truth", Rule.NEVER),
    ShortfallKind(
        "doubled",
        Scope.DRIVE,
        "estimates",
        Rule.JUDGED,
        0.0,
        "{percent} % of the estimates have the stamp of another estimate",
        is_wrong=True,
    ),
    ShortfallKind(
        "poses_repeated",
        Scope.DRIVE,
        "frames",
        Rule.JUDGED,
        0.0,
        "{percent} % of the poses repeat the previous pose although the rover moves, and are not reported as lost or "
        "degraded",
    ),
    # not 0, because an estimate that starts at the true pose is near the truth for some steps
    ShortfallKind(
        "poses_of_truth",
        Scope.DRIVE,
        "steps of the moving rover",
        Rule.JUDGED,
        0.1,
        "{percent} % of the steps are those of the ground truth, closer than any measurement: give the estimate of the "
        "item under test",
        is_wrong=True,
    ),
    ShortfallKind(
        "errors_of_truth",
        Scope.DRIVE,
        "judged motions from a start to an end",
        Rule.JUDGED,
        0.1,
        "{percent} % of the judged motions from a start to an end are those of the ground truth, closer than any "
        "measurement: give the estimate of the item under test",
        accepted_by=("poses_of_truth_max_share",),
        is_wrong=True,
    ),
    ShortfallKind(ERRORS_BEYOND, Scope.DRIVE, "frames", Rule.MISSED, BEYOND_MOST),
    ShortfallKind(STANDING, Scope.DRIVE, "sub-trajectories of a time or of frames", Rule.MISSED, STANDING_MOST),
    ShortfallKind(
        "pairs_without_cloud",
        Scope.MAP,
        "mapping pairs",
        Rule.JUDGED,
        0.0,
        "{percent} % of the mapping pairs have no point in the cloud",
        is_of_expected=True,
    ),
    # not 0, because points at the edge of the sky may have no truth
    ShortfallKind(
        "points_without_truth",
        Scope.MAP,
        "map points",
        Rule.JUDGED,
        0.01,
        "{percent} % of the map points have no ground truth",
    ),
    ShortfallKind(
        "points_not_finite", Scope.MAP, "map points", Rule.JUDGED, 0.0, "{percent} % of the map points are not finite"
    ),
    ShortfallKind(
        "points_repeated",
        Scope.MAP,
        "map points",
        Rule.JUDGED,
        0.0,
        "{percent} % of the map points have the pixel or position of another point",
    ),
    # not 0, because no matcher returns a point for every pixel
    ShortfallKind(
        "pixels_without_point",
        Scope.MAP,
        "true pixels in the scored range, worst pair",
        Rule.JUDGED,
        0.5,
        "a mapping pair has no map point at {percent} % of its true pixels in the scored range",
        unknown="no mapping pair has a true pixel in the scored range, so that no point was required",
        accepted_by=("coverage_min",),
    ),
    ShortfallKind(
        "calls_missing",
        Scope.CALLS,
        "pairs",
        Rule.JUDGED,
        0.0,
        "{percent} % of the pairs have no measured {part} call",
        is_of_expected=True,
    ),
    ShortfallKind(
        "calls_other",
        Scope.CALLS,
        "calls",
        Rule.JUDGED,
        0.0,
        "{percent} % of the {part} calls have stamps that the source does not have",
        is_wrong=True,
    ),
    ShortfallKind(
        "calls_doubled",
        Scope.CALLS,
        "calls",
        Rule.JUDGED,
        0.0,
        "{percent} % of the {part} calls belong to the pair of another call",
        is_wrong=True,
    ),
    ShortfallKind(
        "dropped",
        Scope.LIVE,
        "messages",
        Rule.JUDGED,
        0.0,
        "{percent} % of the messages of the live run were dropped",
        is_of_expected=True,
    ),
    ShortfallKind("restarts", Scope.LIVE, "one run", Rule.JUDGED, 0.0, "the live score restarted {value} times"),
)
"""Figures of completeness, in the order of their scopes."""
EVIDENCE = (
    # a larger fraction than `most` of the images is missing, or a gap is longer than a condition (`drive_completeness`)
    ShortfallKind("missing", Scope.DRIVE, IMAGES, Rule.EVIDENT, MISSING_SHARE),
    # the source has more pairs than the cloud and its ground truth
    ShortfallKind("pairs_without_cloud", Scope.MAP, "mapping pairs", Rule.EVIDENT),
    ShortfallKind(
        ANSWERS,
        Scope.DRIVE,
        "pairs published to an external localiser",
        Rule.EVIDENT,
        accepted_by=("missing_max_share",),
    ),
)
"""Evidence of missing results in the records of a score. A shortfall of the same figure states the same results."""
