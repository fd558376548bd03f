"""The table of shortfalls: when a result is incomplete, one line for each kind of missing or wrong data.

`SHORTFALLS` states for each kind

- the figure, and the largest value of the figure with which the result is complete,
- its text,
- what accepts the shortfall: the limit on its figure, the limits in `accepted_by`, and `--partial` if `partial`.

`judging.incomplete` evaluates the table. Limits on completeness, the deviations of a test report and the table of
docs/metrics.md follow from `SHORTFALLS`.

To add a shortfall, add its line to `SHORTFALLS` and its figure to `catalogue`, and compute the row of the figure in
`expected_items`, or for a drive in `drive`, `copies`, `trajectory.other_frames` or `trajectory.standing`.

To add a scope, add it to `figures.subjects.Scope`, compute its row `judged` in `expected_items`, and state in
`figures.subjects.SUBJECTS` which limits require the scope.
"""

from __future__ import annotations

import math
from enum import Enum, auto
from typing import NamedTuple

from sfr_loc_map.metrics.config import CallKind
from sfr_loc_map.metrics.figures.catalogue import (
    ANSWERED_TWICE,
    CALLS_MISSING,
    ERRORS_BEYOND,
    HIDDEN_CONDITIONS,
    IN_GAPS,
    JUDGED,
    STANDING,
    UNANSWERED,
    UNMEASURED,
)
from sfr_loc_map.metrics.figures.subjects import Scope


class Allowance(Enum):
    """The largest complete value of the figure of a shortfall, by the bound of a limit on another figure."""

    BOUND = auto()  #: The bound: the limit allows the same fraction.
    REST = auto()  #: 1 minus the bound: the limit requires at least this fraction of the items.
    ANY = auto()  #: Any value, because the limit itself judges the same items.
    #: Any value if the bound is above 0, and 0 if the bound is 0. The limit counts other items than the shortfall, so
    #: its bound is not a fraction of them.
    ANY_IF_POSITIVE = auto()

    def largest(self, bound: float) -> float:
        """Return the largest value of the figure with which a scope is complete, given the bound of a limit.

        Infinity if every value is accepted.
        """
        match self:
            case Allowance.BOUND:
                return bound
            case Allowance.REST:
                return 1.0 - bound
            case Allowance.ANY:
                return math.inf
            case Allowance.ANY_IF_POSITIVE:
                return math.inf if bound > 0.0 else 0.0


class AcceptedBy(NamedTuple):
    """A limit on another figure that accepts a shortfall."""

    limit: str  #: Name of the limit.
    allowance: Allowance
    only_without_images: bool = False  #: Whether the limit accepts the shortfall only if the images are unknown.


class ShortfallKind(NamedTuple):
    """A kind of missing, unjudged or unexpected data of one scope."""

    figure: str  #: Figure of completeness: the data as a fraction of `expected`; for `restarts` a number.
    scope: Scope | None  #: None if the shortfall affects every scope, such as `UNKNOWN_ITEMS`.
    expected: str  #: What the figure is a fraction of.
    #: Largest value with which the scope is complete if the score has limits; None if every value is accepted.
    most: float | None
    #: Why the scope is incomplete; empty if every value is complete. `judging.incomplete` inserts `percent`,
    #: `value`, the calls (`part`) and the missing estimates (`gaps`), and other values into the texts of
    #: shortfalls that each limit on errors can have (`judging.incomplete.OF_EACH_LIMIT`).
    text: str = ""
    is_required_without_limits: bool = False  #: Whether `most` also applies to a score without limits.
    accepted_by: tuple[AcceptedBy, ...] = ()  #: Limits that accept the shortfall, besides the limit on its figure.
    partial: bool = True  #: Whether `--partial` accepts the shortfall: missing data, but not wrong data.
    is_limited: bool = True  #: Whether a limits file can have a limit on the figure.
    of_node: CallKind | None = None  #: Calls of the external node whose answers the figure counts; None for others.
    of_figures: tuple[str, ...] = ()  #: Figures whose limits the shortfall affects; empty for all limits of the scope.
    #: Why a fraction of 0 items makes the scope incomplete; empty if the scope is then complete, because nothing can be
    #: missing or wrong.
    text_of_nothing: str = ""

    @property
    def limit_name(self) -> str | None:
        """The name of the limit on the figure; None if the figure cannot be limited."""
        return f"{self.figure}_max_share" if self.is_limited else None

    @property
    def most_without_limits(self) -> float | None:
        """The largest value with which a scope is complete if the score has no limits; None if every value is."""
        return self.most if self.is_required_without_limits else None

    def allowed_fraction(self, limit_name: str, bound: float, *, has_images: bool) -> float:
        """Return the largest value of the figure with which a limit accepts a scope as complete.

        Infinity if the limit accepts every value, and 0 if the limit does not accept the shortfall. `has_images` states
        whether the images of the drive are known.
        """
        if limit_name == self.limit_name:
            return math.inf
        accepting = [
            each.allowance.largest(bound)
            for each in self.accepted_by
            if each.limit == limit_name and not (has_images and each.only_without_images)
        ]
        return max(accepting, default=0.0)


# The reasons of the thresholds are in docs/decisions/0009-verdicts.md, "Thresholds".
BEYOND = 3.0
"""An error is far larger if it exceeds this multiple of the largest usual judged error, or of a limit."""
BEYOND_MOST = 0.02  #: Largest fraction of frames whose errors far exceed the judged errors, as in a short loss.
STANDING_MOST = 0.5  #: Largest fraction of the sub-trajectories that a stationary rover adds.
IN_GAPS_MOST = 0.01  #: Largest fraction in gaps, because the last images of a recording are often not processed.
COPIES_MOST = 0.1  #: Largest fraction of copies of the truth, because some motions equal the truth by chance.
COPIED_ATTITUDES_MOST = 0.5
"""Largest fraction of copied attitudes. The rotations of a precise gyroscope equal the truth by chance more often, to
within the rounding of the files, and those of copied attitudes nearly always."""
WITHOUT_TRUTH_MOST = 0.01  #: Largest fraction of map points without truth, as at the edges of the sky.
UNCOVERED_MOST = 0.5  #: Largest fraction of pixels without a point, because no matcher matches all pixels.
GAPS = "{gaps}"  #: Text of a shortfall whose cause is missing estimates: the covered fraction and the longest gap.
IMAGES = "images, or true poses if the images are unknown"
MISSING = "missing_max_share"  #: Limit that also accepts shortfalls whose cause is missing estimates.
OF_TRUTH = "equal those of the ground truth more closely than any measurement: give the estimate of the item under test"
UNKNOWN_FIGURE = "the fraction of {title} is unknown"
"""Text if a scope is incomplete because a figure is unknown although there are items."""
UNKNOWN_ITEMS = ShortfallKind(JUDGED, None, "expected items, which are unknown", 1.0, is_limited=False)
"""The shortfall of a scope whose expected items are unknown (`judging.incomplete.unknown_items`)."""


def answered_twice(scope: Scope, node: CallKind) -> ShortfallKind:
    """Return the shortfall that an external node answered pairs several times.

    The first answer to a pair is judged. No figure of the trajectory or the map contains the other answers.
    """
    return ShortfallKind(
        ANSWERED_TWICE,
        scope,
        "answers",
        0.0,
        "{percent} % of the answers belong to pairs that were answered before",
        accepted_by=(AcceptedBy("calls_doubled_max_share", Allowance.BOUND),),
        partial=False,
        is_limited=False,
        of_node=node,
    )


SHORTFALLS = (
    # ---- drives
    ShortfallKind("missing", Scope.DRIVE, IMAGES, 0.0, GAPS),
    ShortfallKind(
        IN_GAPS,
        Scope.DRIVE,
        "images, or true path",
        IN_GAPS_MOST,
        GAPS,
        is_required_without_limits=True,
        accepted_by=(AcceptedBy(MISSING, Allowance.BOUND),),
        is_limited=False,
    ),
    ShortfallKind(
        HIDDEN_CONDITIONS,
        Scope.DRIVE,
        "conditions",
        0.0,
        GAPS,
        is_required_without_limits=True,
        accepted_by=(AcceptedBy(MISSING, Allowance.ANY_IF_POSITIVE),),
        is_limited=False,
    ),
    ShortfallKind(
        UNANSWERED,
        Scope.DRIVE,
        "pairs for an external localiser",
        0.0,
        "{percent} % of the pairs have no answer",
        is_required_without_limits=True,
        accepted_by=(AcceptedBy(MISSING, Allowance.BOUND),),
        is_limited=False,
        of_node=CallKind.LOCALISATION,
    ),
    ShortfallKind(
        "images_without_truth",
        Scope.DRIVE,
        IMAGES,
        0.0,
        "{percent} % of the images (of the poses, if the images are unknown) cannot be judged, because there is no "
        "true pose at their stamp (option frames=images interpolates the truth)",
        # if the images are unknown, this figure counts estimates without truth, which this limit also judges
        accepted_by=(AcceptedBy("unmatched_max_share", Allowance.ANY, only_without_images=True),),
    ),
    ShortfallKind("lost", Scope.DRIVE, "frames", None, partial=False),
    ShortfallKind("degraded", Scope.DRIVE, "frames", None, partial=False),
    ShortfallKind("unmatched", Scope.DRIVE, "estimates", None),
    ShortfallKind("path_without_images", Scope.DRIVE, "path of the ground truth", None),
    ShortfallKind(
        "doubled",
        Scope.DRIVE,
        "estimates",
        0.0,
        "{percent} % of the estimates have the stamp of another estimate",
        partial=False,
    ),
    ShortfallKind(
        "poses_repeated",
        Scope.DRIVE,
        "frames",
        0.0,
        "{percent} % of the poses repeat the previous pose although the rover moves, and are not reported as lost or "
        "degraded",
    ),
    ShortfallKind(
        "poses_interpolated",
        Scope.DRIVE,
        "frames",
        IN_GAPS_MOST,
        "{percent} % of the poses are interpolated between other poses, and are not reported as lost or degraded",
        accepted_by=(AcceptedBy(MISSING, Allowance.BOUND),),
    ),
    ShortfallKind(
        "attitudes_of_truth",
        Scope.DRIVE,
        "attitudes of the turning rover that can be compared",
        COPIED_ATTITUDES_MOST,
        f"{{percent}} % of the rotations {OF_TRUTH}",
        accepted_by=(AcceptedBy("poses_of_truth_max_share", Allowance.BOUND),),
        partial=False,
        of_figures=("attitude", "heading"),
    ),
    ShortfallKind(
        "poses_of_truth",
        Scope.DRIVE,
        "poses of the moving rover that can be compared",
        COPIES_MOST,
        f"{{percent}} % of the steps {OF_TRUTH}",
        partial=False,
    ),
    ShortfallKind(
        "errors_of_truth",
        Scope.DRIVE,
        "long judged motions",
        COPIES_MOST,
        f"{{percent}} % of the judged motions from a start to an end {OF_TRUTH}",
        accepted_by=(AcceptedBy("poses_of_truth_max_share", Allowance.BOUND),),
        partial=False,
    ),
    ShortfallKind(
        ERRORS_BEYOND,
        Scope.DRIVE,
        "frames",
        BEYOND_MOST,
        "{percent} % of the frames have errors far above the judged errors, but no judged sub-trajectory starts or "
        "ends at these frames, because starts are {spacing} frames apart: {statistic} of their {figure} over "
        "{condition} is {value} (limit {limit}); find the cause of these errors",
        partial=False,
    ),
    ShortfallKind(
        STANDING,
        Scope.DRIVE,
        "sub-trajectories",
        STANDING_MOST,
        "{added_by_standing}; of the others, {independent} are "
        "independent, and {statistic} of their {figure} is {value}; these alone do not suffice to meet limit {limit}: "
        "record a longer drive in motion, or allow the fraction by standing_max_share",
        partial=False,
    ),
    answered_twice(Scope.DRIVE, CallKind.LOCALISATION),
    # ---- maps
    ShortfallKind(
        "pairs_without_cloud",
        Scope.MAP,
        "mapping pairs",
        0.0,
        "{percent} % of the mapping pairs have no point in the cloud",
        is_required_without_limits=True,
    ),
    ShortfallKind(
        "points_without_truth",
        Scope.MAP,
        "map points",
        WITHOUT_TRUTH_MOST,
        "{percent} % of the map points have no ground truth",
    ),
    ShortfallKind("points_not_finite", Scope.MAP, "map points", 0.0, "{percent} % of the map points are not finite"),
    ShortfallKind(
        "points_repeated",
        Scope.MAP,
        "map points",
        0.0,
        "{percent} % of the map points repeat another point: its pixel, or without pixels its position or true point",
    ),
    ShortfallKind(
        "pixels_without_point",
        Scope.MAP,
        "true pixels, worst pair",
        UNCOVERED_MOST,
        "a mapping pair has no map point at {percent} % of its pixels with ground truth in the scored range",
        accepted_by=(AcceptedBy("coverage_min", Allowance.REST),),
        text_of_nothing="no mapping pair has a pixel with ground truth in the scored range, so no point was required",
    ),
    answered_twice(Scope.MAP, CallKind.MAPPING),
    # ---- calls
    ShortfallKind(CALLS_MISSING, Scope.CALLS, "pairs", 0.0, "{percent} % of the pairs have no measured {part} call"),
    ShortfallKind(
        "calls_other",
        Scope.CALLS,
        "calls",
        0.0,
        "{percent} % of the {part} calls have stamps that the source does not have",
        partial=False,
    ),
    ShortfallKind(
        "calls_doubled",
        Scope.CALLS,
        "calls",
        0.0,
        "{percent} % of the {part} calls belong to the pair of another call",
        partial=False,
    ),
    ShortfallKind(
        UNMEASURED,
        Scope.MEMORY,
        "pairs",
        0.0,
        "the memory of {percent} % of the {part} calls was not measured",
        accepted_by=(AcceptedBy("calls_missing_max_share", Allowance.BOUND),),
        is_limited=False,
    ),
    # ---- live runs
    ShortfallKind("dropped", Scope.LIVE, "messages", 0.0, "{percent} % of the messages of the live run were dropped"),
    ShortfallKind("restarts", Scope.LIVE, "runs", 0.0, "the live score restarted {value} times", is_limited=False),
    ShortfallKind(
        "publisher_changes",
        Scope.LIVE,
        "topics",
        0.0,
        "changes of the publisher of a scored topic within the run: {value}",
        partial=False,
        is_limited=False,
    ),
    # ---- stored scores
    ShortfallKind(
        "inputs_changed",
        Scope.INPUTS,
        "inputs at their recorded paths",
        0.0,
        "{percent} % of the inputs were changed since the score was made: score again",
        partial=False,
        is_limited=False,
    ),
)
"""The kinds of shortfalls, by subject."""
OF_LIMIT = {kind.limit_name: kind for kind in SHORTFALLS if kind.limit_name is not None}
"""The kind of shortfall of each limit on completeness, by the name of the limit."""
