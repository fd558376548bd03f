"""Valid files that commands of the suite make of those in the world: scores, a kept pose, messages."""

from __future__ import annotations

import contextlib
import io
import json
from pathlib import Path

from target import run_command
from targets import SCORE
from world import LOC_RIG

from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.pipeline.localisation_session import KnownPose, PoseFile


def make_made_files(world: Path) -> None:
    """Write them into a world."""
    import numpy as np

    (world / "arguments.json").write_text(json.dumps(["name.csv", "distance=5", "/a:=/b"]))
    PoseFile(world / "resume.json", 1.0).save(
        KnownPose(1_700_000_000_000_000_000, Transform.identity(), np.eye(6)), LOC_RIG
    )
    limits = ("--limits", "{w}/limits_example.yaml", "--stats", "{w}/stats.csv")
    for name, extra in (("score.json", limits), ("score2.json", ())):
        (world / name).unlink(missing_ok=True)
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()) as errors:
            run_command((*SCORE, *extra, "--json", f"{{w}}/{name}"), world, world)
        if not (world / name).exists():
            raise SystemExit(f"no score could be made: {errors.getvalue()}")
    try:
        from message_targets import make_messages
    except ImportError:
        return
    make_messages(world)
