"""The shortfalls of what was expected, one line each: of which part, how much of it leaves the part complete, in words.

Limits on completeness and the verdicts on incomplete parts follow from this table; figures are those of the catalogue.
"""

from __future__ import annotations

from typing import NamedTuple

from sfr_loc_map.metrics.catalogue import CALLS, DRIVE, ERRORS_BEYOND, LIVE, MAP, STANDING


class ShortfallKind(NamedTuple):
    """A figure of completeness that counts what could not be judged, or what came in another way than expected."""

    figure: str  #: In the catalogue.
    part: str  #: What it is about: `drive`, `map`, `calls` or `live`.
    #: Largest value with which the part is complete, unless a limit on the figure is given; None: any value.
    most: float | None = None
    text: str = ""  #: Why the part is incomplete, with `percent`, `value` and `part` of the calls.


BEYOND_MOST = 0.02  #: Fraction of the frames that may be wrong between the judged ones, as a short loss is.
STANDING_MOST = 0.5  #: Fraction of the sub-trajectories in which the rover may stand.
SHORTFALLS = (
    ShortfallKind("missing", DRIVE, 0.0),  # in the words of `incomplete.missing_text`
    ShortfallKind(
        "images_without_truth",
        DRIVE,
        0.0,
        "{percent} % of the images or true poses have no ground truth, or none at the stamp of their estimate "
        "(sfr score --frames images interpolates the truth)",
    ),
    ShortfallKind("lost", DRIVE),
    ShortfallKind("degraded", DRIVE),
    ShortfallKind("unmatched", DRIVE),
    ShortfallKind("path_without_images", DRIVE),
    ShortfallKind("doubled", DRIVE, 0.0, "{percent} % of the estimates have the stamp of another estimate"),
    ShortfallKind(
        "poses_repeated",
        DRIVE,
        0.0,
        "{percent} % of the poses repeat the pose before although the rover moves, and are not reported as lost or "
        "degraded",
    ),
    # an estimate that starts at the true pose is near it for a while
    ShortfallKind(
        "poses_of_truth",
        DRIVE,
        0.1,
        "{percent} % of the steps are those of the ground truth, more exactly than any measurement: give the estimate "
        "of the item under test",
    ),
    ShortfallKind(
        "errors_of_truth",
        DRIVE,
        0.1,
        "{percent} % of the judged motions from a start to an end are those of the ground truth, more exactly than any "
        "measurement: give the estimate of the item under test",
    ),
    # in the words of `incomplete.beyond_text`, for each limit that the errors of the other frames miss
    ShortfallKind(ERRORS_BEYOND, DRIVE, BEYOND_MOST),
    # in the words of `incomplete.standing_text`, for each limit that the errors of the moving rover miss
    ShortfallKind(STANDING, DRIVE, STANDING_MOST),
    ShortfallKind("pairs_without_cloud", MAP, 0.0, "{percent} % of the mapping pairs have no point in the cloud"),
    # a few points at the edges of the sky have no truth
    ShortfallKind(
        "points_without_truth", MAP, 0.01, "{percent} % of the map points are where there is no ground truth"
    ),
    ShortfallKind("points_not_finite", MAP, 0.0, "{percent} % of the map points are not finite"),
    ShortfallKind("points_repeated", MAP, 0.0, "{percent} % of the map points are at a pixel that another point has"),
    # no matcher gives every pixel a point
    ShortfallKind(
        "pixels_without_point",
        MAP,
        0.5,
        "a mapping pair has no map point at {percent} % of its true pixels in the scored range",
    ),
    ShortfallKind("calls_missing", CALLS, 0.0, "{percent} % of the pairs have no measured {part} call"),
    ShortfallKind(
        "calls_other", CALLS, 0.0, "{percent} % of the {part} calls are of stamps that the source does not have"
    ),
    ShortfallKind("calls_doubled", CALLS, 0.0, "{percent} % of the {part} calls repeat a stamp"),
    ShortfallKind("dropped", LIVE, 0.0, "{percent} % of the messages of the live run were dropped"),
    ShortfallKind("restarts", LIVE, 0.0, "the live score restarted {value} times"),
)
