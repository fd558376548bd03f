"""Check of a drive without a ground truth: its runs, their comparisons, and the figures of each kind of evidence."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import combinations, islice

from msgspec.structs import replace

from sfr_loc_map.evidence.agreement import Agreement, agreement_rows, compare, disagreement_of, shortage_of
from sfr_loc_map.evidence.calibration import CameraOffset, corrected_drive, cost_row, offset_rows, right_camera_offsets
from sfr_loc_map.evidence.check_result import DRIVE, Check, CheckResult
from sfr_loc_map.evidence.localiser_runs import (
    CALIBRATED,
    COMPARED,
    CORRECTED,
    ComparedRun,
    PairsInMemory,
    RunVariant,
    run_pairs,
    run_variant,
)
from sfr_loc_map.evidence.other_estimates import at_pairs_of, check_different, hat_rows, scale_row
from sfr_loc_map.evidence.predicted import predicted_rows
from sfr_loc_map.evidence.revisited import agreement_at, closure_rows, find_closures
from sfr_loc_map.io.sequence import LocSequence
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.message_text import counted
from sfr_loc_map.metrics.conditions import Condition
from sfr_loc_map.metrics.figures.rows import Figure

MIN_PAIRS = 20  #: Minimum number of pairs of a drive.


def check_drive(
    sequence: LocSequence,
    config: LocalisationConfig,
    conditions: Sequence[Condition],
    most_pairs: int,
    others: Sequence[ComparedRun] = (),
    progress: Callable[[], None] = lambda: None,
) -> Check:
    """Run each variant of the localiser over the first pairs of a drive; compare the runs and other estimates.

    A drive of fewer than `MIN_PAIRS` pairs has not enough data, and is not run. The forward run is done first, so that
    an estimate of another drive or clock is refused before the other runs.
    `check_result` states which figures decide the result. `progress` is called after each call of the localiser in the
    variants (`calls_of` gives the number of these calls), but not in direct runs and in the run with the corrected
    calibration.
    """
    drive = PairsInMemory(sequence.rig, list(islice(sequence.pairs(), most_pairs)))
    pairs, pairs_of_source = {DRIVE: len(drive)}, {DRIVE: len(sequence)}
    if len(drive) < MIN_PAIRS:
        shortage = f"the drive has {counted(len(drive), 'pair')}: at least {MIN_PAIRS} are required for a check"
        return Check(pairs=pairs, pairs_of_source=pairs_of_source, figures=(), not_checked=(shortage,))
    forward = run_variant(drive, config, RunVariant.FORWARD, progress)
    others = [at_pairs_of(forward, other) for other in others]
    for first, other in combinations((forward, *others), 2):
        check_different(first, other)
    runs = {RunVariant.FORWARD: forward}
    runs |= {variant: run_variant(drive, config, variant, progress) for variant in RunVariant if variant not in runs}

    closures = find_closures(drive, forward, config)
    agreements = [*_agreements_of(runs, conditions), *([agreement_at(closures)] if closures else [])]

    with_others = [compare(forward, other, condition) for condition in conditions for other in others]
    offsets = right_camera_offsets([runs[variant] for variant in CALIBRATED], sequence.rig)
    wrong_offsets = [offset for offset in offsets if offset.is_wrong]
    figures = (
        *(row for agreement in (*agreements, *with_others) for row in agreement_rows(agreement)),
        *(row for condition in conditions for row in predicted_rows(forward, condition)),
        *(row for closure in closures for row in closure_rows(closure)),
        *(scale_row(forward, other, condition) for condition in conditions for other in others),
        *(row for condition in conditions for row in hat_rows((forward, *others), condition)),
        *(row for offset in offsets for row in offset_rows(offset)),
        *_cost_rows(drive, forward, wrong_offsets, conditions, config),
    )
    check = Check(
        pairs=pairs,
        pairs_of_source=pairs_of_source,
        figures=figures,
        advice={offset.angle: offset.advice for offset in offsets},
        calibration=tuple(offset.text for offset in wrong_offsets),
    )
    result = check.results[DRIVE]
    if result is CheckResult.INCONSISTENT:
        return replace(check, disagreements=(disagreement_of(agreements),))
    if result is CheckResult.NOT_ENOUGH_DATA:
        return replace(check, not_checked=(shortage_of(agreements),))
    return check


def _agreements_of(runs: Mapping[RunVariant, ComparedRun], conditions: Sequence[Condition]) -> Iterator[Agreement]:
    """Yield the comparison of each pair of runs in `COMPARED` over each condition."""
    for condition in conditions:
        for first, other in COMPARED:
            yield compare(runs[first], runs[other], condition)


def _cost_rows(
    drive: PairsInMemory,
    forward: ComparedRun,
    wrong_offsets: Sequence[CameraOffset],
    conditions: Sequence[Condition],
    config: LocalisationConfig,
) -> Iterator[Figure]:
    """Yield how the correction of wrong offsets changes the positions, from an additional run."""
    if not wrong_offsets:
        return
    corrected = run_pairs(drive, config, CORRECTED, corrected_drive(drive, wrong_offsets).kept)
    for condition in conditions:
        yield cost_row(wrong_offsets, compare(forward, corrected, condition))
