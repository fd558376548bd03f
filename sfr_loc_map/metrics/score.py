"""The score: one table of figures, a table of verdicts, and a few records about how they were made.

A row of figures is in `metrics.table`, a verdict in `metrics.verdict`, the records in `metrics.records`, and what plots
are drawn from in `metrics.details`.

`Score.figure` finds a row of the table: `score.figure("position", condition="distance=5")`. JSON (`sfr-score/2`) is
written and read by msgspec alone (`metrics.score_json`): every field has its own name there, what does not apply is
null or omitted. The comments at the fields are its reference (docs/reference/score.md). Numbers in brackets are
clauses of the specification. N is the start of a sub-trajectory, N+x its end.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from sfr_loc_map.display import data_frame
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.metrics.catalogue import ANY, Subject
from sfr_loc_map.metrics.config import Condition, VerdictState
from sfr_loc_map.metrics.details import Details, ErrorRows, columns_of
from sfr_loc_map.metrics.limits import Rules
from sfr_loc_map.metrics.records import (
    Alignment,
    Association,
    CallRecords,
    CloudRecord,
    ConventionRecord,
    ExternalScore,
    FindingRecord,
    MethodRecord,
    ProcessUsage,
    Provenance,
    Record,
    TargetRun,
    TruthRecord,
)
from sfr_loc_map.metrics.row_part import RowPart
from sfr_loc_map.metrics.table import COLUMNS, POOLED, Figure, find_rows
from sfr_loc_map.metrics.verdict import Verdict

if TYPE_CHECKING:
    import pandas
    from plotly.graph_objects import Figure as PlotlyFigure

SCHEMA = "sfr-score/2"


def written(default: Any) -> Any:  # noqa: ANN401 - stands for the field's value, as msgspec.field does
    """Declare a field that is always written, null or empty where it is unknown."""
    return msgspec.field(default_factory=lambda: default)


class Score(Record, frozen=True, kw_only=True, tag_field="schema", tag=SCHEMA):
    """The score of a run."""

    #: Verdict over all limits; null without limits, or where nothing is judged.
    verdict: VerdictState | None = written(None)
    figures: tuple[Figure, ...] = written(())  #: The table of figures.
    #: One for each limit, in their order, after those on findings and on what is missing.
    verdicts: tuple[Verdict, ...] = written(())
    association: Association | None = written(None)  #: How estimates found their ground truth.
    truth: TruthRecord | None = written(None)  #: Properties of the ground truth of the trajectory.
    provenance: Provenance | None = written(None)  #: What the score was made of.
    alignment: Alignment | None = None  #: How APE and RPE were computed, where they were asked for.
    cloud: CloudRecord | None = None  #: How a cloud was compared with the ground truth.
    calls: CallRecords | None = None  #: How times and memory were measured on this host.
    target: TargetRun | None = None  #: Where calls were measured elsewhere.
    method: MethodRecord | None = None  #: Whose figures these are; null where the inputs do not name it.
    findings: tuple[FindingRecord, ...] = ()  #: What that method did wrong, one for each kind.
    processes: ProcessUsage | None = None  #: What the processes of the method took; null where it has none of its own.
    external: ExternalScore | None = None  #: How an external node behaved; null where there was none.
    convention: ConventionRecord | None = None  #: How the poses were converted before they were scored.
    warnings: tuple[str, ...] = ()  #: One line for each.
    contradiction: str | None = None  #: Convention mismatch of estimate and truth: no figure of them judges anything.
    incomplete: str | None = None  #: What of the expected data cannot be judged, unless a part was asked for.
    rules: Rules | None = None  #: Rules by which the verdicts follow from the figures; null where there are no limits.
    errors: tuple[ErrorRows, ...] = ()  #: All errors of the figures of the trajectory that are limited.
    details: Details | None = None  #: What plots are drawn from.

    # ---- look-up

    def rows(
        self,
        figure: str = ANY,
        *,
        subject: str = ANY,
        condition: str | Condition | None = ANY,
        part: str | RowPart | None = ANY,
    ) -> list[Figure]:
        """Return the rows of the table of figures that have these values, in their order."""
        return list(find_rows(self.figures, figure, subject=subject, condition=condition, part=part))

    def figure(
        self,
        figure: str,
        *,
        subject: str = ANY,
        condition: str | Condition | None = ANY,
        part: str | RowPart | None = ANY,
    ) -> Figure | None:
        """Return the row of a figure and a part, without a part the row that is judged; None if there is no such row.

        Of several conditions the first one counts. ConfigError, which names the parts, if none is given and all rows of
        the figure have one that is not judged.
        """
        if part != ANY:
            return next(find_rows(self.figures, figure, subject=subject, condition=condition, part=part), None)
        row = self.judged_row(figure, subject=subject, condition=condition)
        if row is None and (rows := self.rows(figure, subject=subject, condition=condition)):
            parts = ", ".join(dict.fromkeys(str(row.part) for row in rows))
            raise ConfigError(f"figure '{figure}' has no row without a part: give part=, one of {parts}")
        return row

    def judged_row(self, figure: str, *, subject: str = ANY, condition: str | Condition | None = ANY) -> Figure | None:
        """Return the row of a figure that verdicts are on, whatever the order of the rows; None without one.

        Errors of sub-trajectories are judged by one reading of the document (`association.rebase`), those of a suite
        over all drives (`pooled`). Of every other figure the row without a part is judged.
        """
        reading = self.reading
        for row in self.rows(figure, subject=subject, condition=condition):
            is_of_pieces = row.subject is Subject.TRAJECTORY and row.condition is not None
            if row.part in ((reading, POOLED) if is_of_pieces else (None,)):
                return row
        return None

    def number(
        self,
        figure: str,
        statistic: str = "value",
        *,
        subject: str = ANY,
        condition: str | Condition | None = ANY,
        part: str | RowPart | None = ANY,
    ) -> float | None:
        """Return one number of a figure, None where it is undefined or there is no such row."""
        row = self.figure(figure, subject=subject, condition=condition, part=part)
        return None if row is None else row.statistic(statistic)

    def place_of(self, row: Figure | None) -> int | None:
        """Return the place of a row of this score in its table of figures, None for no row."""
        return next((place for place, each in enumerate(self.figures) if each is row), None)

    def row_of(self, verdict: Verdict) -> Figure | None:
        """Return the row that a verdict of this score is on, None where it is on none."""
        return None if verdict.row is None else self.figures[verdict.row]

    def errors_of(self, figure: str, condition: str | None) -> FloatArray | None:
        """Return all errors `(n, d)` of a figure, NaN where one is unknown; None if the score does not keep all.

        What plots are drawn from counts only if no sub-trajectory is omitted there.
        """
        names = (figure, condition)
        columns = next((item.errors for item in self.errors if (item.figure, item.condition) == names), ())
        details = None if self.details is None else self.details.trajectory
        for rows in () if columns or details is None else details.sub_trajectories:
            if rows.condition == condition and rows.every == 1:
                columns = rows.errors_of(figure)
        return np.stack([np.array(values, np.float64) for values in columns], axis=1) if columns else None

    def has(self, subject: str) -> bool:
        """Return whether there is a figure about a subject."""
        return any(row.subject == subject for row in self.figures)

    @property
    def conditions(self) -> tuple[str, ...]:
        """The conditions of sub-trajectories, in their order."""
        return tuple(dict.fromkeys(row.condition for row in self.rows("position") if row.condition is not None))

    @property
    def reading(self) -> str | None:
        """The reading of the document that is judged, None without a trajectory."""
        return None if self.association is None else str(self.association.rebase)

    @property
    def fatal_findings(self) -> tuple[FindingRecord, ...]:
        """The findings with which no score can be a pass."""
        return tuple(item for item in self.findings if item.kind.fails)

    @property
    def on_limits(self) -> tuple[Verdict, ...]:
        """The verdicts on limits, which follow those on findings and on what is missing."""
        count = 0 if self.rules is None else len(self.rules.limits)
        return self.verdicts[len(self.verdicts) - count :]

    @property
    def missed(self) -> tuple[Verdict, ...]:
        """The verdicts that are `fail`."""
        return tuple(item for item in self.verdicts if item.state is VerdictState.FAIL)

    # ---- files, tables and figures for users of Python

    @staticmethod
    def load(path: str | os.PathLike[str]) -> Score:
        """Read the JSON of a score."""
        from sfr_loc_map.metrics.score_json import load_score

        return load_score(Path(path))

    def to_json(self) -> str:
        """Return the JSON (`sfr-score/2`), the same as of `sfr score --json`."""
        from sfr_loc_map.metrics.score_json import to_json

        return to_json(self)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the JSON."""
        from sfr_loc_map.atomic import write_text

        write_text(self.to_json(), Path(path))

    def report(self, path: str | os.PathLike[str]) -> None:
        """Write the report page, the same as of `sfr score --html`."""
        from sfr_loc_map.report.page import write_page

        write_page(self, Path(path))

    def to_markdown(self) -> str:
        """Return all tables as Markdown."""
        from sfr_loc_map.report.score_tables import score_markdown

        return score_markdown(self)

    def to_pandas(self, table: str = "figures") -> pandas.DataFrame:
        """Return a pandas table: `figures`, one row per figure, or `sub_trajectories`, thinned.

        Of a condition with many sub-trajectories only every n-th is kept; the column `every` is n. `sfr score --pieces`
        writes all of them.
        """
        if table == "figures":
            return data_frame({name: [row.as_dict()[name] for row in self.figures] for name in COLUMNS})
        if table != "sub_trajectories":
            raise ConfigError(f"table is '{table}': must be figures or sub_trajectories")
        details = None if self.details is None else self.details.trajectory
        return data_frame({} if details is None else columns_of(details.sub_trajectories))

    def plot(self, name: str | None = None) -> PlotlyFigure:
        """Return a figure of the report as a plotly figure, which a notebook shows; by default the first."""
        from sfr_loc_map.report.plots import to_figure
        from sfr_loc_map.report.score_plots import score_plots

        plots = {plot.name: plot for _, plots in score_plots(self) for plot in plots}
        chosen = next(iter(plots), None) if name is None else name
        if chosen not in plots:
            available = ", ".join(plots) or "none"
            raise ConfigError(f"this score has no figure '{name or 'at all'}': it has {available}")
        return to_figure(plots[chosen])

    def __repr__(self) -> str:
        from sfr_loc_map.report.score_tables import row_title
        from sfr_loc_map.report.tables import UNKNOWN

        texts = [self.verdict or "no verdict"]
        for row in (self.judged_row("position"), self.judged_row("point_error")):
            if row is not None:
                total = UNKNOWN if row.mean_plus_3sigma is None else f"{row.mean_plus_3sigma:.4g} {row.unit}"
                texts.append(f"{row_title(row)} {total} (mean + 3 sigma)")
        return f"Score({', '.join(texts)})"

    def _repr_html_(self) -> str:
        from sfr_loc_map.report.score_tables import summary_tables
        from sfr_loc_map.report.tables import to_html

        return f"<b>{self.verdict or 'no verdict'}</b>" + "".join(to_html(table) for table in summary_tables(self))
