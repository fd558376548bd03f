"""The suite from Python: `import sfr_loc_map as sfr`; the same calls as the commands make (docs/python.md).

Every public name stands in `sfr_loc_map` itself. What goes wrong is an `SfrError` whose text says what to do.
"""

from __future__ import annotations

import os
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self, TypedDict, TypeVar, Unpack, overload

import msgspec
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.config import build, read_config
from sfr_loc_map.errors import ConfigError, InputError, MissingExtraError, naming
from sfr_loc_map.geometry import cloud as cloud_base
from sfr_loc_map.geometry import trajectory as trajectory_base
from sfr_loc_map.geometry.pose_convention import PoseConvention
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import NS_PER_S, Task, hash_arrays, printable
from sfr_loc_map.io import registry, sequence
from sfr_loc_map.io.atomic import write_text
from sfr_loc_map.io.cloud_file import LoadedCloud, load_cloud, save_cloud
from sfr_loc_map.io.sequence import drive_of, panorama_of
from sfr_loc_map.io.source_config import source_config
from sfr_loc_map.io.trajectory_file import read_trajectory_file, save_trajectory
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import PoseEstimate, StartPose
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.methods.registry import OURS, MethodLimits, config_text, find_method, record_of_ours
from sfr_loc_map.metrics import score as score_base
from sfr_loc_map.metrics.config import AlignedErrorConfig, aligned_error_config, score_config
from sfr_loc_map.metrics.limits import Limits, load_limits, parse_limits
from sfr_loc_map.metrics.score import MethodRecord
from sfr_loc_map.metrics.score_json import to_json
from sfr_loc_map.report.page import load_score, write_page
from sfr_loc_map.report.path_figure import curves_of, path_plot
from sfr_loc_map.report.plots import to_figure
from sfr_loc_map.report.score_figures import score_figures
from sfr_loc_map.report.score_tables import row_title, score_markdown, summary_tables
from sfr_loc_map.report.tables import UNKNOWN, to_html
from sfr_loc_map.runs import offline
from sfr_loc_map.runs.calls import CallRecord, CallStats, save_stats, stats_of
from sfr_loc_map.scoring.score_run import (
    Correction,
    Run,
    ScoredCloud,
    ScoreInputs,
    converted_run,
    load_map_truth,
    load_run,
    said_fused,
    score_run,
)

if TYPE_CHECKING:
    import pandas
    from plotly.graph_objects import Figure

C = TypeVar("C")
PathLike = str | os.PathLike[str]
SourceLike = PathLike | sequence.Source
Start = str | Transform | StartPose  #: Where a drive starts: `identity`, `truth`, or a pose of RB in DS.
Parameters = PathLike | Mapping[str, object]  #: Parameters: a YAML file, or values by name (`{"max_features": 300}`).
Estimate = PathLike | trajectory_base.Trajectory | cloud_base.PointCloud
Truth = PathLike | trajectory_base.Trajectory | sequence.Source
Step = tuple[PoseEstimate, CallRecord, MethodRecord]


class _Shown:
    """Shows facts in one line, and as a table of HTML whose every text is escaped."""

    __slots__ = ()

    def _facts(self) -> dict[str, str]:
        raise NotImplementedError

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(self._facts().values())})"

    def _repr_html_(self) -> str:
        left = "style='text-align:left'"
        rows = "".join(
            f"<tr><th {left}>{escape(printable(name))}</th><td {left}>{escape(printable(value))}</td></tr>"
            for name, value in self._facts().items()
        )
        return f"<b>{type(self).__name__}</b><table>{rows}</table>"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Trajectory(_Shown, trajectory_base.Trajectory):
    """Poses of RB in DS at stamps: `stamps_ns` `(N,)`, `positions` `(N, 3)` m, `quats_xyzw` `(N, 4)` as in ROS.

    Iterating and `poses[3]` give `(stamp_ns, pose)`; `poses[10:20]`, or a mask, a trajectory.
    """

    #: The calls that gave the poses: time, memory, state, covariance; empty for poses from elsewhere.
    records: tuple[CallRecord, ...] = ()
    method: MethodRecord | None = None  #: Whose poses these are, None where nobody has said so.

    @classmethod
    def of(
        cls, poses: trajectory_base.Trajectory, records: Iterable[CallRecord] = (), method: MethodRecord | None = None
    ) -> Self:
        """Return poses with the calls that gave them."""
        return cls(poses.stamps_ns, poses.positions, poses.quats_xyzw, tuple(records), method)

    @classmethod
    def from_estimates(cls, estimates: Iterable[PoseEstimate]) -> Self:
        """Return the poses of estimates, as `sfr.localise(..., live=True)` and `sfr.Localiser` give them."""
        return cls.from_poses((item.stamp_ns, item.T_ds_rb) for item in estimates)

    @classmethod
    def load(cls, path: PathLike) -> Self:
        """Read a file; the format is detected: csv of the suite, TUM, KITTI, EuRoC."""
        return cls.of(read_trajectory_file(Path(path)).trajectory)

    def save(self, path: PathLike) -> None:
        """Write a file, whose name says the format: `.csv`, `.txt` or `.tum`, `.kitti`, `.euroc.csv`."""
        save_trajectory(Path(path), self)

    def to_stats(self, path: PathLike) -> None:
        """Write one row a call (time, memory, state, covariance) as `sfr localise --stats` does."""
        if not self.records:
            raise ConfigError("these poses have no calls: to_stats() is for what sfr.localise gives")
        save_stats(Path(path), self.records, self.method)

    def to_pandas(self) -> pandas.DataFrame:
        """Return a pandas table: one row a pose, indexed by `stamp_ns`; of our own poses with `state` and `reason`."""
        columns = np.hstack((self.positions, self.quats_xyzw)).T
        frame = _data_frame(dict(zip(("x", "y", "z", "qx", "qy", "qz", "qw"), columns, strict=True)))
        frame.index = self.stamps_ns
        frame.index.name = "stamp_ns"
        for name in ("state", "reason") if self.records else ():
            frame[name] = [getattr(record, name) for record in self.records]
        return frame

    def plot(self, truth: trajectory_base.Trajectory | None = None, align: str = "none") -> Figure:
        """Return the path as a plotly figure, as `sfr report` draws it; with the truth also the distance to it."""
        config = build(AlignedErrorConfig, {"align": align}, origin="align")
        return to_figure(path_plot(curves_of({"estimate": self}, truth, config)))

    def __iter__(self) -> Iterator[tuple[int, Transform]]:
        """Yield stamp (ns) and pose `T_ds_rb` of each pose."""
        for index, stamp_ns in enumerate(self.stamps_ns.tolist()):
            yield stamp_ns, self.pose(index)

    @overload
    def __getitem__(self, key: int) -> tuple[int, Transform]: ...

    @overload
    def __getitem__(self, key: slice | Sequence[int] | NDArray[np.generic]) -> Self: ...

    def __getitem__(self, key: Any) -> tuple[int, Transform] | Self:
        """Return stamp (ns) and pose of a number; of a slice, numbers or a mask a trajectory."""
        if isinstance(key, int | np.integer):
            return int(self.stamps_ns[key]), self.pose(int(key))
        rows = np.arange(len(self))[key]
        kept, first = {*rows.tolist()}, rows.min(initial=len(self))
        records = [  # a step is from the pose before, which may be left out
            self.records[row] if row == first or row - 1 in kept else replace(self.records[row], step=None)
            for row in (rows.tolist() if len(self.records) == len(self) else ())
        ]
        poses = trajectory_base.Trajectory(self.stamps_ns[rows], self.positions[rows], self.quats_xyzw[rows])
        return self.of(poses, records, self.method)

    def _facts(self) -> dict[str, str]:
        duration_s = float(np.ptp(self.stamps_ns)) / NS_PER_S if len(self) else 0.0
        length_m = float(np.linalg.norm(np.diff(self.positions, axis=0), axis=1).sum())
        facts = {"poses": f"{len(self)} poses", "duration": f"{duration_s:.1f} s", "path": f"{length_m:.2f} m"}
        if self.records:
            states = Counter(record.state for record in self.records)
            facts["states"] = ", ".join(f"{count} {state}" for state, count in states.items())
        return facts


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PointCloud(_Shown, cloud_base.PointCloud):
    """Points in LM: `xyz` `(N, 3)` m, `sigma` `(N,)` m, `intensity`, the pixel `u`, `v` and `pair` they come from."""

    #: The calls that gave the points: time, memory; empty for points from elsewhere.
    records: tuple[CallRecord, ...] = ()
    method: MethodRecord | None = None  #: Whose points these are, None where nobody has said so.

    @classmethod
    def of(
        cls, points: cloud_base.PointCloud, records: Iterable[CallRecord] = (), method: MethodRecord | None = None
    ) -> Self:
        """Return points with the calls that gave them."""
        given = {item.name: getattr(points, item.name) for item in fields(cloud_base.PointCloud)}
        return cls(**given, records=tuple(records), method=method)

    @classmethod
    def load(cls, path: PathLike) -> Self:
        """Read a cloud file of the suite: .ply, .pcd or .npz."""
        loaded = load_cloud(Path(path))
        if loaded.cloud is None:
            raise InputError(f"'{path}' has points without pixels (u, v, pair): give the path itself to sfr.score")
        return cls.of(loaded.cloud)

    def save(self, path: PathLike) -> None:
        """Write the cloud: .ply, .pcd or .npz."""
        save_cloud(Path(path), self)

    def to_pandas(self) -> pandas.DataFrame:
        """Return a pandas table: one row a point."""
        records = self.to_structured()
        return _data_frame({name: records[name] for name in cloud_base.FIELD_TYPES})

    def _facts(self) -> dict[str, str]:
        facts = {"points": f"{len(self)} points"}
        if len(self):
            low, high = self.xyz.min(axis=0), self.xyz.max(axis=0)
            facts["extent"] = " x ".join(f"{side:.1f}" for side in (high - low).tolist()) + " m"
            facts["sigma"] = f"median sigma {np.median(self.sigma):.2g} m"
        if self.fused is not None:
            facts["fused"] = "fused" if self.fused else "not fused"
        return facts


@dataclass(frozen=True, slots=True, repr=False)
class Source(_Shown, sequence.Source):
    """An opened data set folder, bag, KITTI or EuRoC sequence: `loc` is its drive, `nav` its mapping pairs, or None."""

    @property
    def truth(self) -> Trajectory | None:
        """True poses of RB in DS, None where the source has none."""
        found = None if self.loc is None else self.loc.ground_truth
        return None if found is None or not len(found) else Trajectory.of(found)

    def pairs(self) -> Iterator[StereoPair | PosedStereoPair]:
        """Yield the pairs of the drive one by one, in grey; without a drive those for mapping, with their poses."""
        found = self.loc if self.loc is not None else self.nav
        return iter(()) if found is None else found.pairs()

    __iter__ = pairs

    def __len__(self) -> int:
        return len(self.loc or self.nav or ())

    def __repr__(self) -> str:
        return f"Source({str(self.path)!r}, {self._facts()['holds']})"

    def _facts(self) -> dict[str, str]:
        holds = [self.format]
        if self.loc is not None:
            holds += [
                f"{len(self.loc)} localisation pairs",
                "with truth" if self.truth is not None else "without truth",
            ]
        if self.nav is not None:
            holds.append(f"{len(self.nav)} mapping pairs")
        return {"path": str(self.path), "holds": ", ".join(holds)}


class Score(score_base.Score, frozen=True, kw_only=True, tag_field="schema", tag=score_base.SCHEMA):
    """Figures and verdicts of an estimate: the fields are those of the JSON (docs/metrics.md)."""

    @classmethod
    def of(cls, score: score_base.Score) -> Self:
        """Return a score with what can be done with it."""
        return cls(**msgspec.structs.asdict(score))

    @classmethod
    def load(cls, path: PathLike) -> Self:
        """Read the JSON of a score."""
        return cls.of(load_score(Path(path)))

    def to_json(self) -> str:
        """Return the JSON (`sfr-score/2`), the same as of `sfr score --json`."""
        return to_json(self)

    def save(self, path: PathLike) -> None:
        """Write the JSON."""
        write_text(self.to_json(), Path(path))

    def report(self, path: PathLike) -> None:
        """Write the report page, the same as of `sfr score --html`."""
        write_page(self, Path(path))

    def to_markdown(self) -> str:
        """Return all tables as Markdown."""
        return score_markdown(self)

    def to_pandas(self, table: str = "figures") -> pandas.DataFrame:
        """Return a pandas table: `figures`, one row a figure, or `sub_trajectories`, one row each."""
        if table == "figures":
            return super().to_pandas()
        if table != "sub_trajectories":
            raise ConfigError(f"table is '{table}': must be figures or sub_trajectories")
        details = None if self.details is None else self.details.trajectory
        columns: dict[str, list[Any]] = {}
        for rows in () if details is None else details.sub_trajectories:
            count = len(rows.start_frame)
            for name, values in msgspec.structs.asdict(rows).items():
                if name != "every":
                    columns.setdefault(name, []).extend([values] * count if name == "condition" else values)
        return _data_frame(columns)

    def plot(self, name: str | None = None) -> Figure:
        """Return a figure of the report, by default the first, as a plotly figure, which a notebook shows."""
        plots = {plot.name: plot for _, plots in score_figures(self) for plot in plots}
        if not plots or (name is not None and name not in plots):
            raise ConfigError(f"this score has no figure '{name or 'at all'}': it has {', '.join(plots) or 'none'}")
        return to_figure(plots[name] if name is not None else next(iter(plots.values())))

    def __repr__(self) -> str:
        texts = [self.verdict or "no verdict"]
        for row in (self.figure("position"), self.figure("point_error", part=None)):
            if row is not None:
                total = UNKNOWN if row.mean_plus_3sigma is None else f"{row.mean_plus_3sigma:.4g} {row.unit}"
                texts.append(f"{row_title(row)} {total} (mean + 3 sigma)")
        return f"Score({', '.join(texts)})"

    def _repr_html_(self) -> str:
        return f"<b>{self.verdict or 'no verdict'}</b>" + "".join(to_html(table) for table in summary_tables(self))


def open(source: SourceLike, remap: Mapping[str, str] | None = None, config: str | Path | None = None) -> Source:
    """Open a data set folder, ROS bag, KITTI or EuRoC sequence: the format is detected.

    Topics of a bag under other names are remapped: `{"/cam0/image": "loc/left/image_rect"}`. `config`: an `sfr.yaml`;
    without it the one in or beside the source.
    """
    if isinstance(source, sequence.Source) and (remap is not None or config is not None):
        raise ConfigError("remap and config are of a path: give it in place of a source that is open")
    if isinstance(source, Source):
        return source
    _check("source", source, sequence.Source)
    found = source
    if not isinstance(found, sequence.Source):
        how = source_config(Path(found), None if config is None else Path(config), remap)
        found = registry.open_source(Path(found), how)
    return Source(found.path, found.format, found.loc, found.nav, found.left_out, found.configuration, found.remap)


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
    """Estimate the trajectory of a drive; the same call as `sfr localise`, whose options have the same names.

    `start` is `identity`, `truth` or a pose of RB in DS. With `live` it returns an iterator that gives each
    `PoseEstimate` as soon as it is there. `config`: parameters, or of another method the file of its configuration.
    """
    opened = open(source)
    drive = drive_of(opened)
    if isinstance(start, str) and start not in ("identity", "truth"):
        raise ConfigError(f"start is '{start}': must be identity, truth or a pose of RB in DS")
    with naming(opened.path):
        first = offline.start_pose(drive, start) if isinstance(start, str) else StartPose.of(start)
    steps: Iterator[Step]
    if method == OURS:
        about = record_of_ours(Task.LOCALISATION)
        runs = offline.localise(drive, _parameters(LocalisationConfig, config, "localisation"), first)
        steps = ((estimate, record, about) for estimate, record in runs)
    else:
        chosen = find_method(method, Task.LOCALISATION, config_text(None if config is None else Path(str(config))))
        steps = offline.localise_with(chosen, drive, first.T_ds_rb, MethodLimits(), [opened.path])
    steps = _named(opened.path, steps)
    if live:
        return (estimate for estimate, _, _ in steps)
    done = list(steps)
    records = [record for _, record, _ in done]
    if (text := offline.tracking_warning(records, opened.path)) is not None:
        warnings.warn(text, UserWarning, stacklevel=2)
    return Trajectory.of(offline.trajectory_of(estimate for estimate, _, _ in done), records, done[-1][2])


def map(
    source: SourceLike,
    *,
    fuse: bool = True,
    refine_poses: bool = False,
    config: Parameters | MappingConfig | None = None,
    method: str = OURS,
) -> PointCloud:
    """Map up to three stereo pairs; the same call as `sfr map`, whose options have the same names.

    `config` are parameters of the mapper, or of another method the file with its configuration.
    """
    opened = open(source)
    panorama = panorama_of(opened)
    with naming(opened.path):
        if method == OURS:
            parameters = _parameters(MappingConfig, config, "mapping")
            parameters = replace(parameters, refine_poses=True) if refine_poses else parameters
            run, about = offline.map_pairs(panorama, parameters), record_of_ours(Task.MAPPING)
        elif refine_poses:
            raise ConfigError(f"refine_poses is of our mapper: leave it out with method {method}")
        else:
            chosen = find_method(method, Task.MAPPING, config_text(None if config is None else Path(str(config))))
            run, about = offline.map_pairs_with(chosen, panorama, MethodLimits(), hidden=[opened.path])
    for line in run.warnings:
        warnings.warn(line, UserWarning, stacklevel=2)
    return PointCloud.of(run.fused.cloud if fuse else run.unfused, run.records, about)


class ScoreSettings(TypedDict, total=False):
    """Options of `sfr score` by the same names."""

    spacing: int  # frames from one start of a sub-trajectory to the next (10)
    rebase: str  # how error from before a start is kept out: `pose`, `displacement` or `position`
    partial: bool  # whether to judge an estimate of a part of the drive as if it were the whole (False)
    frames: str  # what frames are: `truth` poses, or `images` (estimates, with the truth interpolated)
    associate: str  # how an estimate finds its truth: `auto`, `match` or `interpolate`
    max_gap: float  # longest gap of the truth that is interpolated, s (1)
    scored_range: tuple[float, float]  # ranges of the truth that count for coverage, m (0, 10)
    fused: bool  # whether the cloud is fused, for a file that does not say so
    convention: Sequence[str]  # how the poses were written: `["frame=left_optical", "world=first_pose"]`
    apply_diagnosis: bool  # whether to correct the convention mismatch that explains the errors
    max_difference: float  # longest difference of stamps paired for APE and RPE, s (0.01)
    rpe_delta: str  # length of a relative error: `frames=1` or `distance=10`


CONFIG_NAMES = {"spacing": "spacing", "rebase": "rebase", "partial": "partial"}
CONFIG_NAMES |= {"associate": "association.truth", "max_gap": "association.max_gap_s"}
"""Names in `TrajectoryScoreConfig` of those settings that are fields of it."""


def score(
    estimate: Estimate,
    truth: Truth,
    conditions: Sequence[str] | None = None,
    limits: PathLike | Mapping[str, object] | Limits | None = None,
    *,
    align: str | None = None,
    stats: Sequence[PathLike] = (),
    **settings: Unpack[ScoreSettings],
) -> Score:
    """Score an estimate, a trajectory or a cloud, against the truth; the same figures as `sfr score`.

    Each may be in memory or a file. `conditions` are ends of sub-trajectories (`distance=5`, `time=60`, `frames=100`,
    `distance=5,time=10` where both hold; distance=5 where none is given), `limits` a YAML file or its content, `align`
    is `none`, `origin`, `se3` or `sim3` and `stats` files of `sfr localise --stats`, which what `sfr.localise` and
    `sfr.map` give does not need.
    """
    known = ScoreSettings.__annotations__
    if unknown := sorted(set(settings) - set(known)):
        raise ConfigError(f"sfr.score has no setting '{unknown[0]}': it has {', '.join(known)}")
    convention = PoseConvention.parse(_texts("convention", settings.get("convention", ())))
    correction = Correction(convention, settings.get("apply_diagnosis", False))
    low, high = settings.get("scored_range", (0.0, 10.0))
    named = {f"trajectory.{CONFIG_NAMES[name]}": value for name, value in settings.items() if name in CONFIG_NAMES}
    named |= {"map.scored_from_m": low, "map.scored_to_m": high}
    if (frames := settings.get("frames", "truth")) not in ("truth", "images"):
        raise ConfigError(f"frames is '{frames}': must be truth or images")
    if frames == "images":
        named["trajectory.association.truth"] = "interpolate"
    config = score_config(() if conditions is None else _texts("conditions", conditions), named)
    files = [stats] if isinstance(stats, (str, Path)) else stats
    run = _run(estimate, truth, tuple(Path(file) for file in files), settings.get("fused"))
    if correction.is_wanted and run.drive is None:
        raise ConfigError("convention and apply_diagnosis are for trajectories: leave them out for a cloud")
    further = {"max_difference_s": settings.get("max_difference"), "rpe_delta": settings.get("rpe_delta")}
    aligned = aligned_error_config(align, further)
    if isinstance(limits, Mapping):
        limits = parse_limits(limits, "limits")
    elif limits is not None and not isinstance(limits, Limits):
        _check("limits", limits, dict)
        limits = load_limits(Path(limits))
    return Score.of(score_run(converted_run(run, config, correction), config, limits, aligned))


def _run(estimate: Estimate, truth: Truth, stats: tuple[Path, ...], fused: bool | None) -> Run:
    """Return what there is to score: files are read as the command reads them."""
    _check("estimate", estimate, trajectory_base.Trajectory, cloud_base.PointCloud)
    _check("truth", truth, trajectory_base.Trajectory, sequence.Source)
    place = truth.path if isinstance(truth, sequence.Source) else truth
    if isinstance(estimate, cloud_base.PointCloud):
        if isinstance(place, trajectory_base.Trajectory):
            raise ConfigError("a cloud is scored against a source with mapping pairs and truth, not a trajectory")
        read = [*load_run(ScoreInputs(stats=stats)).stats, *_own_stats(estimate)]
        loaded = said_fused(LoadedCloud(estimate.xyz.astype(np.float64), estimate), fused, "the cloud")
        cloud = ScoredCloud(loaded, load_map_truth(Path(place), estimate.pair_stamps_ns))
        in_memory = {"cloud": hash_arrays([estimate.to_structured()])}
        return Run(ScoreInputs(map_truth=Path(place), stats=stats), read, cloud=cloud, in_memory=in_memory)
    if not isinstance(estimate, trajectory_base.Trajectory) and not isinstance(place, trajectory_base.Trajectory):
        return load_run(ScoreInputs.of(Path(estimate), Path(place), stats), fused)
    both: dict[str, Any] = {"estimate": estimate, "truth": place}
    given = {role: item for role, item in both.items() if isinstance(item, trajectory_base.Trajectory)}
    files: dict[str, Any] = {role: Path(item) for role, item in both.items() if role not in given}
    run = load_run(ScoreInputs(**files, stats=stats), fused, calls=_own_stats(estimate), **given)
    hashes = {role: hash_arrays((item.stamps_ns, item.positions, item.quats_xyzw)) for role, item in given.items()}
    return replace(run, in_memory=hashes)


def _own_stats(estimate: object) -> list[CallStats]:
    if isinstance(estimate, (Trajectory, PointCloud)) and estimate.records:
        return [stats_of(estimate.records, estimate.method)]
    return []


def _named(path: Path, steps: Iterator[Step]) -> Iterator[Step]:
    with naming(path):
        yield from steps


def _texts(name: str, items: Sequence[str]) -> Sequence[str]:
    """Return the texts of an argument; a single one is one, not its letters."""
    texts = [items] if isinstance(items, str) or not isinstance(items, Iterable) else [*items]
    wrong = [text for text in texts if not isinstance(text, str)]
    if wrong:
        raise ConfigError(
            f"{name} has {wrong[0]!r:.60}: texts are needed, such as 'distance=5' or 'frame=left_optical'"
        )
    return texts


def _check(name: str, value: object, *kinds: type) -> None:
    """Raise ConfigError, which names the argument, if its value is neither a path nor of these kinds."""
    if not isinstance(value, (str, os.PathLike, *kinds)):
        known = " or ".join(kind.__name__ for kind in kinds)
        raise ConfigError(f"{name} is of type {type(value).__name__}: a path or a {known} is needed")


def _parameters(kind: type[C], config: object, section: str) -> C:
    if config is None or isinstance(config, kind):
        return kind() if config is None else config
    if isinstance(config, Mapping):
        return build(kind, config, origin="config")
    return read_config(kind, Path(str(config)), section)


def _data_frame(columns: Mapping[str, Any]) -> pandas.DataFrame:
    try:
        import pandas
    except ImportError as error:
        raise MissingExtraError("to_pandas() needs pandas: pip install 'sfr_loc_map[notebook]'") from error
    return pandas.DataFrame(dict(columns))
