"""The table of shortfalls: what is expected, what is counted as missing or wrong, and when a result is incomplete.

`SHORTFALLS` lists the figures of completeness that count missing, unjudged or wrong data. `EVIDENT` lists the missing
results that the records of a score show without limits as well. `judging.incomplete` finds the shortfalls of a score by
both tables. Limits on completeness and the check of stored scores (`raw_values`) follow from `SHORTFALLS`.

To add a shortfall, add its line to `SHORTFALLS` and to `catalogue`, and compute its row. The rows of a drive are
computed in `drive_completeness`, `copies`, `other_frames` and `standing`, those of maps, calls and live runs in
`completeness`, those of an external node in `calls`, and those of a missing part in `scoring.score_parts`. A shortfall
with the rule `JUDGED` also requires its text in `TEXTS`, and with the rule `MISSED` a function in `judging.incomplete`.
Scores that were stored without the row are then refused.

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
    JUDGED = "judged"  #: If there are limits, and the figure of a scope in `limit_scope.judged_parts` exceeds `most`.
    #: If the figure exceeds `most`, and the errors at the other frames (`errors_beyond`) or of the moving rover
    #: (`standing`) miss a limit. Too few independent errors of the moving rover also count.
    MISSED = "missed"
    STATED = "stated"  #: Only if the figure is limited, but is unknown because the state of a pose is unknown.
    NEVER = "never"  #: The figure can be limited, but is no shortfall otherwise.


class ShortfallKind(NamedTuple):
    """A kind of missing, unjudged or unexpected data of one scope."""

    figure: str  #: Figure of completeness in the catalogue, which counts the data as a fraction of the expected ones.
    scope: Scope | None  #: None for every scope.
    expected: str  #: What the figure is a fraction of.
    rule: Rule
    most: float = 0.0  #: Largest value of the figure for which the scope is complete.
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
ANSWERS = "answers"  #: Name of the shortfall of unanswered pairs, which have no figure of their own.
MISSING_SHARE = 0.01  #: Missing fraction of a drive that is evident without limits.
BEYOND_MOST = 0.02  #: Largest fraction of frames whose errors far exceed the judged errors, as in a short loss.
STANDING_MOST = 0.5  #: Largest fraction of the sub-trajectories in which the rover is stationary.
IMAGES = "images, or true poses if the images are unknown"
SHORTFALLS = (
    ShortfallKind("missing", Scope.DRIVE, IMAGES, Rule.JUDGED, 0.0, is_of_expected=True),
    ShortfallKind("images_without_truth", Scope.DRIVE, IMAGES, Rule.JUDGED, 0.0, is_of_expected=True),
    ShortfallKind("lost", Scope.DRIVE, "frames", Rule.STATED),
    ShortfallKind("degraded", Scope.DRIVE, "frames", Rule.STATED),
    ShortfallKind("unmatched", Scope.DRIVE, "estimates", Rule.NEVER),
    ShortfallKind("path_without_images", Scope.DRIVE, "path of the ground truth", Rule.NEVER),
    ShortfallKind("doubled", Scope.DRIVE, "estimates", Rule.JUDGED, 0.0, is_wrong=True),
    ShortfallKind("poses_repeated", Scope.DRIVE, "frames", Rule.JUDGED, 0.0),
    # not 0, because an estimate that starts at the true pose is near the truth for some steps
    ShortfallKind("poses_of_truth", Scope.DRIVE, "steps of the moving rover", Rule.JUDGED, 0.1, is_wrong=True),
    ShortfallKind(
        "errors_of_truth", Scope.DRIVE, "judged motions", Rule.JUDGED, 0.1, ("poses_of_truth_max_share",), is_wrong=True
    ),
    ShortfallKind(ERRORS_BEYOND, Scope.DRIVE, "frames", Rule.MISSED, BEYOND_MOST),
    ShortfallKind(STANDING, Scope.DRIVE, "sub-trajectories over a time or frames", Rule.MISSED, STANDING_MOST),
    ShortfallKind("pairs_without_cloud", Scope.MAP, "mapping pairs", Rule.JUDGED, 0.0, is_of_expected=True),
    # not 0, because points at the edge of the sky may have no truth
    ShortfallKind("points_without_truth", Scope.MAP, "map points", Rule.JUDGED, 0.01),
    ShortfallKind("points_not_finite", Scope.MAP, "map points", Rule.JUDGED, 0.0),
    ShortfallKind("points_repeated", Scope.MAP, "map points", Rule.JUDGED, 0.0),
    # not 0, because no matcher returns a point for every pixel
    ShortfallKind("pixels_without_point", Scope.MAP, "true pixels, worst pair", Rule.JUDGED, 0.5, ("coverage_min",)),
    ShortfallKind("calls_missing", Scope.CALLS, "pairs", Rule.JUDGED, 0.0, is_of_expected=True),
    ShortfallKind("calls_other", Scope.CALLS, "calls", Rule.JUDGED, 0.0, is_wrong=True),
    ShortfallKind("calls_doubled", Scope.CALLS, "calls", Rule.JUDGED, 0.0, is_wrong=True),
    ShortfallKind("dropped", Scope.LIVE, "messages", Rule.JUDGED, 0.0, is_of_expected=True),
    ShortfallKind("restarts", Scope.LIVE, "runs", Rule.JUDGED, 0.0),
)
"""Figures of completeness, in the order of their scopes."""
EVIDENT = (
    # a larger fraction than `most` of the images is missing, or a gap is longer than a condition (`drive_completeness`)
    ShortfallKind("missing", Scope.DRIVE, IMAGES, Rule.EVIDENT, MISSING_SHARE),
    # the source has more pairs than the cloud and its ground truth
    ShortfallKind("pairs_without_cloud", Scope.MAP, "mapping pairs", Rule.EVIDENT),
    ShortfallKind(ANSWERS, Scope.DRIVE, "pairs for an external localiser", Rule.EVIDENT, 0.0, ("missing_max_share",)),
)
"""Missing results that the records of a score show. A shortfall of the same figure states the same results."""
UNKNOWN_ITEMS = ShortfallKind(JUDGED, None, "expected items, which are unknown", Rule.JUDGED, 1.0)
UNKNOWN_MEMORY = ShortfallKind(JUDGED, Scope.MEMORY, "pairs", Rule.JUDGED, 1.0, ("calls_missing_max_share",))
"""Shortfalls of the judged fraction itself."""
OF_TRUTH = "are those of the ground truth, closer than any measurement: give the estimate of the item under test"
TEXTS = {
    "images_without_truth": "{percent} % of the images or true poses have no ground truth, or no true pose at the "
    "stamp of their estimate (option frames=images interpolates the truth)",
    "doubled": "{percent} % of the estimates have the stamp of another estimate",
    "poses_repeated": "{percent} % of the poses repeat the previous pose although the rover moves, and are not "
    "reported as lost or degraded",
    "poses_of_truth": f"{{percent}} % of the steps {OF_TRUTH}",
    "errors_of_truth": f"{{percent}} % of the judged motions from a start to an end {OF_TRUTH}",
    "pairs_without_cloud": "{percent} % of the mapping pairs have no point in the cloud",
    "points_without_truth": "{percent} % of the map points have no ground truth",
    "points_not_finite": "{percent} % of the map points are not finite",
    "points_repeated": "{percent} % of the map points have the pixel or position of another point",
    "pixels_without_point": "a mapping pair has no map point at {percent} % of its true pixels in the scored range",
    "calls_missing": "{percent} % of the pairs have no measured {part} call",
    "calls_other": "{percent} % of the {part} calls have stamps that the source does not have",
    "calls_doubled": "{percent} % of the {part} calls belong to the pair of another call",
    "dropped": "{percent} % of the messages of the live run were dropped",
    "restarts": "the live score restarted {value} times",
}
"""Why a scope is incomplete by a figure with the rule `JUDGED`; `percent`, `value` and `part` (the calls) are inserted.
`judging.incomplete` composes the text of `missing`, which has other figures as well."""
TEXTS_IF_UNKNOWN = {
    "pixels_without_point": "no mapping pair has a true pixel in the scored range, so no point was required"
}
"""Why a scope is incomplete by an unknown figure with the rule `JUDGED`; any other unknown figure is accepted."""
