"""Dense matchers side by side."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.bench.disparity_figures import TrueDisparity, disparity_figures
from sfr_loc_map.bench.figures import SCHEMA, Figures, compared, cost_figures, growths, median, provenance
from sfr_loc_map.bench.peers import OURS, Peers
from sfr_loc_map.bench.rounds import Progress, Run, one_pass
from sfr_loc_map.bench.scaling import half_disparity, half_pair, half_rig
from sfr_loc_map.errors import BenchError
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair, StereoRig
from sfr_loc_map.io.sequence import NavSequence
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.semi_global_matching import search_range

Disparities = list[NDArray[np.float32]]


def bench_map(
    sequence: NavSequence,
    config: MappingConfig,
    peers: Peers,
    *,
    repeat: int = 3,
    sizes: int = 1,
    progress: Progress = lambda name: None,
) -> Figures:
    """Return the figures of all matchers on the pairs of a source.

    Args:
        sequence: Pairs, with truth if accuracy is wanted.
        config: Parameters of ours; all search the same disparities.
        peers: Contestants.
        repeat: Passes; medians are shown.
        sizes: Number of sizes of the pictures, each half of the one before.
        progress: Told the name of a peer after each of its calls.

    Raises:
        BenchError: If ours does not run.
    """
    facts = provenance()
    measured = [_one_size(sequence, halvings, config, peers, repeat, progress) for halvings in range(sizes)]
    return {
        "schema": SCHEMA,
        "kind": "map",
        "pairs": len(sequence),
        "repeat": repeat,
        "sizes": measured,
        "growth": growths(measured),
        "missing": dict(peers.missing),
        "provenance": facts,
    }


def _one_size(
    sequence: NavSequence, halvings: int, config: MappingConfig, peers: Peers, repeat: int, progress: Progress
) -> Figures:
    rig = sequence.rig
    for _ in range(halvings):
        rig = half_rig(rig)
    count = search_range(rig, config).count
    runs: dict[str, list[Run]] = {}
    failed: dict[str, str] = {}
    for _ in range(repeat):
        going = [peer for peer in peers.present if peer.name not in failed]
        setup = {"config": asdict(config), "disparities": count}
        done = one_pass(going, rig, lambda: _pairs(sequence, halvings), setup, _keep, progress=progress)
        failed |= done.failed
        if OURS in failed:
            raise BenchError(failed[OURS])
        for name, run in done.runs.items():
            runs.setdefault(name, []).append(run)
    truths = [true_disparity(item, sequence.rig, halvings) for item in sequence.pairs()]
    entries = {name: _entry(mine, truths, rig) for name, mine in runs.items()}
    return {
        "width": rig.width,
        "height": rig.height,
        "disparities": count,
        "entries": entries,
        "ratios": compared(entries, OURS, ("accuracy", "time_s", "memory_bytes")),
        "failed": failed,
    }


def _keep(run: Run, report: Mapping[str, Any], output: Path) -> NDArray[np.float32]:
    return np.asarray(np.load(output), np.float32)


def _pairs(sequence: NavSequence, halvings: int) -> Iterator[StereoPair]:
    for item in sequence.pairs():
        pair = item.pair
        for _ in range(halvings):
            pair = half_pair(pair)
        yield pair


def true_disparity(item: PosedStereoPair, rig: StereoRig, halvings: int) -> TrueDisparity | None:
    """Return the true disparities of a pair of a rig at a size halved so often; None if the source has no truth."""
    if item.truth is None:
        return None
    T_lm_left = item.T_lm_navsb @ rig.T_sb_left
    depth = (item.truth.astype(np.float64) - T_lm_left.translation) @ T_lm_left.rotation[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        disparity = rig.fx * rig.baseline_m / depth
    for _ in range(halvings):
        disparity, rig = half_disparity(disparity), half_rig(rig)
    return TrueDisparity.of(disparity)


def _entry(runs: Sequence[Run], truths: Sequence[TrueDisparity | None], rig: StereoRig) -> Figures:
    known = [truth for truth in truths if truth is not None]
    each = []
    for run in runs:
        figures: Figures = {"filled": float(np.mean([np.isfinite(disparity).mean() for disparity in run.results]))}
        if len(known) == len(truths):
            figures["accuracy"] = disparity_figures(run.results, known, rig)
        each.append(figures | cost_figures(run.seconds, run.peaks, run.idle_bytes))
    return {"version": runs[0].version, **median(each), "runs": each}
