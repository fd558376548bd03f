"""The table of shortfalls: figure of completeness, part of the score, largest complete value, and text.

Limits on completeness and the verdicts on incomplete parts follow from this table.
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
    text: str = ""  #: Why the part is incomplete; `percent`, `value` and `part` (of the calls) are inserted.


BEYOND_MOST = 0.02  #: Largest fraction of frames whose errors far exceed the judged errors, as in a short loss.
STANDING_MOST = 0.5  #: Largest fraction of the sub-trajectories in which the rover is stationary.
SHORTFALLS = (
    ShortfallKind("missing", DRIVE, 0.0),  # text by `incomplete.missing_text`
    ShortfallKind(
        "images_without_truth",
        DRIVE,
        0.0,
        "{percent} % of the images or true poses have no ground truth, or no true pose at the stamp of their estimate "
        "(option frames=images interpolates the truth)",
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
    ),
    ShortfallKind(
        "errors_of_truth",
        DRIVE,
        0.1,
        "{percent} % of the judged motions from a start to an end are those of the ground truth, closer than any "
        "measurement: give the estimate of the item under test",
    ),
    # text by `incomplete.beyond_text`, for each limit that the errors at the other frames miss
    ShortfallKind(ERRORS_BEYOND, DRIVE, BEYOND_MOST),
    # text by `incomplete.standing_text`, for each limit that the errors of the moving rover miss
    ShortfallKind(STANDING, DRIVE, STANDING_MOST),
    ShortfallKind("pairs_without_cloud", MAP, 0.0, "{percent} % of the mapping pairs have no point in the cloud"),
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
    ),
    ShortfallKind("calls_missing", CALLS, 0.0, "{percent} % of the pairs have no measured {part} call"),
    ShortfallKind(
        "calls_other", CALLS, 0.0, "{percent} % of the {part} calls have stamps that the source does not have"
    ),
    ShortfallKind("calls_doubled", CALLS, 0.0, "{percent} % of the {part} calls belong to the pair of another call"),
    ShortfallKind("dropped", LIVE, 0.0, "{percent} % of the messages of the live run were dropped"),
    ShortfallKind("restarts", LIVE, 0.0, "the live score restarted {value} times"),
)
