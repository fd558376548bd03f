"""Localisation and mapping of a whole source."""

from __future__ import annotations

import builtins
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Literal, TypeVar, overload

from sfr_loc_map.api.cloud import PointCloud
from sfr_loc_map.api.paths import PathLike
from sfr_loc_map.api.source import open as open_source
from sfr_loc_map.api.trajectory import Trajectory
from sfr_loc_map.config import build, read_config
from sfr_loc_map.errors import ConfigError, naming
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import Task, read_text
from sfr_loc_map.io.sequence import Source, drive_of, panorama_of
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import PoseEstimate, StartPose
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.methods.registry import OURS, MethodLimits, find_method, record_of_ours
from sfr_loc_map.metrics.score import MethodRecord
from sfr_loc_map.pipeline import offline
from sfr_loc_map.pipeline.call_stats import CallRecord
from sfr_loc_map.pipeline.offline import localise_with, map_pairs_with, tracking_warning

C = TypeVar("C")
SourceLike = PathLike | Source
Start = str | Transform | StartPose
"""Where a drive starts: `identity`, `truth`, or a pose of RB in DS."""
Parameters = PathLike | Mapping[str, object]
"""Parameters: a YAML file, or values by name (`{"max_features": 300}`)."""
Step = tuple[PoseEstimate, CallRecord, MethodRecord]


@overload
def localise(
    source: SourceLike,
    start: Start = "identity",
    *,
    live: Literal[False] = False,
    config: Parameters | LocalisationConfig | None = None,
    method: str = OURS,
) -> Trajectory: ...


@overload
def localise(
    source: SourceLike,
    start: Start = "identity",
    *,
    live: Literal[True],
    config: Parameters | LocalisationConfig | None = None,
    method: str = OURS,
) -> Iterator[PoseEstimate]: ...


def localise(
    source: SourceLike,
    start: Start = "identity",
    *,
    live: bool = False,
    config: Parameters | LocalisationConfig | None = None,
    method: str = OURS,
) -> Trajectory | Iterator[PoseEstimate]:
    """Estimate the trajectory of a drive; the same call as `sfr localise`.

    Args:
        source: What `sfr.open` takes or gives.
        start: First pose: `identity`, `truth` (the true one) or a pose of RB in DS.
        live: Whether to return an iterator that gives each pose as soon as it is estimated.
        config: Parameters of the localiser; of another method the file with its configuration.
        method: Method under test, as `sfr methods` lists them.

    Returns:
        The trajectory with the calls that gave it; live, an iterator of `PoseEstimate`.

    Raises:
        InputError: If the source has no drive, or is broken.
        ConfigError: If a parameter or `start` is not valid.
        MethodError: If there is no such method, or it does not start.
    """
    steps = _steps(open_source(source), start, config, method)
    if live:
        return (estimate for estimate, _, _ in steps)
    done = list(steps)
    records = [record for _, record, _ in done]
    found = offline.trajectory_of(estimate for estimate, _, _ in done)
    _warn(tracking_warning(records, source))
    return Trajectory.of(found, records, done[-1][2])


def _steps(source: Source, start: Start, config: Parameters | LocalisationConfig | None, method: str) -> Iterator[Step]:
    """Yield the estimates of a drive; what can be checked before is checked at once."""
    sequence = drive_of(source)
    with naming(source.path):
        first = _start_pose(source, start)
    if method == OURS:
        about = record_of_ours(Task.LOCALISATION)
        parameters = _parameters(LocalisationConfig, config, "localisation")
        runs = offline.localise(sequence, parameters, first)
        return _named(source, ((estimate, record, about) for estimate, record in runs))
    chosen = find_method(method, Task.LOCALISATION, _text(config))
    return _named(source, localise_with(chosen, sequence, first.T_ds_rb, MethodLimits()))


def _named(source: Source, steps: Iterator[Step]) -> Iterator[Step]:
    with naming(source.path):
        yield from steps


def _start_pose(source: Source, start: Start) -> StartPose:
    if not isinstance(start, str):
        return StartPose.of(start)
    if start not in ("identity", "truth"):
        raise ConfigError(f"start is '{start}': must be identity, truth or a pose of RB in DS")
    return offline.start_pose(drive_of(source), start)


def map(
    source: SourceLike,
    *,
    fuse: bool = True,
    refine_poses: bool = False,
    config: Parameters | MappingConfig | None = None,
    method: str = OURS,
) -> PointCloud:
    """Map up to three stereo pairs; the same call as `sfr map`.

    Args:
        source: What `sfr.open` takes or gives.
        fuse: Whether to fuse the pairs to one surface, or keep the points of every pair.
        refine_poses: Whether to correct the poses of later pairs by registration of the overlaps.
        config: Parameters of the mapper; of another method the file with its configuration.
        method: Method under test, as `sfr methods` lists them.

    Raises:
        InputError: If the source has no mapping pairs, or is broken.
        ConfigError: If a parameter is not valid.
        MappingError: If there are too many pairs.
        MethodError: If there is no such method, or it does not start.
    """
    opened = open_source(source)
    sequence = panorama_of(opened)
    with naming(opened.path):
        if method == OURS:
            parameters = _parameters(MappingConfig, config, "mapping")
            parameters = replace(parameters, refine_poses=True) if refine_poses else parameters
            run, about = offline.map_pairs(sequence, parameters), record_of_ours(Task.MAPPING)
        else:
            if refine_poses:
                raise ConfigError(f"refine_poses is of our mapper: leave it out with method {method}")
            chosen = find_method(method, Task.MAPPING, _text(config))
            run, about = map_pairs_with(chosen, sequence, MethodLimits())
    for line in run.warnings:
        _warn(line)
    return PointCloud.of(run.fused.cloud if fuse else run.unfused, run.records, about)


def _parameters(kind: builtins.type[C], config: object, section: str) -> C:
    if config is None or isinstance(config, kind):
        return kind() if config is None else config
    if isinstance(config, Mapping):
        return build(kind, config, origin="config")
    return read_config(kind, Path(str(config)), section)


def _text(config: object) -> str:
    """Return the text of the configuration file of a method under test."""
    if config is None:
        return ""
    try:
        return read_text(Path(str(config)))
    except (OSError, ValueError) as error:
        raise ConfigError(f"config '{config}' cannot be read ({error}): give a text file") from error


def _warn(text: str | None) -> None:
    if text is not None:
        warnings.warn(text, UserWarning, stacklevel=3)
