"""`sfr check`: consistency of the localisation of a recording, without a truth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import islice

from sfr_loc_map.errors import InputError
from sfr_loc_map.evidence.agreement import (
    PLACES,
    Agreement,
    CheckResult,
    agreement_rows,
    compare,
    result_of,
    scale_row,
    three_cornered_hat,
)
from sfr_loc_map.evidence.calibration import corrected_drive, cost_row, offset_rows, right_camera_offsets
from sfr_loc_map.evidence.item_rows import items_with
from sfr_loc_map.evidence.predicted import predicted_rows
from sfr_loc_map.evidence.revisited import agreement_at, closure_rows, find_closures
from sfr_loc_map.evidence.variants import PairsInMemory, Run, Variant, run_pairs, run_variant
from sfr_loc_map.io.sequence import LocSequence
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.metrics.config import Condition, label_of
from sfr_loc_map.metrics.table import Figure, figure_row
from sfr_loc_map.report.tables import METRE, Cell, Column, Table, fitting

MIN_PAIRS = 20
COMPARED = (
    (Variant.FORWARD, Variant.BACKWARD),
    (Variant.FORWARD, Variant.EVERY_SECOND),
    (Variant.LEFT_HALF, Variant.RIGHT_HALF),
)
"""Runs that are compared with each other."""
CALIBRATED = (Variant.FORWARD, Variant.BACKWARD, Variant.LEFT_HALF, Variant.RIGHT_HALF)
"""Runs that estimate the rotation of the right camera, each from all pairs."""


@dataclass(frozen=True, slots=True)
class Check:
    """Result of the runs over a recording."""

    result: CheckResult
    figures: tuple[Figure, ...]
    agreements: tuple[Agreement, ...]
    forward: Run  #: The run over all pairs in recorded order, as in operation.
    calibration: tuple[str, ...] = ()  #: Large offsets of the calibration, one phrase each.

    @property
    def disagreement(self) -> str:
        """Description of the least probable difference if the runs are inconsistent; otherwise empty."""
        if self.result is not CheckResult.INCONSISTENT:
            return ""
        known = [(item.probability, item) for item in self.agreements if item.probability is not None]
        probability, worst = min(known, key=lambda item: item[0])
        over = worst.condition or PLACES
        return f"{worst.name} over {over} differ by more than their covariances predict (p {probability:.2g})"


def check_drive(
    sequence: LocSequence,
    config: LocalisationConfig,
    conditions: Sequence[Condition],
    most_pairs: int,
    others: Sequence[Run] = (),
    progress: Callable[[], None] = lambda: None,
) -> Check:
    """Run each variant of the localiser over the first pairs of a drive; compare the runs and other estimates."""
    drive = PairsInMemory(sequence.rig, list(islice(sequence.pairs(), most_pairs)))
    if len(drive) < MIN_PAIRS:
        raise InputError(f"the drive has {len(drive)} pairs: a check needs at least {MIN_PAIRS}")
    runs = {variant: run_variant(drive, config, variant, progress) for variant in Variant}
    pairs = [(runs[first], runs[other]) for first, other in COMPARED]
    ours = [compare(first, other, condition) for condition in conditions for first, other in pairs]
    closures = find_closures(drive, runs[Variant.FORWARD], config)
    if closures:
        ours.append(agreement_at(closures))
    theirs = [compare(runs[Variant.FORWARD], other, condition) for condition in conditions for other in others]
    figures = [row for agreement in (*ours, *theirs) for row in agreement_rows(agreement)]
    figures += [row for condition in conditions for row in predicted_rows(runs[Variant.FORWARD], condition)]
    figures += [row for closure in closures for row in closure_rows(closure)]
    figures += [scale_row(agreement) for agreement in theirs]
    if len(others) == 2:
        figures += [row for condition in conditions for row in hat_rows(runs[Variant.FORWARD], others, condition)]
    offsets = right_camera_offsets([runs[variant] for variant in CALIBRATED], sequence.rig)
    figures += [row for offset in offsets for row in offset_rows(offset)]
    wrong = [offset for offset in offsets if offset.is_wrong]
    if wrong:
        corrected = run_pairs(drive, config, "corrected", corrected_drive(drive, wrong).kept)
        moved = [compare(runs[Variant.FORWARD], corrected, condition) for condition in conditions]
        figures += [cost_row(wrong, agreement) for agreement in moved]
    texts = tuple(offset.text for offset in wrong)
    return Check(result_of(ours), tuple(figures), tuple(ours), runs[Variant.FORWARD], texts)


def hat_rows(forward: Run, others: Sequence[Run], condition: Condition) -> list[Figure]:
    """Return the sigma of each of three estimates."""
    pairs = ((forward, others[0]), (forward, others[1]), (others[0], others[1]))
    parts = [compare(first, other, condition).windows.position_m for first, other in pairs]
    count = min(map(len, parts))
    sigmas = three_cornered_hat(*parts) if count > 1 else None
    return [
        figure_row("hat_sigma", condition.setting, run.name, n=count, value=None if sigmas is None else sigmas[number])
        for number, run in enumerate((forward, *others))
    ]


def check_table(figures: Sequence[Figure]) -> Table:
    """Return the comparisons as a table, one line each; the cells name their keys in the figures."""
    titles = ("difference, rmse", "NEES", "expected below", "n", "p", "minimum error of a run")
    columns = (Column("runs", words=True), Column("over", words=True), Column("unit"), *map(Column, titles))
    rows = []
    for item in items_with("difference", figures):
        unit = fitting(METRE, item.number("difference", "rmse"), item.number("error_at_least"))
        rows.append(
            (
                Cell.head(item.part or ""),
                Cell(label_of(item.condition) or PLACES),
                Cell(unit.symbol),
                item.cell("difference", "rmse", unit),
                item.cell("difference_nees", "mean"),
                item.cell("difference_nees", "high95"),
                item.cell("difference_nees", "n"),
                item.cell("agreement"),
                item.cell("error_at_least", unit=unit),
            )
        )
    note = (
        "NEES: squared difference normalised by the covariances of both runs, 6 on average if the covariances are "
        "correct. Errors that both runs share are not included: a wrong calibration is unobservable, and the noise of "
        "common images reduces the difference. At least one of the runs has at least the error in the last column. "
        "p: probability of a difference this large if the covariances are correct."
    )
    return Table("check", "Runs that should agree", columns, tuple(rows), note)


def hat_table(figures: Sequence[Figure]) -> Table:
    """Return the sigmas of three estimates as a table."""
    rows = [
        (
            Cell.head(row.part or ""),
            Cell(label_of(row.condition)),
            Cell("m"),
            Cell.number(row.value, f"figures.{place}.value"),
        )
        for place, row in enumerate(figures)
        if row.figure == "hat_sigma"
    ]
    columns = (Column("estimate", words=True), Column("over", words=True), Column("unit"), Column("sigma"))
    note = (
        "Three-cornered hat: assumes independent errors. Errors that the estimates share, such as those of the "
        "calibration, are hidden."
    )
    return Table("hat", "Three estimates", columns, tuple(rows), note)
