"""Options of the errors that other tools give: APE (ATE) and RPE after an alignment."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from sfr_loc_map.cli import completion
from sfr_loc_map.errors import ConfigError

if TYPE_CHECKING:
    from sfr_loc_map.metrics.config import AlignedErrorConfig

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


def aligned_config(
    align: str | None, max_difference_s: float | None, rpe_delta: str | None, *, has_poses: bool
) -> AlignedErrorConfig | None:
    """Return the settings of APE and RPE, None where they are not asked for.

    Raises:
        ConfigError: If one is not valid, or there are no poses.
        MetricsError: If the length of a relative error is none.
    """
    from sfr_loc_map.metrics.config import aligned_error_config

    if not has_poses and align is not None:
        raise ConfigError("'--align' is for trajectories: leave it out for a cloud")
    return aligned_error_config(align, {"max_difference_s": max_difference_s, "rpe_delta": rpe_delta})
