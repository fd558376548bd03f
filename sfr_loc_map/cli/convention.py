"""Options for estimates that are written in another convention."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from sfr_loc_map.errors import ConfigError

if TYPE_CHECKING:
    from sfr_loc_map.pipeline.scoring import Correction

ConventionOption = Annotated[
    list[str] | None,
    typer.Option(
        "--convention",
        metavar="NAME=VALUE",
        help="How the estimate is written, where not as poses of RB in DS: frame=left_optical, world=first_pose, "
        "quaternion=wxyz, inverse=true, metres_per_unit=0.001, ... (docs/metrics.md); repeatable.",
    ),
]
ApplyDiagnosisOption = Annotated[
    bool,
    typer.Option("--apply-diagnosis", help="Correct the convention mismatch that explains the errors, and say so."),
]


def read_correction(convention: list[str] | None, apply_diagnosis: bool, *, has_poses: bool) -> Correction:
    """Return how an estimate is converted before it is scored.

    Args:
        convention: Settings of `--convention`.
        apply_diagnosis: Value of `--apply-diagnosis`.
        has_poses: Whether there are poses to convert.

    Raises:
        ConfigError: If a setting is none, or there are no poses.
    """
    from sfr_loc_map.geometry.pose_convention import PoseConvention
    from sfr_loc_map.pipeline.scoring import Correction

    correction = Correction(PoseConvention.parse(convention or ()), apply_diagnosis)
    if not has_poses and correction != Correction():
        raise ConfigError("'--convention' and '--apply-diagnosis' are for trajectories: leave them out for a cloud")
    return correction
