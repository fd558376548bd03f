"""Our matcher beside reference matchers on the same pairs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from sfr_loc_map.bench.competitors import Competitors
from sfr_loc_map.bench.disparity_accuracy import DisparityAccuracy, TrueDisparity, disparity_accuracy
from sfr_loc_map.bench.figures import CallCosts, JsonObject
from sfr_loc_map.bench.passes import LIMITS, PassInput, Progress, Run, findings_of, run_passes
from sfr_loc_map.bench.results import Entry, MethodComparison, Provenance, SizeResult
from sfr_loc_map.bench.scaling import half_disparity, half_pair, half_rig
from sfr_loc_map.geometry.arrays import FloatImage
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair, StereoRig
from sfr_loc_map.io.sequence import NavSequence
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.disparity.semi_global_matching import search_range
from sfr_loc_map.methods.isolated_method import IsolatedMethod
from sfr_loc_map.metrics.calls import CallUsage


@dataclass(frozen=True, slots=True)
class MappingFigures:
    """Figures of one pass of a matcher.

    Attributes:
        filled: Mean share of the pixels that have a disparity.
        accuracy: Errors of the disparities; None without ground truth.
        costs: Time and memory of the calls.
    """

    filled: float
    accuracy: DisparityAccuracy | None
    costs: CallCosts

    def to_json(self) -> JsonObject:
        """Return the JSON object."""
        errors = {} if self.accuracy is None else {"accuracy": self.accuracy.to_json()}
        return {"filled": self.filled} | errors | self.costs.to_json()


def benchmark_mapping(
    sequence: NavSequence,
    config: MappingConfig,
    methods: Competitors,
    *,
    repeat: int = 3,
    sizes: int = 1,
    progress: Progress = lambda name: None,
) -> MethodComparison[MappingFigures]:
    """Return the figures of all matchers on the pairs of a source.

    Args:
        sequence: Pairs, with ground truth if accuracy is wanted.
        config: Parameters of ours; all search the same disparities.
        methods: Matchers to compare.
        repeat: Passes; medians are shown.
        sizes: Number of image sizes, each half of the one before.
        progress: Called with the name of a method after each of its calls.

    Raises:
        BenchError: If ours does not run.
    """
    provenance = Provenance.now()
    results = [_one_size(sequence, halvings, config, methods, repeat, progress) for halvings in range(sizes)]
    return MethodComparison("map", len(sequence), None, repeat, results, methods.missing, provenance)


def _one_size(
    sequence: NavSequence,
    halvings: int,
    config: MappingConfig,
    methods: Competitors,
    repeat: int,
    progress: Progress,
) -> SizeResult[MappingFigures]:
    rig = sequence.rig
    for _ in range(halvings):
        rig = half_rig(rig)
    count = search_range(rig, config).count
    given = PassInput(
        lambda: _pairs(sequence, halvings),
        lambda method: IsolatedMethod(method, rig, None, LIMITS, {"disparities": count}),
        lambda mapper, pair, _: _disparity(mapper, pair),
    )
    runs, failed = run_passes(methods.configured(asdict(config)), given, repeat, progress)
    truths = [true_disparity(item, sequence.rig, halvings) for item in sequence.pairs()]
    entries = {
        name: Entry(mine[0].version, [_figures(run, truths, rig) for run in mine]) for name, mine in runs.items()
    }
    return SizeResult(rig.width, rig.height, count, entries, failed, findings_of(runs))


def _disparity(mapper: IsolatedMethod, pair: StereoPair) -> tuple[FloatImage, CallUsage, str]:
    found, call = mapper.disparity(pair)
    return found, call.usage, call.finding


def _pairs(sequence: NavSequence, halvings: int) -> Iterator[StereoPair]:
    for item in sequence.pairs():
        pair = item.pair
        for _ in range(halvings):
            pair = half_pair(pair)
        yield pair


def true_disparity(item: PosedStereoPair, rig: StereoRig, halvings: int) -> TrueDisparity | None:
    """Return the true disparities of a pair at a size halved so often; None if the source has no ground truth."""
    if item.truth is None:
        return None
    T_lm_left = item.T_lm_navsb @ rig.T_sb_left
    depth = (item.truth.astype(np.float64) - T_lm_left.translation) @ T_lm_left.rotation[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        disparity = rig.fx * rig.baseline_m / depth
    for _ in range(halvings):
        disparity, rig = half_disparity(disparity), half_rig(rig)
    return TrueDisparity.of(disparity)


def _figures(run: Run[FloatImage], truths: Sequence[TrueDisparity | None], rig: StereoRig) -> MappingFigures:
    known = [truth for truth in truths if truth is not None]
    filled = float(np.mean([np.isfinite(disparity).mean() for disparity in run.results]))
    errors = disparity_accuracy(run.results, known, rig) if len(known) == len(truths) else None
    return MappingFigures(filled, errors, CallCosts.of(run.seconds, run.peaks, run.idle_bytes))
