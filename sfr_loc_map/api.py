"""Python interface: `import sfr_loc_map as sfr`. Functions and commands make the same calls (docs/python.md).

Every public name can be imported from `sfr_loc_map` itself. Errors are `SfrError`s whose messages say what to do.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, TypeVar, Unpack, get_type_hints, overload

from sfr_loc_map import api_types
from sfr_loc_map.api_types import PathLike
from sfr_loc_map.calls.call_record import tracking_warning
from sfr_loc_map.calls.call_stats import CallStats, stats_of
from sfr_loc_map.config import build
from sfr_loc_map.config_file import read_config
from sfr_loc_map.errors import ConfigError, naming
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.sequence import Source, drive_of, panorama_of
from sfr_loc_map.io.source_settings import source_config
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import PoseEstimate, StartPose
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.message_text import alternatives
from sfr_loc_map.methods.registry import config_text, find_method
from sfr_loc_map.metrics.config import aligned_error_config
from sfr_loc_map.metrics.conventions.pose_convention import PoseConvention
from sfr_loc_map.metrics.judging.limits_file import load_limits, parse_limits
from sfr_loc_map.metrics.score.limits import Limits
from sfr_loc_map.runs.drive_start import start_pose
from sfr_loc_map.runs.localiser_run import Step, localiser_steps, run_localiser
from sfr_loc_map.runs.mapper_run import run_mapper
from sfr_loc_map.runs.under_test import UnderTest
from sfr_loc_map.scoring.conversion import converted_run
from sfr_loc_map.scoring.inputs import Correction, InMemory, Run, ScoreInputs
from sfr_loc_map.scoring.load import load_run
from sfr_loc_map.scoring.score_run import score_run
from sfr_loc_map.scoring.settings import ScoreSettings, score_settings
from sfr_loc_map.suite_names import OURS, Task

C = TypeVar("C")
SourceLike = PathLike | Source
Start = str | Transform | StartPose  #: Start of a drive: `identity`, `truth`, or a pose of RB in DS.
Parameters = PathLike | Mapping[str, object]  #: Parameters: a YAML file, or values by name (`{"max_features": 300}`).
Estimate = PathLike | Trajectory | PointCloud
Truth = PathLike | Trajectory | Source


def open(
    source: SourceLike, remap: Mapping[str, str] | None = None, config: str | Path | None = None
) -> api_types.Source:
    """Open a data set folder, ROS bag, KITTI or EuRoC sequence. The format is detected from the content.

    `remap` maps topics of a bag to those of the suite: `{"/cam0/image": "loc/left/image_rect"}`. `config` is an
    `sfr.yaml`, by default the one in or beside the source.
    """
    if isinstance(source, Source):
        if remap is not None or config is not None:
            raise ConfigError("remap and config apply to a path: give the path instead of an open source")
        return source if isinstance(source, api_types.Source) else api_types.Source.of(source)
    _check("source", source, Source)
    if config is not None:
        _check("config", config)
    if not isinstance(remap, Mapping | None):
        raise ConfigError(
            f"remap has the type {type(remap).__name__}: topics by name are required, {{FOUND: EXPECTED}}"
        )
    how = source_config(Path(source), None if config is None else Path(config), remap)
    return api_types.Source.of(open_source(Path(source), how))


@overload
def localise(
    source: SourceLike,
    start: Start = "identity",
    *,
    live: Literal[False] = False,
    config: Parameters | LocalisationConfig | None = None,
    method: str = OURS,
) -> api_types.Trajectory: ...


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
) -> api_types.Trajectory | Iterator[PoseEstimate]:
    """Estimate the trajectory of a drive, like `sfr localise` with options of the same names.

    `start` is `identity`, `truth` or a pose of RB in DS. With `live`, the result is an iterator that yields each
    `PoseEstimate` as soon as it is estimated. `config` contains the parameters of the localiser. For another `method`,
    `config` is the configuration file of that method.
    """
    opened = open(source)
    drive = drive_of(opened)
    if start not in ("identity", "truth") if isinstance(start, str) else not isinstance(start, Transform | StartPose):
        raise ConfigError(f"start is {start!r:.60}: 'identity', 'truth' or a pose of RB in DS (Transform) is required")
    with naming(opened.path):
        first = start_pose(drive, start) if isinstance(start, str) else StartPose.of(start)
    how: LocalisationConfig | UnderTest
    if method == OURS:
        how = _parameters(LocalisationConfig, config, "localisation")
    else:
        how = _under_test(method, Task.LOCALISATION, config, opened)
    if live:
        steps = _named(opened.path, localiser_steps(drive, how, first))
        return (step.estimate for step in steps)
    with naming(opened.path):
        done = run_localiser(drive, how, first)
    if (text := tracking_warning(done.records, opened.path)) is not None:
        warnings.warn(text, UserWarning, stacklevel=2)
    return api_types.Trajectory.of(done.trajectory, records=tuple(done.records), method=done.method)


def map(
    source: SourceLike,
    *,
    fuse: bool = True,
    refine_poses: bool = False,
    config: Parameters | MappingConfig | None = None,
    method: str = OURS,
) -> api_types.PointCloud:
    """Map up to three stereo pairs, like `sfr map` with options of the same names.

    `config` contains the parameters of the mapper. For another `method`, it is the configuration file of that method.
    """
    opened = open(source)
    panorama = panorama_of(opened)
    with naming(opened.path):
        how: MappingConfig | UnderTest
        if method == OURS:
            parameters = _parameters(MappingConfig, config, "mapping")
            how = replace(parameters, refine_poses=True) if refine_poses else parameters
        elif refine_poses:
            raise ConfigError(f"refine_poses is an option of our mapper: omit it with method {method}")
        else:
            how = _under_test(method, Task.MAPPING, config, opened)
        run = run_mapper(panorama, how)
    for line in run.warnings:
        warnings.warn(line, UserWarning, stacklevel=2)
    cloud = run.fused.cloud if fuse else run.unfused
    return api_types.PointCloud.of(cloud, records=tuple(run.records), method=run.method)


class ScoreOptions(ScoreSettings, total=False):
    """Options of `sfr score` with the same names."""

    fused: bool  # whether the cloud is fused, for a file without this information
    convention: Sequence[str]  # convention of the poses: `["frame=left_optical", "world=first_pose"]`
    apply_diagnosis: bool  # whether to correct the convention mismatch that explains the errors
    max_difference: float  # maximum difference of stamps paired for APE and RPE, s (default 0.01)
    rpe_delta: str  # interval of the RPE: `frames=1` or `distance=10`


def score(
    estimate: Estimate,
    truth: Truth,
    conditions: Sequence[str] | None = None,
    limits: PathLike | Mapping[str, object] | Limits | None = None,
    *,
    align: str | None = None,
    stats: Sequence[PathLike] = (),
    **settings: Unpack[ScoreOptions],
) -> api_types.Score:
    """Score an estimated trajectory or cloud against the ground truth, with the same figures as `sfr score`.

    Estimate and truth may be objects or files. `conditions` are the ends of sub-trajectories: `distance=5` (default),
    `time=60`, `frames=100`, or `distance=5,time=10` if both must hold. `limits` is a YAML file or its content. `align`
    is `none`, `origin`, `se3` or `sim3`. `stats` are files from `sfr localise --stats`, by default the one beside the
    file of the estimate. Results of `sfr.localise` and `sfr.map` contain their statistics.
    """
    known = get_type_hints(ScoreOptions)
    if unknown := sorted(set(settings) - set(known)):
        raise ConfigError(f"sfr.score has no setting '{unknown[0]}': the settings are {', '.join(known)}")
    of_score: Any = {name: value for name, value in settings.items() if name in get_type_hints(ScoreSettings)}
    config = score_settings(None if conditions is None else _texts("conditions", conditions), **of_score)
    convention = PoseConvention.parse(_texts("convention", settings.get("convention", ())))
    correction = Correction(convention, settings.get("apply_diagnosis", False))
    files = [stats] if isinstance(stats, (str, os.PathLike)) or not isinstance(stats, Iterable) else [*stats]
    for file in files:
        _check("stats", file)
    run = _run(estimate, truth, tuple(Path(file) for file in files), settings.get("fused"))
    if correction.is_wanted and run.drive is None:
        raise ConfigError("convention and apply_diagnosis apply only to trajectories: omit them for a cloud")
    if settings.get("fused") is not None and run.cloud is None:
        raise ConfigError("fused applies only to clouds: omit it for a trajectory")
    further = {"max_difference_s": settings.get("max_difference"), "rpe_delta": settings.get("rpe_delta")}
    aligned = aligned_error_config(align, further)
    if isinstance(limits, Mapping):
        limits = parse_limits(limits, "limits")
    elif limits is not None and not isinstance(limits, Limits):
        _check("limits", limits, dict)
        limits = load_limits(Path(limits))
    return api_types.Score.of(score_run(converted_run(run, config, correction), config, limits, aligned))


def _run(estimate: Estimate, truth: Truth, stats: tuple[Path, ...], fused: bool | None) -> Run:
    """Return the run to be scored. Files are read as by the command."""
    _check("estimate", estimate, Trajectory, PointCloud)
    _check("truth", truth, Trajectory, Source)
    place, config = (truth.path, truth.config) if isinstance(truth, Source) else (truth, None)
    if isinstance(estimate, PointCloud):
        if isinstance(place, Trajectory):
            raise ConfigError("a cloud requires a source with mapping pairs and truth; a trajectory was given")
        inputs = ScoreInputs(map_truth=Path(place), stats=stats, config=config)
        return load_run(inputs, fused, InMemory(cloud=estimate, calls=_own_stats(estimate)))
    if not isinstance(estimate, Trajectory) and not isinstance(place, Trajectory):
        inputs = ScoreInputs.of(Path(estimate), Path(place), stats or None)
        return load_run(replace(inputs, config=config), fused)
    poses = estimate if isinstance(estimate, Trajectory) else None
    true = place if isinstance(place, Trajectory) else None
    inputs = ScoreInputs(
        estimate=None if isinstance(estimate, Trajectory) else Path(estimate),
        truth=None if isinstance(place, Trajectory) else Path(place),
        stats=stats,
        config=config,
    )
    return load_run(inputs, fused, InMemory(poses, true, calls=_own_stats(estimate)))


def _under_test(method: str, task: Task, config: object, source: Source) -> UnderTest:
    """Return a method under test; `config` is the file of its configuration, if it has one."""
    if config is not None:
        _check("config", config)
    file = None if config is None else Path(str(config))
    return UnderTest(find_method(method, task, config_text(file)), hidden=source.truth_paths())


def _own_stats(estimate: object) -> list[CallStats]:
    if isinstance(estimate, (api_types.Trajectory, api_types.PointCloud)) and estimate.records:
        return [stats_of(estimate.records, estimate.method)]
    return []


def _named(path: Path, steps: Iterator[Step]) -> Iterator[Step]:
    with naming(path):
        yield from steps


def _texts(name: str, items: Sequence[str]) -> Sequence[str]:
    """Return the strings of an argument; a single string becomes a list of one string."""
    texts = [items] if isinstance(items, str) or not isinstance(items, Iterable) else [*items]
    wrong = [text for text in texts if not isinstance(text, str)]
    if wrong:
        raise ConfigError(
            f"{name} has {wrong[0]!r:.60}: strings are required, such as 'distance=5' or 'frame=left_optical'"
        )
    return texts


def _check(name: str, value: object, *kinds: type) -> None:
    """Raise ConfigError with the name of the argument if its value is neither a path nor one of `kinds`."""
    if not isinstance(value, (str, os.PathLike, *kinds)):
        known = alternatives(kind.__name__ for kind in kinds)
        wanted = f"a path or a {known}" if kinds else "a path"
        raise ConfigError(f"{name} has the type {type(value).__name__}: {wanted} is required")


def _parameters(kind: type[C], config: object, section: str) -> C:
    if config is None or isinstance(config, kind):
        return kind() if config is None else config
    if isinstance(config, Mapping):
        return build(kind, config, origin="config")
    _check("config", config, kind, dict)
    return read_config(kind, Path(str(config)), section)
