"""Comparison of misclosure and true error at revisited places: `python -m campaigns misclosure SRC ...`.

The drives have a ground truth and return to a place. Each drive is localised unchanged and with each injected fault,
with one line per revisited place. The true error is that of the forward run between both visits. The results are in
docs/measurements.md.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from campaigns.check_detection import FAULTS
from sfr_loc_map.evidence.localiser_runs import PairsInMemory, RunVariant, run_variant
from sfr_loc_map.evidence.revisited import find_closures, growth_between
from sfr_loc_map.faults.injector import FaultInjector
from sfr_loc_map.faults.kinds import parse_fault
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.sequence import drive_of
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.metrics.config import AssociationConfig
from sfr_loc_map.metrics.frames.association import associate
from sfr_loc_map.metrics.trajectory.consistency import relative_errors


def main(arguments: list[str]) -> int:
    """Print misclosure and true error of each revisited place; exit code 1 if no place is revisited."""
    config, count = LocalisationConfig(), 0
    for path in map(Path, arguments):
        source = drive_of(open_source(path))
        clean = list(source.pairs())
        for text in FAULTS:
            faults = [parse_fault(text)] if text else []
            injector = FaultInjector(faults, 1, len(clean), source.rig)
            drive = PairsInMemory(injector.rig, [pair for _, pair in injector.pairs(clean)])
            forward = run_variant(drive, config, RunVariant.FORWARD, lambda: None)
            poses = forward.estimates.trajectory
            frames, _ = associate(poses, source.ground_truth, AssociationConfig(truth="match"))
            closures = find_closures(drive, forward, config)
            count += len(closures)
            for closure in closures:
                visits = np.searchsorted(frames.stamps_ns, poses.stamps_ns[[closure.first, closure.again]])
                error = relative_errors(frames.estimate, frames.truth, visits[:1], visits[1:])[0]
                predicted = growth_between(forward, closure.first, closure.again)
                sigma_m = float("nan") if predicted is None else np.sqrt(np.trace(predicted[:3, :3]))
                nees = float("nan") if closure.square is None else closure.square
                print(
                    f"{path.name}; {text or 'none'}; {closure.name}; path {closure.path_m:.2f} m; "
                    f"misclosure {1e3 * closure.misclosure_m:.2f} mm; true {1e3 * np.linalg.norm(error[:3]):.2f} mm; "
                    f"predicted {1e3 * sigma_m:.1f} mm; NEES {nees:.1f}",
                    flush=True,
                )
            if not closures:
                print(f"{path.name}; {text or 'none'}; no revisited place", flush=True)
    return int(count == 0)
