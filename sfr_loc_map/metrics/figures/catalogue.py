"""The catalogue of figures, one line each: the names, clauses and displayed statistics that every view uses.

To add a figure, add its line here, and the text of a new clause in `CLAUSES`. The line of an error of sub-trajectories
also names the function that computes the errors (`compute_errors`). The rows of any other figure are made where its
values are computed. To show one more statistic of a figure, add its name to the line. To add a quantile, add its field
to `metrics.formulas.Statistics`; its name states the percentage (`p99_5`). Any other statistic is computed in
`metrics.formulas.statistics`, and `EXPANSION` of `metrics.judging.limited` states how the error of the truth
affects it. Reports, comparisons, suites, searches, histories, limits, the topics of the monitor and the check of stored
scores then include the figure or statistic. Scores that were stored without a new statistic remain readable.

Plots of the errors of sub-trajectories draw each statistic that is shown or limited. Two things have to be changed
separately:

- the other plots, which draw mean, mean + 3 sigma, p50 and p95,
- the quantiles over the drives of a suite, which is judged by its worst drive.

`shown`, `compared` and `tested` are independent. A statistic that is added to `tested` adds a test to comparisons of
suites and to histories. The paired test of two scores is that of mean + 3 sigma alone, because its interval
(`statistics.intervals`) is that of this statistic.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from enum import Enum, auto

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.metrics.config import CallKind, Reading
from sfr_loc_map.metrics.figures.row_part import (
    ATTITUDE,
    COUNT,
    DIRECTIONS,
    MOVING,
    ON_TARGET,
    OTHER_FRAMES,
    ROTATION,
    TIME,
    Place,
    RowPart,
    distance_of,
)
from sfr_loc_map.metrics.figures.subjects import Subject
from sfr_loc_map.metrics.formulas import QUANTILES
from sfr_loc_map.metrics.other_formulas import chord_error
from sfr_loc_map.metrics.sub_trajectories import SubTrajectories

CLAUSES = {
    "4.1.1": "Sub-trajectories from frame N to the frame N+x at which the condition is met",
    "4.1.2": "Error before the start of a sub-trajectory does not count",
    "4.1.3": "Standard deviation with Bessel's correction",
    "4.2.1": "Time of a localisation call, wall clock on the target",
    "4.2.2": "RAM of a localisation call, by a method that the supplier proposes",
    "4.2.3.1": "3D position error",
    "4.2.3.2": "Attitude error",
    "4.2.3.3": "Heading error",
    "4.3.1": "Time of a mapping call, wall clock on the target",
    "4.3.2": "RAM of a mapping call, by a method that the supplier proposes",
    "4.3.4": "Error of each point of the cloud",
}
"""Clauses of the specification that apply to figures, and their subjects."""
OF_SUB_TRAJECTORIES = ("4.1.1", "4.1.2")  #: Clauses that apply to every error of the trajectory.
STANDARD_DEVIATION = "4.1.3"


class Content(Enum):
    """What the rows of a figure contain."""

    STATISTICS = auto()  #: Statistics of many values.
    FRACTION = auto()  #: One fraction (`value`), which is shown in per cent.
    COUNT = auto()  #: One count (`value`).
    NUMBER = auto()  #: One other number (`value`).


@dataclass(frozen=True, slots=True)
class FigureKind:
    """A figure of the catalogue."""

    name: str  #: Name in the rows of the score.
    subject: Subject
    title: str  #: Displayed name.
    _: KW_ONLY
    clause: str = ""  #: Clause of the specification, see `clause_of`; empty if the specification does not define it.
    unit: str = "1"  #: `m`, `deg`, `px`, `s`, `bytes`, or `1` for counts and fractions.
    #: Statistics of the complete figure that every view shows; if empty, only the detailed tables have the figure.
    shown: tuple[str, ...] = ()
    compared: tuple[str, ...] = ()  #: Statistics of runs that are displayed side by side.
    #: Statistics whose differences between runs are tested, and by the first of which maps are ranked. All tests of a
    #: comparison form one family, so that each further statistic raises the corrected p-values of the others (Holm).
    tested: tuple[str, ...] = ()
    topic: str = ""  #: Topic below `metrics/` on which the monitor publishes the shown statistics; empty for none.
    is_unsigned: bool = False  #: Whether the errors cannot be negative, so their distribution is skewed.
    #: What the rows contain. `STATISTICS` also for evidence, whose rows have either (`Figure.is_one_number`).
    content: Content = Content.STATISTICS
    is_better_if_larger: bool = False  #: Whether a larger value is better, unlike errors, times and memory.
    #: Errors of sub-trajectories, `(M,)` or vectors `(M, d)`, that the figure is about; None for any other figure.
    compute_errors: Callable[[SubTrajectories], FloatArray] | None = None
    axes: tuple[str, ...] = ()
    """If the errors are vectors: for each of their components, the part of the figure `position` that contains this
    component (`horizontal`: x and y). Drives are pooled by axis, because mean vectors of drives cannot be added by
    their norms."""
    is_of_all_readings: bool = False  #: Whether these errors do not depend on the reading of the specification.
    is_without_height: bool = False  #: Whether only scores against a ground truth without heights have the figure.


def of_completeness(name: str, title: str, *, unit: str = "1", content: Content = Content.FRACTION) -> FigureKind:
    """Return a figure of completeness, which is one number and is not in the specification."""
    return FigureKind(name, Subject.COMPLETENESS, title, unit=unit, content=content)


JUDGED = "judged"  #: Fraction of the expected items of a scope that is judged.
IN_GAPS = "in_gaps"  #: Fraction of a drive in evident gaps.
HIDDEN_CONDITIONS = "hidden_conditions"  #: Fraction of the conditions that are shorter than a gap.
CALLS_MISSING = "calls_missing"  #: Fraction of the pairs without a measured call.
UNMEASURED = "unmeasured"  #: Fraction of the pairs whose call has no measured memory.
UNANSWERED = "unanswered"  #: Fraction of the pairs that an external node has not answered.
ANSWERED_TWICE = "answered_twice"  #: Fraction of the answers of an external node to pairs that had an answer.
ERRORS_BEYOND = "errors_beyond"
"""Fraction of the frames whose error far exceeds the judged errors; no judged sub-trajectory starts or ends at them."""
STANDING = "standing"  #: Fraction of the sub-trajectories that a stationary rover adds.
ALIGNED = ("ape", "rpe")  #: Figures of the aligned estimate, which cannot be limited.
REVISITED_PLACES = "revisited places"  #: Label of a comparison that has no condition, in place of the condition.
TOTAL = "mean_plus_3sigma"  #: The statistic that the specification limits.
OF_ERRORS = ("mean", "sigma", TOTAL)  #: Displayed statistics of errors and of the times of API calls.
COMPARED = (TOTAL,)  #: Statistics of errors that are displayed side by side.
TESTED = (TOTAL,)  #: Statistics of errors whose differences between runs are tested.
OF_CALLS = ("mean", "p50", "p95")
ONE_NUMBER = ("value",)
CATALOGUE = (
    # errors of sub-trajectories
    FigureKind(
        "position",
        Subject.TRAJECTORY,
        "position error",
        clause="4.2.3.1",
        unit="m",
        shown=OF_ERRORS,
        compared=COMPARED,
        tested=TESTED,
        topic="position",
        compute_errors=lambda sub_trajectories: sub_trajectories.errors.position_m,
        axes=("x", "y", "z"),
    ),
    FigureKind(
        "attitude",
        Subject.TRAJECTORY,
        "attitude error",
        clause="4.2.3.2",
        unit="deg",
        shown=OF_ERRORS,
        compared=COMPARED,
        tested=TESTED,
        topic="attitude",
        is_unsigned=True,
        compute_errors=lambda sub_trajectories: sub_trajectories.errors.attitude_deg,
    ),
    FigureKind(
        "heading",
        Subject.TRAJECTORY,
        "heading error",
        clause="4.2.3.3",
        unit="deg",
        shown=OF_ERRORS,
        compared=COMPARED,
        tested=TESTED,
        topic="heading",
        compute_errors=lambda sub_trajectories: sub_trajectories.errors.heading_deg,
    ),
    FigureKind(
        "horizontal",
        Subject.TRAJECTORY,
        "horizontal position error",
        unit="m",
        compute_errors=lambda sub_trajectories: sub_trajectories.errors.position_m[:, :2],
        axes=("x", "y"),
        is_without_height=True,
    ),
    FigureKind(
        "chord",
        Subject.TRAJECTORY,
        "chord error",
        unit="m",
        compute_errors=lambda sub_trajectories: chord_error(
            sub_trajectories.poses, sub_trajectories.starts, sub_trajectories.ends
        ),
        is_of_all_readings=True,
    ),
    FigureKind("ape", Subject.TRAJECTORY, "absolute pose error (APE)", unit="m"),
    FigureKind("rpe", Subject.TRAJECTORY, "relative pose error (RPE)", unit="m"),
    # the map; of these figures the specification defines only the point error
    FigureKind(
        "point_error",
        Subject.MAP,
        "point error",
        clause="4.3.4",
        unit="m",
        shown=OF_ERRORS,
        compared=COMPARED,
        tested=TESTED,
        topic="point",
    ),
    FigureKind(
        "nearest_distance",
        Subject.MAP,
        "distance to the nearest true point",
        unit="m",
        shown=OF_ERRORS,
        compared=COMPARED,
        tested=TESTED,
    ),
    FigureKind("disparity_error", Subject.MAP, "disparity error", unit="px"),
    FigureKind(
        "nmad",
        Subject.MAP,
        "height error, normalised median absolute deviation (NMAD)",
        unit="m",
        content=Content.NUMBER,
    ),
    FigureKind("le90", Subject.MAP, "height error, 90 % (LE90)", unit="m", content=Content.NUMBER),
    FigureKind("ce90", Subject.MAP, "horizontal error, 90 % (CE90)", unit="m", content=Content.NUMBER),
    FigureKind(
        "coverage",
        Subject.MAP,
        "coverage",
        shown=ONE_NUMBER,
        compared=ONE_NUMBER,
        content=Content.FRACTION,
        is_better_if_larger=True,
    ),
    FigureKind("points", Subject.MAP, "points of the cloud", compared=ONE_NUMBER, content=Content.COUNT),
    FigureKind("pairs", Subject.MAP, "mapping pairs of the ground truth", content=Content.COUNT),
    FigureKind("maps", Subject.MAP, "maps of the live run", content=Content.COUNT),
    # calls; the specification defines the time on the target, and leaves the method of measuring memory to the supplier
    FigureKind(
        "localisation",
        Subject.TIMING,
        "localisation time",
        clause="4.2.1",
        unit="s",
        shown=OF_ERRORS,
        compared=OF_CALLS,
    ),
    FigureKind(
        "mapping_call",
        Subject.TIMING,
        "mapping call time",
        clause="4.3.1",
        unit="s",
        shown=OF_ERRORS,
        compared=OF_CALLS,
    ),
    FigureKind("mapping", Subject.TIMING, "mapping time", unit="s", compared=OF_CALLS),
    FigureKind("fusion", Subject.TIMING, "fusion time", unit="s", compared=OF_CALLS),
    FigureKind("period", Subject.TIMING, "period of the pairs", unit="s", content=Content.NUMBER),
    FigureKind("within_period", Subject.TIMING, "fraction of calls within the period", content=Content.FRACTION),
    FigureKind(
        "processor_share", Subject.TIMING, "mean time of a call divided by the period", content=Content.FRACTION
    ),
    FigureKind(
        "above_idle",
        Subject.MEMORY,
        "peak memory above the idle process",
        clause="4.2.2",
        unit="bytes",
        shown=ONE_NUMBER,
        compared=ONE_NUMBER,
        content=Content.NUMBER,
    ),
    FigureKind(
        "peak",
        Subject.MEMORY,
        "peak memory",
        clause="4.2.2",
        unit="bytes",
        shown=ONE_NUMBER,
        compared=ONE_NUMBER,
        content=Content.NUMBER,
    ),
    FigureKind(
        "heap_peak",
        Subject.MEMORY,
        "peak of the heap",
        clause="4.2.2",
        unit="bytes",
        compared=ONE_NUMBER,
        content=Content.NUMBER,
    ),
    FigureKind(
        "stack_peak",
        Subject.MEMORY,
        "peak of the stack",
        clause="4.2.2",
        unit="bytes",
        compared=ONE_NUMBER,
        content=Content.NUMBER,
    ),
    # completeness, and the consistency of the covariance: not in the specification
    of_completeness(JUDGED, "judged fraction of the expected items"),
    of_completeness("missing", "missing"),
    of_completeness(IN_GAPS, "evident gaps"),
    of_completeness(HIDDEN_CONDITIONS, "conditions that are shorter than an evident gap"),
    of_completeness("images_without_truth", "images without ground truth"),
    of_completeness("lost", "lost"),
    of_completeness("degraded", "degraded"),
    of_completeness("unmatched", "estimates without ground truth"),
    of_completeness("doubled", "estimates with a repeated stamp"),
    of_completeness("poses_repeated", "poses that repeat the previous pose while moving"),
    of_completeness("poses_interpolated", "poses interpolated between others while moving"),
    of_completeness("attitudes_of_truth", "attitudes that are copies of the ground truth"),
    of_completeness("poses_of_truth", "poses that are copies of the ground truth"),
    of_completeness("errors_of_truth", "judged motions that are copies of the ground truth"),
    of_completeness(ERRORS_BEYOND, "unjudged frames with an error far above the judged ones"),
    of_completeness(STANDING, "sub-trajectories of a stationary rover"),
    of_completeness("path_without_images", "true path without images"),
    of_completeness("longest_gap", "longest gap", unit="m", content=Content.NUMBER),
    of_completeness("points_without_truth", "map points without ground truth"),
    of_completeness("pairs_without_cloud", "mapping pairs without points"),
    of_completeness("points_repeated", "map points at the pixel or position of another"),
    of_completeness("points_not_finite", "map points that are not finite"),
    of_completeness("pixels_without_point", "true pixels without a map point, worst pair"),
    of_completeness(CALLS_MISSING, "pairs without a measured call"),
    of_completeness("calls_other", "calls with stamps that are not in the source"),
    of_completeness("calls_doubled", "calls with a repeated stamp"),
    of_completeness(UNMEASURED, "calls without measured memory"),
    of_completeness(UNANSWERED, "pairs without an answer"),
    of_completeness(ANSWERED_TWICE, "answers to pairs that were answered before"),
    of_completeness("dropped", "messages dropped"),
    of_completeness("restarts", "restarts of the live score", content=Content.COUNT),
    of_completeness("publisher_changes", "changes of the publisher of a scored topic", content=Content.COUNT),
    of_completeness("inputs_changed", "inputs that were changed since the score"),
    FigureKind("truth_error", Subject.CONSISTENCY, "error of the ground truth", unit="m", content=Content.NUMBER),
    FigureKind("nees", Subject.CONSISTENCY, "normalised error squared (NEES)"),
    FigureKind(
        "nees_not_usable",
        Subject.CONSISTENCY,
        "sub-trajectories whose covariance cannot be tested",
        content=Content.NUMBER,
    ),
    FigureKind(
        "nees_from_steps",
        Subject.CONSISTENCY,
        "sub-trajectories tested by the covariance of steps",
        content=Content.NUMBER,
    ),
    # confidence of the figures (metrics.trajectory.trajectory_errors): not in the specification
    FigureKind("confidence", Subject.EVIDENCE, "confidence of mean + 3 sigma"),
    FigureKind("shape", Subject.EVIDENCE, "relative sigma of position errors"),
    FigureKind("normality", Subject.EVIDENCE, "p-value of the normality of position errors"),
    # evidence without a ground truth (package `evidence`): not in the specification
    FigureKind("difference", Subject.EVIDENCE, "difference of positions", unit="m"),
    FigureKind("attitude_difference", Subject.EVIDENCE, "difference of attitudes", unit="deg"),
    FigureKind("difference_nees", Subject.EVIDENCE, "normalised difference squared (NEES)"),
    FigureKind("error_at_least", Subject.EVIDENCE, "minimum error (rmse) of one of the two runs", unit="m"),
    FigureKind("agreement", Subject.EVIDENCE, "p-value of the difference by the covariances"),
    FigureKind("revisited_path", Subject.EVIDENCE, "path between two visits of a place", unit="m"),
    FigureKind("misclosure", Subject.EVIDENCE, "misclosure of the position at a revisited place", unit="m"),
    FigureKind("misclosure_of_path", Subject.EVIDENCE, "misclosure divided by the path"),
    FigureKind("misclosure_nees", Subject.EVIDENCE, "normalised misclosure squared (NEES)"),
    FigureKind("overlap", Subject.EVIDENCE, "overlap of two mapping pairs"),
    FigureKind(
        "overlap_difference", Subject.EVIDENCE, "range difference where two maps overlap (robust rms)", unit="m"
    ),
    FigureKind("overlap_ratio", Subject.EVIDENCE, "ratio of the range difference to the expected difference"),
    FigureKind("overlap_grey", Subject.EVIDENCE, "ratio of the grey level difference to that of shifted images"),
    FigureKind("predicted", Subject.EVIDENCE, "position error by the covariance (rms)", unit="m"),
    FigureKind("predicted_share", Subject.EVIDENCE, "fraction of the mean square position error"),
    FigureKind("predicted_attitude", Subject.EVIDENCE, "attitude error by the covariance (rms)", unit="deg"),
    FigureKind("right_camera", Subject.EVIDENCE, "offset of the right camera from its calibration", unit="px"),
    FigureKind("right_camera_spread", Subject.EVIDENCE, "difference between runs of the offset", unit="px"),
    FigureKind("depth_error", Subject.EVIDENCE, "error of depth by the offset in yaw", unit="m"),
    FigureKind("calibration_cost", Subject.EVIDENCE, "change of positions by a corrected calibration (rmse)", unit="m"),
    FigureKind("scale", Subject.EVIDENCE, "excess of length"),
    FigureKind("hat_sigma", Subject.EVIDENCE, "sigma by the three-cornered hat", unit="m"),
    FigureKind("bound", Subject.EVIDENCE, "tolerance bound"),
)
KINDS: dict[str, FigureKind] = {kind.name: kind for kind in CATALOGUE}
"""The catalogue by the unique names of its figures."""
FITTED = tuple(RowPart(reading) for reading in Reading if reading.is_fit)  #: Readings after an alignment of the drive.
CLAUSES_OF_MEMORY = {CallKind.LOCALISATION: "4.2.2", CallKind.MAPPING_CALL: "4.3.2"}  #: Clauses by the kind of call.
DEFINED = {Subject.TRAJECTORY: ("mean", "sigma", TOTAL), Subject.MAP: ()}
"""Statistics that the specification defines, by subject; any for other subjects. Clause 4.3.4 ends with the error of
one point and defines no statistic. The mean and the standard deviation of 4.1.1 are those of sub-trajectories."""

UNITS_OF_PARTS: dict[tuple[str, RowPart | None], str] = {
    ("ape", ROTATION): "deg",
    ("rpe", ROTATION): "deg",
    ("longest_gap", TIME): "s",
    ("truth_error", ATTITUDE): "deg",
}
"""Units of parts whose unit differs from that of their figure."""


def unit_of_row(figure: str, part: RowPart | None) -> str:
    """Return the unit of the row of a figure and a part."""
    return UNITS_OF_PARTS.get((figure, part), KINDS[figure].unit)


def clause_of(figure: str, part: RowPart | None) -> str:
    """Return the clause that defines a figure of a part; empty if the specification does not define the figure.

    4.2.1 and 4.3.1 define the time of a call on the target, 4.2.2 and 4.3.2 the memory of a call. The specification
    does not define an alignment of the complete drive, stages of a mapping call, times on another host, or the times
    and memory that an external node reports for its own calls. It does not define errors of sub-trajectories along one
    direction. It does not define the parts `moving`, `other frames` and a distance (`5 m`) either, because their
    sub-trajectories are chosen by other rules.
    """
    place = Place.HOST if part is None else part.place
    if figure not in KINDS or part in DIRECTIONS or part in FITTED or place is Place.STATED:
        return ""
    kind = KINDS[figure]
    if kind.subject is Subject.TRAJECTORY and (part in (MOVING, OTHER_FRAMES) or distance_of(part) is not None):
        return ""
    if kind.subject is Subject.TIMING:
        return kind.clause if part == ON_TARGET else ""
    if kind.subject is Subject.MEMORY:
        return "" if part is None or part.call is None else CLAUSES_OF_MEMORY.get(part.call, "")
    return kind.clause


def defines(figure: str, part: RowPart | None, statistic: str) -> bool:
    """Return whether the specification defines this statistic of a figure."""
    if not clause_of(figure, part):
        return False
    subject = KINDS[figure].subject
    return subject not in DEFINED or statistic in DEFINED[subject]


def is_fraction(figure: str, part: str | None = None) -> bool:
    """Return whether the row of a figure and a part is a fraction, which is shown in per cent."""
    return figure in KINDS and KINDS[figure].content is Content.FRACTION and part != COUNT


def title_of(figure: str) -> str:
    """Return the displayed name of a figure."""
    return KINDS[figure].title if figure in KINDS else figure.replace("_", " ")


def statistic_title(statistic: str) -> str:
    """Return the displayed name of a statistic: `mean + 3 sigma` for `mean_plus_3sigma`."""
    if statistic in QUANTILES:
        return f"p{QUANTILES[statistic]:g}"
    return statistic.replace("_plus_3sigma", " + 3 sigma").replace("_", " ")
