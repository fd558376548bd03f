"""The table of shortfalls: figures of completeness that count missing, unjudged or wrong data.

Limits on completeness, the verdicts on incomplete parts (`judging.incomplete`), and the check of the figures of a
stored score (`raw_values`) follow from this table.

To add a shortfall, add its line here and in `catalogue`, and compute its row (`completeness`, `copies`). A shortfall
that depends on the limits (`is_by_limit`) also requires a function in `judging.incomplete`. Scores that were stored
without the row are then refused. A figure without a largest value (`most`) is never short, but can be limited.

To add a part of a score, also add the part to `catalogue`, compute its row `judged`, and state in `judging.limit_scope`
which limits require the part.
"""

from __future__ import annotations

from typing import NamedTuple

from sfr_loc_map.metrics.catalogue import CALLS, DRIVE, ERRORS_BEYOND, LIVE, MAP, STANDING


class ShortfallKind(NamedTuple):
    """A figure of completeness that counts missing, unjudged or unexpected data."""

    figure: str  #: Name in the catalogue.
    part: str  #: Part of the score: `drive`, `map`, `calls` or `live`.
    #: Largest value for which the part is complete, unless a limit on the figure is given; None for any value.
    most: float | None = None
    #: Why the part is incomplete; `percent`, `value` and `part` (of the calls) are inserted. If empty, the text has
    #: other figures as well and is composed by `judging.incomplete`.
    text: str = ""
    unknown: str = ""  #: Why the part is incomplete if the figure is unknown; if empty, an unknown figure is accepted.
    is_of_expected: bool = False  #: Whether the figure is a fraction of the expected items, as the row `judged`.
    is_of_states: bool = False  #: Whether the figure requires the state of each pose, so that a limit on it does, too.
    #: Whether the shortfall also requires a limit that the counted data affect. The part is then incomplete for all its
    #: limits. `judging.incomplete` has a function for each of these figures; `--partial` never accepts them.
    is_by_limit: bool = False
    is_wrong: bool = False  #: Whether the counted data are wrong and not only missing; never accepted by `--partial`.


BEYOND_MOST = 0.02  #: Largest fraction of frames whose errors far exceed the judged errors, as in a short loss.
STANDING_MOST = 0.5  #: Largest fraction of the sub-trajectories in which the rover is stationary.
SHORTFALLS = (
    ShortfallKind("missing", DRIVE, 0.0, is_of_expected=True),
    ShortfallKind(
        "images_without_truth",
        DRIVE,
        0.0,
        "{percent} % of the images or true poses have no ground truth, or no true pose at the stamp of their estimate "
        "(option frames=images interpolates the truth)",
        is_of_expected=True,
    ),
    ShortfallKind("lost", DRIVE, is_of_states=True),
    ShortfallKind("degraded", DRIVE, is_of_states=True),
    ShortfallKind("unmatched", DRIVE),
    ShortfallKind("path_without_images", DRIVE),
    ShortfallKind(
        "doubled", DRIVE, 0.0, "{percent} % of the estimates have the stamp of another estimate", is_wrong=True
    ),
    ShortfallKind(
        "poses_repeated",
        DRIVE,
        0.0,
        "{percent} % of the poses repeat the previous pose although the rover moves, and are not reported as lost or "
        "degraded",
    ),
    # not 0, because an estimate that starts at the true pose is near the truth for some steps
    ShortfallKind(
        "poses_of_truth",
        DRIVE,
        0.1,
        "{percent} % of the steps are those of the ground truth, closer than any measurement: give the estimate of the "
        "item under test",
        is_wrong=True,
    ),
    ShortfallKind(
        "errors_of_truth",
        DRIVE,
        0.1,
        "{percent} % of the judged motions from a start to an end are those of the ground truth, closer than any "
        "measurement: give the estimate of the item under test",
        is_wrong=True,
    ),
    ShortfallKind(ERRORS_BEYOND, DRIVE, BEYOND_MOST, is_by_limit=True),
    ShortfallKind(STANDING, DRIVE, STANDING_MOST, is_by_limit=True),
    ShortfallKind(
        "pairs_without_cloud",
        MAP,
        0.0,
        "{percent} % of the mapping pairs have no point in the cloud",
        is_of_expected=True,
    ),
    # not 0, because points at the edge of the sky may have no truth
    ShortfallKind("points_without_truth", MAP, 0.01, "{percent} % of the map points have no ground truth"),
    ShortfallKind("points_not_finite", MAP, 0.0, "{percent} % of the map points are not finite"),
    ShortfallKind(
        "points_repeated", MAP, 0.0, "{percent} % of the map points have the pixel or position of another point"
    ),
    # not 0, because no matcher returns a point for every pixel
    ShortfallKind(
        "pixels_without_point",
        MAP,
        0.5,
        "a mapping pair has no map point at {percent} % of its true pixels in the scored range",
        unknown="no mapping pair has a true pixel in the scored range, so that no point was required",
    ),
    ShortfallKind(
        "calls_missing", CALLS, 0.0, "{percent} % of the pairs have no measured {part} call", is_of_expected=True
    ),
    ShortfallKind(
        "calls_other",
        CALLS,
        0.0,
        "{percent} % of the {part} calls have stamps that the source does not have",
        is_wrong=True,
    ),
    ShortfallKind(
        "calls_doubled", CALLS, 0.0, "{percent} % of the {part} calls belong to the pair of another call", is_wrong=True
    ),
    ShortfallKind(
        "dropped", LIVE, 0.0, "{percent} % of the messages of the live run were dropped", is_of_expected=True
    ),
    ShortfallKind("restarts", LIVE, 0.0, "the live score restarted {value} times"),
)
