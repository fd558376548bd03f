"""Whether estimate and truth contradict each other by convention, live and of files."""

from __future__ import annotations

from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.metrics.config import AssociationConfig
from sfr_loc_map.metrics.convention import diagnose


def convention_mismatch(
    estimate: Trajectory, truth: Trajectory, association: AssociationConfig, rig: StereoRig | None = None
) -> str | None:
    """Return the convention mismatch that explains how estimate and truth disagree, and its remedy; None without."""
    found = diagnose(estimate, truth, association, rig, every=False).found
    if found is None:
        return None
    remedy = f"--convention {found.setting} or --apply-diagnosis corrects it; " if found.setting else ""
    return f"{found.sentence} ({remedy}sfr score EST TRUTH --diagnose shows every hypothesis)"
