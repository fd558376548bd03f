"""Conversion of an estimate to poses of RB in DS, and diagnosis of convention mismatches."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from msgspec.structs import replace as struct_replace

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.conventions.convention_diagnosis import Diagnosis, diagnose
from sfr_loc_map.metrics.conventions.pose_convention import PoseConvention
from sfr_loc_map.metrics.figures.records import ConventionRecord
from sfr_loc_map.scoring.inputs import Correction, DriveToScore, Run


def converted_run(run: Run, config: ScoreConfig, correction: Correction) -> Run:
    """Return a run with its estimate converted by the declared or diagnosed convention."""
    if run.drive is None:
        return run
    drive, convention = corrected(run.drive, correction, config)
    return replace(run, drive=drive, convention=convention)


def corrected(
    drive: DriveToScore, correction: Correction, config: ScoreConfig
) -> tuple[DriveToScore, ConventionRecord | None]:
    """Return the converted drive and the record of the conversion; None if nothing was converted."""
    done = ConventionRecord(declared=correction.declared.settings)
    if done.declared:
        drive = drive.converted(correction.declared)
        done = struct_replace(done, fitted=correction.declared.has_fitted_unit)
    found = None
    if correction.apply_diagnosis:
        found = diagnose(drive.estimates.trajectory, drive.truth, config.trajectory.association, drive.rig).found
    if found is not None and found.setting:
        drive = drive.converted(PoseConvention.parse([found.setting]))
        fitted = done.fitted or found.fitted
        done = struct_replace(done, diagnosed=found.setting, fitted=fitted, sentence=found.sentence)
    return drive, None if done == ConventionRecord() else done


class ConventionFinding(NamedTuple):
    """A finding about the conventions of estimate and truth."""

    text: str
    prevents_verdict: bool  #: Whether the figures are meaningless; if not, they are judged as delivered.


def convention_mismatch(drive: DriveToScore, config: ScoreConfig) -> ConventionFinding | None:
    """Return the convention mismatch that explains the disagreement of estimate and truth, with its remedy, or None."""
    association = config.trajectory.association
    found = diagnose(drive.estimates.trajectory, drive.truth, association, drive.rig, every=False).found
    if found is None:
        return None
    remedy = f"--convention {found.setting} or --apply-diagnosis corrects it; " if found.setting else ""
    if not found.prevents_verdict:
        remedy = f"the figures are those of the estimate as delivered; if a clock is wrong, {remedy}"
    text = f"{found.sentence} ({remedy}sfr score EST TRUTH --diagnose shows every hypothesis)"
    return ConventionFinding(text, found.prevents_verdict)


def fitted_unit(convention: ConventionRecord | None) -> ConventionFinding | None:
    """Return why an estimate with a declared factor is not judged; None if the factor is a unit of length."""
    if convention is None or not PoseConvention.parse(convention.declared).has_fitted_unit:
        return None
    text = (
        f"the declared factor of the positions ({', '.join(convention.declared)}) is not a unit of length: a factor "
        "fitted to the ground truth hides a scale error; give a power of ten of a metre, inch, foot or yard"
    )
    return ConventionFinding(text, prevents_verdict=True)


def diagnose_run(run: Run, config: ScoreConfig) -> Diagnosis:
    """Return the diagnosis of the convention mismatch between estimate and truth.

    MetricsError if the run has no trajectories, or if the estimate has only positions.
    """
    drive = run.drive
    if drive is None:
        raise MetricsError("a diagnosis requires an estimated and a true trajectory: give files with poses")
    return diagnose(drive.estimates.trajectory, drive.truth, config.trajectory.association, drive.rig)
