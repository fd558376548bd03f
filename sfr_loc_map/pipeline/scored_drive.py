"""Estimated poses with their truth: converted as their convention says, and what contradicts the truth still."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from sfr_loc_map.geometry.pose_convention import PoseConvention
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.convention.convention_diagnosis import Diagnosis, diagnose
from sfr_loc_map.metrics.convention.estimate_convention import converted_estimates
from sfr_loc_map.metrics.score import ConventionRecord
from sfr_loc_map.metrics.trajectory.association import Estimates


@dataclass(frozen=True, slots=True, eq=False)
class ScoredDrive:
    """Estimated poses and their truth.

    Attributes:
        estimates: Estimated poses of RB in DS.
        truth: True poses of RB in DS.
        rig: Rig of the localisation cameras, None where it is not known.
    """

    estimates: Estimates
    truth: Trajectory
    rig: StereoRig | None

    @property
    def T_rb_left(self) -> Transform | None:
        """Extrinsics of the left camera, None where they are not known."""
        return None if self.rig is None or self.rig.T_rb_sb is None else self.rig.T_rb_left


@dataclass(frozen=True, slots=True)
class Correction:
    """How an estimate is converted to poses of RB in DS before it is scored.

    Attributes:
        declared: What the user says of its convention.
        apply_diagnosis: Whether the mismatch that the diagnosis finds then is corrected as well.
    """

    declared: PoseConvention = field(default_factory=PoseConvention)
    apply_diagnosis: bool = False

    @property
    def is_wanted(self) -> bool:
        """Whether anything is to be converted."""
        return self.apply_diagnosis or bool(self.declared.settings)


def corrected(
    drive: ScoredDrive, correction: Correction, config: ScoreConfig
) -> tuple[ScoredDrive, ConventionRecord | None]:
    """Return a drive as its convention says, and what was done; None where nothing was.

    Args:
        drive: Estimated poses as they were written.
        correction: How they are converted.
        config: Settings.

    Raises:
        ConfigError: If a frame is declared that the rig does not tell.
        MetricsError: If the world frame cannot be aligned.
    """
    done = ConventionRecord(declared=correction.declared.settings)
    if done.declared:
        drive = _converted(drive, correction.declared)
    found = diagnosis_of(drive, config).found if correction.apply_diagnosis else None
    if found is not None and found.setting:
        drive = _converted(drive, PoseConvention.parse([found.setting]))
        done = replace(done, diagnosed=found.setting, fitted=found.fitted, sentence=found.sentence)
    return drive, None if done == ConventionRecord() else done


def _converted(drive: ScoredDrive, convention: PoseConvention) -> ScoredDrive:
    T_rb_child = convention.T_rb_child(drive.rig)
    return replace(drive, estimates=converted_estimates(drive.estimates, convention, T_rb_child, drive.truth))


def applied_text(convention: ConventionRecord | None) -> tuple[str, ...]:
    """Return the warning that a diagnosis was applied, empty where none was."""
    if convention is None or convention.diagnosed is None:
        return ()
    fitted = "; numbers of it were fitted to the truth, which flatters the figures" if convention.fitted else ""
    return (f"--apply-diagnosis converted the estimate by {convention.diagnosed} before scoring it{fitted}",)


def convention_mismatch(drive: ScoredDrive, config: ScoreConfig) -> str | None:
    """Return in one line which convention mismatch explains the errors, None if none does."""
    found = diagnosis_of(drive, config).found
    if found is None:
        return None
    remedy = f"--convention {found.setting} or --apply-diagnosis corrects it; " if found.setting else ""
    return f"{found.sentence} ({remedy}sfr doctor EST TRUTH tells more)"


def diagnosis_of(drive: ScoredDrive, config: ScoreConfig) -> Diagnosis:
    """Return which single convention mismatch explains how a drive disagrees with its truth."""
    return diagnose(drive.estimates.trajectory, drive.truth, config.trajectory.association, drive.T_rb_left)
