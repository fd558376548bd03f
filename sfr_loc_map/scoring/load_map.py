"""Read the cloud of a run and the truth of its pairs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from sfr_loc_map import io  # readers of sources are loaded when called, because files of trajectories require no images
from sfr_loc_map.errors import ConfigError, InputError
from sfr_loc_map.geometry.arrays import IntArray
from sfr_loc_map.geometry.stereo import PosedStereoPair
from sfr_loc_map.io.clouds.cloud_file import LoadedCloud, load_cloud
from sfr_loc_map.io.source_config import SourceConfig
from sfr_loc_map.metrics.errors.cloud_error import PairTruth, truths_of
from sfr_loc_map.scoring.inputs import CloudToScore, ScoreInputs


def read_cloud(
    inputs: ScoreInputs, given: LoadedCloud | None, fused: bool | None
) -> tuple[CloudToScore | None, IntArray | None]:
    """Return a cloud, read or in memory, with the truth of its pairs; return also the stamps of all pairs."""
    if inputs.map_truth is None or (inputs.cloud or given) is None:
        return None, None
    if inputs.cloud is not None:
        loaded, name = load_cloud(inputs.cloud), f"cloud '{inputs.cloud}'"
    else:
        assert given is not None  # as checked above
        loaded, name = given, "the cloud"
    loaded = with_fusion_flag(loaded, fused, name)
    stamps_ns = None if loaded.cloud is None else loaded.cloud.pair_stamps_ns
    truths, nav_stamps_ns = load_map_truth(inputs.map_truth, stamps_ns, inputs.config)
    if truths:
        loaded = loaded.of_images(truths[0].rig.width, truths[0].rig.height, name)
    return CloudToScore(loaded, truths), nav_stamps_ns


def load_map_truth(
    path: Path, stamps_ns: Sequence[int] | None = None, config: SourceConfig | None = None
) -> tuple[list[PairTruth], IntArray]:
    """Read the truth of all mapping pairs of a source, or of those at given stamps; return also all stamps."""
    source = io.open_source(path, config)
    nav = source.nav
    if nav is None:
        raise InputError(
            f"'{path}' has no mapping pairs: to score a cloud, give a source that has mapping pairs with ground truth"
        )
    wanted = None if stamps_ns is None else set(stamps_ns)
    pairs: dict[int, PosedStereoPair] = {}
    every = list(source.missing_nav_ns)
    for item in nav.pairs():
        every.append(item.pair.stamp_ns)
        if wanted is None or item.pair.stamp_ns in wanted:
            pairs[item.pair.stamp_ns] = item
    missing = [str(stamp_ns) for stamp_ns in stamps_ns or () if stamp_ns not in pairs]
    if missing:
        raise InputError(
            f"the cloud was made from pairs with stamps {', '.join(missing)}, which '{path}' does not have: give the "
            "source of the cloud"
        )
    chosen = pairs.values() if stamps_ns is None else [pairs[stamp_ns] for stamp_ns in stamps_ns]
    return truths_of(list(chosen), nav.rig), np.array(every, np.int64)


def with_fusion_flag(loaded: LoadedCloud, fused: bool | None, name: str) -> LoadedCloud:
    """Return a cloud with a known fusion flag, unless its points have no pixels."""
    if loaded.cloud is None:
        return loaded
    said = loaded.cloud.fused
    if said is None and fused is None:
        raise InputError(
            f"{name} does not declare whether it is fused, which changes the coverage: give --fused (one surface of "
            "several pairs) or --not-fused (separate points of each pair)"
        )
    if said is not None and fused is not None and said != fused:
        option, word = ("--fused", "not fused") if fused else ("--not-fused", "fused")
        raise ConfigError(f"'{option}': {name} declares that it is {word}; omit the option")
    return replace(loaded, cloud=replace(loaded.cloud, fused=fused if said is None else said))
