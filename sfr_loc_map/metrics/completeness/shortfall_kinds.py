"""The table of shortfalls: what is expected, what is counted as missing or wrong, and when a result is incomplete.

`SHORTFALLS` has one line for each kind of shortfall, with the largest complete value of its figure, with and without
limits. `judging.incomplete` finds the shortfalls of a score: for each line, one function compares the figure with the
largest complete value. Limits on completeness and the deviations of a test report follow from this table.

To add a shortfall, add its line to `SHORTFALLS`, its figure to `catalogue` and its text to `TEXTS`, and compute the row
of the figure. The rows are computed in `expected_items`, and for a drive also in `drive`, `copies`,
`errors.other_frames` and `errors.standing`. A shortfall that depends on more than its figure also has a function in
`judging.incomplete`.

To add a scope, add it to `row_part.Scope`, compute its row `judged`, and state in `judging.limit_scope` which limits
require the scope.
"""

from __future__ import annotations

from typing import NamedTuple

from sfr_loc_map.metrics.table.catalogue import ERRORS_BEYOND, STANDING
from sfr_loc_map.metrics.table.row_part import Scope


class ShortfallKind(NamedTuple):
    """A kind of missing, unjudged or unexpected data of one scope."""

    figure: str  #: Figure of completeness, which counts the data as a fraction of the expected ones.
    scope: Scope | None  #: None for every scope.
    expected: str  #: What the figure is a fraction of.
    #: Largest value of the figure for which the scope is complete, if the score has limits; None for any value.
    most: float | None
    most_without_limits: float | None = None  #: The same if the score has no limits.
    accepted_by: tuple[str, ...] = ()  #: Limits that accept the shortfall, besides the limit on the figure.
    is_lifted_by_partial: bool = True  #: Whether `--partial` accepts the shortfall: missing data, but not wrong data.
    is_limited: bool = True  #: Whether a limits file can have a limit on the figure.
    is_of_expected: bool = False  #: Whether the figure is a fraction of the expected items, as the row `judged`.

    @property
    def limit_name(self) -> str | None:
        """The name of the limit on the figure; None if the figure cannot be limited."""
        return f"{self.figure}_max_share" if self.is_limited else None

    def is_accepted_by(self, limit_name: str) -> bool:
        """Return whether a limit of this name replaces the largest complete value."""
        return self.most is not None and limit_name in (self.limit_name, *self.accepted_by)


JUDGED = "judged"  #: Figure of the fraction of the expected items of a scope that is judged.
IN_GAPS, HIDDEN_CONDITIONS = "in_gaps", "hidden_conditions"
"""Figures of the evident gaps of a drive: their fraction, and that of the conditions that are shorter than a gap."""
UNMEASURED = "unmeasured"  #: Shortfall of the memory of calls, as the row `judged` states it.
UNANSWERED, ANSWERED_TWICE = "unanswered", "answered_twice"
"""Shortfalls of an external node, whose record has their numbers."""
BEYOND_MOST = 0.02  #: Largest fraction of frames whose errors far exceed the judged errors, as in a short loss.
STANDING_MOST = 0.5  #: Largest fraction of the sub-trajectories in which the rover is stationary.
IMAGES = "images, or true poses if the images are unknown"
MISSING, OF_COPIES = ("missing_max_share",), ("poses_of_truth_max_share",)
SHORTFALLS = (
    ShortfallKind(JUDGED, None, "expected items, which are unknown", 1.0, is_limited=False),
    ShortfallKind("missing", Scope.DRIVE, IMAGES, 0.0, is_of_expected=True),
    # not 0 without limits, because the last images of a recording are often not processed
    ShortfallKind(IN_GAPS, Scope.DRIVE, "images, or true path", 0.01, 0.01, MISSING, is_limited=False),
    ShortfallKind(HIDDEN_CONDITIONS, Scope.DRIVE, "conditions", 0.0, 0.0, MISSING, is_limited=False),
    ShortfallKind(UNANSWERED, Scope.DRIVE, "pairs for an external localiser", 0.0, 0.0, MISSING, is_limited=False),
    ShortfallKind("images_without_truth", Scope.DRIVE, IMAGES, 0.0, is_of_expected=True),
    ShortfallKind("lost", Scope.DRIVE, "frames", None, is_lifted_by_partial=False),
    ShortfallKind("degraded", Scope.DRIVE, "frames", None, is_lifted_by_partial=False),
    ShortfallKind("unmatched", Scope.DRIVE, "estimates", None),
    ShortfallKind("path_without_images", Scope.DRIVE, "path of the ground truth", None),
    ShortfallKind("doubled", Scope.DRIVE, "estimates", 0.0, is_lifted_by_partial=False),
    ShortfallKind("poses_repeated", Scope.DRIVE, "frames", 0.0),
    # not 0, because an estimate may equal the truth by chance for some motions
    ShortfallKind("poses_of_truth", Scope.DRIVE, "poses of the moving rover", 0.1, is_lifted_by_partial=False),
    ShortfallKind(
        "errors_of_truth", Scope.DRIVE, "judged motions", 0.1, accepted_by=OF_COPIES, is_lifted_by_partial=False
    ),
    ShortfallKind(ERRORS_BEYOND, Scope.DRIVE, "frames", BEYOND_MOST, is_lifted_by_partial=False),
    ShortfallKind(
        STANDING, Scope.DRIVE, "sub-trajectories over a time or frames", STANDING_MOST, is_lifted_by_partial=False
    ),
    ShortfallKind(
        ANSWERED_TWICE,
        Scope.DRIVE,
        "answers",
        0.0,
        accepted_by=("calls_doubled_max_share",),
        is_lifted_by_partial=False,
        is_limited=False,
    ),
    ShortfallKind("pairs_without_cloud", Scope.MAP, "mapping pairs", 0.0, 0.0, is_of_expected=True),
    # not 0, because points at the edge of the sky may have no truth
    ShortfallKind("points_without_truth", Scope.MAP, "map points", 0.01),
    ShortfallKind("points_not_finite", Scope.MAP, "map points", 0.0),
    ShortfallKind("points_repeated", Scope.MAP, "map points", 0.0),
    # not 0, because no matcher returns a point for every pixel
    ShortfallKind("pixels_without_point", Scope.MAP, "true pixels, worst pair", 0.5, accepted_by=("coverage_min",)),
    ShortfallKind(
        ANSWERED_TWICE,
        Scope.MAP,
        "answers",
        0.0,
        accepted_by=("calls_doubled_max_share",),
        is_lifted_by_partial=False,
        is_limited=False,
    ),
    ShortfallKind("calls_missing", Scope.CALLS, "pairs", 0.0, is_of_expected=True),
    ShortfallKind("calls_other", Scope.CALLS, "calls", 0.0, is_lifted_by_partial=False),
    ShortfallKind("calls_doubled", Scope.CALLS, "calls", 0.0, is_lifted_by_partial=False),
    ShortfallKind("dropped", Scope.LIVE, "messages", 0.0, is_of_expected=True),
    ShortfallKind("restarts", Scope.LIVE, "runs", 0.0, is_limited=False),
    ShortfallKind(UNMEASURED, Scope.MEMORY, "calls", 0.0, accepted_by=("calls_missing_max_share",), is_limited=False),
)
"""The kinds of shortfalls."""
OF_TRUTH = "are those of the ground truth, closer than any measurement: give the estimate of the item under test"
TEXTS = {
    UNANSWERED: "{percent} % of the pairs have no answer",
    ANSWERED_TWICE: "{percent} % of the answers belong to pairs that were answered before",
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
    UNMEASURED: "the memory of {percent} % of the {part} calls was not measured",
    "calls_missing": "{percent} % of the pairs have no measured {part} call",
    "calls_other": "{percent} % of the {part} calls have stamps that the source does not have",
    "calls_doubled": "{percent} % of the {part} calls belong to the pair of another call",
    "dropped": "{percent} % of the messages of the live run were dropped",
    "restarts": "the live score restarted {value} times",
}
"""Why a scope is incomplete by a figure; `percent`, `value` and `part` (the calls) are inserted. `judging.incomplete`
composes the other texts."""
NOTHING_REQUIRED = {
    "pixels_without_point": "no mapping pair has a true pixel in the scored range, so no point was required"
}
"""Why a scope is incomplete by a figure that is unknown because it is a fraction of 0 items. Other figures are accepted
then, because nothing of this kind can be missing or wrong."""
UNKNOWN_FIGURE = "the fraction of {title} is unknown"
"""Why a scope is incomplete by a figure that is unknown although there are items."""
