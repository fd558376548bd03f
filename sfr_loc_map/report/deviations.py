"""Deviations of a score from the specification, and data of the score that is not judged.

The sentences about a score are classified as follows:

- caveats (`metrics.score.caveats.caveats_of`) restrict the meaning of the figures and are also warnings of the score;
- deviations are the caveats and the sentences of this module;
- anomalies of the test report are the contradiction, the findings, and the warnings that are not caveats.

A deviation concerns the complete score or one verdict (`Deviation.verdict`). To add a deviation, add a function that
yields its sentences, and its line in `OF_SCORE` or `OF_VERDICT`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

from sfr_loc_map.message_stamps import NS_PER_MS, NS_PER_S
from sfr_loc_map.metrics.calls.call_score import STATED_BY_NODE
from sfr_loc_map.metrics.completeness.shortfall_kinds import SHORTFALLS
from sfr_loc_map.metrics.conditions import Condition, ConditionKind, label_of
from sfr_loc_map.metrics.config import SPACING_FRAMES, CallKind, CloudKind, MapScoreConfig, Reading
from sfr_loc_map.metrics.figures.catalogue import (
    ERRORS_BEYOND,
    JUDGED,
    KINDS,
    STANDING,
    TOTAL,
    statistic_title,
    title_of,
)
from sfr_loc_map.metrics.figures.records import REPLAY_RATE, MethodKind
from sfr_loc_map.metrics.figures.row_part import COUNT, MOVING, OTHER_FRAMES, SUB_TRAJECTORIES, calls_part, range_of
from sfr_loc_map.metrics.figures.subjects import Scope, Subject
from sfr_loc_map.metrics.judging.incomplete import limits_missed_at_other_frames, statistic_of
from sfr_loc_map.metrics.judging.limited import tasks_of
from sfr_loc_map.metrics.judging.several_scores import other_recording
from sfr_loc_map.metrics.score.caveats import caveats_of
from sfr_loc_map.metrics.score.limits import COVERAGE_MIN, DEFAULT_TERMS, INDEPENDENT_FOR_VERDICT
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.score.verdict import Verdict
from sfr_loc_map.report.settings import changed_settings, has_all_settings, setting_text
from sfr_loc_map.report.verdict_view import VerdictView
from sfr_loc_map.suite_names import OURS, Task
from sfr_loc_map.tables.model import METRE, exact_number, fitting, number

PATH_WITHOUT_IMAGES = 0.01
"""Fraction of the true path without images that is accepted, because the truth begins and ends near an image."""
HALF_TURN_DEG = 180.0  #: Largest error of attitude and heading, deg.
MAX_STANDING = 0.1  #: Accepted fraction of sub-trajectories with a stationary rover.
TIMES_OF_PAIRS = (CallKind.MAPPING_CALL, CallKind.MAPPING)
"""Calls whose time contains or may contain the mapping of single pairs."""
RETURNING_DISPARITIES = (MethodKind.BUILT_IN, MethodKind.PEER, MethodKind.PYTHON)
"""Kinds of methods that may return disparities for a pair, except the suite's own mapper."""
STAGES = (CallKind.MAPPING, CallKind.FUSION)  #: Calls that are stages of the mapping call of the specification.
CALLS_WITH_FINDINGS = {
    Task.LOCALISATION: (CallKind.LOCALISATION,),
    Task.MAPPING: (CallKind.MAPPING_CALL, CallKind.MAPPING),
}
"""Calls of each task that show which pairs have calls. Findings are recorded with calls, and the states of poses with
the calls of a localiser."""
UNKNOWN_WITHOUT_CALLS = {
    Task.LOCALISATION: "Failures of the method in these calls, and which poses are lost or degraded,",
    Task.MAPPING: "Failures of the method in these calls",
}

SECTIONS_OF_READING = ("topics", "frames", "calibration", "extrinsics", "sync")
"""Sections of `sfr.yaml` that select, pair or interpret the messages of a source (`SourceConfig.changed_reading`)."""
SETTINGS_WITH_A_SENTENCE = frozenset(
    {
        "trajectory.conditions",  # each limit names its condition
        "trajectory.spacing",
        "trajectory.rebase",
        "trajectory.partial",
        "map.scored_from_m",
        "map.scored_to_m",
    }
)
"""Settings of a score that its figures name or that have a deviation of their own."""


class Deviation(NamedTuple):
    """A deviation from the specification, or data that is not judged."""

    text: str  #: Sentences.
    verdict: Verdict | None = None  #: The verdict that deviates; None if the deviation concerns the complete score.
    is_beside_verdict: bool = False  #: Whether a warning, or the line of the verdict of the score, states it, too.


def each_deviation(score: Score) -> Iterator[Deviation]:
    """Yield the deviations of a score: those of the complete score, then those of each verdict."""
    for of_score in OF_SCORE:
        for text in of_score(score):
            yield Deviation(text, is_beside_verdict=of_score in BESIDE_VERDICT)
    for item in score.verdicts:
        for of_verdict in OF_VERDICT:
            for text in of_verdict(item, score):
                yield Deviation(text, item)


def deviations_of(score: Score) -> Iterator[str]:
    """Yield the sentences of the deviations of a score."""
    return (deviation.text for deviation in each_deviation(score))


def deviations_beside_warnings(score: Score) -> tuple[str, ...]:
    """Return the deviations of a judged score that are neither warnings nor stated beside its verdict."""
    if not score.is_judged:
        return ()
    return tuple(item.text for item in each_deviation(score) if not item.is_beside_verdict)


# ---- settings and measurements that differ from the requirements of the specification


def _spacing(score: Score) -> Iterator[str]:
    """Yield a spacing of the sub-trajectories that differs from the recommendation of the specification."""
    association = score.association
    if association is not None and association.spacing_frames != SPACING_FRAMES:
        spacing = association.spacing_frames
        yield f"Sub-trajectories start every {spacing} frames; the specification states {SPACING_FRAMES} [4.1.1]."


def _reading(score: Score) -> Iterator[str]:
    """Yield a reading that differs from the literal reading, with the errors by both readings."""
    association = score.association
    if association is None or association.reading is Reading.DISPLACEMENT:
        return
    compared = []
    for condition in score.conditions:
        used = score.number("position", TOTAL, condition=condition, part=str(association.reading))
        literal = score.number("position", TOTAL, condition=condition, part=str(Reading.DISPLACEMENT))
        if used is None or literal is None:
            continue
        unit = fitting(METRE, used, literal)
        used_text = f"{number(used, unit=unit)} {unit.symbol}"
        literal_text = f"{number(literal, unit=unit)} {unit.symbol}"
        compared.append(f"mean + 3 sigma over {label_of(condition)} {used_text}, by displacements {literal_text}")
    yield (
        f"Errors are computed by the reading '{association.reading}' of the specification, which literally compares "
        f"displacements [4.2.3.1]{': ' if compared else ''}{'; '.join(compared)}."
    )


def _interpolated_truth(score: Score) -> Iterator[str]:
    """Yield the number of frames whose true pose was interpolated."""
    association = score.association
    if association is not None and association.interpolated:
        gap_s = association.largest_gap_ns / NS_PER_S
        yield f"{association.interpolated} frames have an interpolated truth, over gaps of up to {gap_s:.3g} s."


def _caveats(score: Score) -> Iterator[str]:
    """Yield the caveats as sentences."""
    for text in caveats_of(score):
        yield f"{text[0].upper()}{text[1:]}."


def _map_range(score: Score) -> Iterator[str]:
    """Yield ranges of the map that differ from the default ranges, if a verdict depends on them."""
    used = _judged_range(score)
    usual = MapScoreConfig()
    if used is not None and used != (usual.scored_from_m, usual.scored_to_m):
        yield (
            f"Coverage counts true points from {used[0]:g} m to {used[1]:g} m (--range); the default is "
            f"{usual.scored_from_m:g} m to {usual.scored_to_m:g} m."
        )


def _judged_range(score: Score) -> tuple[float, float] | None:
    """Return the range of the coverage, m; None if it is unknown or no verdict is about the map."""
    if score.provenance is None or not any(item.subject is Subject.MAP for item in score.verdicts):
        return None
    from_m = score.provenance.configuration.get("map.scored_from_m")
    to_m = score.provenance.configuration.get("map.scored_to_m")
    return None if from_m is None or to_m is None else (from_m, to_m)


def _points_beyond(score: Score) -> Iterator[str]:
    """Yield how many true pixels beyond the range of the coverage have a point, if a verdict depends on the points."""
    used = _judged_range(score)
    if used is None:
        return
    to_m = used[1]
    beyond = []
    for row in score.rows("coverage"):
        bounds = range_of(row.part)
        if bounds is not None and bounds[0] >= to_m and row.n:
            beyond.append(row)
    pixels = sum(row.n or 0 for row in beyond)
    if pixels:
        share = sum((row.n or 0) * (row.value or 0.0) for row in beyond) / pixels
        yield (
            f"Coverage does not count the {pixels} true pixels beyond {to_m:g} m. The map has points at "
            f"{100.0 * share:.3g} % of them, which are judged; a map without these points has smaller errors."
        )


def _other_settings(score: Score) -> Iterator[str]:
    """Yield the settings of the score that differ from the defaults, if no other deviation is about them.

    Yield one sentence if the settings are unknown.
    """
    if not has_all_settings(score):
        yield "The settings of the score are unknown, so that they may differ from the defaults."
    for item in changed_settings(score):
        if item.is_of_score and item.name not in SETTINGS_WITH_A_SENTENCE:
            yield f"The setting {item.name} is {setting_text(item.value)}; the default is {setting_text(item.default)}."


def _calls(item: Verdict, score: Score) -> Iterator[str]:
    """Yield a sentence on who measured the calls (host, node or target), and one if the limit applies to a stage.

    Calls that were not measured, so that the limited number is undefined, have no deviation.
    """
    if item.value is None:
        return
    is_stated = score.calls is not None and STATED_BY_NODE in score.calls.clocks.values()
    is_on_calls = item.subject in (Subject.TIMING, Subject.MEMORY)
    if is_on_calls and not item.is_of_target:
        on_target = "the specification requires the target [4.2.1, 4.3.1]"
        as_proposed = "the specification leaves the method to the supplier [4.2.2, 4.3.2]"
        how = "was stated by the node and not measured from outside" if is_stated else "was measured on the host"
        yield f"{_name(item)} {how}; {on_target if item.subject is Subject.TIMING else as_proposed}."
    if item.is_of_target:
        yield f"{_name(item)} was stated by the file of the target and not measured by this suite."
    if is_of_stage(item):
        yield f"{_name(item)} concerns a stage. The specification's mapping call makes one cloud of all pairs [4.3.1]."
    if item.figure in TIMES_OF_PAIRS and not item.is_of_target and _may_return_disparities(score):
        yield (
            f"{_name(item)} does not contain the triangulation of disparity images, which this suite computes outside "
            "the call if the method returns disparities instead of points."
        )


def _may_return_disparities(score: Score) -> bool:
    """Return whether the method may return disparity images, because it maps pairs one by one."""
    if score.method is None or score.method.name == OURS:
        return False
    return score.method.kind in RETURNING_DISPARITIES and score.figure(CallKind.MAPPING, part=None) is not None


def is_of_stage(item: Verdict) -> bool:
    """Return whether a verdict is on the time or memory of a stage. For memory, the part of the row names the call."""
    return item.figure in STAGES or (item.part is not None and item.part.call in STAGES)


def _name(item: Verdict) -> str:
    return VerdictView.of(item).title


def _relaxed_limit(item: Verdict, score: Score) -> Iterator[str]:
    """Yield the relaxation of a default by a limit of the limits file."""
    strict = {kind.limit_name: kind.most for kind in SHORTFALLS if kind.most is not None}
    if item.name in strict and item.limit > strict[item.name]:
        default = exact_number(strict[item.name])
        yield f"The limits allow {item.name} {exact_number(item.limit)}; the default is {default}."
    usual_coverage = 1.0 - strict["pixels_without_point_max_share"]
    if item.name == COVERAGE_MIN and item.limit < usual_coverage:
        yield f"The limits require {item.name} {exact_number(item.limit)}; the default is {usual_coverage:g}."
    if (proof := item.proof) is None:
        return
    for name in ("prob", "confidence"):
        used, usual = getattr(proof, name), getattr(DEFAULT_TERMS, name)
        if used < usual:
            yield f"The limits require {name} {exact_number(used)} for {item.name}; the default is {usual:g}."
    if proof.normal:
        yield f"The limits declare that the errors of {item.name} are normal, which the score does not prove."


def _limit_without_motion(item: Verdict, score: Score) -> Iterator[str]:
    """Yield a limit that an estimate without motion meets: an error of the complete distance, or of half a turn.

    On a straight path, the position error of such an estimate is the distance. An error of attitude or heading is at
    most 180 deg. A limit on the standard deviation alone, which is 0 on such a path, is compared with the same values.
    """
    bounds = {"attitude": HALF_TURN_DEG, "heading": HALF_TURN_DEG}
    for each in Condition.parse(item.condition).components if item.condition else ():
        if each.kind in (ConditionKind.DISTANCE, ConditionKind.DISPLACEMENT):
            bounds |= dict.fromkeys(("position", "horizontal", "chord"), each.value)
    least = bounds.get(item.figure or "")
    if least is not None and item.limit >= least:
        unit = KINDS[item.figure or ""].unit
        yield (
            f"{_name(item)} has the limit {exact_number(item.limit)} {unit}, which an estimate without motion can "
            f"meet, because its error is {least:g} {unit}. The limit may be in another unit."
        )


def _relaxed_rules(score: Score) -> Iterator[str]:
    """Yield the relaxations of the rules of judgement by the limits file."""
    rules = score.rules
    if rules is None:
        return
    if rules.partial:
        yield "An incomplete result is judged as if it were complete (--partial)."
    if rules.minimum_independent < INDEPENDENT_FOR_VERDICT:
        least = f"{rules.minimum_independent:g}"
        usual = f"{INDEPENDENT_FOR_VERDICT:g}"
        yield f"The limits require {least} independent sub-trajectories; the default is {usual}."


# ---- data that is not judged, or whose judgement has a condition


def _incomplete(score: Score) -> Iterator[str]:
    """Yield the missing results."""
    if score.incomplete:
        yield f"The expected results are incomplete: {score.incomplete}."


def _lost_and_degraded(score: Score) -> Iterator[str]:
    """Yield the numbers of lost and degraded frames."""
    if (association := score.association) is not None:
        for count, state in ((association.lost, "lost"), (association.degraded, "degraded")):
            if count:
                yield f"{count} of {association.matched} frames are {state}. They are judged like the others."


def _unmatched_estimates(score: Score) -> Iterator[str]:
    """Yield the number of estimates without a true pose."""
    if score.association is not None and (unmatched := score.number("unmatched", part=COUNT)):
        yield f"{unmatched:.0f} estimates have no truth or are not the nearest to an image, and are not judged."


def _images(score: Score) -> Iterator[str]:
    """Yield one sentence if parts of the drive have no images, and another if the images are unknown."""
    if score.association is None:
        return
    without_images = score.number("path_without_images") or 0.0
    if without_images > PATH_WITHOUT_IMAGES:
        yield f"{100.0 * without_images:.3g} % of the true path has no images, so no estimate is expected there."
    if score.association.images is None:
        yield (
            "The images of the drive are unknown. The estimate had to cover only the true poses. Images without an "
            "estimate and without a true pose are not counted."
        )


def _stamps_beside_images(score: Score) -> Iterator[str]:
    """Yield the number of frames whose estimate has another stamp than its image, at which it was not compared."""
    association = score.association
    if association is not None and association.beside_images:
        largest_ms = association.largest_image_difference_ns / NS_PER_MS
        yield (
            f"{association.beside_images} of {association.matched} estimates do not have the stamp of an image; the "
            f"largest difference is {largest_ms:.4g} ms. The specification compares the poses of the images. These "
            "estimates were compared with the ground truth at their own stamps, so that a delay is not measured."
        )


def _standing(score: Score) -> Iterator[str]:
    """Yield the conditions for which a stationary rover adds many sub-trajectories."""
    for row in score.rows(STANDING, part=SUB_TRAJECTORIES):
        if row.value is None or row.value <= MAX_STANDING:
            continue
        moving = score.number("position", TOTAL, condition=row.condition, part=MOVING)
        condition = Condition.parse(row.condition or "")
        share = f"{100.0 * row.value:.3g} %"
        text = f"{condition.added_by_standing(f'{share} of the {row.n} sub-trajectories')}."
        if moving is not None:
            unit = fitting(METRE, moving)
            text += f" Over the others, mean + 3 sigma is {number(moving, unit=unit)} {unit.symbol}."
        yield text


def _duplicates(score: Score) -> Iterator[str]:
    """Yield the numbers of poses that were ignored because of their stamps."""
    association = score.association
    if association is not None and association.estimate_duplicates:
        count = association.estimate_duplicates
        yield f"Estimates that were ignored because a later estimate has the same stamp: {count}."
    if association is not None and association.truth_duplicates:
        count = association.truth_duplicates
        yield f"True poses that were ignored because a later true pose has the same stamp: {count}."


def _unjudged_map(score: Score) -> Iterator[str]:
    """Yield the mapping pairs without points, and the number of points without a true surface."""
    without_cloud = score.figure("pairs_without_cloud", part=COUNT)
    if without_cloud is not None and without_cloud.value:
        yield f"{without_cloud.value:.0f} of {without_cloud.n} mapping pairs have no point in the cloud."
    if without_truth := score.number("points_without_truth", part=COUNT):
        yield f"{without_truth:.0f} points have no ground truth and are not judged."


def _fused_cloud(score: Score) -> Iterator[str]:
    """Yield how the coverage of a fused cloud is counted, if a verdict is on the map."""
    is_limited = any(item.subject is Subject.MAP for item in score.verdicts)
    if is_limited and score.cloud is not None and score.cloud.kind is CloudKind.FUSED:
        yield (
            "The cloud is declared to be fused. A pixel with ground truth is therefore covered if a point of any pair "
            "is within two pixel footprints of its true point, so that a quarter of the points can give full coverage."
        )


def _nearest_only(score: Score) -> Iterator[str]:
    """Yield that the points have no pixels, if a verdict is on the map: their distances underestimate the errors."""
    is_limited = any(item.subject is Subject.MAP for item in score.verdicts)
    if is_limited and score.cloud is not None and score.cloud.nearest_only:
        yield (
            "The pixels of the map points are unknown. Each point was compared with the nearest true point, which is "
            "rarely the observed one, so that the distances underestimate the errors. Points are not weighted by true "
            "point, so that several points at one true point count several times."
        )


def _unknown_calls(score: Score) -> Iterator[str]:
    """Yield the judged tasks whose calls are unknown, completely or in part."""
    if not score.verdicts:
        return
    for task in tasks_of(score):
        found = [score.figure(JUDGED, part=calls_part(Scope.CALLS, kind)) for kind in CALLS_WITH_FINDINGS[task]]
        judged = [row.value for row in found if row is not None]
        if not judged:
            without = UNKNOWN_WITHOUT_CALLS[task]
            yield f"The {task} calls of the run are unknown (option stats). {without} are therefore unknown."
        elif None in judged:
            yield f"It is unknown whether all pairs have a {task} call, because the expected pairs are unknown."
        elif (share := 1.0 - max(value for value in judged if value is not None)) > 0.0:
            text = f"{100.0 * share:.3g} % of the pairs have no measured {task} call."
            yield f"{text} Failures of the method and states of poses at these pairs are unknown."


def _external_node(score: Score) -> Iterator[str]:
    """Yield a sentence if the item under test was not isolated."""
    is_external = score.method is not None and score.method.kind is MethodKind.EXTERNAL
    if score.external is not None or is_external:
        yield "The external node was not isolated: it could read the ground truth from the disk."


def _rate_of_replay(score: Score) -> Iterator[str]:
    """Yield the rate of a replay if a limit is on the times of an external node, which may work between its answers."""
    if score.external is None or score.provenance is None:
        return
    rate = score.provenance.configuration.get(REPLAY_RATE)
    if rate is not None and any(item.subject is Subject.TIMING for item in score.verdicts):
        yield (
            f"The pairs were played at {rate:g} times the recorded speed (--rate). The processing of the external node "
            "after its answer to a pair is not measured; with --rate 0 the next answer would be later."
        )


def _frames_beyond(score: Score) -> Iterator[str]:
    """Yield the fraction of the frames with errors far above the judged errors, by condition and figure."""
    for condition in score.conditions:
        for share in score.rows(ERRORS_BEYOND, condition=condition):
            if not share.value or share.part is None:
                continue
            others = score.figure(share.part, condition=condition, part=OTHER_FRAMES)
            largest = None if others is None else others.max
            size = "" if largest is None or others is None else f" up to {largest:.3g} {others.unit}"
            yield (
                f"{100.0 * share.value:.3g} % of all frames have a {share.part} error{size}, far above the judged "
                f"errors, and are not judged: no judged sub-trajectory over {label_of(condition)} starts or ends there."
            )


def _limits_missed_at_other_frames(score: Score) -> Iterator[str]:
    """Yield a sentence for each limit that is missed by errors at frames outside the judged sub-trajectories' ends.

    `judging.incomplete.missed_at_other_frames` states when these errors also prevent a pass.
    """
    spacing = 1 if score.association is None else score.association.spacing_frames
    for limit, others, value in limits_missed_at_other_frames(score):
        yield (
            f"No judged sub-trajectory over {label_of(limit.condition)} starts or ends at {others.n} frames, because "
            f"starts are {spacing} frames apart. There, {statistic_title(statistic_of(limit))} of the "
            f"{title_of(limit.limited.figure)}, relative to the nearest judged frame, is {value:.4g} {others.unit}, "
            f"which misses the limit of {exact_number(limit.limit)} {others.unit}. --spacing 1 judges all frames."
        )


def _origin_of_truth(score: Score) -> Iterator[str]:
    """Yield how the ground truth differs from that of a single recording.

    `TruthRecord.declared` contains a topic or frame that selects the poses (`truth.source`, `truth.frame`). A file that
    `truth.source` names is an input of the provenance instead.
    """
    if score.truth is not None and score.truth.declared:
        yield f"The ground truth was read with {', '.join(score.truth.declared)}; the recording does not state this."
    if (made := score.provenance) is None:
        return
    if (file := made.inputs.get("truth_file")) is not None:
        yield f"The true poses are those of '{file.path}' (truth.source), not those of the recording."
    if (pair := other_recording([made])) is not None:
        drive, map_truth = (file.path for file in pair)
        yield f"The drive and the map come from different recordings: '{drive}' and '{map_truth}'."


def _reading_of_source(score: Score) -> Iterator[str]:
    """Yield the settings of `sfr.yaml` that select, pair or interpret the messages of the source."""
    used = [
        f"{item.name} {setting_text(item.value)}"
        for item in changed_settings(score)
        if item.name.partition(".")[0] in SECTIONS_OF_READING
    ]
    if used:
        yield f"The source was not read by its own topics, stamps and calibration alone, but with {', '.join(used)}."


def _converted_poses(score: Score) -> Iterator[str]:
    """Yield the conversion of the poses before scoring."""
    if score.convention is not None:
        by_user = ", ".join(score.convention.declared)
        yield f"The poses were converted before scoring by {by_user or score.convention.diagnosed}."


OF_SCORE: tuple[Callable[[Score], Iterator[str]], ...] = (
    _spacing,
    _reading,
    _interpolated_truth,
    _caveats,
    _map_range,
    _points_beyond,
    _other_settings,
    _relaxed_rules,
    _incomplete,
    _lost_and_degraded,
    _unmatched_estimates,
    _images,
    _stamps_beside_images,
    _standing,
    _duplicates,
    _unjudged_map,
    _fused_cloud,
    _nearest_only,
    _unknown_calls,
    _frames_beyond,
    _limits_missed_at_other_frames,
    _external_node,
    _rate_of_replay,
    _origin_of_truth,
    _reading_of_source,
    _converted_poses,
)
"""Deviations of a complete score, in the order of the test report."""
BESIDE_VERDICT = frozenset({_caveats, _incomplete})  #: The deviations that warnings or the verdict state, too.
OF_VERDICT: tuple[Callable[[Verdict, Score], Iterator[str]], ...] = (_calls, _relaxed_limit, _limit_without_motion)
"""Deviations of a verdict."""
