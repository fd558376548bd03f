"""Read the cloud of a run and the truth of its pairs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from sfr_loc_map import io  # `io` imports its readers of sources on first use; trajectory files require none
from sfr_loc_map.calls.call_stats import CallStats
from sfr_loc_map.errors import ConfigError, InputError
from sfr_loc_map.geometry.arrays import IntArray
from sfr_loc_map.geometry.stereo import PosedStereoPair
from sfr_loc_map.io.clouds.cloud_file import LoadedCloud, load_cloud
from sfr_loc_map.io.sequence import NavSequence
from sfr_loc_map.metrics.map.pair_truth import truths_of
from sfr_loc_map.scoring.call_checks import check_cloud, other_map_images
from sfr_loc_map.scoring.inputs import CloudToScore, ScoreInputs


def read_cloud(
    inputs: ScoreInputs, given: LoadedCloud | None, fused: bool | None, stats: Sequence[CallStats] = ()
) -> tuple[CloudToScore | None, IntArray | None]:
    """Return a cloud from a file or memory, with the truth of its pairs, and the stamps of all pairs of the source.

    InputError if the calls `stats` of files made another cloud; a caveat if they were made on other images.
    """
    if inputs.map_truth is None or (inputs.cloud or given) is None:
        return None, None
    if inputs.cloud is not None:
        loaded, name = load_cloud(inputs.cloud), f"cloud '{inputs.cloud}'"
    else:
        assert given is not None  # as checked above
        loaded, name = given, "the cloud"
    check_cloud(stats, loaded.cloud)
    loaded = with_fusion_flag(loaded, fused, name)
    source = io.open_source(inputs.map_truth, inputs.config)
    if source.nav is None:
        raise InputError(
            f"'{source.path}' has no mapping pairs: to score a cloud, give a source that has mapping pairs with ground "
            "truth"
        )
    rig = source.nav.rig
    pairs = pairs_of_cloud(source.nav, loaded.pair_stamps_ns, source.path)
    caveats = tuple(other_map_images(stats, [item.pair for item in pairs], source.path))
    truths = truths_of(pairs, rig)
    return CloudToScore(loaded.of_images(rig.width, rig.height, name), truths, caveats), source.expected_nav_ns()


def pairs_of_cloud(nav: NavSequence, stamps_ns: Sequence[int] | None, place: Path) -> list[PosedStereoPair]:
    """Return the mapping pairs from which a cloud was made, in the order of the points' `pair`.

    `stamps_ns` are the stamps that the cloud states; None stands for all pairs of the source. InputError if the source
    at `place` does not have a pair.
    """
    if stamps_ns is None:
        return list(nav.pairs())
    by_stamp = {item.pair.stamp_ns: item for item in nav.pairs() if item.pair.stamp_ns in stamps_ns}
    missing = [str(stamp_ns) for stamp_ns in stamps_ns if stamp_ns not in by_stamp]
    if missing:
        raise InputError(
            f"the cloud was made from pairs with stamps {', '.join(missing)}, which '{place}' does not have: give the "
            "source of the cloud"
        )
    return [by_stamp[stamp_ns] for stamp_ns in stamps_ns]


def with_fusion_flag(loaded: LoadedCloud, fused: bool | None, name: str) -> LoadedCloud:
    """Return a cloud with a known fusion flag, unless its points have no pixels."""
    if loaded.cloud is None:
        return loaded
    said = loaded.cloud.fused
    if said is None and fused is None:
        raise InputError(
            f"{name} does not declare whether it is fused, which changes the coverage: give --fused or fused=True (one "
            "surface of several pairs), or --not-fused or fused=False (separate points of each pair)"
        )
    if said is not None and fused is not None and said != fused:
        option, word = ("--fused or fused=True", "not fused") if fused else ("--not-fused or fused=False", "fused")
        raise ConfigError(f"{name} declares that it is {word}: omit {option}")
    return replace(loaded, cloud=replace(loaded.cloud, fused=fused if said is None else said))
