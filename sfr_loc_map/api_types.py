"""Types of the Python interface: sources, poses, clouds and scores with methods that load, save, draw and display them.

Each type extends the type of the same name of a lower layer, which contains only the values. Functions of all layers
therefore accept objects of these types. `Score` is an exception: its look-ups raise an error for a name without a row,
so that the pages and tables are made from a score of the lower layer (`Score._plain`).
"""

from __future__ import annotations

import os
import warnings
from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, fields, replace
from html import escape
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import msgspec
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.atomic import write_text
from sfr_loc_map.calls.call_files import save_stats
from sfr_loc_map.calls.call_record import CallRecord, call_of_estimate
from sfr_loc_map.configuration.parameters import build, suggestion
from sfr_loc_map.errors import ConfigError, GeometryError, InputError, MissingExtraError, OutputError
from sfr_loc_map.geometry import cloud, trajectory
from sfr_loc_map.io import sequence
from sfr_loc_map.io.clouds.cloud_file import LoadedCloud, load_cloud, save_cloud
from sfr_loc_map.io.tables.trajectory_file import read_trajectory_file
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory
from sfr_loc_map.localisation.estimate import PoseEstimate
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.message_text import printable
from sfr_loc_map.metrics.calls.call_meter import CallUsage
from sfr_loc_map.metrics.conditions import Condition
from sfr_loc_map.metrics.config import AlignedErrorConfig
from sfr_loc_map.metrics.figures.catalogue import KINDS
from sfr_loc_map.metrics.figures.details import columns_of
from sfr_loc_map.metrics.figures.records import MethodRecord
from sfr_loc_map.metrics.figures.row_part import ANY
from sfr_loc_map.metrics.figures.rows import COLUMNS, RowNumbers, find_rows
from sfr_loc_map.metrics.figures.rows import Figure as Row
from sfr_loc_map.metrics.formulas import STATISTICS
from sfr_loc_map.metrics.score import score
from sfr_loc_map.metrics.stored.score_json import load_score, to_json
from sfr_loc_map.suffixes import HTML_SUFFIXES, check_suffix
from sfr_loc_map.suite_names import Task

if TYPE_CHECKING:
    import pandas
    from plotly.graph_objects import Figure

PathLike = str | os.PathLike[str]


def path_of(value: object, name: str = "path", required: str = "a path") -> Path:
    """Return an argument as a path; ConfigError, which states what is `required`, if it cannot be a path."""
    if not isinstance(value, str | os.PathLike):
        raise wrong_type(name, value, required)
    if not str(value):
        raise ConfigError(f"'{name}' is empty: {required} is required")
    if "\0" in str(value):
        raise ConfigError(f"'{name}' is {str(value)!r:.60}, which contains a NUL character: {required} is required")
    return Path(value)


def wrong_type(name: str, value: object, required: str) -> ConfigError:
    """Return the error for the argument `name`, which has the wrong type."""
    return ConfigError(f"{name} has the type {type(value).__name__}: {required} is required")


class Shown:
    """Base class of the extended dataclasses: they display their facts in one line and as an HTML table."""

    _extended: ClassVar[type[Any]]  #: Dataclass of a lower layer that the class extends.

    @classmethod
    def of(cls, value: Any, **further: Any) -> Self:  # noqa: ANN401 - the extended dataclass, and fields of this class
        """Return a value of the extended type as this type; `further` are fields that only this type has.

        Fields of a subclass of the extended type are omitted, such as the uncertainty of a truth in a trajectory.
        ConfigError for a value of another type.
        """
        if not isinstance(value, cls._extended):
            raise wrong_type("value", value, f"a {cls.__name__}")
        given: type[Any] = cls if isinstance(value, cls) else cls._extended
        return cls(**{item.name: getattr(value, item.name) for item in fields(given)} | further)

    def _facts(self) -> dict[str, str]:
        """Return the displayed facts by name."""
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


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory(Shown, trajectory.Trajectory):
    """Stamped poses of RB in DS, stored exactly as given (not sorted, quaternions not normalised).

    If the attitudes are unknown, every quaternion is zero, as in a message with an unset orientation. Iterating and
    `poses[3]` return `(stamp_ns, pose)`; `poses[10:20]` and masks return a trajectory.
    """

    _extended = trajectory.Trajectory
    #: The calls that estimated the poses: time, memory, state, covariance. Empty if unknown.
    records: tuple[CallRecord, ...] = ()
    method: MethodRecord | None = None  #: The method that estimated the poses; None if unknown.

    def __post_init__(self) -> None:
        """Check the poses, their calls and the method; GeometryError if they are invalid."""
        super().__post_init__()
        _check_calls(self.records, self.method)
        if len(self.records) not in (0, len(self)):
            raise GeometryError(
                f"records has {len(self.records)} calls for {len(self)} poses: a tuple with one call for each pose, or "
                "an empty tuple, is required"
            )

    @classmethod
    def from_estimates(cls, estimates: Iterable[PoseEstimate]) -> Self:
        """Return the poses of estimates, as `sfr.localise(..., live=True)` and `sfr.Localiser` return them.

        The calls have the states, reasons and covariances of the estimates. Their time and memory are unknown.
        ConfigError if an item is not a PoseEstimate.
        """
        if not isinstance(estimates, Iterable):
            raise wrong_type("estimates", estimates, "a sequence of PoseEstimate")
        found = [*estimates]
        for item in found:
            if not isinstance(item, PoseEstimate):
                raise wrong_type("an item of estimates", item, "a PoseEstimate")
        poses = cls.from_poses((item.stamp_ns, item.T_ds_rb) for item in found)
        return replace(poses, records=tuple(call_of_estimate(item, CallUsage()) for item in found))

    @staticmethod
    def load(path: PathLike, columns: str = "") -> Trajectory:
        """Read a file; the format is detected from the content: csv of the suite, TUM, KITTI, EuRoC, any other table.

        `columns` names the columns of a table that does not name them, as `--columns` of the commands:
        `t[s],x,y,z,qx,qy,qz,qw`. A UserWarning reports an inferred format or unit, and skipped rows. KITTI poses
        require a file with their times. InputError for poses without stamps: give their path to `sfr.score`, which uses
        the stamps of the other trajectory.
        """
        if not isinstance(columns, str):
            raise wrong_type("columns", columns, "a text such as 't[s],x,y,z'")
        found = read_trajectory_file(path_of(path), columns, 'columns="COLUMNS"')
        if found.is_announced:
            warnings.warn(found.text, UserWarning, stacklevel=2)
        return Trajectory.of(found.stamped)

    def save(self, path: PathLike) -> None:
        """Write a file; the suffix selects the format: `.csv`, `.txt` or `.tum`, `.kitti`, `.euroc.csv`.

        OutputError for another suffix, for KITTI poses without attitudes, and for a trajectory without poses.
        """
        if not len(self):
            raise OutputError(f"cannot write '{path}': the trajectory has no pose; save a trajectory with poses")
        save_trajectory(path_of(path), self)

    def to_stats(self, path: PathLike) -> None:
        """Write one row per call (time, memory, state, covariance) as `sfr localise --stats` does.

        ConfigError for a trajectory without calls, OutputError if the file cannot be written.
        """
        _save_calls(path, "sfr.localise", Task.LOCALISATION, self)

    def to_pandas(self) -> pandas.DataFrame:
        """Return a pandas DataFrame, one row per pose, indexed by `stamp_ns`; with `state` and `reason` if known."""
        columns = np.hstack((self.positions, self.quats_xyzw)).T
        frame = data_frame(dict(zip(("x", "y", "z", "qx", "qy", "qz", "qw"), columns, strict=True)))
        frame.index = self.stamps_ns
        frame.index.name = "stamp_ns"
        if self.records:
            frame["state"] = [record.state for record in self.records]
            frame["reason"] = [record.reason for record in self.records]
        return frame

    def plot(self, truth: trajectory.Trajectory | None = None, align: str = "none") -> Figure:
        """Return the path as a plotly figure, as in `sfr report`; with a ground truth, also the distance to it.

        `align` is the alignment with the truth: `none`, `origin`, `se3` or `sim3`. ConfigError for another value, and
        for an alignment without a truth. MetricsError if the poses have no common stamps or cannot be aligned.
        """
        from sfr_loc_map.report.path_plot import curves_of, path_plot
        from sfr_loc_map.report.plots import to_figure

        if truth is not None and not isinstance(truth, trajectory.Trajectory):
            raise wrong_type("truth", truth, "a Trajectory")
        config = build(AlignedErrorConfig, {"align": align}, origin="")
        if truth is None and config.align != "none":
            raise ConfigError(f"'align' is '{align}', but no truth is given: give the truth, or omit align")
        return to_figure(path_plot(curves_of({"estimate": self}, truth, config)))

    def at_rows(self, rows: NDArray[np.intp]) -> Self:
        """Return the poses and calls in `rows`; the step of a call that does not follow its previous call is None."""
        poses = trajectory.Trajectory.at_rows(replace(self, records=()), rows)
        if not self.records:
            return poses
        numbers = rows.tolist()
        calls = tuple(
            self.records[row] if row == before + 1 else replace(self.records[row], step=None)
            for before, row in pairwise([-1, *numbers])
        )
        return replace(poses, records=calls)

    def _facts(self) -> dict[str, str]:
        duration_s = float(np.ptp(self.stamps_ns)) / NS_PER_S if len(self) else 0.0
        length_m = float(np.linalg.norm(np.diff(self.positions, axis=0), axis=1).sum())
        facts = {"poses": f"{len(self)} poses", "duration": f"{duration_s:.1f} s", "path": f"{length_m:.2f} m"}
        if self.records:
            states = Counter(record.state for record in self.records)
            facts["states"] = ", ".join(f"{count} {state}" for state, count in states.items())
        return facts


@dataclass(frozen=True, eq=False, repr=False)
class Truth(Trajectory, trajectory.Truth):
    """True poses of RB in DS; if the attitudes are unknown, the true positions of a point of RB."""

    _extended = trajectory.Truth


@dataclass(frozen=True, eq=False, repr=False)
class PointCloud(Shown, cloud.PointCloud):
    """Points in LM, each with its pixel and stereo pair; one row per point.

    `fused` is True if several pairs were fused into one surface, and False if the cloud keeps the points of each pair.
    `fused` and the stamps of the pairs are None if unknown.
    """

    _extended = cloud.PointCloud
    records: tuple[CallRecord, ...] = ()  #: The calls that produced the points; empty if unknown.
    method: MethodRecord | None = None  #: The method that produced the points; None if unknown.
    #: Width and height of an organised cloud file whose pixels follow from the order of its points; None for others.
    grid: tuple[int, int] | None = None
    not_finite: int = 0  #: Number of points of a file that were omitted because a coordinate is not finite.

    def __post_init__(self) -> None:
        """Check the points, the calls and the method; GeometryError if they are invalid."""
        super().__post_init__()
        _check_calls(self.records, self.method)

    @staticmethod
    def load(path: PathLike) -> PointCloud:
        """Read a cloud file: .ply, .pcd or .npz, with the pixel and pair of each point, or organised.

        InputError if the file is missing or invalid, or if its points have no pixels.
        """
        found = load_cloud(path_of(path))
        if found.cloud is None:
            raise InputError(f"'{path}' has points without pixels (u, v, pair): give the path itself to sfr.score")
        return PointCloud.of(found.cloud, grid=found.grid, not_finite=found.not_finite)

    @property
    def loaded(self) -> LoadedCloud:
        """The cloud in the form in which its file is read, so that the cloud and its file have equal scores."""
        return replace(LoadedCloud.of(self), grid=self.grid, not_finite=self.not_finite)

    def save(self, path: PathLike) -> None:
        """Write the cloud: .ply, .pcd or .npz. OutputError for another suffix, or if the file cannot be written."""
        save_cloud(path_of(path), self)

    def to_stats(self, path: PathLike) -> None:
        """Write one row per call (time, memory, state) as `sfr map --stats` does.

        ConfigError for a cloud without calls, OutputError if the file cannot be written.
        """
        _save_calls(path, "sfr.map", Task.MAPPING, self)

    def to_pandas(self) -> pandas.DataFrame:
        """Return a pandas DataFrame with one row per point."""
        structured = self.to_structured()
        return data_frame({name: structured[name] for name in cloud.FIELD_TYPES})

    def _facts(self) -> dict[str, str]:
        facts = {"points": f"{len(self)} points"}
        if len(self):
            sides = self.xyz.max(axis=0) - self.xyz.min(axis=0)
            facts["extent"] = " x ".join(f"{side:.1f}" for side in sides.tolist()) + " m"
            facts["sigma"] = f"median sigma {np.median(self.sigma):.2g} m"
        if self.fused is not None:
            facts["fused"] = "fused" if self.fused else "not fused"
        return facts


@dataclass(frozen=True, eq=False, repr=False)
class Source(Shown, sequence.Source):
    """An opened data set folder, bag or sequence. A field is None if the source does not contain it."""

    _extended = sequence.Source

    @property
    def truth(self) -> Truth | None:
        """True poses of RB in DS; None without truth."""
        found = super().truth
        return None if found is None else Truth.of(found)

    def _facts(self) -> dict[str, str]:
        holds = [str(self.format)]
        if self.loc is not None:
            holds.append(f"{len(self.loc)} localisation pairs")
            holds.append("without truth" if self.truth is None else "with truth")
        if self.nav is not None:
            holds.append(f"{len(self.nav)} mapping pairs")
        return {"path": repr(str(self.path)), "holds": ", ".join(holds)}


class Score(score.Score, frozen=True, kw_only=True, tag_field="schema", tag=score.SCHEMA):
    """The score of a run."""

    @classmethod
    def of(cls, found: score.Score) -> Self:
        """Return a score of the lower layers as this type; ConfigError for another object."""
        if not isinstance(found, score.Score):
            raise wrong_type("value", found, "a Score")
        return cls(**msgspec.structs.asdict(found))

    @property
    def _plain(self) -> score.Score:
        """The score as a value of the lower layers, whose look-ups also accept names without a row."""
        return score.Score(**msgspec.structs.asdict(self))

    @staticmethod
    def load(path: PathLike) -> Score:
        """Read the JSON of a score, as `save` and `sfr score --json` write it; InputError if the file is invalid."""
        return Score.of(load_score(path_of(path)))

    def figure(
        self,
        figure: str,
        *,
        subject: str = ANY,
        condition: str | Condition | None = ANY,
        part: str | None = score.JUDGED_ROW,
    ) -> Row | None:
        """Return the row of a figure and a part, or without `part` the judged row; None if the score lacks the figure.

        Without `condition` the first condition is used; `condition=None` selects the row of a figure that has no
        condition. ConfigError for a figure that does not exist, for a figure without a judged row if `part` is not
        given, and for a subject, condition or part that the figure does not have in this score; the message then lists
        the available ones.
        """
        _check_name("figure", figure, {*KINDS, *(row.figure for row in self.figures)})
        self._check_keys(figure, {"subject": subject, "condition": condition, "part": part})
        return super().figure(figure, subject=subject, condition=condition, part=part)

    def _check_keys(self, figure: str, keys: Mapping[str, str | Condition | None]) -> None:
        """Raise ConfigError if no row of a figure has the given keys; a figure without rows is accepted."""
        rows = tuple(self.rows(figure))
        for name, given in keys.items():
            if given is not None and not isinstance(given, str | Condition):
                raise wrong_type(name, given, "a text")
            if given == score.JUDGED_ROW:
                continue
            left = tuple(find_rows(rows, **{name: given}))  # type: ignore[arg-type] # the name determines the type
            if rows and not left:
                known = ", ".join(dict.fromkeys(str(getattr(row, name)) for row in rows))
                raise ConfigError(f"figure '{figure}' has no {name} '{given}' in this score: give one of {known}")
            rows = left

    def number(
        self,
        figure: str,
        statistic: str = "value",
        *,
        subject: str = ANY,
        condition: str | Condition | None = ANY,
        part: str | None = score.JUDGED_ROW,
    ) -> float | None:
        """Return one statistic of a figure; None if it is undefined, or if the score lacks the figure.

        The statistic of a count, fraction or peak is `value`. Errors, times and other figures of many values have
        `mean`, `sigma`, `mean_plus_3sigma`, ... instead. ConfigError as for `figure`, for a statistic that does not
        exist, and for `value` of a figure of many values or another statistic of a figure with one number.
        """
        _check_name("statistic", statistic, RowNumbers.__struct_fields__)
        row = self.figure(figure, subject=subject, condition=condition, part=part)
        if row is None:
            return None
        found = row.statistic(statistic)
        if found is None and row.is_one_number != (statistic == "value"):
            required = "omit the statistic" if row.is_one_number else f"give one of {', '.join(STATISTICS)}"
            raise ConfigError(f"figure '{figure}' has no statistic '{statistic}': {required}")
        return found

    def to_json(self) -> str:
        """Return the JSON (`sfr-score/2`) that `sfr score --json` writes."""
        return to_json(self)

    def save(self, path: PathLike) -> None:
        """Write the JSON; OutputError for a suffix other than `.json`, or if the file cannot be written."""
        file = path_of(path)
        check_suffix(file, (".json",))
        write_text(self.to_json(), file)

    def report(self, path: PathLike) -> None:
        """Write the report page that `sfr score --html` writes.

        OutputError for a suffix other than `.html` or `.htm`, or if the file cannot be written.
        """
        from sfr_loc_map.report.page import write_page

        file = path_of(path)
        check_suffix(file, HTML_SUFFIXES)
        write_page(self._plain, file)

    def to_markdown(self) -> str:
        """Return all tables as Markdown."""
        from sfr_loc_map.report.score_tables import score_markdown

        return score_markdown(self._plain)

    def to_pandas(self, table: str = "figures") -> pandas.DataFrame:
        """Return a pandas table: `figures` has one row per figure, `sub_trajectories` one row per sub-trajectory.

        For a condition with many sub-trajectories only every n-th is kept, and the column `every` is n.
        `sfr score --pieces` writes all sub-trajectories. ConfigError for another name of a table, MissingExtraError if
        pandas is not installed.
        """
        if not isinstance(table, str):
            raise wrong_type("table", table, "figures or sub_trajectories")
        if table == "figures":
            return data_frame({name: [row.as_dict()[name] for row in self.figures] for name in COLUMNS})
        if table != "sub_trajectories":
            raise ConfigError(f"table is '{table}': figures or sub_trajectories is required")
        details = None if self.details is None else self.details.trajectory
        return data_frame({} if details is None else columns_of(details.sub_trajectories))

    def plot(self, name: str | None = None) -> Figure:
        """Return a plot of the report page as a plotly figure for a notebook; by default the first plot.

        ConfigError, which lists the plots, for a name that the score does not have.
        """
        from sfr_loc_map.report.page import score_plots
        from sfr_loc_map.report.plots import to_figure

        plots = {plot.name: plot for _, plots in score_plots(self._plain) for plot in plots}
        if not plots:
            raise ConfigError("this score has no plots: it contains no data of a drive, a map or calls")
        chosen = next(iter(plots)) if name is None else name
        if not isinstance(chosen, str):
            raise wrong_type("name", chosen, "the name of a plot, or None,")
        if chosen not in plots:
            raise ConfigError(f"this score has no plot '{chosen}': give one of {', '.join(plots)}")
        return to_figure(plots[chosen])

    def __repr__(self) -> str:
        from sfr_loc_map.report.score_tables import row_title
        from sfr_loc_map.tables.model import UNKNOWN

        texts = [self.verdict or "no verdict"]
        for row in (self.judged_row("position"), self.judged_row("point_error")):
            if row is not None:
                total = UNKNOWN if row.mean_plus_3sigma is None else f"{row.mean_plus_3sigma:.4g} {row.unit}"
                texts.append(f"{row_title(row)} {total} (mean + 3 sigma)")
        return f"Score({', '.join(texts)})"

    def _repr_html_(self) -> str:
        from sfr_loc_map.report.score_tables import summary_tables
        from sfr_loc_map.tables.formats import to_html

        tables = "".join(to_html(table) for table in summary_tables(self._plain))
        return f"<b>{self.verdict or 'no verdict'}</b>{tables}"


def _check_calls(records: object, method: object) -> None:
    """Raise GeometryError unless the calls of a result are a tuple of CallRecord, and its method a MethodRecord."""
    if not isinstance(records, tuple) or not all(isinstance(item, CallRecord) for item in records):
        raise GeometryError(f"records is {records!r:.60}: a tuple of CallRecord is required")
    if method is not None and not isinstance(method, MethodRecord):
        raise GeometryError(f"method is {method!r:.60}: a MethodRecord or None is required")


def _save_calls(path: PathLike, function: str, task: Task, result: Trajectory | PointCloud) -> None:
    """Write the calls of a result of a function of this interface; ConfigError if the result has no calls."""
    if not result.records:
        raise ConfigError(f"the result has no calls: to_stats() requires a result of {function}")
    methods = {} if result.method is None else {task: result.method}
    estimate = result if isinstance(result, Trajectory) else None
    cloud = result if isinstance(result, PointCloud) else None
    save_stats(path_of(path), result.records, methods, estimate, cloud=cloud)


def _check_name(kind: str, name: object, known: Collection[str]) -> None:
    """Raise ConfigError if a name of this kind, such as `figure`, is unknown."""
    if not isinstance(name, str):
        raise wrong_type(kind, name, "a text")
    if name not in known:
        raise ConfigError(f"there is no {kind} '{name}'{suggestion(name, known)}: give one that exists")


def data_frame(columns: Mapping[str, Any]) -> pandas.DataFrame:
    """Return a pandas table of columns; raise MissingExtraError if pandas is not installed."""
    try:
        import pandas
    except ImportError as error:
        raise MissingExtraError("to_pandas() requires pandas: pip install 'sfr_loc_map[notebook]'") from error
    return pandas.DataFrame(dict(columns))
