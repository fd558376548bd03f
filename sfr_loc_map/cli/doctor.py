"""`sfr doctor`: which single mistake of convention makes an estimate and the truth disagree."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer


def doctor(
    estimate: Annotated[Path, typer.Argument(metavar="EST", help="Trajectory: TUM, csv, bag.")],
    truth: Annotated[Path, typer.Argument(metavar="TRUTH", help="Trajectory, bag or data set folder.")],
    json_path: Annotated[
        str | None, typer.Option("--json", metavar="F", help="Write what was found as JSON; - for standard output.")
    ] = None,
) -> None:
    """Find the mistake of convention that explains how an estimate disagrees with the truth.

    The disagreement is the mean error of position over the way and of attitude in radians, re-based at many starts.
    """
    from dataclasses import asdict

    from sfr_loc_map.io.atomic import atomic_path
    from sfr_loc_map.metrics.config import ScoreConfig
    from sfr_loc_map.pipeline.scoring import diagnose

    diagnosis = diagnose(estimate, truth, ScoreConfig())
    text = json.dumps(asdict(diagnosis), allow_nan=False) + "\n"
    if json_path == "-":
        sys.stdout.write(text)
        return
    if json_path is not None:
        with atomic_path(Path(json_path)) as temporary:
            temporary.write_text(text, encoding="utf-8")
    before = diagnosis.disagreement
    typer.echo("no stamp in common" if before is None else f"disagreement as it stands: {before:.4g}")
    for item in diagnosis.suspicions[:5]:
        typer.echo(f"  {item.disagreement:.4g} without: {item.mistake}")
    if diagnosis.found is not None:
        typer.echo(diagnosis.found.sentence)
    else:
        typer.echo("no single mistake of convention explains what disagreement there is")
