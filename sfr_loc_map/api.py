"""Python interface: `import sfr_loc_map as sfr`. Functions and commands make the same calls (docs/python.md).

The functions, the types of their arguments and the types of their results can be imported from `sfr_loc_map` itself.
Every function raises a subclass of `SfrError`, whose message says what to do. ConfigError refers to an argument or a
configuration file, and InputError to a file or a source that is missing, invalid or incomplete.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from inspect import signature
from pathlib import Path
from typing import Any, Literal, TypeVar, overload

import numpy as np

from sfr_loc_map import api_types
from sfr_loc_map.api_types import PathLike, path_of, wrong_type
from sfr_loc_map.calls.call_findings import findings_of
from sfr_loc_map.calls.call_record import CallRecord, tracking_warning
from sfr_loc_map.calls.call_stats import CallStats
from sfr_loc_map.calls.growing_calls import stats_of
from sfr_loc_map.configuration.parameters import build
from sfr_loc_map.configuration.sections import Configuration
from sfr_loc_map.errors import ConfigError, naming
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.clouds.cloud_file import LoadedCloud
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.sequence import Source, drive_of, panorama_of
from sfr_loc_map.io.source_config import source_config
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import PoseEstimate, StartPose
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.message_text import one_line
from sfr_loc_map.methods.registry import config_text, find_method
from sfr_loc_map.metrics.judging.reasons import unmet_conditions
from sfr_loc_map.runs.drive_start import start_pose, unstamped_start_warning
from sfr_loc_map.runs.localiser_run import Step, localiser_steps, run_localiser
from sfr_loc_map.runs.mapper_run import run_mapper
from sfr_loc_map.runs.under_test import UnderTest
from sfr_loc_map.scoring.inputs import InMemory, ScoreInputs
from sfr_loc_map.scoring.judgement import Judgement
from sfr_loc_map.scoring.load import how_to_read, load_run
from sfr_loc_map.scoring.request import ScoreRequest
from sfr_loc_map.suite_names import OURS, Task

C = TypeVar("C")
SourceLike = PathLike | Source
Start = str | Transform | StartPose  #: Start of a drive: `identity`, `truth`, or a pose of RB in DS.
Parameters = PathLike | Mapping[str, object]  #: Parameters: a YAML file, or values by name (`{"max_features": 300}`).
Estimate = PathLike | Trajectory | PointCloud
Truth = PathLike | Trajectory | Source
EXAMPLES = {"conditions": "distance=5", "convention": "frame=left_optical"}  #: Arguments of strings with an example.


def open(
    source: SourceLike, remap: Mapping[str, str] | None = None, config: PathLike | None = None
) -> api_types.Source:
    """Open a data set folder, ROS bag, KITTI or EuRoC sequence. The format is detected from the content.

    `remap` maps topics of a bag to those of the suite: `{"/cam0/image": "loc/left/image_rect"}`. `config` is an
    `sfr.yaml`, by default the one in or beside the source. An open source is returned as it is.

    InputError if the source does not exist, has no known format, or is invalid. ConfigError for an invalid `remap` or
    `config`, and if one of them is given with an open source.
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

    - `start`: `identity`, `truth` or a pose of RB in DS.
    - `live`: return an iterator that yields each `PoseEstimate` as soon as it is estimated.
    - `config`: the parameters of the localiser. A file also configures how a `source` that is a path is read. A
      dictionary or a `LocalisationConfig` replaces the complete section `localisation` of the file with which the
      source was opened: parameters that a dictionary does not contain have their defaults. None selects this section.
    - `method`: name of another method, a Python class or a C library; `config` is then the configuration file of this
      method.

    The errors are those of `sfr.open`, and InputError for a source without a drive, for a drive without pairs, for
    images that cannot be read, and for `start="truth"` without true attitudes. ConfigError for an invalid argument,
    GeometryError for an invalid start pose, LocalisationError for pairs that do not fit the rig, and MethodError for a
    method that cannot be found or started. With `live`, errors of the rig, the pairs and the method are raised by
    `next()` on the iterator.

    A UserWarning reports many lost or degraded poses, findings on a method, and a start pose whose stamp differs from
    that of the first pair if the method cannot use the stamp. With `live` there are no warnings.
    """
    _check_flag("live", live)
    opened = _opened(source, config, method)
    drive = drive_of(opened)
    is_named = isinstance(start, str) and start in ("identity", "truth")
    if not is_named and not isinstance(start, Transform | StartPose):
        required = "'identity', 'truth' or a pose of RB in DS (Transform) is required"
        raise ConfigError(one_line(f"'start' is {start!r:.60}: {required}"))
    with naming(opened.path):
        first = start_pose(drive, start) if isinstance(start, str) else StartPose.of(start)
    how = _parameters_or_method(LocalisationConfig, Task.LOCALISATION, method, config, opened)
    if live:
        steps = _named(opened.path, localiser_steps(drive, how, first))
        return (step.estimate for step in steps)
    with naming(opened.path):
        done = run_localiser(drive, how, first)
    if isinstance(how, UnderTest):
        _warn(unstamped_start_warning(first, drive))
    is_ours = not isinstance(how, UnderTest)
    _warn(tracking_warning(done.records, opened.path, is_ours=is_ours), *_findings(method, done.records))
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

    - `fuse`: fuse the pairs into one surface, or keep the points of every pair.
    - `refine_poses`: correct the poses of later pairs by registration of the overlaps. None uses the parameter of this
      name in `config`; a given value replaces this parameter.
    - `config`: the parameters of the mapper, in the forms that `sfr.localise` accepts for the localiser.
    - `method`: as for `sfr.localise`.

    The errors are those of `sfr.open`, and InputError for a source without mapping pairs and for images that cannot be
    read. ConfigError for an invalid argument, MappingError for pairs that cannot be mapped together, such as more than
    three, and MethodError for a method that cannot be found or started.

    A UserWarning reports problems of a pair or of the fusion, and findings on a method.
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
        elif refine_poses is not None:
            raise ConfigError(f"refine_poses applies only to the suite's mapper: omit it with method {method}")
        run = run_mapper(panorama, how)
    _warn(*run.warnings, *_findings(method, run.records))
    cloud = run.fused.cloud if fuse else run.unfused
    return api_types.PointCloud.of(cloud, records=tuple(run.records), method=run.method)


def score(  # noqa: PLR0913 - every option of a score has a name and a default
    estimate: Estimate,
    truth: Truth,
    conditions: Sequence[str] | None = None,
    limits: PathLike | Mapping[str, object] | None = None,
    *,
    align: str | None = None,
    stats: Sequence[PathLike] = (),
    spacing: int = 10,
    rebase: str = "pose",
    partial: bool = False,
    frames: str = "truth",
    associate: str = "auto",
    max_gap: float = 1.0,
    scored_range: tuple[float, float] = (0.0, 10.0),
    fused: bool | None = None,
    convention: Sequence[str] = (),
    apply_diagnosis: bool = False,
    max_difference: float | None = None,
    rpe_delta: str | None = None,
) -> api_types.Score:
    """Score an estimated trajectory or cloud against the ground truth, with the same figures as `sfr score`.

    - `estimate`, `truth`: objects or files. The truth of a cloud is a source with mapping pairs.
    - `conditions`: lengths of the sub-trajectories: `distance=5`, `time=60`, `frames=100`, or `distance=5,time=10` if
      both must be reached. None selects the `conditions` of the configuration of the source, by default `distance=5`.
    - `limits`: a YAML file or its content. None selects the `limits` of the configuration of the source. Without
      limits the verdict is None, or `incomplete` for an estimate that covers only a part of the drive or the map.
    - `stats`: files from `sfr localise --stats`, by default the one beside the file of the estimate. Results of
      `sfr.localise` and `sfr.map` contain their statistics.

    Of trajectories:

    - `spacing`: frames between the starts of sub-trajectories.
    - `rebase`: how the error at the start of a sub-trajectory is removed: `pose`, `displacement` or `position`.
    - `partial`: judge the available part of an estimate that does not cover the complete drive.
    - `frames`: frames of the score: the true poses (`truth`), or the estimates with interpolated truth (`images`).
    - `associate`: truth of an estimate: the true pose of the same stamp (`match`), interpolated between two true poses
      (`interpolate`), or one of the two, chosen by the first stamps (`auto`).
    - `max_gap`: longest gap of the truth in which it is interpolated, s.
    - `convention`: convention of the poses: `["frame=left_optical", "world=first_pose"]`.
    - `apply_diagnosis`: correct the convention mismatch that explains the errors.
    - `align`: also compute APE and RPE after the alignment `none`, `origin`, `se3` or `sim3`.
    - `max_difference`: maximum difference of stamps that are paired for APE and RPE, s; None selects 0.01 s. Requires
      `align`.
    - `rpe_delta`: interval of the RPE, `frames=N` or `distance=M`; None selects `frames=1`. Requires `align`.

    Of clouds:

    - `scored_range`: range interval of the true points that count for coverage, m.
    - `fused`: whether the cloud is fused, for a file without this information.

    ConfigError for an invalid argument, for an invalid condition or `limits`, and for an argument that does not apply
    to the kind of estimate. InputError for a file that is missing or invalid. MetricsError if figures cannot be
    computed, for example from poses without common stamps. A missed limit is not an error: see `Score.verdict`.

    The configuration of a source is that with which the source was opened, or the `sfr.yaml` in or beside its path.

    A UserWarning reports what the command prints about a file: an inferred format or unit, and skipped rows. Another
    UserWarning reports a condition that no sub-trajectory meets.
    """
    _check_flag("apply_diagnosis", apply_diagnosis)
    if fused is not None:
        _check_flag("fused", fused)
    of_trajectories: dict[str, Any] = {
        "spacing": spacing,
        "rebase": rebase,
        "partial": partial,
        "frames": frames,
        "associate": associate,
        "max_gap": max_gap,
        "align": align,
        "max_difference": max_difference,
        "rpe_delta": rpe_delta,
        "convention": _texts("convention", convention),
        "apply_diagnosis": apply_diagnosis,
    }
    wanted = _conditions(conditions)
    inputs, in_memory = _inputs(estimate, truth, [path_of(file, "stats") for file in _items(stats)])
    how = how_to_read(inputs)
    by = Judgement.of(_limits(limits), wanted, how.configuration)
    request = ScoreRequest.of(by.conditions, by.limits, scored_range=scored_range, **of_trajectories)
    if inputs.estimate is None and in_memory.estimate is None:
        _refuse_given({"conditions": wanted, **of_trajectories}, "trajectories: omit it for a cloud")
    if inputs.cloud is None and in_memory.cloud is None:
        _refuse_given({"scored_range": scored_range, "fused": fused}, "clouds: omit it for a trajectory")
    run = load_run(replace(inputs, config=how, limits=by.limits_file), fused, in_memory)
    if run.drive is not None:
        _warn(*run.drive.notes)
    scored = request.scored(run).score
    _warn(*unmet_conditions(scored, by.asked).values())
    return api_types.Score.of(scored)


# ---- a run to be scored


def _inputs(estimate: Estimate, truth: Truth, stats: Sequence[Path]) -> tuple[ScoreInputs, InMemory]:
    """Return the files and the objects of a run. Objects are scored like their files."""
    true_poses = truth if isinstance(truth, Trajectory) else None
    true_file = None if isinstance(truth, Trajectory) else _truth_file(truth)
    if isinstance(estimate, PointCloud):
        files = ScoreInputs(map_truth=true_file, stats=tuple(stats))
        in_memory = InMemory(cloud=_loaded(estimate), calls=_own_calls(estimate))
    elif isinstance(estimate, Trajectory):
        files = ScoreInputs(truth=true_file, stats=tuple(stats))
        in_memory = InMemory(estimate, true_poses, calls=_own_calls(estimate))
    else:
        file = path_of(estimate, "estimate", "a path, a Trajectory or a PointCloud")
        files = ScoreInputs.of(file, true_file, stats or None)
        in_memory = InMemory(truth=true_poses)
    is_cloud = files.cloud is not None or in_memory.cloud is not None
    if is_cloud and true_poses is not None:
        raise ConfigError("the truth is a trajectory: a cloud requires a source with mapping pairs and their truth")
    config = truth.config if isinstance(truth, Source) else None
    return replace(files, config=config), in_memory


def _truth_file(truth: PathLike | Source) -> Path:
    if isinstance(truth, Source):
        return truth.path
    return path_of(truth, "truth", "a path, a Trajectory or an open source")


def _refuse_given(arguments: Mapping[str, Any], kind: str) -> None:
    """Raise ConfigError if an argument of `score` that applies only to another kind of estimate is not its default."""
    parameters = signature(score).parameters
    for name, value in arguments.items():
        default = parameters[name].default
        found = tuple(value) if isinstance(default, tuple) else value
        if found != default:
            raise ConfigError(f"'{name}' applies only to {kind}")


def _loaded(cloud: PointCloud) -> LoadedCloud:
    """Return a cloud in the form in which its file is read."""
    return cloud.loaded if isinstance(cloud, api_types.PointCloud) else LoadedCloud.of(cloud)


def _own_calls(estimate: Trajectory | PointCloud) -> list[CallStats]:
    """Return the calls that a result of `sfr.localise` or `sfr.map` contains; empty for other values."""
    if isinstance(estimate, (api_types.Trajectory, api_types.PointCloud)) and estimate.records:
        return [stats_of(estimate.records, estimate.method)]
    return []


# ---- arguments


def _limits(given: PathLike | Mapping[str, object] | None) -> Path | Mapping[str, object] | None:
    """Return a limits file as a path, or its content; ConfigError if the argument has another type."""
    if given is None or isinstance(given, Mapping):
        return given
    return path_of(given, "limits", "a path or the content of a limits file")


def _conditions(given: Sequence[str] | None) -> Sequence[str] | None:
    texts = None if given is None else _texts("conditions", given)
    if texts is not None and not texts:
        raise ConfigError("'conditions' is empty: give at least one, such as 'distance=5', or None for the default")
    return texts


def _opened(source: SourceLike, config: object, method: str) -> api_types.Source:
    """Return the open source. A path is opened with `config` if `config` is a file and not that of a method.

    ConfigError if `config` is invalid, or if `method` is not a text.
    """
    if not isinstance(method, str):
        raise wrong_type("method", method, "the name of a method")
    is_file = method == OURS and isinstance(config, str | os.PathLike)
    if is_file and not isinstance(source, Source):
        return open(source, config=path_of(config))
    return open(source)


def _parameters_or_method(kind: type[C], task: Task, method: str, config: object, source: Source) -> C | UnderTest:
    """Return the parameters of our localiser or mapper, or another method with the text of its configuration file."""
    if method != OURS:
        text = config_text(None if config is None else path_of(config, "config"))
        return UnderTest(find_method(method, task, text), hidden=source.truth_paths())
    if config is None:
        return source.config.configuration.build(kind, task.value)
    if isinstance(config, kind):
        return config
    if isinstance(config, Mapping):
        return build(kind, config, origin="config")
    file = path_of(config, "config", f"a path, parameters by name, or a {kind.__name__}")
    return Configuration.read(file).build(kind, task.value)


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
        raise ConfigError(f"'{name}' has {found}: strings are required, such as '{EXAMPLES[name]}'")
    return texts


def _check_flag(name: str, value: object) -> None:
    """Raise ConfigError with the name of the argument unless its value is a boolean: `"no"` would be true."""
    if not isinstance(value, bool | np.bool_):
        raise ConfigError(one_line(f"'{name}' is {value!r:.60}: True or False is required"))


# ---- results


def _named(path: Path, steps: Iterator[Step]) -> Iterator[Step]:
    with naming(path):
        yield from steps


def _findings(method: str, records: Sequence[CallRecord]) -> Iterator[str]:
    """Yield a warning about each kind of finding on a method."""
    for finding in findings_of((record.stamp_ns, record.finding) for record in records):
        yield f"method {method}: {finding}"


def _warn(*texts: str | None) -> None:
    """Issue warnings that refer to the line that calls a function of this interface; None is ignored."""
    for text in texts:
        if text is not None:
            warnings.warn(text, UserWarning, stacklevel=3)
