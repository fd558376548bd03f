"""`sfr plot`: a quick figure of trajectories."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sfr_loc_map.cli import completion
from sfr_loc_map.cli.app import app, examples
from sfr_loc_map.cli.output import HTML_SUFFIXES, OverwriteOption, check_outputs, check_suffix, say

PNG = ".png"


@app.command(
    epilog=examples(
        "sfr plot estimate.csv other.tum --truth data/ -o paths.html",
        "sfr plot 00.kitti --truth poses/00.txt --align se3 -o paths.png",
        "sfr plot estimate.csv -o path.png",
    )
)
def plot(
    trajectories: Annotated[
        list[Path],
        typer.Argument(metavar="T...", help="Trajectories: csv, TUM, KITTI, EuRoC, evo, bags, sources with truth."),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="X.html|X.png", help="The figure.")],
    truth: Annotated[
        Path | None, typer.Option(metavar="TRUTH", help="True trajectory: also the distance of each to it.")
    ] = None,
    align: Annotated[
        str,
        typer.Option(
            metavar="none|origin|se3|sim3",
            help="Alignment of each with the truth.",
            autocompletion=completion.words("none", "origin", "se3", "sim3"),
        ),
    ] = "none",
    max_difference: Annotated[
        float, typer.Option(metavar="S", help="Longest difference of the stamps of estimate and truth.")
    ] = 0.01,
    overwrite: OverwriteOption = False,
) -> None:
    """Draw trajectories from above, in height and, with --truth, their distance to it, for a quick look."""
    from sfr_loc_map.config import build
    from sfr_loc_map.metrics.config import AlignedErrorConfig
    from sfr_loc_map.pipeline.paths import load_curves
    from sfr_loc_map.report.path_figure import save_path_html, save_path_png

    check_suffix(output, (*HTML_SUFFIXES, PNG))
    inputs = (*trajectories, *([truth] if truth is not None else []))
    check_outputs(output, overwrite=overwrite, inputs=inputs)
    config = build(AlignedErrorConfig, {"align": align, "max_difference_s": max_difference}, origin="options")
    curves = load_curves(trajectories, truth, config)
    save = save_path_png if output.suffix == PNG else save_path_html
    save(curves, output)
    say(f"{', '.join(curve.name for curve in curves)}: {output}", err=True)
