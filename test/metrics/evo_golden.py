"""Errors of the pairs of trajectories by evo, for comparison: evo_golden.json was written by

    PYTHONPATH=.:test/metrics python test/metrics/evo_golden.py > test/metrics/evo_golden.json

evo (github.com/MichaelGrupp/evo) is GPL: it is never needed to run the suite, and its numbers are kept so that the
comparison needs no evo either.
"""

from __future__ import annotations

import copy
import itertools
import json
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from trajectory_pairs import PAIRS

from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.trajectory_file import save_trajectory

ALIGNMENTS = ("none", "origin", "se3", "sim3")
STATISTICS = ("rmse", "mean", "median", "std", "min", "max")
DELTAS = ("frames=1", "distance=0.7")


def by_evo(
    pair: tuple[Trajectory, Trajectory], folder: Path, delta: str
) -> Iterator[tuple[str, dict[str, dict[str, float]]]]:
    """Yield alignment and the statistics of evo of estimate and truth, which it reads as TUM files."""
    from evo.core import sync
    from evo.core.metrics import PoseRelation, Unit
    from evo.main_ape import ape
    from evo.main_rpe import rpe
    from evo.tools import file_interface

    save_trajectory(folder / "est.tum", pair[0])
    save_trajectory(folder / "ref.tum", pair[1])
    read = [file_interface.read_tum_trajectory_file(str(folder / name)) for name in ("ref.tum", "est.tum")]
    ref, est = sync.associate_trajectories(*read)
    kind, _, size = delta.partition("=")
    step = {"delta": float(size), "delta_unit": Unit.frames if kind == "frames" else Unit.meters}
    relations = {"translation": PoseRelation.translation_part, "rotation_deg": PoseRelation.rotation_angle_deg}
    for alignment in ALIGNMENTS:
        fitted, origin = alignment in ("se3", "sim3"), alignment == "origin"
        options = {"align": fitted, "correct_scale": alignment == "sim3", "align_origin": origin}
        figures = {}
        for (name, relation), (metric, of) in itertools.product(relations.items(), (("ape", ape), ("rpe", rpe))):
            result = of(copy.deepcopy(ref), copy.deepcopy(est), relation, **options, **(step if of is rpe else {}))
            stats = {key: float(result.stats[key]) for key in STATISTICS}
            figures[f"{metric}.{name}"] = {**stats, "count": len(result.np_arrays["error_array"])}
        yield alignment, figures


if __name__ == "__main__":
    golden = {
        name: {delta: dict(by_evo(make(), Path(folder), delta)) for delta in DELTAS}
        for name, make in PAIRS.items()
        for folder in [tempfile.mkdtemp()]
    }
    json.dump(golden, sys.stdout, indent=1)
