"""Notes below the tables of a score: what the figures mean, and how they were measured."""

from __future__ import annotations

from sfr_loc_map.metrics.conditions import label_of
from sfr_loc_map.metrics.config import Reading
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.score.verdict import Verdict
from sfr_loc_map.report.verdict_view import name_of
from sfr_loc_map.tables.model import UNKNOWN, number

HOST = "host"  #: First word in the names of the host's clocks.
EXACT = "The truth is assumed exact; --set truth.sigma_m=M and truth.sigma_deg=DEG of sfr score set its noise."
NO_INTERVAL = (
    "Only mean + 3 sigma over sub-trajectories has a 95 % interval, if at least two sub-trajectories are independent. "
    "Without an interval no verdict is certain (-)."
)
READINGS = {
    Reading.POSE: "the estimate is re-based at the start by its full pose, then poses are compared",
    Reading.DISPLACEMENT: "displacements in DS, and changes of attitude and heading since the start, are compared as "
    "the specification literally states; an attitude error at the start counts in the position error",
    Reading.POSITION: "the estimate is re-based at the start by its position only; earlier attitude errors count",
}
DS_IS_COMMON = (
    "The readings by displacement and by position compare vectors in DS. They require an estimate that starts "
    "at a true pose (--start truth, initialpose)."
)
OF_EVIDENCE = (
    "Mean + 3 sigma of n independent sub-trajectories exceeds the stated fraction of all position errors with this "
    "confidence, if errors are normally distributed. A dominant axis lowers the confidence."
)
OF_DEADLINE = (
    "The period is the median difference of the stamps of the pairs. Each time is the wall-clock time of one call."
)
OF_STAGES = "Statistics over the calls that ran the stage."
OF_DIRECTIONS = "x, y, z of DS. Means are signed."


def headline_note(score: Score) -> str:
    """Return the explanation of the figures of the specification."""
    note = f"n: sub-trajectories, map points or calls. {NO_INTERVAL} "
    if (drive := score.association) is not None:
        lost, degraded = ("unknown" if count is None else count for count in (drive.lost, drive.degraded))
        note += f"{drive.matched} frames of {drive.estimate_poses} estimates, lost: {lost}, degraded: {degraded}; "
        note += f"re-based by {drive.reading.replace('_', ' ')}. "
        if drive.reading.is_fit:
            note += "Position errors are those of the estimate fitted to the truth. "
    return f"{note}{truth_text(score)}{clock_text(score)}".rstrip()


def covered_note(score: Score) -> str:
    """Return what makes the score incomplete; empty if it is complete."""
    return f"Incomplete: {score.incomplete}." if score.incomplete else ""


def readings_note(score: Score) -> str:
    """Return the definitions of the readings, and the verdicts that depend on them."""
    note = "".join(f"{rebase.capitalize()}: {text}. " for rebase, text in READINGS.items())
    judged = [item for item in score.verdicts if item.by_reading]
    if not judged:
        return note
    said = [f"{name_of(item)}: {readings_text(item)}" for item in judged if len(set(item.by_reading.values())) > 1]
    if not said:
        return note + "Each reading gives the same verdicts."
    return f"{note}The verdict depends on the reading: {'; '.join(said)}. {DS_IS_COMMON}"


def readings_text(item: Verdict) -> str:
    """Return the verdict by each reading of the specification."""
    return ", ".join(f"{state} by {name}" for name, state in item.by_reading.items())


def aligned_note(score: Score) -> str:
    """Return the settings of APE and RPE."""
    if (how := score.alignment) is None:
        return ""
    return (
        f"Alignment: {how.align}. {how.association}, within {how.max_difference_s:g} s. RPE over "
        f"{label_of(how.rpe_delta)}, consecutive. Not figures of the specification."
    )


def map_note(score: Score) -> str:
    """Return the explanation of coverage."""
    if (cloud := score.cloud) is None:
        return ""
    low, high = (number(bound) for bound in cloud.scored_range_m)
    kind = f"The cloud is {cloud.kind}. " if cloud.kind is not None else ""
    return f"{kind}Coverage: fraction of the true points from {low} to {high} m, or in the named range."


def memory_note(score: Score) -> str:
    """Return the method of the memory measurement."""
    return f"Method: {UNKNOWN if score.calls is None else score.calls.memory_method or UNKNOWN}."


def nees_note(score: Score) -> str:
    """Return the explanation of the consistency of the uncertainty."""
    return (
        "value: the expected mean. For consistent covariances, 95 of 100 means are in the interval. If a mean is above "
        "the interval, the estimated sigma is too small; if below, too large. "
        "n: sub-trajectories that do not overlap, or points "
        "of distant blocks. The covariance of our localiser assumes a baseline error within 0.1 %. The sigma of a map "
        "point assumes the errors of baseline, focal length and yaw in mapping.calibration, which are unobservable in "
        f"a pair. {truth_text(score) or EXACT}"
    )


def target_note(score: Score) -> str:
    """Return the name of the target on which calls were measured."""
    if (target := score.target) is None:
        return ""
    method = "" if target.memory_method is None else f" Memory: {target.memory_method}."
    return f"Target and clock: {target.name}.{method}"


def clock_text(score: Score) -> str:
    """Return the clock with which calls were timed, with a remark if this is a clock of the host."""
    clocks = [] if score.calls is None else sorted(set(score.calls.clocks.values()))
    if not clocks:
        return ""
    text = f"Clock: {', '.join(clocks)}."
    if any(clock.startswith(HOST) for clock in clocks):
        target = "" if score.target is None else f", not on {score.target.name}"
        text += f" Host times were measured on the machine of the run{target}."
    return text


def truth_text(score: Score) -> str:
    """Return the properties of a truth with noise or without attitudes; empty for an exact truth."""
    about, said = score.truth, []
    if about is None or about.is_exact:
        return ""
    if about.sigma_m or about.sigma_deg:
        sigmas = ((about.sigma_m, "m"), (about.sigma_deg, "deg"))
        named = ", ".join(f"{number(value)} {unit}" for value, unit in sigmas if value)
        said.append(f"Noise of the truth: {named} (standard deviation along an axis), counted in NEES. ")
    if not about.attitude:
        point = ", ".join(map(number, about.lever_arm_m))
        said.append(f"The truth has no attitudes{f' and refers to a point at {point} m in RB' if point else ''}. ")
        tilt = "" if about.tilt_deg is None else f", a tilt of {number(about.tilt_deg)} deg"
        said.append(f"The estimate was aligned to the truth: yaw {number(about.yaw_deg)} deg{tilt} and a translation. ")
    return "".join(said)
