"""Our mapper on one set of pairs with one fault at a time: does it know how wrong its points are?"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Final

import numpy as np

from sfr_loc_map.bench.figures import JsonObject
from sfr_loc_map.bench.honesty import LIMIT, Honesty
from sfr_loc_map.bench.results import SCHEMA
from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoRig
from sfr_loc_map.io.sequence import NavSequence
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.mapper import Mapper, PairMap
from sfr_loc_map.metrics.cloud_error import PairTruth, pixel_coverage, point_errors, truths_of
from sfr_loc_map.pipeline.convert import FaultyNav
from sfr_loc_map.simulation.faults import Fault, parse_fault

MAP_FAULTS: Final = (
    "yaw:amount=0.03",
    "yaw",
    "pitch",
    "roll",
    "focal",
    "baseline",
    "blurred",
    "blurred:camera=right",
    "noisy",
    "exposure",
    "exposure:camera=right,amount=0.7",
    "saturation",
    "saturation:camera=right",
    "blinded",
    "blinded:camera=left",
    "dirt",
    "shadow",
    "body",
    "torn:share=0.5",
    "repeated:share=0.5",
    "swapped",
    "identical",
    "black:camera=right",
)
"""Faults of cameras and calibrations; those of images affect all pairs."""
SCORED_TO_M: Final = 10.0
LIMIT_SHARE: Final = 0.01
"""Share of points beyond the limit from which on a map counts as wrong: beside edges some always are."""


@dataclass(frozen=True, slots=True)
class MapFaultFigures:
    """Figures of the mapper on one set of pairs; ratios are errors over the stated 3 sigma.

    Attributes:
        pairs: Number of pairs that were mapped.
        refused: Number of pairs that were refused by name.
        warnings: What was said of the others, one line each.
        coverage: Share of the true points of all pairs to `SCORED_TO_M` whose pixel has a point.
        mean_error_m: Mean error of the points there, metres; None without points.
        median_sigma_m: Median of their stated sigma.
        median_ratio: Median ratio.
        ratio_p99: 99th percentile of the ratios.
        largest_ratio: Largest ratio.
        beyond_share: Share of points whose ratio is above `LIMIT`.
    """

    pairs: int
    refused: int
    warnings: tuple[str, ...]
    coverage: float
    mean_error_m: float | None = None
    median_sigma_m: float | None = None
    median_ratio: float | None = None
    ratio_p99: float | None = None
    largest_ratio: float | None = None
    beyond_share: float | None = None

    @property
    def honesty(self) -> Honesty:
        """What the mapper said of its errors: a map that is wrong and not warned of is silent."""
        if self.warnings or self.refused:
            return Honesty.SAID
        return Honesty.SILENT if (self.beyond_share or 0.0) > LIMIT_SHARE else Honesty.STATED


@dataclass(frozen=True, slots=True)
class MapFaultComparison:
    """Result of the benchmark of faults on maps.

    Attributes:
        seed: Seed of the faults.
        entries: Figures by fault; `none` is the map without.
        limit_share: Share of points beyond the limit from which on a map counts as wrong.
    """

    seed: int
    entries: Mapping[str, MapFaultFigures]
    limit_share: float = LIMIT_SHARE

    def to_json(self) -> JsonObject:
        """Return the JSON object."""
        entries = {name: asdict(item) | {"honesty": item.honesty.value} for name, item in self.entries.items()}
        head: JsonObject = {"schema": SCHEMA, "kind": "map-faults", "seed": self.seed, "to_m": SCORED_TO_M}
        return head | {"limit": LIMIT, "limit_share": self.limit_share, "entries": entries, "missing": {}}

    @property
    def silent(self) -> list[str]:
        """Faults with a wrong map that nothing was said of."""
        return [name for name, item in self.entries.items() if item.honesty is Honesty.SILENT]


def benchmark_map_faults(
    sequence: NavSequence,
    faults: Sequence[str],
    config: MappingConfig,
    seed: int = 0,
    progress: Callable[[str], None] = lambda _: None,
) -> MapFaultComparison:
    """Return the figures of the mapper on a set of pairs without and with each fault.

    Args:
        sequence: Up to three pairs with their truth.
        faults: Each a text for `parse_fault`, or several joined by `+`.
        config: Parameters of the mapper.
        seed: Seed of the faults.
        progress: Called with the name of each fault when it is done.

    Raises:
        ConfigError: If a fault is not known.
        MetricsError: If a pair has no truth.
    """
    parsed: dict[str, list[Fault]] = {"none": []}
    parsed |= {text: [_of_all_pairs(part) for part in text.split("+")] for text in faults}
    truths_of(list(sequence.pairs()), sequence.rig)
    entries = {}
    for name, injected in parsed.items():
        faulty = FaultyNav(sequence, injected, seed)
        entries[name] = map_fault_figures(list(faulty.pairs()), faulty.rig, sequence.rig, config)
        progress(name)
    return MapFaultComparison(seed, entries)


def _of_all_pairs(text: str) -> Fault:
    """Return a fault that begins with the first pair and affects all, unless its text says otherwise."""
    fault = parse_fault(text)
    said = {item.partition("=")[0] for item in text.partition(":")[2].split(",")}
    return replace(
        fault, share=fault.share if "share" in said else 1.0, start=fault.start if said & {"start", "share"} else 0
    )


def map_fault_figures(
    pairs: Sequence[PosedStereoPair], rig: StereoRig, true_rig: StereoRig, config: MappingConfig
) -> MapFaultFigures:
    """Return the figures of the fused map of pairs.

    Args:
        pairs: As the mapper gets them, with the truth of the pairs without fault.
        rig: Rig that the mapper is given.
        true_rig: Rig of the truth.
        config: Parameters of the mapper.

    Raises:
        ConfigError: If the parameters do not fit the rig.
        MappingError: If there are more pairs than a map may have.
    """
    mapper = Mapper(rig, config)
    maps: list[PairMap] = []
    mapped: list[PosedStereoPair] = []
    for item in pairs:
        try:
            maps.append(mapper.process(item.pair, item.T_lm_navsb, len(maps)))
            mapped.append(item)
        except MappingError:
            continue
    refused = len(pairs) - len(maps)
    if not maps:
        return MapFaultFigures(0, refused, (), 0.0)
    fused = mapper.fuse(maps)
    warnings = (*(line for item in maps for line in item.warnings), *fused.warnings)
    total = sum(int(np.count_nonzero(truth.ranges_m() < SCORED_TO_M)) for truth in truths_of(pairs, true_rig))
    figures = MapFaultFigures(len(maps), refused, warnings, 0.0)
    return _with_errors(figures, fused.cloud, truths_of(mapped, true_rig), total)


def _with_errors(
    figures: MapFaultFigures, cloud: PointCloud, truths: Sequence[PairTruth], total: int
) -> MapFaultFigures:
    """Return the figures with the errors of a cloud; `total` is the number of true points in range."""
    covered = zip(pixel_coverage(cloud, truths), truths, strict=True)
    count = sum(int(np.count_nonzero(image[truth.ranges_m() < SCORED_TO_M])) for image, truth in covered)
    errors = point_errors(cloud, truths)
    near = errors.range_m < SCORED_TO_M
    if not near.any():
        return figures
    sigma = cloud.sigma[errors.index[near]].astype(np.float64)
    with np.errstate(divide="ignore"):
        ratio = errors.error_m[near] / (3.0 * sigma)
    return replace(
        figures,
        coverage=count / total,
        mean_error_m=float(errors.error_m[near].mean()),
        median_sigma_m=float(np.median(sigma)),
        median_ratio=float(np.median(ratio)),
        ratio_p99=float(np.quantile(ratio, 0.99)),
        largest_ratio=float(ratio.max()),
        beyond_share=float((ratio > LIMIT).mean()),
    )
