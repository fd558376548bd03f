"""The table of shortfalls: when a result is incomplete, one line for each kind of missing or wrong data.

`SHORTFALLS` states for each kind the figure, the largest value of the figure with which the result is complete, with
and without limits, the text, and what accepts the shortfall. `judging.incomplete` compares the row of the figure with
this value (`above_most`); the kinds in its table `FINDERS` depend on more than the row. Limits on completeness, the
deviations of a test report and the table of docs/metrics.md follow from this table.

To add a shortfall, add its line to `SHORTFALLS` and its figure to `catalogue`, and compute the row of the figure in
`expected_items`, or for a drive in `drive`, `copies`, `errors.other_frames` or `errors.standing`.

To add a scope, add it to `row_part.Scope`, compute its row `judged` in `expected_items`, and state in
`judging.limit_scope` which limits require the scope.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from sfr_loc_map.metrics.config import CallKind
from sfr_loc_map.metrics.table.catalogue import (
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
from sfr_loc_map.metrics.table.row_part import Scope


class Acceptance(NamedTuple):
    """What accepts a shortfall besides its own limit."""

    limits: tuple[str, ...] = ()
    """Limits on related figures. The fraction that such a limit allows is also complete for the figure."""
    limits_without_images: tuple[str, ...] = ()
    """Limits that judge the same items for a drive whose images are unknown."""
    of_other_items: bool = False
    """Whether a related limit that allows any fraction accepts each value, because the figure counts other items."""
    partial: bool = True  #: Whether `--partial` accepts the shortfall: missing data, but not wrong data.


NOT_WRONG = Acceptance(partial=False)  #: Wrong data are accepted only by a limit on their figure.


class ShortfallKind(NamedTuple):
    """A kind of missing, unjudged or unexpected data of one scope."""

    figure: str  #: Figure of completeness, which counts the data as a fraction of `expected`.
    scope: Scope | None  #: None for every scope, as of `UNKNOWN_ITEMS`.
    expected: str  #: What the figure is a fraction of.
    #: Largest value of the figure for which the scope is complete, if the score has limits; None for any value.
    most: float | None
    #: Why the scope is incomplete. `percent`, `value`, `part` (the calls) and `covered` (the covered fraction and the
    #: longest gap of a drive) are inserted. Empty if the finder of the kind composes the text.
    text: str = ""
    most_without_limits: float | None = None  #: The largest complete value if the score has no limits.
    accepted_by: Acceptance = Acceptance()
    is_limited: bool = True  #: Whether a limits file can have a limit on the figure.
    is_of_expected: bool = False  #: Whether the figure is a fraction of the expected items, as the row `judged`.
    of_node: CallKind | None = None  #: Calls of the external node whose answers the figure counts; None for others.
    #: Why the scope is incomplete if the figure is a fraction of 0 items; empty if it is complete then, because nothing
    #: of this kind can be missing or wrong.
    text_of_nothing: str = ""

    @property
    def limit_name(self) -> str | None:
        """The name of the limit on the figure; None if the figure cannot be limited."""
        return f"{self.figure}_max_share" if self.is_limited else None

    @property
    def is_complete_without_items(self) -> bool:
        """Whether the scope is complete if the figure is a fraction of 0 items."""
        return not self.text_of_nothing

    def allowed_fraction(self, limit_name: str, limit: float, *, has_images: bool) -> float:
        """Return the fraction that a limit allows for the figure, 0 for a limit on another figure."""
        own = (self.limit_name,) if has_images else (self.limit_name, *self.accepted_by.limits_without_images)
        if limit_name in own:  # the limit judges the items of the figure
            return math.inf
        if limit_name not in self.accepted_by.limits:
            return 0.0
        fraction = 1.0 - limit if limit_name.endswith("_min") else limit
        return math.inf if self.accepted_by.of_other_items and fraction > 0.0 else fraction


BEYOND_MOST = 0.02  #: Largest fraction of frames whose errors far exceed the judged errors, as in a short loss.
STANDING_MOST = 0.5  #: Largest fraction of the sub-trajectories that a stationary rover adds.
IMAGES = "images, or true poses if the images are unknown"
MISSING = ("missing_max_share",)
COVERED = "{covered}"
OF_TRUTH = "equal those of the ground truth more closely than any measurement: give the estimate of the item under test"
UNKNOWN_FIGURE = "the fraction of {title} is unknown"
"""Why a scope is incomplete by a figure that is unknown although there are items."""
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
        accepted_by=Acceptance(("calls_doubled_max_share",), partial=False),
        is_limited=False,
        of_node=node,
    )


SHORTFALLS = (
    # ---- drives
    ShortfallKind("missing", Scope.DRIVE, IMAGES, 0.0, COVERED, is_of_expected=True),
    ShortfallKind(  # not 0 without limits, because the last images of a recording are often not processed
        IN_GAPS,
        Scope.DRIVE,
        "images, or true path",
        0.01,
        COVERED,
        most_without_limits=0.01,
        accepted_by=Acceptance(MISSING),
        is_limited=False,
    ),
    ShortfallKind(
        HIDDEN_CONDITIONS,
        Scope.DRIVE,
        "conditions",
        0.0,
        COVERED,
        most_without_limits=0.0,
        accepted_by=Acceptance(MISSING, of_other_items=True),
        is_limited=False,
    ),
    ShortfallKind(
        UNANSWERED,
        Scope.DRIVE,
        "pairs for an external localiser",
        0.0,
        "{percent} % of the pairs have no answer",
        most_without_limits=0.0,
        accepted_by=Acceptance(MISSING),
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
        accepted_by=Acceptance(limits_without_images=("unmatched_max_share",)),
        is_of_expected=True,
    ),
    ShortfallKind("lost", Scope.DRIVE, "frames", None, accepted_by=NOT_WRONG),
    ShortfallKind("degraded", Scope.DRIVE, "frames", None, accepted_by=NOT_WRONG),
    ShortfallKind("unmatched", Scope.DRIVE, "estimates", None),
    ShortfallKind("path_without_images", Scope.DRIVE, "path of the ground truth", None),
    ShortfallKind(
        "doubled",
        Scope.DRIVE,
        "estimates",
        0.0,
        "{percent} % of the estimates have the stamp of another estimate",
        accepted_by=NOT_WRONG,
    ),
    ShortfallKind(
        "poses_repeated",
        Scope.DRIVE,
        "frames",
        0.0,
        "{percent} % of the poses repeat the previous pose although the rover moves, and are not reported as lost or "
        "degraded",
    ),
    ShortfallKind(  # not 0, because an estimate may equal the truth by chance for some motions
        "poses_of_truth",
        Scope.DRIVE,
        "poses of the moving rover that can be compared",
        0.1,
        f"{{percent}} % of the steps {OF_TRUTH}",
        accepted_by=NOT_WRONG,
    ),
    ShortfallKind(
        "errors_of_truth",
        Scope.DRIVE,
        "long judged motions",
        0.1,
        f"{{percent}} % of the judged motions from a start to an end {OF_TRUTH}",
        accepted_by=Acceptance(("poses_of_truth_max_share",), partial=False),
    ),
    ShortfallKind(ERRORS_BEYOND, Scope.DRIVE, "frames", BEYOND_MOST, accepted_by=NOT_WRONG),
    ShortfallKind(STANDING, Scope.DRIVE, "sub-trajectories", STANDING_MOST, accepted_by=NOT_WRONG),
    answered_twice(Scope.DRIVE, CallKind.LOCALISATION),
    # ---- maps
    ShortfallKind(
        "pairs_without_cloud",
        Scope.MAP,
        "mapping pairs",
        0.0,
        "{percent} % of the mapping pairs have no point in the cloud",
        most_without_limits=0.0,
        is_of_expected=True,
    ),
    ShortfallKind(  # not 0, because points at the edge of the sky may have no truth
        "points_without_truth", Scope.MAP, "map points", 0.01, "{percent} % of the map points have no ground truth"
    ),
    ShortfallKind("points_not_finite", Scope.MAP, "map points", 0.0, "{percent} % of the map points are not finite"),
    ShortfallKind(
        "points_repeated",
        Scope.MAP,
        "map points",
        0.0,
        "{percent} % of the map points have the pixel or position of another point",
    ),
    ShortfallKind(  # not 0, because no matcher returns a point for every pixel
        "pixels_without_point",
        Scope.MAP,
        "true pixels, worst pair",
        0.5,
        "a mapping pair has no map point at {percent} % of its pixels with ground truth in the scored range",
        accepted_by=Acceptance(("coverage_min",)),
        text_of_nothing="no mapping pair has a pixel with ground truth in the scored range, so no point was required",
    ),
    answered_twice(Scope.MAP, CallKind.MAPPING),
    # ---- calls
    ShortfallKind(
        CALLS_MISSING,
        Scope.CALLS,
        "pairs",
        0.0,
        "{percent} % of the pairs have no measured {part} call",
        is_of_expected=True,
    ),
    ShortfallKind(
        "calls_other",
        Scope.CALLS,
        "calls",
        0.0,
        "{percent} % of the {part} calls have stamps that the source does not have",
        accepted_by=NOT_WRONG,
    ),
    ShortfallKind(
        "calls_doubled",
        Scope.CALLS,
        "calls",
        0.0,
        "{percent} % of the {part} calls belong to the pair of another call",
        accepted_by=NOT_WRONG,
    ),
    ShortfallKind(
        UNMEASURED,
        Scope.MEMORY,
        "pairs",
        0.0,
        "the memory of {percent} % of the {part} calls was not measured",
        accepted_by=Acceptance(("calls_missing_max_share",)),
        is_limited=False,
        is_of_expected=True,
    ),
    # ---- live runs
    ShortfallKind(
        "dropped",
        Scope.LIVE,
        "messages",
        0.0,
        "{percent} % of the messages of the live run were dropped",
        is_of_expected=True,
    ),
    ShortfallKind("restarts", Scope.LIVE, "runs", 0.0, "the live score restarted {value} times", is_limited=False),
)
"""The kinds of shortfalls, by subject."""
OF_LIMIT = {kind.limit_name: kind for kind in SHORTFALLS if kind.limit_name is not None}
"""The kind of shortfall of each limit on completeness, by the name of the limit."""
