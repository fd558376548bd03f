"""Runs of a method under test over a whole source: the same records as of our own."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.io.sequence import LocSequence, NavSequence
from sfr_loc_map.localisation.estimate import PoseEstimate
from sfr_loc_map.mapping.config import MAX_PAIRS, MappingConfig
from sfr_loc_map.mapping.disparity.semi_global_matching import search_range
from sfr_loc_map.methods.isolated_localiser import IsolatedLocaliser
from sfr_loc_map.methods.isolated_mapper import IsolatedMapper, MapperCall
from sfr_loc_map.methods.method import Method, MethodLimits
from sfr_loc_map.metrics.config import MappingState
from sfr_loc_map.metrics.method_record import MethodRecord
from sfr_loc_map.pipeline.call_record import CallRecord
from sfr_loc_map.pipeline.offline import MapRun, Progress

DEFAULT_STEP_S = 0.1


def localise_with(
    method: Method, sequence: LocSequence, T_ds_rb: Transform, limits: MethodLimits
) -> Iterator[tuple[PoseEstimate, CallRecord, MethodRecord]]:
    """Yield the estimate and the cost of each pair of a drive, and whose they are.

    Args:
        method: The localiser.
        sequence: The drive.
        T_ds_rb: Pose of RB in DS at the first pair.
        limits: What it may take.

    Raises:
        MethodError: If it does not start.
    """
    first_ns, *later_ns = (pair.stamp_ns for pair in islice(sequence.pairs(), 2))
    step_s = next(((stamp_ns - first_ns) / NS_PER_S for stamp_ns in later_ns if stamp_ns > first_ns), DEFAULT_STEP_S)
    with IsolatedLocaliser(method, sequence.rig, T_ds_rb, limits, {"rate_hz": 1.0 / step_s}) as localiser:
        for pair in sequence.pairs():
            call = localiser.process(pair, {"since_start_s": (pair.stamp_ns - first_ns) / NS_PER_S})
            record = CallRecord(
                pair.stamp_ns,
                call.usage.processing_time_s,
                call.estimate.state.value,
                call.usage.peak_rss_bytes,
                call.usage.above_idle_bytes,
                call.statistics,
                call.covariance,
                call.reason,
                call.step,
                call.finding,
            )
            yield call.estimate, record, localiser.record


def map_pairs_with(
    method: Method, sequence: NavSequence, limits: MethodLimits, progress: Progress = lambda done: None
) -> tuple[MapRun, MethodRecord]:
    """Map the pairs of a source; return the map and whose it is.

    Args:
        method: The mapper.
        sequence: The pairs.
        limits: What it may take.
        progress: Called with the number of pairs that are done.

    Raises:
        MappingError: If there are more pairs than a map may have, or none.
        MethodError: If it does not start.
    """
    if not 1 <= len(sequence) <= MAX_PAIRS:
        raise MappingError(f"a map is made of 1 to {MAX_PAIRS} stereo pairs, the source has {len(sequence)}: split it")
    maps, records = [], []
    searched = search_range(sequence.rig, MappingConfig()).count
    with IsolatedMapper(method, sequence.rig, limits, {"disparities": searched}) as mapper:
        for index, item in enumerate(sequence.pairs()):
            done, call = mapper.process(item.pair, item.T_lm_navsb, index)
            maps.append(done)
            records.append(_record(item.pair.stamp_ns, MappingState.MAPPED, call, dict(done.statistics)))
            progress(index + 1)
        fused, fusion = mapper.fuse(maps, item.pair)
        if fusion is not None:
            records.append(_record(item.pair.stamp_ns, MappingState.FUSED, fusion, dict(fused.statistics)))
        return MapRun(maps, fused, records), mapper.record


def _record(stamp_ns: int, state: MappingState, call: MapperCall, figures: dict[str, float]) -> CallRecord:
    usage = call.usage
    costs = (usage.processing_time_s, state.value, usage.peak_rss_bytes, usage.above_idle_bytes)
    return CallRecord(stamp_ns, *costs, figures, finding=call.finding)
