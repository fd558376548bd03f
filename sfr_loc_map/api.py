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

import numpy as np

from sfr_loc_map import api_types
from sfr_loc_map.api_types import PathLike, path_of, wrong_type
from sfr_loc_map.calls.call_record import tracking_warning
from sfr_loc_map.calls.call_stats import CallStats, stats_of
from sfr_loc_map.config import build
from sfr_loc_map.config_file import read_config
from sfr_loc_map.errors import ConfigError, naming
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.clouds.cloud_file import LoadedCloud
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.sequence import Source, drive_of, panorama_of
from sfr_loc_map.io.source_settings import source_config
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import PoseEstimate, StartPose
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.message_text import one_line
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
from sfr_loc_map.scoring.settings import ScoreSettings, check_known, score_settings
from sfr_loc_map.suite_names import OURS, Task

C = TypeVar("C")
SourceLike = PathLike | Source
Start = str | Transform | StartPose  #: Start of a drive: `identity`, `truth`, or a pose of RB in DS.
Parameters = PathLike | Mapping[str, object]  #: Parameters: a YAML file, or values by name (`{"max_features": 300}`).
Estimate = PathLike | Trajectory | PointCloud
Truth = PathLike | Trajectory | Source


def open(
    source: SourceLike, remap: Mapping[str, str] | None = None, config: PathLike | None = None
) -> api_types.Source:
    """Open a data set folder, ROS bag, KITTI or EuRoC sequence. The format is detected from the content.

    `remap` maps topics of a bag to those of the suite: `{"/cam0/image": "loc/left/image_rect"}`. `config` is an
    `sfr.yaml`, by default the one in or beside the source.
    """
    if isinstance(source, Source):
        if remap is not None or config is not None:
            raise ConfigError("remap and config apply to a path: give the path instead of an open source")
        return source if isinstance(source, api_types.Source) else api_types.Source.of(source)
    place = path_of(source, "source", "a path or an open source")
    how = source_config(place, None if config is None else path_of(config, "config"), remap)
    return api_types.Source.of(open_source(place, how))


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
    `PoseEstimate` as soon as it is estimated.

    `config` contains the parameters of the localiser. A file also configures how a `source` that is a path is read.
    Without `config`, the parameters are those of the file with which the source was opened. For another `method`,
    `config` is the configuration file of that method.
    """
    _check_flag("live", live)
    opened = _opened(source, config, method)
    drive = drive_of(opened)
    is_named = isinstance(start, str) and start in ("identity", "truth")
    if not is_named and not isinstance(start, Transform | StartPose):
        required = "'identity', 'truth' or a pose of RB in DS (Transform) is required"
        raise ConfigError(one_line(f"start is {start!r:.60}: {required}"))
    with naming(opened.path):
        first = start_pose(drive, start) if isinstance(start, str) else StartPose.of(start)
    how = _parameters_or_method(LocalisationConfig, Task.LOCALISATION, method, config, opened)
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
    refine_poses: bool | None = None,
    config: Parameters | MappingConfig | None = None,
    method: str = OURS,
) -> api_types.PointCloud:
    """Map up to three stereo pairs, like `sfr map` with options of the same names.

    `config` contains the parameters of the mapper, as that of `sfr.localise` those of the localiser. If `refine_poses`
    is given, it has priority over the parameter of this name.
    """
    _check_flag("fuse", fuse)
    if refine_poses is not None:
        _check_flag("refine_poses", refine_poses)
    opened = _opened(source, config, method)
    panorama = panorama_of(opened)
    with naming(opened.path):
        how = _parameters_or_method(MappingConfig, Task.MAPPING, method, config, opened)
        if isinstance(how, MappingConfig):
            how = how if refine_poses is None else replace(how, refine_poses=bool(refine_poses))
        elif refine_poses:
            raise ConfigError(f"refine_poses applies only to the suite's mapper: omit it with method {method}")
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

    A UserWarning reports what the command prints about a file: an inferred format or unit, and skipped rows.
    """
    check_known(settings, ScoreOptions, "sfr.score")
    of_score: Any = {name: value for name, value in settings.items() if name in get_type_hints(ScoreSettings)}
    texts = None if conditions is None else _texts("conditions", conditions)
    if texts is not None and not texts:
        raise ConfigError("conditions is empty: give at least one, such as 'distance=5', or None for the default")
    config = score_settings(texts, **of_score)
    further = {name: settings.get(name) for name in ("max_difference", "rpe_delta")}
    aligned = aligned_error_config(align, further)
    fused, apply_diagnosis = settings.get("fused"), settings.get("apply_diagnosis", False)
    _check_flag("apply_diagnosis", apply_diagnosis)
    if fused is not None:
        _check_flag("fused", fused)
    correction = Correction(PoseConvention.parse(_texts("convention", settings.get("convention", ()))), apply_diagnosis)
    judged_by = _limits(limits)
    run = _run(estimate, truth, tuple(path_of(file, "stats") for file in _items(stats)), fused)
    for note in () if run.drive is None else run.drive.notes:
        warnings.warn(note, UserWarning, stacklevel=2)
    if correction.is_wanted and run.drive is None:
        raise ConfigError("convention and apply_diagnosis apply only to trajectories: omit them for a cloud")
    if fused is not None and run.cloud is None:
        raise ConfigError("fused applies only to clouds: omit it for a trajectory")
    return api_types.Score.of(score_run(converted_run(run, config, correction), config, judged_by, aligned))


def _run(estimate: Estimate, truth: Truth, stats: tuple[Path, ...], fused: bool | None) -> Run:
    """Return the run to be scored. Files are read as by the command, and objects are treated like their files."""
    if not isinstance(estimate, Trajectory | PointCloud):
        estimate = path_of(estimate, "estimate", "a path, a Trajectory or a PointCloud")
    config = truth.config if isinstance(truth, Source) else None
    place = truth.path if isinstance(truth, Source) else truth
    if not isinstance(place, Trajectory):
        place = path_of(place, "truth", "a path, a Trajectory or an open source")
    if isinstance(estimate, Path) and isinstance(place, Path):
        return load_run(replace(ScoreInputs.of(estimate, place, stats or None), config=config), fused)
    calls = _own_stats(estimate)
    if isinstance(estimate, PointCloud):
        if isinstance(place, Trajectory):
            raise ConfigError("the truth is a trajectory: a cloud requires a source with mapping pairs and their truth")
        loaded = estimate.loaded if isinstance(estimate, api_types.PointCloud) else LoadedCloud.of(estimate)
        inputs = ScoreInputs(map_truth=place, stats=stats, config=config)
        return load_run(inputs, fused, InMemory(cloud=loaded, calls=calls))
    inputs = ScoreInputs(
        estimate=estimate if isinstance(estimate, Path) else None,
        truth=place if isinstance(place, Path) else None,
        stats=stats,
        config=config,
    )
    poses = estimate if isinstance(estimate, Trajectory) else None
    true_poses = place if isinstance(place, Trajectory) else None
    return load_run(inputs, fused, InMemory(poses, true_poses, calls=calls))


def _own_stats(estimate: object) -> list[CallStats]:
    if isinstance(estimate, (api_types.Trajectory, api_types.PointCloud)) and estimate.records:
        return [stats_of(estimate.records, estimate.method)]
    return []


def _named(path: Path, steps: Iterator[Step]) -> Iterator[Step]:
    with naming(path):
        yield from steps


def _limits(given: PathLike | Mapping[str, object] | Limits | None) -> Limits | None:
    """Return the limits in a file or in its content."""
    if given is None or isinstance(given, Limits):
        return given
    if isinstance(given, Mapping):
        return parse_limits(given, "limits")
    return load_limits(path_of(given, "limits", "a path, the content of a file of limits, or Limits"))


def _opened(source: SourceLike, config: object, method: str) -> api_types.Source:
    """Return the open source; a path is opened with a `config` that is a file, if the file is not that of a method."""
    is_file = method == OURS and isinstance(config, str | os.PathLike)
    if is_file and not isinstance(source, Source):
        return open(source, config=path_of(config))
    return open(source)


def _parameters_or_method(kind: type[C], task: Task, method: str, config: object, source: Source) -> C | UnderTest:
    """Return the parameters of our localiser or mapper, or another method with the text of its configuration file."""
    if not isinstance(method, str):
        raise wrong_type("method", method, "the name of a method")
    if method != OURS:
        text = config_text(None if config is None else path_of(config, "config"))
        return UnderTest(find_method(method, task, text), hidden=source.truth_paths())
    if config is None:
        return source.config.parameters(kind, task.value)
    if isinstance(config, kind):
        return config
    if isinstance(config, Mapping):
        return build(kind, config, origin="config")
    file = path_of(config, "config", f"a path, parameters by name, or a {kind.__name__}")
    return read_config(kind, file, task.value)


def _items(values: object) -> list[Any]:
    """Return the items of an argument; a text, a path or another single value becomes a list of one item."""
    if isinstance(values, str | os.PathLike) or not isinstance(values, Iterable):
        return [values]
    return [*values]


def _texts(name: str, values: Sequence[str]) -> Sequence[str]:
    """Return the strings of an argument; a single string becomes a list of one string."""
    texts = _items(values)
    wrong = [text for text in texts if not isinstance(text, str)]
    if wrong:
        found = one_line(f"{wrong[0]!r:.60}")
        raise ConfigError(f"{name} has {found}: strings are required, such as 'distance=5' or 'frame=left_optical'")
    return texts


def _check_flag(name: str, value: object) -> None:
    """Raise ConfigError with the name of the argument unless its value is a boolean: `"no"` would be true."""
    if not isinstance(value, bool | np.bool_):
        raise ConfigError(f"{name} is {value!r:.60}: True or False is required")
