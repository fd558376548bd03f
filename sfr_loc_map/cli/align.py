"""Options of the errors that other tools give: APE (ATE) and RPE after an alignment."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sfr_loc_map.cli import completion
from sfr_loc_map.errors import ConfigError

if TYPE_CHECKING:
    from sfr_loc_map.metrics.config import AlignedErrorConfig
    from sfr_loc_map.pipeline.scoring import Run

AlignOption = Annotated[
    str | None,
    typer.Option(
        metavar="none|origin|se3|sim3",
        help="Also APE (ATE) and RPE after this alignment; the other figures stay unaligned.",
        autocompletion=completion.words("none", "origin", "se3", "sim3"),
    ),
]
MaxDifferenceOption = Annotated[
    float | None,
    typer.Option(metavar="S", help="Of stamps paired for APE and RPE.", show_default="0.01"),
]
RpeDeltaOption = Annotated[
    str | None,
    typer.Option(metavar="frames=N|distance=M", help="Length of a relative error.", show_default="frames=1"),
]


EvoOption = Annotated[
    Path | None, typer.Option(metavar="F.zip", help="Write the APE as a result of evo, for evo_res; needs --align.")
]
EVO_SUFFIXES = (".zip",)


def aligned_config(
    align: str | None, max_difference_s: float | None, rpe_delta: str | None, evo: Path | None, *, has_poses: bool
) -> AlignedErrorConfig | None:
    """Return the settings of APE and RPE, None where they are not asked for.

    Raises:
        ConfigError: If one is not valid, or there are no poses.
        MetricsError: If the length of a relative error is none.
    """
    from sfr_loc_map.metrics.config import aligned_error_config

    if not has_poses and align is not None:
        raise ConfigError("'--align' is for trajectories: leave it out for a cloud")
    if align is None and evo is not None:
        raise ConfigError("'--evo' writes an APE, which --align none|origin|se3|sim3 asks for")
    return aligned_error_config(align, {"max_difference_s": max_difference_s, "rpe_delta": rpe_delta})


def save_evo(path: Path | None, run: Run, config: AlignedErrorConfig | None) -> None:
    """Write the APE of a run as a result of evo, where `--evo` names a file."""
    from sfr_loc_map.pipeline.evo_export import save_evo_result

    if path is not None and run.drive is not None and config is not None:
        inputs = run.inputs.estimate, run.inputs.truth
        names = {"est_name": str(inputs[0]), "ref_name": str(inputs[1])}
        save_evo_result(path, run.drive.estimates.trajectory, run.drive.truth, config, names)
